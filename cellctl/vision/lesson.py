"""What one picture of a good part teaches: its features, measured as a unit's are, and how much of each edge is clean.

In the first picture the features are recognised, or a person has pointed at them; in the others they are looked for
near where the first one had them. Pure.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from cellctl.geometry import Px
from cellctl.vision.base import find_base
from cellctl.vision.battery import find_battery
from cellctl.vision.blind_circles import RoundOutline, follow_circle
from cellctl.vision.features import (
    BaseMeasurement,
    BatteryMeasurement,
    Edge,
    ExpectedCircle,
    ExpectedEdge,
    Limits,
    NotFound,
    Pixels,
    Search,
)
from cellctl.vision.plane import direction
from cellctl.vision.recognise import Corner, corner_of, recognise_corner, recognise_edge, recognise_hole
from cellctl.vision.stretches import StraightOutline, follow_edge, whole_stretch

NEARBY = Search(20.0, 1.0)  # a recognised feature is known so well
LEAST_CONTRAST = 20.0  # grey levels: a recipe should not be taught on less
HOLE_RADIUS_PX = 12.0
SPARE_SKIP_PX = 24.0  # behind the rounded corner

Stretch = tuple[Px, Px]


class BaseLesson(NamedTuple):
    """A base as measured, and the clean stretch of its reference edge as the measured edge runs."""

    seen: BaseMeasurement
    expected: tuple[ExpectedCircle, ExpectedEdge]
    clean: Stretch


class BatteryLesson(NamedTuple):
    """A battery's corner as measured, and the clean stretches of both edges, away from the corner."""

    seen: BatteryMeasurement
    expected: tuple[ExpectedEdge, ExpectedEdge]
    clean: tuple[Stretch, Stretch]
    skip_px: float  # the rounded corner


class Pointed(NamedTuple):
    """Where a person says that features are: about the hole, and two points on each edge."""

    hole: tuple[Px, float] | None = None
    edges: tuple[Stretch, ...] = ()


# -- the base ----------------------------------------------------------------------------------------------


def first_base(pixels: Pixels, pointed: Pointed) -> BaseLesson:
    """Recognise and measure a base. Raises NotFound with the check that failed, Undecided with the candidates."""
    hole = pointed_hole(pixels, *pointed.hole) if pointed.hole else recognise_hole(pixels)
    edge = pointed_edge(pixels, *pointed.edges[0]) if pointed.edges else recognise_edge(pixels, hole.circle)
    return next_base(pixels, (hole.circle, edge.edge), NEARBY)


def next_base(pixels: Pixels, expected: tuple[ExpectedCircle, ExpectedEdge], search: Search) -> BaseLesson:
    """Measure a base near an expected one. Raises NotFound."""
    limits = Limits(radius_px=HOLE_RADIUS_PX, min_contrast=LEAST_CONTRAST)
    seen = find_base(pixels, *expected, search, limits)
    clean = _clean(pixels, seen.edge, expected[1], "edge")
    circle = ExpectedCircle(seen.circle.centre, seen.circle.radius_px, expected[0].dark_inside)
    return BaseLesson(seen, (circle, ExpectedEdge(*clean, expected[1].bright_left)), clean)


# -- the battery -------------------------------------------------------------------------------------------


def first_battery(pixels: Pixels, pointed: Pointed) -> BatteryLesson:
    """Recognise and measure a battery's corner. Raises NotFound with the check that failed, Undecided."""
    corner = _pointed_corner(pixels, pointed) if pointed.edges else recognise_corner(pixels)
    expected = tuple(_from_corner(corner.at, side) for side in (corner.one, corner.two))
    skip_px = max(math.dist(corner.at, side.edge.start) for side in (corner.one, corner.two))
    return next_battery(pixels, (expected[0], expected[1]), skip_px, NEARBY)


def next_battery(
    pixels: Pixels, expected: tuple[ExpectedEdge, ExpectedEdge], skip_px: float, search: Search
) -> BatteryLesson:
    """Measure a battery near an expected one, its rounded corner left out. Raises NotFound."""
    limits = Limits(min_contrast=LEAST_CONTRAST, corner_skip_px=skip_px + SPARE_SKIP_PX)
    seen = find_battery(pixels, *expected, search, limits)
    edges = zip((seen.edge_1, seen.edge_2), expected, ("edge 1", "edge 2"), strict=True)
    clean = [_clean(pixels, edge, near, name) for edge, near, name in edges]
    again = [
        ExpectedEdge(seen.corner, stretch[1], near.bright_left) for stretch, near in zip(clean, expected, strict=True)
    ]
    return BatteryLesson(seen, (again[0], again[1]), (clean[0], clean[1]), skip_px)


def _from_corner(at: Px, side: StraightOutline) -> ExpectedEdge:
    return ExpectedEdge(at, side.edge.end, side.edge.bright_left)


def _pointed_corner(pixels: Pixels, pointed: Pointed) -> Corner:
    if len(pointed.edges) != 2:
        raise NotFound("corner", f"needs both edges pointed at, not {len(pointed.edges)}")
    one, two = (pointed_edge(pixels, *edge) for edge in pointed.edges)
    corner = corner_of(one, two)
    if corner is None:
        raise NotFound("corner", "the edges pointed at do not end at each other at a right angle")
    return corner


# -- both --------------------------------------------------------------------------------------------------


def pointed_hole(pixels: Pixels, centre: Px, radius_px: float) -> RoundOutline:
    """The stronger round outline, dark or bright inside, near where a person pointed. Raises NotFound."""
    guesses = (ExpectedCircle(centre, radius_px, dark) for dark in (True, False))
    found = [circle for guess in guesses if (circle := follow_circle(pixels, guess)) is not None]
    if not found:
        raise NotFound("hole", f"no round outline of {radius_px:.0f} px at ({centre.u:.0f}, {centre.v:.0f}) px")
    return max(found, key=lambda circle: circle.score)


def pointed_edge(pixels: Pixels, start: Px, end: Px) -> StraightOutline:
    """The stronger straight edge, of either bright side, near where a person pointed. Raises NotFound."""
    way = direction(start, end)
    sides = (Px(way.v, -way.u), Px(-way.v, way.u))
    found = [edge for side in sides if (edge := follow_edge(pixels, start, end, side)) is not None]
    if not found:
        ends = f"({start.u:.0f}, {start.v:.0f}) to ({end.u:.0f}, {end.v:.0f}) px"
        raise NotFound("edge", f"no straight edge from {ends}")
    return max(found, key=lambda edge: edge.score)


def _clean(pixels: Pixels, edge: Edge, expected: ExpectedEdge, name: str) -> Stretch:
    """The clean stretch of a measured edge. Raises NotFound."""
    way = direction(edge.start, edge.end)
    left = Px(way.v, -way.u)
    stretch = whole_stretch(pixels, edge, left if expected.bright_left else Px(-left.u, -left.v))
    if stretch is None:
        raise NotFound(name, "no part of it is straight and clean")
    return stretch
