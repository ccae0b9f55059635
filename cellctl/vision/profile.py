"""The grey profile across an outline: a step, blurred by the lens, integrated by the pixels. Pure.

Each block of an outline gives one offset, the maximum-likelihood one, and says by its misfit how far it is to be
believed: dirt, scratches and whatever lies over the outline do not look like a blurred step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from cellctl.vision.features import Appearance, Floats, Singles
from cellctl.vision.offsets import FARTHEST_PX, typical_height
from cellctl.vision.robust import middle, quantile
from cellctl.vision.strip import Part, Strip

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

    def of(self, part: Part) -> Blocks:
        """Those of one outline."""
        return Blocks(*(values[part.where] for values in self))


@lru_cache(maxsize=1)
def _unit_step() -> Singles:
    """Level and slope (2, places) of a step of blur 1 over distance."""
    z = np.arange(-REACH * PER_SIGMA, REACH * PER_SIGMA + 1.0) / PER_SIGMA
    level = [0.5 * (1.0 + math.erf(d / math.sqrt(2.0))) for d in z]
    return np.array([level, np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi)], np.float32)


def block_offsets(strip: Strip, widths_px: Sequence[float]) -> Blocks:
    """Compare each block with a step of its outline's blur (sigma of all that blurs it), by linear least squares.

    level = dark + height * (step + shift * slope); and how the rest looks like a change of the width.
    """
    per_px = np.repeat([1.0 / width for width in widths_px], [p.where.stop - p.where.start for p in strip.parts])
    z = strip.distance * per_px.astype(np.float32)
    columns = np.empty((4, *z.shape), np.float32)  # step, slope, slope by distance, levels
    place = (z * np.float32(PER_SIGMA) + np.float32(REACH * PER_SIGMA + 0.5)).astype(np.intp)
    _unit_step().take(place, axis=1, mode="clip", out=columns[:2])
    np.multiply(columns[1], z, out=columns[2])
    columns[3] = strip.levels
    means = np.add.reduce(columns, axis=1) * np.float32(1.0 / len(z))
    columns -= means[:, None]
    gram = np.einsum("irn,jrn->ijn", columns, columns)
    return _solved(gram.astype(np.float64), means, len(z), per_px)


def _solved(gram: Floats, means: Singles, rows: int, per_px: Floats) -> Blocks:
    """The blocks' least squares out of the products (4, 4, n) of step, slope, slope by distance and levels."""
    (ff, fg, fh, fi), (_, gg, gh, gi), (_, _, hh, hi), (_, _, _, ii) = gram
    det = ff * gg - fg * fg
    det[det <= 1e-6] = np.inf  # no step in the band
    height, turn = (gg * fi - fg * gi) / det, (ff * gi - fg * fi) / det
    power = np.square(height * per_px)
    return Blocks(
        shift=turn / (np.where(np.abs(height) < 1e-3, np.inf, height) * per_px),
        dark=means[3] - height * means[0] - turn * means[1],
        height=height,
        information=power * (gg - fg * fg / np.maximum(ff, 1e-6)),
        variance=np.maximum(ii - height * fi - turn * gi, 0.0) / max(1, rows - 3),
        wider=height * per_px * (height * fh + turn * gh - hi),
        widths=power * (hh - (gg * fh * fh - 2.0 * fg * fh * gh + ff * gh * gh) / det),
    )


def beliefs(strip: Strip, part: Part, blocks: Blocks, least: float) -> Floats:
    """How far each block of an outline is to be believed before its offset is compared with its neighbours'.

    The scale of a clean block's misfit is taken from the best quarter: with dirt on most of an outline the median
    would already be dirty. Blocks without a step, far off, or over-exposed get 0.
    """
    floor = max(least, LEAST_SHARE * typical_height(blocks, least))
    used = blocks.height > floor
    used &= np.abs(blocks.shift) < FARTHEST_PX
    used &= strip.levels[-1, part.where] < BRIGHT
    if not used.any():
        return np.zeros(len(used))
    clean = quantile(blocks.variance[used], CLEAN_SHARE) / CLEAN_QUANTILE
    misfit = blocks.variance * (1.0 / max(clean, 2.0 * PIXEL_VARIANCE / part.pixels))
    weight = np.minimum(blocks.information * (1.0 / middle(blocks.information[used])), 2.0)
    weight /= 1.0 + DOUBT * np.maximum(misfit - FREE_MISFIT, 0.0)
    used &= misfit <= MOST_MISFIT
    weight *= used
    return weight


def appearance(strip: Strip, part: Part, blocks: Blocks, weight: Floats, width_px: float) -> Appearance:
    """How the picture shows the outline whose blocks have these final weights."""
    good = np.flatnonzero(weight)
    contrast, dark = middle(blocks.height[good]), middle(blocks.dark[good])
    return Appearance(
        blur_px=blur_of(width_px, part.smear),
        contrast=contrast,
        noise=math.sqrt(middle(blocks.variance[good]) * part.pixels),
        dark=dark,
        bright=dark + contrast,
        saturated=saturated(strip, part),
    )


def saturated(strip: Strip, part: Part) -> float:
    """Share of an outline's blocks that are over-exposed on their bright side."""
    bright = strip.levels[-1, part.where]
    return float(np.count_nonzero(bright >= BRIGHT) / bright.size)


def better_width(blocks: Blocks, weight: Floats, width_px: float) -> float:
    """The width that the good blocks together ask for; at most a third wider or narrower at a time."""
    power = float(weight @ blocks.widths)
    change = float(weight @ blocks.wider) / power if power > 0.0 else 0.0
    change = min(max(change, -width_px / 3.0), width_px / 3.0)
    return min(max(width_px + change, WIDTHS_PX[0]), WIDTHS_PX[1])


def blur_of(width_px: float, smear: float) -> float:
    """Sigma of the lens's blur, when pixels and averaging are taken out of the width."""
    return math.sqrt(max(width_px**2 - PIXEL_VARIANCE - smear, 0.01))
