"""Bands of pixels along outlines, and how much of each pixel a shape covers. Pure.

Outlines that run nearer to the picture's rows are met in whole columns, the others in whole rows; between 35 and 55
degrees in both, so that no pixel beside a bend is missed. All shapes of a picture are worked on at once.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulators.optics import Optics, Points
from simulators.shapes import Floats, Placed, Polygon, Shape, Stroke

Singles: TypeAlias = NDArray[np.float32]
Places: TypeAlias = NDArray[np.intp]

MARGIN_PX = 48  # of the canvas around the picture, so that bands need no clipping
WIDEST_PX = MARGIN_PX // 2  # from an outline to the border of its band
REACH_SIGMA = 3.4  # a step is over at this many sigmas
STEEPEST = math.tan(math.radians(55.0))
SMOOTH_DEG = 8.0  # a vertex that turns less than this is no corner
UNIT = 1024  # distances are looked up in 1/1024 px
MIDDLE = 8 * UNIT  # of the table of the step


class Traced(NamedTuple):
    """An outline in the picture: samples and directions (lines, k, 2) in px, and how to paint it."""

    points: Points
    directions: Points
    level: float
    texture: float
    half_px: float | None  # half the width of a stroke; None: an area
    over: float | None  # level of the area inside which it lies; None: whatever is there


class Band(NamedTuple):
    """Flat places on the canvas and how much of each is covered, (w, n); columns bounds[i] to bounds[i + 1] are i's."""

    places: Places
    cover: Singles
    bounds: NDArray[np.intp]

    def part(self, number: int) -> Band:
        """The band of one outline alone."""
        mine = slice(self.bounds[number], self.bounds[number + 1])
        return Band(self.places[:, mine], self.cover[:, mine], self.bounds[:0])


class _Spans(NamedTuple):
    """Arcs between neighbouring samples: ends and directions at the ends (n, 2) in px, number of the outline (n,)."""

    start: Points
    end: Points
    leave: Points
    arrive: Points
    owner: Places


class _Crossings(NamedTuple):
    """Where outlines cross whole columns or rows: all (n,), px."""

    at: Floats  # column or row
    across: Floats  # position across
    slope: Floats
    bend: Floats  # second derivative
    rising: Floats  # +1 where the outline runs towards greater columns or rows
    owner: Floats


