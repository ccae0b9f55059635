"""Find a battery's corner in camera 2's picture: two straight edges, and the point where their lines meet. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from cellctl.geometry import Px, wrap_deg
from cellctl.vision.coarse import Votes, line_votes, rough_lines, turns_the_same_way
from cellctl.vision.features import (
    BatteryMeasurement,
    Edge,
    ExpectedEdge,
    Limits,
    NotFound,
    Pixels,
    Search,
)
from cellctl.vision.line import Caught, Line, Scan, catch_line, line_through, measure_line, stretch
from cellctl.vision.picture import Coarse, checked, checked_search, coarse

ROUGH_SQUARE_DEG = 0.8  # caught lines may be so far from the expected angle between them
DISTINCT_PX = 8.0  # lines closer than this are one
OVERRUN_PX = (40.0, 260.0)  # past the corner: here the edge must have ended
OVERRUN_STATIONS = 24


class _Candidate(NamedTuple):
    """One edge's caught line and the direction it runs in, away from the corner."""

    caught: Caught
    direction: Px


def find_battery(
    pixels: Pixels, edge_1: ExpectedEdge, edge_2: ExpectedEdge, search: Search, limits: Limits
) -> BatteryMeasurement:
    """Measure the corner of a battery that lies within `search` of its expected place.

    Both edges start at the expected corner and run away from it. `pixels` is uint8 (height, width). Raises NotFound
    with the check that failed, ValueError when the picture or the expectation is none.
    """
    pixels = checked(pixels)
    checked_search(search, edge_1.start, edge_1.end, edge_2.start, edge_2.end)
    edges = (edge_1, edge_2)
    if edge_1.start != edge_2.start or abs(_cross(_direction(edge_1), _direction(edge_2))) < 0.5:
        raise ValueError(f"expected two edges that start at one corner and run apart, got {edges}")
    scans = (Scan.of(edge_1), Scan.of(edge_2))
    near = _catch(pixels, edges, scans, search, limits)
    rough = _meet(scans, near[0].caught.line, near[1].caught.line)
    lines, found = [], []
    for i in (0, 1):
        first, last = _used(pixels, scans[i], edges[i], near[i].direction, rough, limits)
        line, edge = measure_line(pixels, scans[i], near[i].caught.line, first, last, limits, f"edge {i + 1}")
        lines.append(line)
        found.append(edge)
    corner = _meet(scans, lines[0], lines[1])
    for i in (0, 1):
        _check_end(pixels, scans[i], lines[i], corner, near[i].direction, found[i], limits, f"edge {i + 1}")
    squareness = _checked_squareness(edges, found, limits)
    return BatteryMeasurement(found[0], found[1], corner, _corner_sd(found, corner), squareness)


def _catch(
    pixels: Pixels, edges: tuple[ExpectedEdge, ExpectedEdge], scans: tuple[Scan, Scan], search: Search, limits: Limits
) -> tuple[_Candidate, _Candidate]:
    """The best pair of lines that stand to each other as expected. Raises NotFound, also when it has a rival."""
    small = coarse(pixels)
    used = [_without_corner(edge, limits) for edge in edges]
    votes = _joint_votes(small, used, search, limits)
    caught = [_candidates(pixels, used[i], scans[i], votes[i], limits) for i in (0, 1)]
    for i in (0, 1):
        if not caught[i]:
            raise NotFound(f"edge {i + 1}", f"no straight edge within {search.position_px:.0f} px of its place")
    pairs = [(a, b) for a in caught[0] for b in caught[1] if abs(_off_square(edges, a, b)) < ROUGH_SQUARE_DEG]
    if not pairs:
        raise NotFound("squareness", f"no two edges within {ROUGH_SQUARE_DEG} deg of the expected angle")
    best = max(pairs, key=lambda pair: pair[0].caught.score + pair[1].caught.score)
    for i in (0, 1):
        _check_rival(best[i], caught[i], limits, f"edge {i + 1}")
    return best


def _joint_votes(small: Coarse, edges: list[ExpectedEdge], search: Search, limits: Limits) -> list[Votes]:
    """Votes for both edges; each direction is supported by the other edge's votes for the same turn of the part."""
    turn_px = 0.5 * max(math.dist(e.start, e.end) for e in edges) * math.tan(math.radians(search.angle_deg))
    reach = search.position_px + turn_px + 8.0
    votes = [line_votes(small, edge, reach, search.angle_deg, limits.min_contrast) for edge in edges]
    way = slice(None) if turns_the_same_way(*edges) else slice(None, None, -1)
    support = [cv2.dilate(v.count.max(axis=1)[way].reshape(-1, 1), np.ones((5, 1), np.uint8)) for v in votes]
    return [
        votes[0]._replace(count=_backed(votes[0], support[1])),
        votes[1]._replace(count=_backed(votes[1], support[0])),
    ]


def _backed(votes: Votes, support: cv2.typing.MatLike) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Votes with the other edge's support added wherever there are votes at all."""
    return np.where(votes.count > 0.0, votes.count + support, 0.0).astype(np.float32)


def _candidates(pixels: Pixels, edge: ExpectedEdge, scan: Scan, votes: Votes, limits: Limits) -> list[_Candidate]:
    first, last = stretch(scan, pixels, edge.start, edge.end)
    lines = [
        (rough, catch_line(pixels, scan, line_through(scan, rough), first, last, limits.min_contrast))
        for rough in rough_lines(votes, edge, 2)
    ]
    return [_Candidate(caught, _along(scan, caught.line, rough.direction)) for rough, caught in lines if caught]


def _along(scan: Scan, line: Line, like: Px) -> Px:
    """Unit vector along a line, pointing the same way as `like`."""
    c = math.copysign(line.cosine, like[scan.axis])
    return scan.point(c, c * line.slope)


