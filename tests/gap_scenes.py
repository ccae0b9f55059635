"""Pictures of a corner of a battery in its seat, with the truth about the gap, for the tests and the benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellctl.geometry import Px
from cellctl.vision import ExpectedEdge, Limits, Search
from cellctl.vision.gap import ExpectedGap, GapMeasurement, find_gap
from simulators.parts import BODY, FOIL, SLIT, BaseDrawing, BatteryDrawing, base, battery
from simulators.place import Place
from simulators.render import Disks, Optics, Polygon, Scene, Shape, Stroke, placed, render
from simulators.supply import SIZE_LIMIT_MM
from tests.vision_scenes import HERE, Camera, textured, to_px, walk

SEARCH_MM, WIDEST_MM, TURN_DEG = 0.3, 0.4, 0.3
SKIP_MM, LENGTHS_MM = 2.0, (9.0, 5.5)
VIEW_MM = (4.5, 3.5)
SEAT_MM, PLAY_MM = (53.2, 85.2), 0.1
SIZE_SD_MM = 0.02
BLUR_SD_PX = 0.03  # how well the base shows the camera's blur


@dataclass(frozen=True)
class Lie:
    """How a battery lies in its seat: its corner against that of the drawing, and the sizes of both parts."""

    dx_mm: float = 0.0
    dy_mm: float = 0.0
    dt_deg: float = 0.0
    seat_mm: tuple[float, float] = SEAT_MM
    battery_mm: tuple[float, float] = (53.0, 85.0)
    corner: tuple[int, int] = (-1, -1)

    @property
    def seat_from_battery(self) -> Place:
        """Of the middles."""
        (sx, sy), (sw, sh), (bw, bh) = self.corner, self.seat_mm, self.battery_mm
        corner = Place(sx * (sw / 2 - PLAY_MM) + self.dx_mm, sy * (sh / 2 - PLAY_MM) + self.dy_mm, self.dt_deg)
        return corner @ Place(-sx * bw / 2, -sy * bh / 2)


class Dirt(NamedTuple):
    """Shapes that spoil a picture, in the frame of the seat's corner, x and y along its edges: on its floor, on top."""

    floor: Sequence[Shape] = ()
    over: Sequence[Shape] = ()


CLEAN = Dirt()
PLAIN_CAMERA, CENTRED = Camera(), Lie()


class GapView(NamedTuple):
    """A picture, what to look for in it, and where the features truly are."""

    pixels: np.ndarray
    expected: ExpectedGap
    truth: tuple[Px, Px]  # corners of seat and battery
    gaps_mm: tuple[float, float]  # between these, across the seat's edges: along the width, along the height
    optics: Optics
    base: Place  # where the cell believes the base, in the camera's object plane

    def found(self, **limits: float) -> GapMeasurement:
        scale = self.optics.px_per_mm
        rules = replace(Limits(corner_skip_px=SKIP_MM * scale, min_contrast=40.0), **limits)
        return find_gap(self.pixels, self.expected, Search(SEARCH_MM * scale, TURN_DEG), rules)


def some_lie(rng: np.random.Generator, corner: tuple[int, int] = (-1, -1)) -> Lie:
    """A battery placed as a cell places it, or somewhat worse, of parts as a line supplies them."""
    dx, dy = rng.normal(0.0, 0.012, 2).clip(-0.04, 0.04)
    sizes = np.clip(rng.normal(0.0, SIZE_SD_MM, 4), -SIZE_LIMIT_MM, SIZE_LIMIT_MM)
    seat = (SEAT_MM[0] + float(sizes[0]), SEAT_MM[1] + float(sizes[1]))
    held = (53.0 + float(sizes[2]), 85.0 + float(sizes[3]))
    return Lie(float(dx), float(dy), float(rng.normal(0.0, 0.004)), seat, held, corner)


def some_camera_1(rng: np.random.Generator) -> Camera:
    """A camera that looks down, mounted roughly along the robot's axes, with some blur and noise."""
    turn = float(rng.choice([0.0, 90.0, 180.0, -90.0]) + rng.uniform(-3.0, 3.0))
    return Camera(turn, "down", blur_px=float(rng.uniform(0.8, 1.5)), noise=float(rng.uniform(2.0, 5.0)))


