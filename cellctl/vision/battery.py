"""Find a battery's corner in camera 2's picture: two straight edges, and the point where their lines meet. Pure."""

from __future__ import annotations

import numpy as np

from cellctl.geometry import Px
from cellctl.vision.covariance import corner_covariance
from cellctl.vision.features import (
    BatteryMeasurement,
    Edge,
    ExpectedEdge,
    Limits,
    NotFound,
    Pixels,
    Search,
)
from cellctl.vision.gates import check_in_view
from cellctl.vision.line import Stretch, edge_of, lane_of, line_outline
from cellctl.vision.outline import measure
from cellctl.vision.outside import Border, check_outside
from cellctl.vision.pair import Near, Side, Sides, catch_pair, square_off_deg
from cellctl.vision.picture import checked, checked_search
from cellctl.vision.plane import ahead, cross, direction
from cellctl.vision.scan import Line, Scan, stretch
from cellctl.vision.strip import BAND_PX, line_strip

OVERRUN_PX = (40.0, 260.0)  # past the corner: here the edge must have ended
OVERRUN_STATIONS = 24
BESIDE_PX = np.arange(2, 6)  # where the overrun test looks, to either side of the edge's line


def find_battery(
    pixels: Pixels, edge_1: ExpectedEdge, edge_2: ExpectedEdge, search: Search, limits: Limits
) -> BatteryMeasurement:
    """Measure the corner of a battery that lies within `search` of its expected place.

    Both edges start at the expected corner and run away from it. `pixels` is uint8 (height, width). Raises NotFound
    with the check that failed, ValueError when the picture or the expectation is none.
    """
    pixels = checked(pixels)
    sides = _sides(edge_1, edge_2, search, limits)
    near = catch_pair(pixels, sides, search, limits)
    rough = _meet(sides, near[0].caught.line, near[1].caught.line)
    (line_1, seen_1), (line_2, seen_2) = _measure(pixels, sides, near, rough, limits)
    corner = _meet(sides, line_1, line_2)
    for side, line, edge in ((sides[0], line_1, seen_1), (sides[1], line_2, seen_2)):
        check_end(pixels, side, line, corner, edge, limits)
    for side, edge, other in ((sides[0], seen_1, seen_2), (sides[1], seen_2, seen_1)):
        border = Border(side.name, edge, side.edge.bright_left, other.end)
        check_outside(pixels, border, search.position_px, 2.0 * limits.squareness_deg)
    squareness = _checked_squareness(sides, seen_1, seen_2, limits)
    return BatteryMeasurement(seen_1, seen_2, corner, corner_covariance(corner, seen_1, seen_2), squareness)


def _sides(edge_1: ExpectedEdge, edge_2: ExpectedEdge, search: Search, limits: Limits) -> Sides:
    """The expectation, checked. Raises ValueError."""
    checked_search(search, edge_1.start, edge_1.end, edge_2.start, edge_2.end)
    sides = Side("edge 1", edge_1, Scan.of(edge_1)), Side("edge 2", edge_2, Scan.of(edge_2))
    if edge_1.start != edge_2.start or abs(cross(sides[0].way, sides[1].way)) < 0.5:
        raise ValueError(f"expected two edges that start at one corner and run apart, got {edge_1}, {edge_2}")
    for side in sides:
        if side.length_px <= limits.corner_skip_px:
            raise ValueError(f"{side.name} is expected {side.length_px:.0f} px long: no longer than the skipped corner")
    return sides


def _measure(
    pixels: Pixels, sides: Sides, near: tuple[Near, Near], corner: Px, limits: Limits
) -> list[tuple[Line, Edge]]:
    found = [_stretch(pixels, side, each, corner, limits) for side, each in zip(sides, near, strict=True)]
    lanes = [lane_of(each, limits) for each in found]
    outlines = [line_outline(each, lane) for each, lane in zip(found, lanes, strict=True)]
    seen = measure(line_strip(pixels, lanes, BAND_PX), outlines, limits)
    return [edge_of(*each, limits) for each in zip(found, lanes, seen, strict=True)]


def _stretch(pixels: Pixels, side: Side, near: Near, corner: Px, limits: Limits) -> Stretch:
    first, last = side.used(pixels, corner, near.way, limits.corner_skip_px)
    expected_px = (side.length_px - limits.corner_skip_px) * near.way[side.scan.axis]
    check_in_view(first, last, expected_px, limits, side.name)
    return Stretch(side.name, side.scan, near.caught, first, last)


def _meet(sides: Sides, one: Line, two: Line) -> Px:
    """Where the lines of both sides meet."""
    p, q = sides[0].scan.point(one.at, one.height), sides[1].scan.point(two.at, two.height)
    d, e = sides[0].scan.point(1.0, one.slope), sides[1].scan.point(1.0, two.slope)
    return ahead(p, d, cross(Px(q.u - p.u, q.v - p.v), e) / cross(d, e))


def check_end(pixels: Pixels, side: Side, line: Line, corner: Px, edge: Edge, limits: Limits) -> None:
    """Raises NotFound when the edge goes on past the corner: then this is not the corner of a battery."""
    scan, way = side.scan, direction(edge.start, edge.end)
    first, last = stretch(scan, pixels, *(ahead(corner, way, -distance) for distance in OVERRUN_PX))
    if last - first < OVERRUN_STATIONS:
        raise NotFound("view", f"past the corner at ({corner.u:.0f}, {corner.v:.0f}) px there is too little picture")
    along = first + np.arange(OVERRUN_STATIONS) * (last - first) // (OVERRUN_STATIONS - 1)
    rim = int(BESIDE_PX[-1]) + 1
    across = np.rint(line.across(along)).clip(rim, scan.limits(pixels)[1] - rim - 1).astype(np.int64)
    step, beside = scan.strides(pixels)
    places = (along * step + across * beside)[:, None]
    above, below = (
        np.add.reduce(pixels.reshape(-1).take(places + k * beside), axis=1, dtype=np.int32)
        for k in (BESIDE_PX, -BESIDE_PX)
    )
    like_it = (above - below) * scan.rising > 0.4 * edge.contrast * BESIDE_PX.size
    overrun = np.count_nonzero(like_it) / OVERRUN_STATIONS
    if overrun > limits.max_overrun:
        raise NotFound("corner", f"{overrun:.0%} of the extension of {side.name} past the corner look like the edge")


def _checked_squareness(sides: Sides, one: Edge, two: Edge, limits: Limits) -> float:
    """Angle from edge 1 to edge 2 less the expected one, deg. Raises NotFound when it is too large."""
    squareness = square_off_deg(sides, direction(one.start, one.end), direction(two.start, two.end))
    if abs(squareness) > limits.squareness_deg:
        raise NotFound("squareness", f"{squareness:+.3f} deg off, allowed are {limits.squareness_deg:.3f}")
    return squareness