def _without_corner(edge: ExpectedEdge, limits: Limits) -> ExpectedEdge:
    d = _direction(edge)
    if math.dist(edge.start, edge.end) <= limits.corner_skip_px + 1.0:
        raise ValueError(f"the expected edge {edge} is no longer than the skipped corner of {limits.corner_skip_px} px")
    return edge._replace(start=_ahead(edge.start, d, limits.corner_skip_px))


def _check_rival(best: _Candidate, others: list[_Candidate], limits: Limits, name: str) -> None:
    """Raises NotFound when another distinct line is nearly as good."""
    for other in others:
        apart = abs(other.caught.line.height - best.caught.line.across(np.array(other.caught.line.at)))
        rival = other.caught.score / max(best.caught.score, 1e-9)
        if float(apart) > DISTINCT_PX and rival > limits.max_rival:
            raise NotFound(
                f"{name} rival", f"another line has {rival:.0%} of its score, allowed are {limits.max_rival:.0%}"
            )


def _used(pixels: Pixels, scan: Scan, edge: ExpectedEdge, direction: Px, corner: Px, limits: Limits) -> tuple[int, int]:
    """The scanned range of an edge, from behind the rounded corner to the end of the expected length."""
    length = math.dist(edge.start, edge.end)
    return stretch(scan, pixels, _ahead(corner, direction, limits.corner_skip_px), _ahead(corner, direction, length))


def _meet(scans: tuple[Scan, Scan], one: Line, two: Line) -> Px:
    """Where two lines meet."""
    (p, d), (q, e) = (
        (s.point(line.at, line.height), s.point(1.0, line.slope)) for s, line in zip(scans, (one, two), strict=True)
    )
    t = _cross(Px(q.u - p.u, q.v - p.v), e) / _cross(d, e)
    return Px(p.u + t * d.u, p.v + t * d.v)


def _check_end(
    pixels: Pixels, scan: Scan, line: Line, corner: Px, direction: Px, edge: Edge, limits: Limits, name: str
) -> None:
    """Raises NotFound when the edge goes on past the corner: then this is not the corner of a battery."""
    far, near = (_ahead(corner, direction, -d) for d in reversed(OVERRUN_PX))
    first, last = stretch(scan, pixels, far, near)
    along = np.linspace(first, last, OVERRUN_STATIONS).astype(np.int64) if last - first > OVERRUN_STATIONS else []
    if len(along) == 0:
        raise NotFound("view", f"past the corner at ({corner.u:.0f}, {corner.v:.0f}) px there is too little picture")
    across = np.rint(line.across(np.asarray(along))).clip(8, scan.limits(pixels)[1] - 9).astype(np.int64)
    step, side = scan.strides(pixels)
    places = (np.asarray(along) * step + across * side)[:, None]
    beside = np.arange(2, 6) * side
    flat = pixels.reshape(-1)
    rise = (flat.take(places + beside).mean(axis=1) - flat.take(places - beside).mean(axis=1)) * scan.rising
    overrun = float(np.mean(rise > 0.4 * edge.contrast))
    if overrun > limits.max_overrun:
        raise NotFound("corner", f"{overrun:.0%} of the extension of {name} past the corner look like the edge")


def _checked_squareness(edges: tuple[ExpectedEdge, ExpectedEdge], found: list[Edge], limits: Limits) -> float:
    """Angle from edge 1 to edge 2 less the expected one, deg. Raises NotFound when it is too large."""
    directions = [_towards(Px(e.end.u - e.start.u, e.end.v - e.start.v), x) for e, x in zip(found, edges, strict=True)]
    squareness = wrap_deg(_angle(*directions) - _angle(_direction(edges[0]), _direction(edges[1])))
    if abs(squareness) > limits.squareness_deg:
        detail = f"the edges are {squareness:+.3f} deg off, allowed are {limits.squareness_deg:.3f}"
        raise NotFound("squareness", detail)
    return squareness


def _off_square(edges: tuple[ExpectedEdge, ExpectedEdge], one: _Candidate, two: _Candidate) -> float:
    return wrap_deg(_angle(one.direction, two.direction) - _angle(_direction(edges[0]), _direction(edges[1])))


def _corner_sd(found: list[Edge], corner: Px) -> float:
    """1 sigma of the corner per axis: each edge's offset and angle, carried from its middle to the corner."""
    variance = 0.0
    for edge in found:
        lever = math.dist(corner, ((edge.start.u + edge.end.u) / 2, (edge.start.v + edge.end.v) / 2))
        variance += edge.offset_sd_px**2 + (lever * math.radians(edge.angle_sd_deg)) ** 2
    return math.sqrt(variance / 2.0)


def _direction(edge: ExpectedEdge) -> Px:
    length = math.dist(edge.start, edge.end)
    if length <= 0.0:
        raise ValueError(f"an expected edge must have a length, got {edge}")
    return Px((edge.end.u - edge.start.u) / length, (edge.end.v - edge.start.v) / length)


def _towards(direction: Px, edge: ExpectedEdge) -> Px:
    """The direction, turned round if it runs against the expected edge."""
    d = _direction(edge)
    return direction if direction.u * d.u + direction.v * d.v > 0.0 else Px(-direction.u, -direction.v)


def _ahead(point: Px, direction: Px, distance: float) -> Px:
    return Px(point.u + direction.u * distance, point.v + direction.v * distance)


def _cross(a: Px, b: Px) -> float:
    return a.u * b.v - a.v * b.u


def _angle(a: Px, b: Px) -> float:
    """From a to b, deg."""
    return math.degrees(math.atan2(_cross(a, b), a.u * b.u + a.v * b.v))
