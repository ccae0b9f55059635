"""Where a hole or an edge roughly is: votes of signed gradients on the coarse picture. Pure.

A Hough vote finds, it does not measure. The radius, the polarity and nearly the place are known, so few votes do.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from cellctl.geometry import Px
from cellctl.vision.features import ExpectedCircle, ExpectedEdge, Limits, NotFound, Pixels, Singles
from cellctl.vision.picture import COARSE, Box, Coarse, coarse, to_coarse, to_fine
from cellctl.vision.plane import direction, middle

TURN_STEP_DEG = 0.4  # over the longest edges that is 6 px at the ends: calipers reach five times as far
MOST_TURNS = 64  # to either side
SPARE_DEG = 12.0  # gradients of noisy pixels point that far off their edge's normal
SUPPRESSED_BINS = 4  # to either side of a peak: no second hypothesis there, calipers see beyond (16 px)
SAME_CIRCLE = 4  # coarse px: votes so near belong to the same circle
LEAST_VOTES = 0.15  # per coarse px of radius, at the peak: a whole, clean outline has 0.9
LEAST_SHARE = 0.8  # of the best peak's votes; half of joint votes come from the other edge
GRADIENT_PER_LEVEL = 2.0  # the weakest edge of contrast c has coarse gradients of this times c
SPARE_PX = 3 * COARSE
OUT_OF_REACH = 1e6


class Frame(NamedTuple):
    """An expected edge in coarse px: its middle, unit vectors along it and to its bright side, half its length."""

    middle: Px
    along: Px
    bright: Px
    half: float


class Votes(NamedTuple):
    """Votes for lines near an expected edge: rows are turns towards its bright side, columns half px of offset."""

    heights: Singles
    turns: Singles  # rad
    frame: Frame


class RoughLine(NamedTuple):
    """A straight line through a point in a direction (unit vector)."""

    point: Px
    way: Px


def rough_circle(pixels: Pixels, circle: ExpectedCircle, search_px: float, limits: Limits) -> Px:
    """Centre of the circle of that radius to about 5 px. Raises NotFound when there is none, or two."""
    (cu, cv), far = circle.centre, circle.radius_px + search_px + SPARE_PX
    picture = coarse(pixels, Box(cu - far, cv - far, cu + far, cv + far), "hole")
    radius = circle.radius_px / COARSE
    reach = math.ceil(search_px / COARSE) + 2
    left, top = round(to_coarse(cu)) - reach, round(to_coarse(cv)) - reach
    n = 2 * reach + 1
    u, v = _centres(picture, radius if circle.dark_inside else -radius, GRADIENT_PER_LEVEL * limits.min_contrast)
    bu, bv = (u + (picture.left + 0.5 - left)).astype(np.intp), (v + (picture.top + 0.5 - top)).astype(np.intp)
    place = (bv * n + bu)[(bu >= 0) & (bu < n) & (bv >= 0) & (bv < n)]
    single = np.bincount(place, minlength=n * n).reshape(n, n).astype(np.float32)
    count = cv2.GaussianBlur(single, (7, 7), 1.4, borderType=cv2.BORDER_CONSTANT)
    _, votes, _, (best_u, best_v) = cv2.minMaxLoc(count)
    if votes < LEAST_VOTES * radius:
        raise NotFound("hole", f"no outline of radius {circle.radius_px:.0f} px within {search_px:.0f} px")
    cv2.circle(count, (best_u, best_v), SAME_CIRCLE, (0.0,), -1)
    share = cv2.minMaxLoc(count)[1] / votes
    if share > limits.max_rival:
        detail = f"another centre has {share:.0%} of its votes, allowed are {limits.max_rival:.0%}"
        raise NotFound("hole rival", f"{detail}: two holes, or one of another radius?")
    return Px(to_fine(left + best_u), to_fine(top + best_v))


def _centres(picture: Coarse, step: float, least: float) -> tuple[Singles, Singles]:
    """Where outlines' points see the centre of their circle, `step` coarse px towards their dark side."""
    gu, gv = picture.along_u, picture.along_v
    strong = np.flatnonzero(np.maximum(np.abs(gu), np.abs(gv)) > 0.7 * least)
    du, dv = gu.reshape(-1).take(strong).astype(np.float32), gv.reshape(-1).take(strong).astype(np.float32)
    size = np.hypot(du, dv)
    v, u = np.divmod(strong, gu.shape[1])
    reach = np.float32(step) / size
    reach[size <= least] = OUT_OF_REACH
    return np.asarray(u - du * reach, np.float32), np.asarray(v - dv * reach, np.float32)


