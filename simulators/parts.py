"""Drawings of the parts and how they look under the lamp: shapes in each part's own frame, in mm. Pure.

Levels are grey values of full light. Metal bodies are mid-grey, what lies behind them is dark, holes are darker still.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np

from simulators.optics import Points
from simulators.place import Place
from simulators.render import Scene
from simulators.shapes import Disks, Placed, Polygon, Ring, Shape, Stroke, disk, placed

BACKGROUND = 45.0
BODY = 130.0
HOLE = 30.0
POCKET = 95.0
SLIT = 32.0  # of the pocket beside a battery in it: hardly any light gets down there
FOIL = 145.0
CARD = 185.0
WALL_MM = 5.0  # of the base around its seat
SIDE_MM = 14.0  # the base reaches at least so far to either side of its hole
Part: TypeAlias = tuple[Shape, ...]
ROUNDED_MM = 3.0  # so far from its corners an outline is what the drawing says
FORM_STEP_MM = 1.0  # between samples of an edge's form error


@dataclass(frozen=True)
class BaseDrawing:
    """A cellphone base. Frame: hole centre, x along the reference edge, the edge at y = +edge_distance."""

    hole_radius_mm: float = 3.0
    edge_distance_mm: float = 6.0
    seat_x_mm: float = 18.0
    seat_y_mm: float = -62.0
    seat_t_deg: float = 0.0
    seat_width_mm: float = 53.2
    seat_height_mm: float = 85.2
    edge_reach_mm: tuple[float, float] = (0.0, 0.0)  # the reference edge is straight at least from here to there
    form_sd_mm: float = 0.0  # straightness error of the reference edge
    form_seed: int = 0


@dataclass(frozen=True)
class BatteryDrawing:
    """A battery. Frame: its centre, x along the width."""

    width_mm: float = 53.0
    height_mm: float = 85.0
    corner_radius_mm: float = 1.0
    form_sd_mm: float = 0.0  # straightness error of each edge
    form_seed: int = 0


@dataclass(frozen=True)
class PlateDrawing:
    """A calibration plate. Frame: centre of dot (0, 0), the larger one; x along columns, y along rows."""

    columns: int = 9
    rows: int = 7
    pitch_mm: float = 1.2
    dot_mm: float = 0.6
    first_dot_mm: float = 0.9
    margin_mm: float = 2.0

    def dots(self) -> Points:
        """Centres (rows * columns, 2), row by row."""
        x, y = np.meshgrid(np.arange(self.columns) * self.pitch_mm, np.arange(self.rows) * self.pitch_mm)
        return np.stack([x.ravel(), y.ravel()], axis=1)


def scene(*things: tuple[Part, Place], background: float = BACKGROUND) -> Scene:
    """Things one on top of the other, each with its place in the camera's object plane."""
    return Scene(background, [shape for shapes, place in things for shape in placed(shapes, place)])


@lru_cache(maxsize=8)
def base(drawing: BaseDrawing, pocket: float = POCKET) -> Part:
    """The base with its seat (at level `pocket`), hole, chamfer, groove and two windows."""
    r, edge = drawing.hole_radius_mm, drawing.edge_distance_mm
    groove = np.array([[-SIDE_MM + 1.5, edge - 1.0], [SIDE_MM - 1.5, edge - 1.0]])
    return (
        _body(drawing),
        _pocket(drawing, pocket),
        Polygon(np.concatenate([groove, groove[::-1] - (0.0, 0.15)]), 95.0),
        Polygon(_rectangle(r + 2.1, -1.2, r + 4.3, 2.6), BACKGROUND, radius_mm=0.5),
        Polygon(_rectangle(-r - 3.6, -2.4, -r - 2.2, 2.0), BACKGROUND, radius_mm=0.3),
        Ring((0.0, 0.0), r + 0.16, r + 0.29, 158.0),
        disk((0.0, 0.0), r, HOLE),
        Ring((0.12, -0.09), 0.66 * r, 0.70 * r, 58.0),
    )


@lru_cache(maxsize=8)
def battery(drawing: BatteryDrawing, over: float | None = None) -> Part:
    """The battery with the seam of its wrap and some print; `over`: the plain level that surrounds all of it."""
    w, h = drawing.width_mm / 2, drawing.height_mm / 2
    rng = np.random.default_rng(drawing.form_seed)
    outline = _wavy(_rectangle(-w, -h, w, h), drawing.form_sd_mm, rng)
    seam = _rectangle(0.6 - w, 0.6 - h, w - 0.6, h - 0.6)
    shapes: list[Shape] = [
        Polygon(outline, FOIL, radius_mm=drawing.corner_radius_mm, texture=1.5, over=over),
        Stroke(np.concatenate([seam, seam[:1]]), 0.07, 122.0),
    ]
    for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
        corner = np.array([i * w, j * h])
        shapes += [Stroke(corner - stroke * (i, j), 0.09, 70.0) for stroke in _print()]
    return tuple(shapes)


