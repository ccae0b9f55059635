"""Find how a battery lies in its seat in camera 1's picture of a corner: slits along two sides of it. Pure.

Seat and battery are measured in the same picture, a fraction of a millimetre apart: what comes out is true whatever
the camera's place, the robot and the calibration think.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from cellctl.geometry import Px
from cellctl.vision.battery import check_end
from cellctl.vision.features import Edge, ExpectedEdge, Limits, NotFound, Pixels, Search
from cellctl.vision.pair import Side
from cellctl.vision.picture import check_light, checked, checked_search
from cellctl.vision.plane import ahead, angle_deg, cross, direction
from cellctl.vision.scan import Scan, stretch
from cellctl.vision.slit import Reach, Slit, course, line_of, measure_slit

NAMES = ("along the width", "along the height")


@dataclass(frozen=True)
class GapMeasurement:
    """A corner of a seated battery; the corners are where the straight edges' lines meet."""

    slit_1: Slit
    slit_2: Slit
    seat_corner: Px
    battery_corner: Px


class ExpectedGap(NamedTuple):
    """Two edges of a seat that start at its corner, the base on their bright side, the battery beyond a dark slit."""

    edge_1: ExpectedEdge
    edge_2: ExpectedEdge
    widest_px: float  # a slit
    blur_px: float  # sigma of the edges' blur, as seen of the base


def find_gap(pixels: Pixels, expected: ExpectedGap, search: Search, limits: Limits) -> GapMeasurement:
    """Measure the slits beside both edges of a seat's corner that lies within `search` of its expected place.

    The edges' direction is well known; `search.angle_deg` is how far the battery may be turned against the seat.
    `pixels` is uint8 (height, width). Raises NotFound with the check that failed, ValueError when the picture or
    the expectation is none.
    """
    pixels = checked(pixels)
    edges = expected.edge_1, expected.edge_2
    checked_search(search, *(point for edge in edges for point in edge[:2]))
    check_light(pixels, "gap")
    reach = Reach(search.position_px, expected.widest_px, expected.blur_px)
    one, two = (
        _measure(pixels, edge, reach, limits, f"of the slit {name}") for edge, name in zip(edges, NAMES, strict=True)
    )
    _check_turn((one, two), search.angle_deg, limits)
    corner = _meet(one.seat, two.seat)
    for edge, slit, name in zip(edges, (one, two), NAMES, strict=True):
        side = Side(f"the seat's edge {name}", edge, Scan.of(edge))
        check_end(pixels, side, line_of(side.scan, slit.seat), corner, slit.seat, limits)
    return GapMeasurement(one, two, corner, _meet(one.battery, two.battery))


def _measure(pixels: Pixels, edge: ExpectedEdge, reach: Reach, limits: Limits, name: str) -> Slit:
    begin = ahead(edge.start, direction(edge.start, edge.end), limits.corner_skip_px)
    first, last = stretch(Scan.of(edge), pixels, begin, edge.end)
    return measure_slit(pixels, course(pixels, edge, first, last, name), reach, limits, name)


def _meet(one: Edge, two: Edge) -> Px:
    """Where the lines of two edges meet."""
    d, e = direction(one.start, one.end), direction(two.start, two.end)
    away = Px(two.start.u - one.start.u, two.start.v - one.start.v)
    return ahead(one.start, d, cross(away, e) / cross(d, e))


def _check_turn(slits: tuple[Slit, Slit], most_deg: float, limits: Limits) -> None:
    """Raises NotFound when the battery is turned in its seat, or is no rectangle."""
    turns = [angle_deg(direction(s.seat.start, s.seat.end), direction(s.battery.start, s.battery.end)) for s in slits]
    for turn, name in zip(turns, NAMES, strict=True):
        if abs(turn) > most_deg:
            raise NotFound("turn", f"the battery's edge {name} is turned by {turn:+.3f} deg, allowed are {most_deg:g}")
    if abs(turns[0] - turns[1]) > limits.squareness_deg:
        off = turns[1] - turns[0]
        raise NotFound("squareness", f"{off:+.3f} deg off, allowed are {limits.squareness_deg:.3f}")
