"""Find a base in camera 1's picture: first its hole, then the reference edge at its known place beside it. Pure."""

from __future__ import annotations

import math

from cellctl.geometry import Px
from cellctl.vision.circle import circle_of, circle_strip
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
from cellctl.vision.line import edge_of, lane_of, line_outline
from cellctl.vision.outline import measure
from cellctl.vision.picture import checked
from cellctl.vision.plane import cross, direction, middle
from cellctl.vision.single import roughly_circle, roughly_edge
from cellctl.vision.strip import BAND_PX, line_strip, side_by_side

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
    pixels = checked(pixels)
    rough = roughly_circle(pixels, circle, search, limits)
    moved = Px(rough.centre.u - circle.centre.u, rough.centre.v - circle.centre.v)
    reach = EDGE_REACH_PX + aside * math.tan(math.radians(search.angle_deg))
    near = roughly_edge(pixels, _shifted(edge, moved), Search(reach, search.angle_deg), limits)
    lane = lane_of(near, limits)
    beside = line_strip(pixels, [lane], BAND_PX)
    around, outline = circle_strip(pixels, rough, circle, len(beside.levels))
    seen = measure(side_by_side(around, beside), [outline, line_outline(near, lane)], limits)
    hole, (_, found) = circle_of(seen[0], circle, limits), edge_of(near, lane, seen[1], limits)
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