def line_votes(
    pixels: Pixels, edge: ExpectedEdge, reach_px: float, angle_deg: float, min_contrast: float, name: str
) -> Votes:
    """Votes for lines near an edge, by offset of its middle towards its bright side and by turn. Raises NotFound."""
    frame = _frame(edge)
    centre, along, bright, half = frame
    angle, reach = math.radians(angle_deg), reach_px / COARSE
    across = reach + half * math.tan(angle) + 1.0
    far = [half * abs(along[i]) + across * abs(bright[i]) + 1.0 for i in (0, 1)]
    box = Box(*(to_fine(centre[i] + sign * far[i]) for sign in (-1.0, 1.0) for i in (0, 1)))
    picture = coarse(pixels, box, name)
    steep = math.tan(angle + math.radians(SPARE_DEG))
    u, v, rise = _rising(picture, along, bright, steep, GRADIENT_PER_LEVEL * min_contrast)
    du, dv = u + np.float32(picture.left - centre[0]), v + np.float32(picture.top - centre[1])
    s = du * np.float32(along[0]) + dv * np.float32(along[1])
    d = du * np.float32(bright[0]) + dv * np.float32(bright[1])
    (used,) = ((np.abs(s) <= half) & (np.abs(d) <= across)).nonzero()
    return Votes(*_accumulated(s[used], d[used], np.sqrt(rise[used]), reach, angle), frame)


def _rising(picture: Coarse, along: Px, bright: Px, steep: float, least: float) -> tuple[Singles, Singles, Singles]:
    """Places u, v of gradients towards the bright side, at most so steep across it, and their sizes."""
    gu, gv = picture.along_u, picture.along_v
    rise = cv2.addWeighted(gu, bright[0], gv, bright[1], 0.0)
    drift = np.abs(cv2.addWeighted(gu, along[0], gv, along[1], 0.0))
    found = np.flatnonzero((rise > least) & (cv2.addWeighted(rise, steep, drift, -1.0, 0.0) > 0))
    v, u = np.divmod(found, gu.shape[1])
    return u.astype(np.float32), v.astype(np.float32), rise.reshape(-1).take(found).astype(np.float32)


def _accumulated(s: Singles, d: Singles, weight: Singles, reach: float, angle: float) -> tuple[Singles, Singles]:
    """Votes (turns, offsets) of gradients at places s along and d across, and the turns."""
    turns, slopes = _turns(angle)
    zero = math.ceil(2.0 * reach) + 1
    bins = 2 * zero + 3  # the outermost two take what is out of reach
    place = 2.0 * (d - s * slopes) + np.float32(zero + 1.5)
    place = np.minimum(np.maximum(place, 0.0, out=place), bins - 1, out=place).astype(np.int32)
    place += (np.arange(turns.size, dtype=np.int32) * bins)[:, None]
    count = np.bincount(place.reshape(-1), np.tile(weight, turns.size), minlength=bins * turns.size)
    single = count.reshape(-1, bins)[:, 1:-1].astype(np.float32)
    heights = cv2.GaussianBlur(single, (5, 3), 0, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(heights, np.float32), turns


@lru_cache(maxsize=16)
def _turns(angle: float) -> tuple[Singles, Singles]:
    """Turns to be tried (turns,), and their slopes (turns, 1)."""
    steps = min(math.ceil(math.degrees(angle) / TURN_STEP_DEG), MOST_TURNS)
    turns = np.linspace(-angle, angle, 2 * steps + 1, dtype=np.float32)
    return turns, np.tan(turns)[:, None]


def rough_lines(votes: Votes, most: int) -> list[RoughLine]:
    """The most voted lines, best first, distinct in offset."""
    heights, lines, least = votes.heights.copy(), [], 0.0
    centre, along, bright, _ = votes.frame
    for _ in range(most):
        _, best, _, (column, row) = cv2.minMaxLoc(heights)
        if best <= least:
            break
        least = max(least, LEAST_SHARE * best)
        offset, turn = (column - heights.shape[1] // 2) / 2.0, float(votes.turns[row])
        c, s = math.cos(turn), math.sin(turn)
        point = Px(*(to_fine(centre[i] + offset * bright[i]) for i in (0, 1)))
        lines.append(RoughLine(point, Px(*(c * along[i] + s * bright[i] for i in (0, 1)))))
        heights[:, max(0, column - SUPPRESSED_BINS) : column + SUPPRESSED_BINS + 1] = 0.0
    return lines


def turns_the_same_way(one: ExpectedEdge, other: ExpectedEdge) -> bool:
    """Whether a turn of the part is the same turn towards the bright side for both edges."""
    return one.bright_left == other.bright_left


def _frame(edge: ExpectedEdge) -> Frame:
    along = direction(edge.start, edge.end)
    left = Px(along.v, -along.u)  # on the screen, v runs down
    bright = left if edge.bright_left else Px(-left.u, -left.v)
    u, v = middle(edge.start, edge.end)
    return Frame(Px(to_coarse(u), to_coarse(v)), along, bright, 0.5 * math.dist(edge.start, edge.end) / COARSE)