def some_stop(rng: np.random.Generator) -> Place:
    """How far a base is from where the stop over its seat expects it, and how it is turned."""
    x, y = (float(x) for x in rng.uniform(-0.15, 0.15, 2))
    return Place(x, y, float(rng.uniform(-1.5, 1.5)))


def gap_view(
    rng: np.random.Generator,
    camera: Camera = PLAIN_CAMERA,
    lie: Lie = CENTRED,
    place: Place = HERE,
    dirt: Dirt = CLEAN,
    texture: float = 1.5,
) -> GapView:
    """A corner of a seated battery; `place` shifts and turns the base about that corner, its turn is expected."""
    (sx, sy), drawing = lie.corner, BaseDrawing(seat_width_mm=lie.seat_mm[0], seat_height_mm=lie.seat_mm[1])
    held = BatteryDrawing(width_mm=lie.battery_mm[0], height_mm=lie.battery_mm[1])
    mark = Place(drawing.seat_x_mm + sx * SEAT_MM[0] / 2, drawing.seat_y_mm + sy * SEAT_MM[1] / 2)
    optics = camera.aimed((mark.x_mm - sx * VIEW_MM[0], mark.y_mm - sy * VIEW_MM[1]))
    believed = mark @ Place(0.0, 0.0, place.t_deg)
    edges = _expected(optics, believed, lie.corner)
    moved = mark @ place @ mark.back()
    seat = moved @ Place(drawing.seat_x_mm, drawing.seat_y_mm)
    corner = seat @ Place(sx * lie.seat_mm[0] / 2, sy * lie.seat_mm[1] / 2)
    shapes = [
        *placed(textured(base(drawing, SLIT), texture), moved),
        *placed(_mirrored(dirt.floor, lie.corner), corner),
        *placed(textured(battery(held, SLIT), texture), seat @ lie.seat_from_battery),
        *placed(_mirrored(dirt.over, lie.corner), corner),
    ]
    pixels = render(Scene(45.0, shapes), optics, rng, exposure=camera.exposure)
    blur = camera.blur_px + float(rng.normal(0.0, BLUR_SD_PX))
    expected = ExpectedGap(*edges, WIDEST_MM * optics.px_per_mm, blur)
    return GapView(pixels, expected, *_truth(optics, seat, lie), optics, believed @ mark.back())


def _expected(optics: Optics, corner: Place, signs: tuple[int, int]) -> tuple[ExpectedEdge, ExpectedEdge]:
    """The seat's edges as a calibrated cell expects them."""
    sx, sy = signs
    ends = [(0.0, 0.0), (-sx * (SKIP_MM + LENGTHS_MM[0]), 0.0), (0.0, -sy * (SKIP_MM + LENGTHS_MM[1])), (sx, sy)]
    start, end_1, end_2, outside = to_px(optics, [corner.point(*end) for end in ends])
    return walk(start, end_1, outside), walk(start, end_2, outside)


def _truth(optics: Optics, seat: Place, lie: Lie) -> tuple[tuple[Px, Px], tuple[float, float]]:
    sx, sy = lie.corner
    corner = (sx * lie.seat_mm[0] / 2, sy * lie.seat_mm[1] / 2)
    held = lie.seat_from_battery.point(sx * lie.battery_mm[0] / 2, sy * lie.battery_mm[1] / 2)
    one, two = to_px(optics, [seat.point(*corner), seat.point(*held)])
    return (one, two), (sy * (corner[1] - held[1]), sx * (corner[0] - held[0]))


def _mirrored(shapes: Sequence[Shape], corner: tuple[int, int]) -> list[Shape]:
    """Shapes that are drawn for a corner whose edges run towards positive x and y, for another corner."""
    flip = -np.array(corner, float)
    return [
        replace(shape, centres=np.asarray(shape.centres) * flip)
        if isinstance(shape, Disks)
        else replace(shape, points=np.asarray(shape.points) * flip)
        for shape in shapes
    ]


# -- what spoils a picture ---------------------------------------------------------------------------------


def dirt(rng: np.random.Generator, *, strong: bool = False) -> Dirt:
    """Walls that shine, worn rims, scratches, dust and fibres in the slit, a blot of glare, something that covers."""
    much = 2 if strong else 1
    over: list[Shape] = [*_rims(rng, 12.0 * much), *_scratches(rng, 10 * much), *_dust(rng, 40 * much)]
    for _ in range(int(rng.integers(0, 2 * much + 1))):
        over.append(Disks(_beside(rng, 1), rng.uniform(0.1, 0.4 * much, 1), 235.0))
    if strong or rng.random() < 0.5:
        over.append(_cover(rng, float(rng.uniform(0.05, 0.2 * much))))
    return Dirt(_walls(rng, 15.0 * much), over)


