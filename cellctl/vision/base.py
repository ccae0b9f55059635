"""Find a base in camera 1's picture: first its hole, then the reference edge at its known place beside it. Pure."""

from __future__ import annotations

import math

from cellctl.geometry import Px
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
from cellctl.vision.plane import cross, direction, middle
from cellctl.vision.single import find_circle, find_edge

EDGE_REACH_PX = 90.0  # once the hole is found, the edge can only be so far from its place: parallel grooves are further


def find_base(
    pixels: Pixels, circle: ExpectedCircle, edge: ExpectedEdge, search: Search, limits: Limits
) -> BaseMeasurement:
    """Measure hole and reference edge of a base that lies within `search` of its expected place.

    `pixels` is the camera's picture, uint8 (height, width). Raises NotFound with the check that failed, ValueError
    when the picture or the expectation is none.
    """
    way, lever = direction(edge.start, edge.end), middle(edge.start, edge.end)
    aside = abs((lever.u - circle.centre.u) * way.u + (lever.v - circle.centre.v) * way.v)
    hole = find_circle(pixels, circle, search, limits)
    moved = Px(hole.centre.u - circle.centre.u, hole.centre.v - circle.centre.v)
    reach = EDGE_REACH_PX + aside * math.tan(math.radians(search.angle_deg))
    found = find_edge(pixels, _shifted(edge, moved), Search(reach, search.angle_deg), limits)
    return BaseMeasurement(hole, found, _checked_distance(hole, found, limits))


def _shifted(edge: ExpectedEdge, by: Px) -> ExpectedEdge:
    start, end = (Px(p.u + by.u, p.v + by.v) for p in (edge.start, edge.end))
    return ExpectedEdge(start, end, edge.bright_left)


def _checked_distance(hole: Circle, edge: Edge, limits: Limits) -> float:
    """Distance of the hole's centre from the edge. Raises NotFound when it is not the drawing's."""
    away = Px(hole.centre.u - edge.start.u, hole.centre.v - edge.start.v)
    distance = abs(cross(direction(edge.start, edge.end), away))
    drawn = limits.hole_to_edge_px
    if drawn is not None and abs(distance - drawn) > limits.hole_to_edge_tolerance_px:
        detail = f"{distance:.1f} px, expected are {drawn:.1f} +- {limits.hole_to_edge_tolerance_px:.1f}"
        raise NotFound("hole to edge", detail)
    return distance
