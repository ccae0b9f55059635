"""The grey profile across an outline: a step, blurred by the lens, integrated by the pixels. Pure.

Each block of an outline gives one offset, the maximum-likelihood one, and says by its misfit how far it is to be
believed: dirt, scratches and whatever lies over the outline do not look like a blurred step.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cellctl.vision.features import Appearance, Floats, Singles
from cellctl.vision.offsets import FARTHEST_PX, typical_height
from cellctl.vision.robust import middle, quantile
from cellctl.vision.strip import Strip

PIXEL_VARIANCE = 1.0 / 12.0  # of a pixel's own width, px^2
REACH = 6.0  # the table of the step reaches so many sigmas
PER_SIGMA = 512
WIDTHS_PX = (0.45, 4.5)  # sigmas of the whole blur that are believed
BRIGHT = 247.0  # mean level from which pixels are cut off at 255
LEAST_SHARE = 0.4  # of the typical step: blocks with less do not see the outline
CLEAN_SHARE, CLEAN_QUANTILE = 0.25, 0.70  # a quarter of the blocks is clean; chi^2 / n of 12 has its quartile there
FREE_MISFIT, MOST_MISFIT, DOUBT = 1.5, 6.0, 4.0


class Blocks(NamedTuple):
    """What each block (n,) says, px and grey levels."""

    shift: Floats  # positive when the outline lies on the dark side of where it was assumed
    dark: Floats  # level of the dark side
    height: Floats  # of the step; negative: wrong way round
    information: Floats  # of the shift, for a variance of the levels of 1
    variance: Floats  # of the levels about the fitted profile
    wider: Floats  # how much wider the blur is, times `widths`
    widths: Floats  # information about that


@lru_cache(maxsize=1)
def _unit_step() -> tuple[Singles, Singles]:
    """Level and slope of a step of blur 1 over distance."""
    z = np.arange(-REACH * PER_SIGMA, REACH * PER_SIGMA + 1.0) / PER_SIGMA
    level = [0.5 * (1.0 + math.erf(d / math.sqrt(2.0))) for d in z]
    return np.array(level, np.float32), (np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)).astype(np.float32)


def block_offsets(strip: Strip, width_px: float) -> Blocks:
    """Compare each block with a step of this blur (sigma of all that blurs it), by linear least squares.

    level = dark + height * (step + shift * slope); and how the rest looks like a change of the width.
    """
    level, slope = _unit_step()
    z = strip.distance * np.float32(1.0 / width_px)
    index = (z * np.float32(PER_SIGMA) + np.float32(REACH * PER_SIGMA + 0.5)).astype(np.int32)
    columns = np.empty((len(z), 4, z.shape[1]), np.float32)
    columns[:, 0] = level.take(index, mode="clip")
    columns[:, 1] = g = slope.take(index, mode="clip") * np.float32(1.0 / width_px)
    columns[:, 2] = -g * z
    columns[:, 3] = strip.levels
    means = np.add.reduce(columns, axis=2) * np.float32(1.0 / z.shape[1])
    columns -= means[:, :, None]
    return _solved(columns @ columns.transpose(0, 2, 1), means, z.shape[1])


def _solved(gram: Singles, means: Singles, rows: int) -> Blocks:
    """The blocks' least squares out of the products (n, 4, 4) of step, slope, widening and levels."""
    (ff, fg, fh, fi), (_, gg, gh, gi), (_, _, hh, hi), (_, _, _, ii) = gram.astype(np.float64).transpose(1, 2, 0)
    det = ff * gg - fg * fg
    flat = det <= 1e-6
    det[flat] = 1.0
    height, turn = (gg * fi - fg * gi) / det, (ff * gi - fg * fi) / det
    height[flat] = turn[flat] = 0.0
    return Blocks(
        shift=turn / np.where(np.abs(height) < 1e-3, np.inf, height),
        dark=means[:, 3] - height * means[:, 0] - turn * means[:, 1],
        height=height,
        information=height * height * (det / np.maximum(ff, 1e-6)),
        variance=np.maximum(ii - height * fi - turn * gi, 0.0) / max(1, rows - 3),
        wider=height * (hi - height * fh - turn * gh),
        widths=height * height * (hh - (gg * fh * fh - 2.0 * fg * fh * gh + ff * gh * gh) / det),
    )


def beliefs(strip: Strip, blocks: Blocks, least: float) -> Floats:
    """How far each block is to be believed before its offset is compared with its neighbours'.

    The scale of a clean block's misfit is taken from the best quarter: with dirt on most of an outline the median
    would already be dirty. Blocks without a step, far off, or over-exposed get 0.
    """
    floor = max(least, LEAST_SHARE * typical_height(blocks, least))
    used = (blocks.height > floor) & (np.abs(blocks.shift) < FARTHEST_PX) & (strip.levels[:, -1] < BRIGHT)
    if not used.any():
        return np.zeros(len(used))
    clean = quantile(blocks.variance[used], CLEAN_SHARE) / CLEAN_QUANTILE
    misfit = blocks.variance / max(clean, 2.0 * PIXEL_VARIANCE / strip.pixels)
    weight = np.minimum(blocks.information / middle(blocks.information[used]), 2.0)
    weight /= 1.0 + DOUBT * np.maximum(misfit - FREE_MISFIT, 0.0)
    weight[~used | (misfit > MOST_MISFIT)] = 0.0
    return weight


def appearance(strip: Strip, blocks: Blocks, weight: Floats, width_px: float, least: float) -> Appearance:
    """How the picture shows the outline whose blocks have these final weights."""
    good = np.flatnonzero(weight)
    contrast, dark = typical_height(blocks, least), middle(blocks.dark[good])
    return Appearance(
        blur_px=blur_of(width_px, strip.smear),
        contrast=contrast,
        noise=math.sqrt(middle(blocks.variance[good]) * strip.pixels),
        dark=dark,
        bright=dark + contrast,
        saturated=saturated(strip),
    )


def saturated(strip: Strip) -> float:
    """Share of the blocks that are over-exposed on their bright side."""
    return np.count_nonzero(strip.levels[:, -1] >= BRIGHT) / len(strip.levels)


def better_width(blocks: Blocks, weight: Floats, width_px: float) -> float:
    """The width that the good blocks together ask for; at most a third wider or narrower at a time."""
    power = float(weight @ blocks.widths)
    change = float(weight @ blocks.wider) / power if power > 0.0 else 0.0
    change = min(max(change, -width_px / 3.0), width_px / 3.0)
    return min(max(width_px + change, WIDTHS_PX[0]), WIDTHS_PX[1])


def blur_of(width_px: float, smear: float) -> float:
    """Sigma of the lens's blur, when pixels and averaging are taken out of the width."""
    return math.sqrt(max(width_px**2 - PIXEL_VARIANCE - smear, 0.01))
