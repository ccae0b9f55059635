"""Pictures of parts with known truth, for the tests and the benchmark of vision."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from cellctl.geometry import Px
from cellctl.vision import (
    BaseMeasurement,
    BatteryMeasurement,
    Edge,
    ExpectedCircle,
    ExpectedEdge,
    Limits,
    Search,
    find_base,
    find_battery,
)
from simulators.parts import BaseDrawing, BatteryDrawing, base, battery
from simulators.place import Place
from simulators.render import Disks, Light, Optics, Polygon, Scene, Shape, Stroke, placed, render

Looks = Literal["down", "up"]

HOLE_MM, EDGE_MM = 3.0, 6.0
BASE_SEARCH, BATTERY_SEARCH = Search(1.5 * 136.36, 2.0), Search(2.5 * 136.36, 2.0)
UM_PER_PX = 1000.0 / 136.36
HERE, BASE = Place(0.0, 0.0), BaseDrawing()
PLAIN, LIGHT = Light(0.0, 0.0, 0.0), Light()


class View(NamedTuple):
    """A picture, what to look for in it, and where its features truly are in px."""

    pixels: np.ndarray
    features: tuple[ExpectedCircle, ExpectedEdge] | tuple[ExpectedEdge, ExpectedEdge]
    search: Search
    limits: Limits
    truth: tuple[Px, ...]  # base: hole, edge start, edge end; battery: corner, end of edge 1, end of edge 2
    optics: Optics

    def base(self) -> BaseMeasurement:
        return find_base(self.pixels, *self.features, self.search, self.limits)

    def battery(self) -> BatteryMeasurement:
        return find_battery(self.pixels, *self.features, self.search, self.limits)


@dataclass(frozen=True)
class Camera:
    """How the camera is mounted and what it does to a picture."""

    turn_deg: float = 0.0
    looks: Looks = "down"
    k1: float = 0.0
    noise: float = 2.5
    blur_px: float = 1.1
    exposure: float = 1.0
    light: Light = LIGHT

    def aimed(self, at_mm: tuple[float, float]) -> Optics:
        plain = Optics.aimed(at_mm, looks=self.looks, turn_deg=self.turn_deg)
        return replace(plain, k1=self.k1, noise=self.noise, blur_px=self.blur_px, light=self.light)


def some_camera(rng: np.random.Generator) -> Camera:
    """A camera mounted along or across the robot's axes or in between, mirrored or not."""
    turn = rng.choice([0.0, 90.0, 180.0, -90.0, float(rng.uniform(-180.0, 180.0))])
    looks: Looks = "down" if rng.random() < 0.5 else "up"
    return Camera(float(turn), looks, blur_px=float(rng.uniform(0.8, 1.5)))


def some_place(rng: np.random.Generator, within_mm: float = 1.0, within_deg: float = 1.5) -> Place:
    return Place(
        *(float(x) for x in rng.uniform(-within_mm, within_mm, 2)), float(rng.uniform(-within_deg, within_deg))
    )


def to_px(optics: Optics, points: Sequence[tuple[float, float]]) -> list[Px]:
    return [Px(float(u), float(v)) for u, v in optics.px_from_mm(np.array(points, float))]


def walk(start: Px, end: Px, bright: Px) -> ExpectedEdge:
    """The expected edge from start to end, with the bright side where `bright` lies."""
    left = (end.u - start.u) * (bright.v - start.v) - (end.v - start.v) * (bright.u - start.u) < 0
    return ExpectedEdge(start, end, left)