def assembly(base_drawing: BaseDrawing, battery_drawing: BatteryDrawing, seat_from_battery: Place) -> Part:
    """A base with a battery in its seat: round the battery a narrow dark slit is left of the pocket."""
    seat = Place(base_drawing.seat_x_mm, base_drawing.seat_y_mm, base_drawing.seat_t_deg)
    lies_inside = _lies_inside(base_drawing, battery_drawing, seat_from_battery)
    held = battery(battery_drawing, SLIT if lies_inside else None)
    return (*base(base_drawing, SLIT), *placed(held, seat @ seat_from_battery))


def _lies_inside(seat: BaseDrawing, battery: BatteryDrawing, seat_from_battery: Place) -> bool:
    """Whether a battery touches the walls of its seat nowhere."""
    w, h = battery.width_mm / 2, battery.height_mm / 2
    corners = np.array([seat_from_battery.point(*corner) for corner in _rectangle(-w, -h, w, h)])
    return bool(np.all(np.abs(corners) < (seat.seat_width_mm / 2, seat.seat_height_mm / 2)))


@lru_cache(maxsize=8)
def dot_plate(drawing: PlateDrawing = PlateDrawing()) -> Part:
    """The dot plate: dark dots on a bright card."""
    m, dots = drawing.margin_mm, drawing.dots()
    width, height = (drawing.columns - 1) * drawing.pitch_mm, (drawing.rows - 1) * drawing.pitch_mm
    radii = np.full(len(dots), drawing.dot_mm / 2)
    radii[0] = drawing.first_dot_mm / 2
    card = Polygon(_rectangle(-m, -m, width + m, height + m), CARD, texture=0.75)
    return (card, Disks(dots, radii, HOLE + 20.0))


def _body(drawing: BaseDrawing) -> Polygon:
    half_w, half_h = drawing.seat_width_mm / 2 + WALL_MM, drawing.seat_height_mm / 2 + WALL_MM
    first, last = drawing.edge_reach_mm
    left = min(-SIDE_MM, drawing.seat_x_mm - half_w, first - ROUNDED_MM)
    right = max(SIDE_MM, drawing.seat_x_mm + half_w, last + ROUNDED_MM)
    outline = _rectangle(left, min(-10.0, drawing.seat_y_mm - half_h), right, drawing.edge_distance_mm)
    rng = np.random.default_rng(drawing.form_seed)
    return Polygon(_wavy(outline, drawing.form_sd_mm, rng), BODY, radius_mm=1.5, texture=1.5)


def _pocket(drawing: BaseDrawing, level: float) -> Placed:
    w, h = drawing.seat_width_mm / 2, drawing.seat_height_mm / 2
    seat = Place(drawing.seat_x_mm, drawing.seat_y_mm, drawing.seat_t_deg)
    return Placed(Polygon(_rectangle(-w, -h, w, h), level, radius_mm=0.5), seat)


def _rectangle(left: float, low: float, right: float, high: float) -> Points:
    return np.array([[left, low], [right, low], [right, high], [left, high]])


def _print() -> list[Points]:
    """Some letters' strokes, measured inwards from a corner."""
    return [np.array([[5.0 + 0.8 * k, 4.0], [5.0 + 0.8 * k + 0.3 * (k % 2), 5.2]]) for k in range(4)]


def _wavy(outline: Points, sd_mm: float, rng: np.random.Generator) -> Points:
    """The outline with form error: its edges deviate by a smooth random amount, correlated over some 3 mm."""
    if sd_mm <= 0.0:
        return outline
    return np.concatenate(
        [_wavy_edge(outline[i], outline[(i + 1) % len(outline)], sd_mm, rng) for i in range(len(outline))]
    )


def _wavy_edge(start: Points, end: Points, sd_mm: float, rng: np.random.Generator) -> Points:
    """A corner and the points of the edge that begins there; the last 2 mm at either corner stay straight."""
    length = float(np.linalg.norm(end - start))
    along = np.arange(2.0, length - 2.0, FORM_STEP_MM)
    window = np.exp(-0.5 * (np.arange(-6, 7) * FORM_STEP_MM / 1.5) ** 2)
    noise = rng.standard_normal(along.size + window.size - 1)
    away = np.convolve(noise, window / np.linalg.norm(window), "valid") * sd_mm
    unit = (end - start) / length
    normal = np.array([unit[1], -unit[0]])
    return np.vstack([start, start + along[:, None] * unit + away[:, None] * normal])
