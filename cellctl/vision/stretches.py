"""How much of a straight edge is straight and clean: the stretch that a recipe tells the finders to use. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellctl.geometry import Px
from cellctl.vision.edgels import GOOD_CONTRAST, LEAST_CONTRAST, blocks_of, strip_across
from cellctl.vision.features import Edge, ExpectedEdge, Floats, Pixels
from cellctl.vision.plane import ahead, cross, direction
from cellctl.vision.robust import line_consensus, middle, tukey_fit
from cellctl.vision.steps import step_response

SHORTEST_PX = 200.0  # a shorter stretch is of no use
HALF_PX = 16  # to either side of the rough line
BLOCK_PX = 16
CLEAN_PX = 0.7  # a block of a clean edge lies so near its line ...
CLEAN_HEIGHT = 0.4  # ... and its contrast differs from the typical one by at most this part
UNCLEAN_BLOCKS = 3  # so many in a row do not end a stretch


class StraightOutline(NamedTuple):
    """The straight and clean stretch of an edge: its contrast and its length."""

    edge: ExpectedEdge
    contrast: float
    length_px: float

    @property
    def score(self) -> float:
        """By how much of it there is to measure."""
        return self.length_px * min(self.contrast, GOOD_CONTRAST)


class _Blocks(NamedTuple):
    """What an edge's blocks of pixels say, (n,): place along the rough line, offset to its bright side, contrast."""

    along: Floats
    away: Floats
    height: Floats


def follow_edge(pixels: Pixels, start: Px, end: Px, bright: Px) -> StraightOutline | None:
    """The longest straight and clean stretch of an edge that is known to some pixels.

    `bright` is the unit vector towards its bright side. None when less than 200 px of it are clean.
    """
    blocks = _blocks(pixels, start, end, bright)
    strong = blocks.height > LEAST_CONTRAST
    t, away = blocks.along[strong], blocks.away[strong]
    together = line_consensus(t, away)
    if together is None:
        return None
    fit = tukey_fit(np.stack([np.ones_like(t), t], axis=1), away, together.astype(np.float64), 4)
    straight = fit.parameters[0] + fit.parameters[1] * blocks.along
    ends_px = _clean(blocks._replace(away=blocks.away - straight))
    if ends_px is None:
        return None
    way = direction(start, end)
    one, two = (ahead(ahead(start, way, s), bright, float(fit.parameters[0] + fit.parameters[1] * s)) for s in ends_px)
    edge = ExpectedEdge(one, two, bright_left=cross(way, bright) < 0.0)
    return StraightOutline(edge, middle(blocks.height[strong][together]), ends_px[1] - ends_px[0])


def whole_stretch(pixels: Pixels, edge: Edge, bright: Px) -> tuple[Px, Px] | None:
    """The longest clean stretch of a measured edge's line, from border to border of the picture, as the edge runs."""
    way = direction(edge.start, edge.end)
    first, last = _within(pixels, edge.start, way)
    start = ahead(edge.start, way, first)
    ends_px = _clean(_blocks(pixels, start, ahead(start, way, last - first), bright))
    return None if ends_px is None else (ahead(start, way, ends_px[0]), ahead(start, way, ends_px[1]))


def _within(pixels: Pixels, point: Px, way: Px) -> tuple[float, float]:
    """From where to where a line through a point of the picture is in it, px along `way`."""
    first, last = -math.inf, math.inf
    for at, step, size in zip(point, way, pixels.shape[::-1], strict=True):
        if abs(step) > 1e-9:
            one, two = sorted((-at / step, (size - 1 - at) / step))
            first, last = max(first, one), min(last, two)
    return first, last


def _blocks(pixels: Pixels, start: Px, end: Px, bright: Px) -> _Blocks:
    along = np.arange(0.0, math.dist(start, end))[:, None]
    points = np.array(start) + along * np.array(direction(start, end))
    strip = strip_across(pixels, points, np.array(bright), HALF_PX)
    hit, height = step_response(blocks_of(strip, BLOCK_PX), 1.0)
    t = (np.arange(len(hit), dtype=np.float64) + 0.5) * BLOCK_PX
    return _Blocks(t, hit - HALF_PX, height.astype(np.float64))


def _clean(blocks: _Blocks) -> tuple[float, float] | None:
    """Where the longest run of blocks begins and ends that lie on the line and have the contrast of most of them, px.

    Offsets of the blocks count from the line.
    """
    near = (np.abs(blocks.away) < CLEAN_PX) & (blocks.height > LEAST_CONTRAST)
    typical = middle(blocks.height[near])
    clean = near & (np.abs(blocks.height - typical) < CLEAN_HEIGHT * typical)
    first, last = longest_run(np.flatnonzero(clean).astype(np.float64), UNCLEAN_BLOCKS + 1.0)
    ends_px = first * BLOCK_PX, (last + 1.0) * BLOCK_PX
    return ends_px if ends_px[1] - ends_px[0] >= SHORTEST_PX else None


def longest_run(places: Floats, gap: float) -> tuple[float, float]:
    """First and last of the longest run of places without a larger gap; (0, 0) of none."""
    if places.size == 0:
        return 0.0, 0.0
    ordered = np.sort(places)
    breaks = np.flatnonzero(np.diff(ordered) > gap)
    firsts, lasts = ordered[np.r_[0, breaks + 1]], ordered[np.r_[breaks, ordered.size - 1]]
    best = int(np.argmax(lasts - firsts))
    return float(firsts[best]), float(lasts[best])
