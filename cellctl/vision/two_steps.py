"""The grey profile across a dark slit: two blurred steps, fitted at once, block by block. Pure.

Where two edges are near each other, blur mixes them, and a step that is fitted to one of them alone is drawn towards
the other. Fitted together, they do not disturb each other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellctl.vision.features import Floats, Singles
from cellctl.vision.offsets import PER_PX, SPAN_PX, Offsets, step_table

ABSORBED = 1.5  # what a shift hides of something beside a step, against what is left to be seen of it
RIDGE = 1e-9  # of a block's pixels: keeps the normal equations of an empty block solvable


class Profiles(NamedTuple):
    """Blocks of pixels (blocks, pixels): grey levels, and signed distances past the step down and past the step up."""

    levels: Singles
    past_down: Singles
    past_up: Singles


class TwoSteps(NamedTuple):
    """What each block says of the step down and of the step up. Shifts count the way the distances do."""

    down: Offsets
    up: Offsets
    levels: Floats  # (blocks, 3): before, between, behind the steps
    blur_asked: Floats  # (2, blocks): how far the block asks for more blur, and how clearly: px = sum / sum
    width_by_blur: Floats  # (blocks,): how much further apart both steps are found per px of blur not assumed
    rest: Singles  # (blocks, pixels): grey levels that the profile does not explain


def fit_two_steps(seen: Profiles, blur_px: float) -> TwoSteps:
    """Compare blocks of pixels with the blurred profile: linear least squares of before + fall * step + rise * step.

    Each step has its slope beside it for a small shift; shifts beyond a pixel want another round from the better
    distances. What is left over is compared with the profile's derivative by its blur.
    """
    basis = _basis(seen, blur_px)
    mean = seen.levels.mean(axis=1, keepdims=True, dtype=np.float64)
    grey = np.asarray(seen.levels - mean, np.float32)[..., None]
    inverse = np.linalg.inv(_product(basis, basis) + RIDGE * basis.shape[1] * np.identity(5))
    right = _product(basis, grey)
    found = inverse @ right
    before, fall, rise, fall_shift, rise_shift = found[..., 0].T
    left = _product(grey, grey)[:, 0, 0] - (right * found).sum(axis=(1, 2))
    variance = np.maximum(left, 0.0) / max(1, basis.shape[1] - 5)
    by_blur = _by_blur(seen, basis, found, blur_px)
    explained = _product(basis, by_blur)
    moved = inverse @ explained
    asked = _product(by_blur, grey) - (explained * found).sum(axis=1, keepdims=True)
    clear = _product(by_blur, by_blur) - (explained * moved).sum(axis=1, keepdims=True)
    return TwoSteps(
        _offsets(-fall, fall_shift, inverse[:, 3, 3], variance),
        _offsets(rise, -rise_shift, inverse[:, 4, 4], variance),
        np.stack([before, before + fall, before + fall + rise], axis=1) + mean,
        np.stack([asked[:, 0, 0], clear[:, 0, 0]]),
        _divided(moved[:, 3, 0], fall) - _divided(moved[:, 4, 0], rise),
        grey[..., 0] - np.asarray(basis @ found.astype(np.float32))[..., 0],
    )


def _basis(seen: Profiles, blur_px: float) -> Singles:
    """(blocks, pixels, 5): one, both steps, both slopes."""
    rise, slope = step_table(round(blur_px * 20.0) / 20.0)
    basis = np.empty((*seen.levels.shape, 5), np.float32)
    basis[..., 0] = 1.0
    for i, distance in enumerate(seen[1:]):
        places = (distance * np.float32(PER_PX) + np.float32(SPAN_PX * PER_PX + 0.5)).astype(np.int32)
        basis[..., 1 + i] = rise.take(places, mode="clip")
        basis[..., 3 + i] = slope.take(places, mode="clip")
    return basis


def _by_blur(seen: Profiles, basis: Singles, found: Floats, blur_px: float) -> Singles:
    """The derivative of the found profile by its blur, (blocks, pixels, 1)."""
    fall, rise = (found[:, i].astype(np.float32) / np.float32(-blur_px) for i in (1, 2))
    return (fall * seen.past_down * basis[..., 3] + rise * seen.past_up * basis[..., 4])[..., None]


def _product(a: Singles, b: Singles) -> Floats:
    """Transposed a times b, block by block."""
    return np.asarray(a.transpose(0, 2, 1) @ b, np.float64)


def _offsets(height: Floats, slope_part: Floats, spread: Floats, variance: Floats) -> Offsets:
    """`slope_part` is height times shift; its variance is `spread` times that of the pixels."""
    return Offsets(_divided(slope_part, height), height, height * height / np.maximum(spread, 1e-12), variance)


def misfit_px(rest: Singles, past: Singles, height: float, blur_px: float, reach_px: int) -> float:
    """How far a step may be off because what lies beside it is no plain level: a rim, a wall that shines.

    `rest` are the residuals of good blocks (blocks, pixels) at distances `past` the step. Their mean profile is as
    large as what a shift of so many px would leave; the noise that is left in the mean is taken off.
    """
    bins = np.rint(past).astype(np.int64).reshape(-1) + reach_px
    near = (bins >= 0) & (bins <= 2 * reach_px)
    left = rest.reshape(-1)[near].astype(np.float64)
    count, total, squares = (np.bincount(bins[near], weights, 2 * reach_px + 1) for weights in (None, left, left**2))
    filled = np.maximum(count, 2)
    mean = total / filled
    power = mean * mean - np.maximum(squares / filled - mean * mean, 0.0) / (filled - 1)
    slope_power = 1.0 / (2.0 * math.sqrt(math.pi) * math.hypot(blur_px, math.sqrt(1.0 / 12.0)))
    return ABSORBED * math.sqrt(max(float(power.sum()), 0.0) / slope_power) / height


def _divided(part: Floats, height: Floats) -> Floats:
    """0 where there is no step."""
    return np.asarray(part / np.where(np.abs(height) < 1e-3, np.inf, height))
