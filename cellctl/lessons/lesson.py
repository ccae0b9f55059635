"""What measured pictures of good parts say in the parts' own frames, mm. Pure.

One figure per picture; `recipe_measured.py` makes the values of a recipe of them.
"""

from collections.abc import Mapping
from typing import NamedTuple

from cellctl.assembly.views import CORNER_SIGNS, is_left, to_mm
from cellctl.geometry import Mm, Pose, direction_deg, wrap_deg
from cellctl.pictures.scale import Scale
from cellctl.vision.features import Appearance
from cellctl.vision.lesson import BaseLesson, BatteryLesson

OFF_AXIS_DEG = 30.0

Span = tuple[float, float]


class BaseFigures(NamedTuple):
    """One picture of the base, in the base frame."""

    radius_mm: float
    distance_mm: float
    clean_mm: Span  # of the reference edge, x
    view_mm: Mm  # what the middle of the picture shows
    turn_deg: float  # of the base's x axis in the frame of the scale
    hole_dark: bool
    base_bright: bool
    looks: Mapping[str, Appearance]


class BatteryFigures(NamedTuple):
    """One picture of the battery's corner: distances from the corner along the width and along the height."""

    clean_x_mm: Span
    clean_y_mm: Span
    view_mm: Mm  # how far inside the corner the middle of the picture lies, along either
    turn_deg: float
    squareness_deg: float
    battery_bright: bool
    looks: Mapping[str, Appearance]  # "edge x" runs along the width, "edge y" along the height


def base_figures(lesson: BaseLesson, scale: Scale) -> BaseFigures:
    """A measured base in its own frame: x along the edge, the edge at positive y."""
    circle, edge = lesson.seen.circle, lesson.seen.edge
    hole, start, end = to_mm(scale.plane, [circle.centre, edge.start, edge.end])
    edge_is_left = _turn(hole, start, end) > 0.0
    pose = Pose(*hole, direction_deg(start, end) if edge_is_left else direction_deg(end, start))
    clean = [_in(pose, point) for point in to_mm(scale.plane, lesson.clean)]
    expected_circle, expected_edge = lesson.expected
    return BaseFigures(
        radius_mm=circle.radius_px * scale.plane.mm_per_px,
        distance_mm=sum(point.y_mm for point in clean) / 2,
        clean_mm=_ordered(clean[0].x_mm, clean[1].x_mm),
        view_mm=_in(pose, scale.plane.mm_at(scale.middle)),
        turn_deg=pose.t_deg,
        hole_dark=expected_circle.dark_inside,
        base_bright=expected_edge.bright_left == is_left(edge.start, edge.end, circle.centre),
        looks=lesson.seen.appearances,
    )


def battery_figures(lesson: BatteryLesson, scale: Scale, corner: str) -> BatteryFigures:
    """A measured corner of a battery; `corner` is its name in the battery frame."""
    (sx, sy), seen = CORNER_SIGNS[corner], lesson.seen
    sides = [(seen.edge_1, lesson.clean[0], lesson.expected[0]), (seen.edge_2, lesson.clean[1], lesson.expected[1])]
    at, one, two = to_mm(scale.plane, [seen.corner, seen.edge_1.end, seen.edge_2.end])
    if (_turn(one, at, two) > 0.0) != (sx * sy > 0):
        sides.reverse()
    (edge_x, clean_x, expected_x), (edge_y, clean_y, _) = sides
    along_deg = direction_deg(at, scale.plane.mm_at(edge_x.end))
    pose = Pose(*at, wrap_deg(along_deg if sx < 0 else along_deg + 180.0))
    middle = _in(pose, scale.plane.mm_at(scale.middle))
    inside_left = is_left(seen.corner, edge_x.end, edge_y.end)
    return BatteryFigures(
        clean_x_mm=_ordered(*(-sx * _in(pose, point).x_mm for point in to_mm(scale.plane, clean_x))),
        clean_y_mm=_ordered(*(-sy * _in(pose, point).y_mm for point in to_mm(scale.plane, clean_y))),
        view_mm=Mm(-sx * middle.x_mm, -sy * middle.y_mm),
        turn_deg=pose.t_deg,
        squareness_deg=seen.squareness_deg,
        battery_bright=expected_x.bright_left == inside_left,
        looks={"edge x": edge_x.appearance, "edge y": edge_y.appearance},
    )


def corner_name(lesson: BatteryLesson, scale: Scale) -> str | None:
    """Which corner of the battery it is, when the scale knows the robot's axes; None when it cannot tell."""
    at, one, two = to_mm(scale.plane, [lesson.seen.corner, lesson.seen.edge_1.end, lesson.seen.edge_2.end])
    away_x, away_y = one.x_mm + two.x_mm - 2 * at.x_mm, one.y_mm + two.y_mm - 2 * at.y_mm
    off_axis_deg = abs(wrap_deg(4 * direction_deg(at, one))) / 4
    if not scale.oriented or off_axis_deg > OFF_AXIS_DEG:
        return None
    return next(name for name, (sx, sy) in CORNER_SIGNS.items() if sx * away_x < 0 and sy * away_y < 0)


def _in(pose: Pose, point: Mm) -> Mm:
    return pose.inverse().point(*point)


def _ordered(one: float, other: float) -> Span:
    return (one, other) if one < other else (other, one)


def _turn(origin: Mm, start: Mm, end: Mm) -> float:
    """Positive when somebody who walks start -> end has the origin on the right hand, as seen from above."""
    along = end.x_mm - start.x_mm, end.y_mm - start.y_mm
    return along[0] * (start.y_mm - origin.y_mm) - along[1] * (start.x_mm - origin.x_mm)
