"""Find a base in camera 1's picture: first its hole, then the reference edge at its known place beside it. Pure."""

from __future__ import annotations

import math

from cellctl.geometry import Px
from cellctl.vision.circle import catch_circle, measure_circle
from cellctl.vision.coarse import line_votes, rough_circle, rough_lines
from cellctl.vision.features import (
    BaseMeasurement,
    Circle,
    Edge,
    ExpectedCircle,
    ExpectedEdge,
    Limits,
    NotFound,
    Pixels,
    Search,
)
from cellctl.vision.line import Scan, catch_line, line_through, measure_line, stretch
from cellctl.vision.picture import Coarse, checked, checked_search, coarse
from cellctl.vision.plane import cross, direction, middle

EDGE_REACH_PX = 90.0  # once the hole is found, the edge can only be so far from its place: parallel grooves are further
RADII_PX = (40.0, 4000.0)


def find_base(
    pixels: Pixels, circle: ExpectedCircle, edge: ExpectedEdge, search: Search, limits: Limits
) -> BaseMeasurement:
    """Measure hole and reference edge of a base that lies within `search` of its expected place.

    `pixels` is the camera's picture, uint8 (height, width). Raises NotFound with the check that failed, ValueError
    when the picture or the expectation is none.
    """
    pixels = checked(pixels)
    checked_search(search, circle.centre, edge.start, edge.end)
    if not RADII_PX[0] <= circle.radius_px <= RADII_PX[1]:
        raise ValueError(f"expected a hole of {RADII_PX[0]:.0f} to {RADII_PX[1]:.0f} px radius, got {circle.radius_px}")
    way = direction(edge.start, edge.end)
    small = coarse(pixels)
    centre = rough_circle(small, circle, search.position_px, limits.min_contrast)
    hole = measure_circle(pixels, catch_circle(pixels, centre, circle, limits.min_contrast), circle, limits)
    moved = Px(hole.centre.u - circle.centre.u, hole.centre.v - circle.centre.v)
    lever = middle(edge.start, edge.end)
    aside = abs((lever.u - circle.centre.u) * way.u + (lever.v - circle.centre.v) * way.v)
    reach = EDGE_REACH_PX + aside * math.tan(math.radians(search.angle_deg))
    found = _find_edge(pixels, small, _shifted(edge, moved), Search(reach, search.angle_deg), limits)
    return BaseMeasurement(hole, found, _checked_distance(hole, found, limits))


def _shifted(edge: ExpectedEdge, by: Px) -> ExpectedEdge:
    start, end = (Px(p.u + by.u, p.v + by.v) for p in (edge.start, edge.end))
    return ExpectedEdge(start, end, edge.bright_left)


def _find_edge(pixels: Pixels, small: Coarse, edge: ExpectedEdge, search: Search, limits: Limits) -> Edge:
    """The reference edge, expected from where the hole is. Raises NotFound."""
    votes = line_votes(small, edge, search.position_px, search.angle_deg, limits.min_contrast)
    scan = Scan.of(edge)
    first, last = stretch(scan, pixels, edge.start, edge.end)
    for rough in rough_lines(votes, 1):
        caught = catch_line(pixels, scan, line_through(scan, rough), first, last, limits.min_contrast)
        if caught is not None:
            return measure_line(pixels, scan, caught.line, first, last, limits, "edge")[1]
    raise NotFound("edge", f"no straight edge within {search.position_px:.0f} px of its place beside the hole")


def _checked_distance(hole: Circle, edge: Edge, limits: Limits) -> float:
    """Distance of the hole's centre from the edge. Raises NotFound when it is not the drawing's."""
    away = Px(hole.centre.u - edge.start.u, hole.centre.v - edge.start.v)
    distance = abs(cross(direction(edge.start, edge.end), away))
    drawn = limits.hole_to_edge_px
    if drawn is not None and abs(distance - drawn) > limits.hole_to_edge_tolerance_px:
        detail = f"{distance:.1f} px, expected are {drawn:.1f} +- {limits.hole_to_edge_tolerance_px:.1f}"
        raise NotFound("hole to edge", detail)
    return distance
