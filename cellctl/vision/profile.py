"""The grey profile across an edge: a step, blurred by the lens, integrated by the pixels. Pure.

Blocks of pixels along an edge are compared with this profile where they lie; nothing is interpolated. One block gives
one offset, the maximum-likelihood one, with its information: far less sensitive to dirt than single profiles.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cellctl.vision.features import Floats, Singles
from cellctl.vision.robust import middle

SPAN_PX = 16  # the tables reach so far to either side
PER_PX = 128  # table entries
START_BLUR_PX = 1.15
FARTHEST_PX = 3.0  # a block whose offset is larger has locked on something else
BLURS_PX = np.arange(0.6, 3.05, 0.1)
MEAN_STEP_PX = 0.25  # resolution of the mean profile
MEAN_BINS = 49
FEWEST_BINS, FEWEST_PER_BIN = 9, 5


class Offsets(NamedTuple):
    """One offset per block, px: positive when the edge lies on the dark side of where it was assumed."""

    shift: Floats
    height: Floats  # of the step, grey levels; negative: wrong way round
    information: Floats  # of the shift, for a noise variance of 1
    variance: Floats  # of the pixels about the fitted profile


@lru_cache(maxsize=64)
def step_table(blur_px: float) -> tuple[Singles, Singles]:
    """Level and slope of a unit step over distance, for a Gaussian blur and square pixels."""
    sigma = math.hypot(blur_px, math.sqrt(1.0 / 12.0))
    distance = np.arange(-SPAN_PX * PER_PX, SPAN_PX * PER_PX + 1) / PER_PX
    level = [0.5 * (1.0 + math.erf(d / (sigma * math.sqrt(2.0)))) for d in distance]
    slope = np.exp(-0.5 * (distance / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
    return np.array(level, np.float32), slope.astype(np.float32)


def block_offsets(levels: Singles, distance: Singles, blur_px: float) -> Offsets:
    """Compare blocks of pixels (blocks, pixels) at signed distances (towards the bright side) with the blurred step.

    Linear least squares per block of level = dark + height * step + height * shift * slope.
    """
    rise, slope = step_table(round(blur_px * 20.0) / 20.0)
    place = (distance * np.float32(PER_PX) + np.float32(SPAN_PX * PER_PX + 0.5)).astype(np.int32)
    f, g, i = rise.take(place, mode="clip"), slope.take(place, mode="clip"), _centred(levels)
    part = 1.0 / levels.shape[1]
    sf, sg = (a.sum(axis=1, dtype=np.float64) for a in (f, g))
    ff, fg, gg = _sums(f, f) - part * sf * sf, _sums(f, g) - part * sf * sg, _sums(g, g) - part * sg * sg
    fi, gi, ii = _sums(f, i), _sums(g, i), _sums(i, i)
    det = ff * gg - fg * fg
    det[det <= 1e-9] = np.inf
    height = (gg * fi - fg * gi) / det
    slope_part = (ff * gi - fg * fi) / det
    variance = np.maximum(ii - height * fi - slope_part * gi, 0.0) / max(1, levels.shape[1] - 3)
    safe = np.where(np.abs(height) < 1e-3, np.inf, height)
    information = height * height * np.maximum(gg - fg * fg / np.maximum(ff, 1e-9), 0.0)
    return Offsets(slope_part / safe, height, information, variance)


def _centred(a: Singles) -> Singles:
    return np.asarray(a - a.mean(axis=1, keepdims=True), np.float32)


def _sums(a: Singles, b: Singles) -> Floats:
    return np.asarray(np.einsum("ij,ij->i", a, b), np.float64)


def typical_height(offsets: Offsets, least: float) -> float:
    """The contrast of the outline: the median step of the blocks that have one."""
    return middle(offsets.height[offsets.height > least])


def block_weights(offsets: Offsets, least: float) -> Floats:
    """How far each block is to be believed before its offset is compared with its neighbours'.

    The weight is the block's information over its residual variance; blocks without a step get 0.
    """
    floor = max(least, 0.35 * typical_height(offsets, least))
    weight = offsets.information / np.maximum(offsets.variance, 1.0)
    weight[(offsets.height < floor) | (np.abs(offsets.shift) > FARTHEST_PX)] = 0.0
    used = weight > 0.0
    if used.any():
        weight = np.minimum(weight / middle(weight[used]), 3.0)
    return weight


@lru_cache(maxsize=1)
def _blurred_steps() -> Floats:
    """Step profiles for all blurs: (blurs, bins)."""
    distance = (np.arange(MEAN_BINS) - MEAN_BINS // 2) * MEAN_STEP_PX
    sigma = np.hypot(BLURS_PX, math.sqrt(1.0 / 12.0))[:, None] * math.sqrt(2.0)
    return np.asarray(np.vectorize(math.erf)(distance / sigma), np.float64)


def estimate_blur(levels: Singles, distance: Singles, offsets: Offsets, weight: Floats) -> float | None:
    """Blur of an outline from the mean profile of its good blocks; None when there are too few.

    An outline that runs along the pixels leaves some bins of the profile empty: only the others are compared.
    """
    good = np.flatnonzero(weight > 0.2)
    if good.size < 3:
        return None
    where = distance[good] + offsets.shift[good, None].astype(np.float32)
    where *= np.float32(1.0 / MEAN_STEP_PX)
    where += np.float32(MEAN_BINS // 2 + 1.5)
    place = where.clip(0, MEAN_BINS + 1).astype(np.int32).reshape(-1)  # the outermost two take what is out of reach
    level = _centred(levels[good]) / offsets.height[good, None].astype(np.float32)
    count = np.bincount(place, minlength=MEAN_BINS + 2)[1:-1]
    total = np.bincount(place, weights=level.reshape(-1), minlength=MEAN_BINS + 2)[1:-1]
    filled = np.flatnonzero(count >= FEWEST_PER_BIN)
    if filled.size < FEWEST_BINS:
        return None
    mean, steps = total[filled] / count[filled], _blurred_steps()[:, filled]
    mean -= mean.mean()
    steps = steps - steps.mean(axis=1, keepdims=True)
    likeness = (steps @ mean) / np.sqrt(np.einsum("ij,ij->i", steps, steps))
    return float(BLURS_PX[int(np.argmax(likeness))])