def trace(shapes: Sequence[Shape], optics: Optics) -> list[Traced]:
    """The outlines of those shapes that are in the picture, in order."""
    contours = [thing.contour for thing in shapes]
    if not contours:
        return []
    flat = [np.concatenate([c[i].reshape(-1, 2) for c in contours]) for i in (0, 1)]
    points, directions = optics.traced(flat[0], flat[1])
    traced, first = [], 0
    for thing, contour in zip(shapes, contours, strict=True):
        part = slice(first, first + contour.points.size // 2)
        first = part.stop
        if _in_view(points[part], optics):
            shape = thing.shape if isinstance(thing, Placed) else thing
            half = 0.5 * shape.width_mm * optics.px_per_mm if isinstance(shape, Stroke) else None
            size = contour.points.shape
            line, way = points[part].reshape(size), directions[part].reshape(size)
            over = shape.over if isinstance(shape, Polygon) else None
            traced.append(Traced(line, way, shape.level, shape.texture, half, over))
    return traced


def _in_view(points: Points, optics: Optics) -> bool:
    u, v = points[:, 0], points[:, 1]
    wide = float(u.max()) > -MARGIN_PX and float(u.min()) < optics.width + MARGIN_PX
    return wide and float(v.max()) > -MARGIN_PX and float(v.min()) < optics.height + MARGIN_PX


def bands(outlines: Sequence[Traced], optics: Optics) -> list[Band]:
    """All pixels along all outlines: areas and strokes, each met in columns and in rows, then sharp corners."""
    made = []
    maker = _Maker(optics)
    for stroke in (False, True):
        spans = _spans(outlines, stroke)
        if spans is None:
            continue
        half_px = np.array([outline.half_px or 0.0 for outline in outlines]) if stroke else None
        made += [maker.band(spans, along, len(outlines), half_px) for along in (0, 1)]
        if not stroke:
            made += maker.corners(spans, len(outlines))
    return made


def _spans(outlines: Sequence[Traced], stroke: bool) -> _Spans | None:
    """The spans of all areas, or of all strokes; None when there are none."""
    chosen = [(i, o) for i, o in enumerate(outlines) if (o.half_px is not None) == stroke]
    if not chosen:
        return None
    ends, first = [], 0
    for _, outline in chosen:
        lines, k = outline.points.shape[:2]
        start = first + np.arange(lines * k).reshape(lines, k)
        end = np.roll(start, -1, axis=1)
        if stroke:
            end[:, -1] = start[:, -1]
        ends.append(end.reshape(-1))
        first += lines * k
    after = np.concatenate(ends)
    points = np.concatenate([o.points.reshape(-1, 2) for _, o in chosen])
    directions = np.concatenate([o.directions.reshape(-1, 2) for _, o in chosen])
    owner = np.repeat([i for i, _ in chosen], [o.points.size // 2 for _, o in chosen])
    return _Spans(points, points[after], directions, directions[after], owner)


@lru_cache(maxsize=8)
def _step(sigma: float) -> Singles:
    """The step's rise from -8 to +8 px."""
    scale = 1.0 / (UNIT * sigma * math.sqrt(2.0))
    return np.array([0.5 * (1.0 + math.erf(i * scale)) for i in range(-MIDDLE, MIDDLE + 1)], np.float32)


class _Maker:
    """Makes bands for one camera."""

    def __init__(self, optics: Optics) -> None:
        self._size = (optics.width, optics.height)
        self._stride = (1, optics.width + 2 * MARGIN_PX)
        self._sigma = math.hypot(optics.blur_px, math.sqrt(1.0 / 12.0))
        self._table = _step(round(self._sigma, 6))
        self._left = math.copysign(1.0, float(np.linalg.det(optics.matrix)))  # -1: mirrored

    def band(self, spans: _Spans, along: int, outlines: int, half_px: Floats | None) -> Band:
        """The pixels near all places where the spans cross whole columns (along 0) or rows (along 1)."""
        cross = _crossings(spans, along, self._size[along])
        nearest = np.rint(cross.across)
        seen = (nearest > -WIDEST_PX) & (nearest < self._size[1 - along] + WIDEST_PX)
        if not seen.all():
            cross, nearest = _Crossings(*(a[seen] for a in cross)), nearest[seen]
        half = None if half_px is None else half_px[cross.owner.astype(np.intp)]
        width = self._width(cross, half)
        k = np.arange(-width, width + 1)[:, None]
        offset = k.astype(np.float32) + (nearest - cross.across).astype(np.float32)
        distance = _distance(offset, cross, self._left if along == 0 else -self._left, self._sigma)
        start = (cross.at + MARGIN_PX) * self._stride[along] + (nearest + MARGIN_PX) * self._stride[1 - along]
        places = start.astype(np.intp) + k * self._stride[1 - along]
        bounds = np.searchsorted(cross.owner, np.arange(outlines + 1))
        return Band(places, self._covered(distance, half), bounds)

    def _width(self, cross: _Crossings, half_px: Floats | None) -> int:
        """How many pixels the band reaches to either side; it is wider along a column where the edge is steep."""
        slope = float(np.abs(cross.slope).max(initial=0.0))
        half = 0.0 if half_px is None else float(half_px.max(initial=0.0))
        width = math.ceil((REACH_SIGMA * self._sigma + half) * math.hypot(1.0, slope))
        if width > WIDEST_PX:
            raise ValueError(f"a stroke {2 * half:.0f} px wide is too wide: paint it as a polygon")
        return width

    def _covered(self, distance: Singles, half_px: Floats | None) -> Singles:
        """Coverage of pixels at a signed distance (1/1024 px, inside positive) from an edge or a stroke's middle."""
        if half_px is None:
            distance += np.float32(MIDDLE + 0.5)
            return self._table.take(distance.astype(np.int32), mode="clip")
        half = (half_px * UNIT + MIDDLE + 0.5).astype(np.float32)
        cover = self._table.take((half - distance).astype(np.int32), mode="clip")
        cover += self._table.take((half + distance).astype(np.int32), mode="clip")
        cover -= np.float32(1.0)
        return cover

    def corners(self, spans: _Spans, outlines: int) -> list[Band]:
        """Squares about the sharp vertices: there two edges meet."""
        half = math.ceil(2.0 * REACH_SIGMA * self._sigma)
        vertex = np.flatnonzero(np.abs(spans.end - spans.start).max(axis=1) < 1e-6)
        at, come, go = spans.start[vertex], spans.leave[vertex], spans.arrive[vertex]
        turn = np.arctan2(come[:, 0] * go[:, 1] - come[:, 1] * go[:, 0], np.sum(come * go, axis=1))
        low, high = half + 2 - MARGIN_PX, np.array(self._size) + MARGIN_PX - half - 2
        sharp = np.all((at > low) & (at < high), axis=1) & (np.abs(turn) > math.radians(SMOOTH_DEG))
        if not sharp.any():
            return []
        bounds = np.searchsorted(spans.owner[vertex[sharp]], np.arange(outlines + 1))
        k = np.arange(-half, half + 1)
        pixel = np.rint(at[sharp]) + np.stack(np.meshgrid(k, k), axis=-1).reshape(-1, 1, 2)
        cover = self._corner(pixel - at[sharp], come[sharp], go[sharp], turn[sharp])
        places = (pixel + MARGIN_PX) @ self._stride
        return [Band(places.astype(np.intp), cover, bounds)]

    def _corner(self, away: Points, come: Points, go: Points, turn: Floats) -> Singles:
        """Coverage by a corner of pixels that lie `away` (w, n, 2) from its vertex, where two half planes meet."""
        one, two = self._side(away, come), self._side(away, go)
        alike = np.clip(np.cos(turn), 0.0, 1.0).astype(np.float32)
        hollow = turn * self._left < 0.0
        return np.where(hollow, 1 - _both(1 - one, 1 - two, alike), _both(one, two, alike))

    def _side(self, away: Points, direction: Points) -> Singles:
        """How much of each pixel lies on the inner side of a straight line."""
        unit = direction * (UNIT * self._left) / np.hypot(direction[:, 0], direction[:, 1])[:, None]
        return self._covered((unit[:, 0] * away[..., 1] - unit[:, 1] * away[..., 0]).astype(np.float32), None)


def _both(a: Singles, b: Singles, alike: Singles) -> Singles:
    """Coverage by both of two half planes: the product at a right angle, the smaller one where they are the same."""
    return np.asarray(a * b * (1 - alike) + np.minimum(a, b) * alike, np.float32)


def _crossings(spans: _Spans, along: int, limit: int) -> _Crossings:
    """Where the spans cross whole columns (along 0) or rows (along 1) of the picture, steep spans left out.

    Between its ends a span is a parabola with the slopes of its ends.
    """
    a0, a1 = spans.start[:, along], spans.end[:, along]
    first = np.clip(np.ceil(np.minimum(a0, a1)), 0, limit)
    count = np.clip(np.ceil(np.maximum(a0, a1)), 0, limit) - first
    rise = spans.end[:, 1 - along] - spans.start[:, 1 - along]
    used = np.flatnonzero((count > 0) & (np.abs(rise) <= STEEPEST * np.abs(a1 - a0)))
    number, length = count[used].astype(np.intp), (a1 - a0)[used]
    slopes = [d[used, 1 - along] / d[used, along] for d in (spans.leave, spans.arrive)]
    bend = (slopes[1] - slopes[0]) / length
    slope = rise[used] / length - 0.5 * bend * length
    skipped = first[used] - (np.cumsum(number) - number)
    known = [a0[used], spans.start[used, 1 - along], slope, bend, np.sign(length), skipped, spans.owner[used]]
    each = np.repeat(np.stack(known), number, axis=1)
    at = np.arange(each.shape[1]) + each[5]
    run = at - each[0]
    across = each[1] + (each[2] + 0.5 * each[3] * run) * run
    return _Crossings(at, across, each[2] + each[3] * run, each[3], each[4], each[6])


def _distance(offset: Singles, cross: _Crossings, left: float, sigma: float) -> Singles:
    """Distance (1/1024 px, inside positive) from a curve of pixels `offset` px away along a column or row.

    Its foot is found to second order. Blur shifts a curved edge to its centre by half its curvature times sigma^2.
    """
    cos = 1.0 / np.sqrt(1.0 + cross.slope**2)
    side = cross.rising * (left * UNIT)
    hook = 0.5 * cross.bend * cos**3 * side  # half the curvature
    distance = offset * (hook * (cross.slope * cos) ** 2).astype(np.float32)
    np.subtract((cos * side).astype(np.float32), distance, out=distance)
    distance *= offset
    distance -= (hook * sigma * sigma).astype(np.float32)
    return distance