def base_view(
    rng: np.random.Generator,
    camera: Camera = Camera(),
    place: Place = HERE,
    drawing: BaseDrawing = BASE,
    over: Sequence[Shape] = (),
    texture: float = 1.5,
) -> View:
    """A base somewhere near the origin of the object plane; `over` lies on top of it, in the part's frame."""
    optics = camera.aimed((0.0, 2.0))

    def seen(where: Place, hole: float = EDGE_MM) -> list[Px]:
        return to_px(optics, [where.point(*p) for p in ((0.0, 0.0), (-7.0, hole), (7.0, hole), (0.0, hole - 1.0))])

    centre, start, end, inside = seen(Place(0.0, 0.0))
    features = (ExpectedCircle(centre, HOLE_MM * optics.px_per_mm, True), walk(start, end, inside))
    shapes = [*placed(textured(base(drawing), texture), place), *placed(over, place)]
    pixels = render(Scene(45.0, shapes), optics, rng, exposure=camera.exposure)
    limits = Limits(hole_to_edge_px=EDGE_MM * optics.px_per_mm)
    return View(pixels, features, BASE_SEARCH, limits, tuple(seen(place, drawing.edge_distance_mm)[:3]), optics)


def battery_view(
    rng: np.random.Generator,
    camera: Camera = Camera(looks="up"),
    place: Place = HERE,
    corner: tuple[int, int] = (-1, -1),
    over: Sequence[Shape] = (),
    texture: float = 1.5,
) -> View:
    """A battery's corner near its place: `place` turns the battery about the corner and shifts it."""
    drawing = BatteryDrawing()
    (sx, sy), mark = corner, (corner[0] * drawing.width_mm / 2, corner[1] * drawing.height_mm / 2)
    optics = camera.aimed((mark[0] - sx * 4.5, mark[1] - sy * 3.5))
    points = [mark, (mark[0] - sx * 11.0, mark[1]), (mark[0], mark[1] - sy * 7.5), (mark[0] - sx, mark[1] - sy)]
    moved = Place(mark[0] + place.x_mm, mark[1] + place.y_mm, place.t_deg) @ Place(-mark[0], -mark[1])
    start, end_1, end_2, inside = to_px(optics, points)
    features = (walk(start, end_1, inside), walk(start, end_2, inside))
    shapes = [*placed(textured(battery(drawing), texture), moved), *placed(over, moved)]
    pixels = render(Scene(40.0, shapes), optics, rng, exposure=camera.exposure)
    truth = tuple(to_px(optics, [moved.point(*p) for p in points[:3]]))
    return View(pixels, features, BATTERY_SEARCH, Limits(), truth, optics)


def textured(shapes: Sequence[Shape], texture: float) -> list[Shape]:
    """The shapes with another texture on their surfaces."""
    return [replace(s, texture=texture) if isinstance(s, Polygon) and s.texture else s for s in shapes]


def clutter(rng: np.random.Generator, optics: Optics) -> list[Shape]:
    """Scratches, dust and two blots anywhere in the picture (in the camera's object plane)."""
    size = np.array([optics.width, optics.height])
    shapes: list[Shape] = []
    for _ in range(12):
        start, way = rng.uniform(0.0, 1.0, 2) * size, rng.normal(0.0, 250.0, 2)
        line = optics.mm_from_px(np.array([start, start + way]))
        shapes.append(Stroke(line, float(rng.uniform(0.008, 0.05)), float(rng.uniform(20.0, 200.0))))
    dust = optics.mm_from_px(rng.uniform(0.0, 1.0, (40, 2)) * size)
    shapes.append(Disks(dust, rng.uniform(0.02, 0.15, 40), 30.0))
    blots = optics.mm_from_px(rng.uniform(0.0, 1.0, (2, 2)) * size)
    shapes.append(Disks(blots, rng.uniform(0.3, 0.8, 2), 235.0))
    return shapes


def line_error(edge: Edge, start: Px, end: Px) -> tuple[float, float]:
    """Offset of a found edge's middle from the true line, px, and its turn, deg."""
    length = math.dist(start, end)
    way = ((end.u - start.u) / length, (end.v - start.v) / length)
    u, v = (edge.start.u + edge.end.u) / 2 - start.u, (edge.start.v + edge.end.v) / 2 - start.v
    found = math.atan2(edge.end.v - edge.start.v, edge.end.u - edge.start.u)
    turn = found - math.atan2(way[1], way[0])
    return way[0] * v - way[1] * u, math.degrees((turn + math.pi / 2) % math.pi - math.pi / 2)
