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

EDGE_REACH_PX = 90.0  # once the hole is found, the edge can only be so far from its place: parallel grooves are further


def find_base(
    pixels: Pixels, circle: ExpectedCircle, edge: ExpectedEdge, search: Search, limits: Limits
) -> BaseMeasurement:
    """Measure hole and reference edge of a base that lies within `search` of its expected place.

    `pixels` is the camera's picture, uint8 (height, width). Raises NotFound with the check that failed, ValueError
    when the picture or the expectation is none.
    """
    pixels = checked(pixels)
    checked_search(search, circle.centre, edge.start, edge.end)
    if not 10.0 <= circle.radius_px <= 4000.0 or edge.start == edge.end:
        raise ValueError(f"expected a hole of 10 to 4000 px radius and an edge with a length, got {circle}, {edge}")
    small = coarse(pixels)
    centre = rough_circle(small, circle, search.position_px, limits.min_contrast)
    hole = measure_circle(pixels, catch_circle(pixels, centre, circle, limits.min_contrast), circle, limits)
    du, dv = hole.centre.u - circle.centre.u, hole.centre.v - circle.centre.v
    if math.hypot(du, dv) > 1.5 * search.position_px + 8.0:
        raise NotFound("hole", f"it lies {math.hypot(du, dv):.0f} px from its expected place")
    moved = ExpectedEdge(
        Px(edge.start.u + du, edge.start.v + dv), Px(edge.end.u + du, edge.end.v + dv), edge.bright_left
    )
    found = _find_edge(pixels, small, moved, search, limits)
    return BaseMeasurement(hole, found, _checked_distance(hole, found, limits))


def _find_edge(pixels: Pixels, small: Coarse, edge: ExpectedEdge, search: Search, limits: Limits) -> Edge:
    """The reference edge, expected from where the hole is. Raises NotFound."""
    votes = line_votes(small, edge, min(search.position_px, EDGE_REACH_PX), search.angle_deg, limits.min_contrast)
    scan = Scan.of(edge)
    first, last = stretch(scan, pixels, edge.start, edge.end)
    for rough in rough_lines(votes, edge, 1):
        caught = catch_line(pixels, scan, line_through(scan, rough), first, last, limits.min_contrast)
        if caught is not None:
            return measure_line(pixels, scan, caught.line, first, last, limits, "edge")[1]
    raise NotFound("edge", f"no straight edge within {EDGE_REACH_PX:.0f} px of its place beside the hole")


def _checked_distance(hole: Circle, edge: Edge, limits: Limits) -> float:
    """Distance of the hole's centre from the edge. Raises NotFound when it is not the drawing's."""
    du, dv = edge.end.u - edge.start.u, edge.end.v - edge.start.v
    area = du * (hole.centre.v - edge.start.v) - dv * (hole.centre.u - edge.start.u)
    distance = abs(area) / math.hypot(du, dv)
    drawn = limits.hole_to_edge_px
    if drawn is not None and abs(distance - drawn) > limits.hole_to_edge_tolerance_px:
        detail = f"{distance:.1f} px, expected are {drawn:.1f} +- {limits.hole_to_edge_tolerance_px:.1f}"
        raise NotFound("hole to edge", detail)
    return distance