def _walls(rng: np.random.Generator, most: float) -> list[Shape]:
    """What a camera that does not look quite straight down sees of the seat's walls."""
    x, y = rng.uniform(0.004, 0.03, 2)
    brighter = rng.uniform(0.3 * most, most, 2)
    return [
        Polygon(_box(-2.0, 0.0, 20.0, float(y)), SLIT + float(brighter[0]), over=SLIT),
        Polygon(_box(0.0, -2.0, float(x), 20.0), SLIT + float(brighter[1]), over=SLIT),
    ]


def _rims(rng: np.random.Generator, most: float) -> list[Shape]:
    """Rims of the seat and of the battery's foil that are a little brighter or darker than the rest."""
    wide, away = rng.uniform(0.02, 0.08, 4), rng.uniform(-most, most, 4)
    gap = 0.25  # behind any slit: this one lies on the foil
    return [
        Polygon(_box(1.5, -float(wide[0]), 20.0, 0.0), BODY + float(away[0]), over=BODY),
        Polygon(_box(-float(wide[1]), 1.5, 0.0, 20.0), BODY + float(away[1]), over=BODY),
        Polygon(_box(1.5, gap, 20.0, gap + float(wide[2])), FOIL + float(away[2]), over=FOIL),
        Polygon(_box(gap, 1.5, gap + float(wide[3]), 20.0), FOIL + float(away[3]), over=FOIL),
    ]


def _scratches(rng: np.random.Generator, count: int) -> list[Shape]:
    """Some anywhere, a quarter nearly along an edge."""
    shapes: list[Shape] = []
    for number in range(count):
        start, angle = rng.uniform((-4.0, -4.0), (13.0, 9.0)), float(rng.uniform(0.0, np.pi))
        if number % 4 == 0:
            start, angle = rng.uniform((-1.0, -0.6), (10.0, 0.6)), float(rng.normal(0.0, 0.02))
        way = float(rng.uniform(0.5, 5.0)) * np.array([np.cos(angle), np.sin(angle)])
        line = np.array([start, start + way])
        shapes.append(Stroke(line, float(rng.uniform(0.008, 0.05)), float(rng.uniform(20.0, 220.0))))
    return shapes


def _dust(rng: np.random.Generator, count: int) -> list[Shape]:
    """Grains, half of them near an edge, dark and bright, and some bright fibres across the slit."""
    anywhere = rng.uniform((-4.0, -4.0), (13.0, 9.0), (count // 2, 2))
    spots = np.concatenate([anywhere, _beside(rng, count - count // 2)])
    radii = rng.uniform(0.01, 0.06, count)
    half = count // 2
    fibres = [
        Stroke(np.array([spot - way, spot + way]), 0.012, 200.0)
        for spot, way in zip(_beside(rng, 4), rng.normal(0.0, 0.15, (4, 2)), strict=True)
    ]
    return [Disks(spots[:half], radii[:half], 30.0), Disks(spots[half:], radii[half:], 210.0), *fibres]


def _cover(rng: np.random.Generator, part: float) -> Shape:
    """A piece of foil that hides a part of one edge."""
    length = 11.0 if (along_x := rng.random() < 0.5) else 7.5
    start = float(rng.uniform(SKIP_MM, length - part * (length - SKIP_MM)))
    end = start + part * (length - SKIP_MM)
    box = _box(start, -1.0, end, 1.0) if along_x else _box(-1.0, start, 1.0, end)
    return Polygon(box, 180.0)


def _beside(rng: np.random.Generator, count: int) -> np.ndarray:
    """Places within 0.2 mm of an edge."""
    along, across = rng.uniform(0.5, 11.0, count), rng.normal(0.05, 0.1, count)
    on_x = rng.random(count) < 0.6
    return np.where(on_x[:, None], np.stack([along, across], axis=1), np.stack([across, 0.7 * along], axis=1))


def _box(left: float, low: float, right: float, high: float) -> np.ndarray:
    return np.array([[left, low], [right, low], [right, high], [left, high]])
