"""Outlines that have been caught are measured: blocks of pixels against a blurred step, and a robust fit. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellctl.vision.features import Appearance, Floats, Limits, NotFound
from cellctl.vision.gates import check_seen
from cellctl.vision.profile import Blocks, appearance, beliefs, better_width, block_offsets
from cellctl.vision.robust import Bools, Fit, covariance, tukey_fit
from cellctl.vision.strip import Part, Strip

PASSES, ROUNDS = 8, 12  # at most; a clean outline needs one pass and three rounds of the robust fit
SETTLED_PX, SETTLED_WIDTH = 0.1, 0.03  # calipers catch better than that: a further pass would change next to nothing


class Outline(NamedTuple):
    """A caught outline: how each of its parameters moves its blocks towards the bright side, (blocks, parameters)."""

    name: str
    design: Floats
    parameters: Floats  # to begin with
    width_px: float  # of its blur, roughly
    fewest: int  # blocks that must see it


class Measured(NamedTuple):
    """An outline's parameters with their covariance, and how its picture looks."""

    parameters: Floats
    spread: Floats
    used: Bools  # (blocks,)
    appearance: Appearance
    inliers: float
    residual_px: float


class _Seen(NamedTuple):
    """One outline after a pass."""

    outline: Outline  # with better parameters and width
    blocks: Blocks
    weights: Floats  # before the fit
    fit: Fit
    moves: Floats  # of the blocks, towards their bright side
    settled: bool  # a further pass would change next to nothing


def measure(strip: Strip, outlines: Sequence[Outline], limits: Limits) -> list[Measured]:
    """Measure outlines that lie side by side in a strip, each known to some pixels.

    Raises NotFound when too few blocks see one of them, or when one settles nowhere.
    """
    for _ in range(PASSES):
        blocks = block_offsets(strip, [outline.width_px for outline in outlines])
        seen = [
            _fitted(strip, part, blocks.of(part), outline, limits)
            for part, outline in zip(strip.parts, outlines, strict=True)
        ]
        outlines = [each.outline for each in seen]
        if all(each.settled for each in seen):
            return [_measured(strip, *each) for each in zip(strip.parts, seen, strict=True)]
        strip = strip.moved(np.concatenate([each.moves for each in seen]))
    worst = max(seen, key=lambda each: float(np.abs(each.moves).max()))
    detail = f"what is seen of it agrees on no place: after {PASSES} passes it still moves by"
    raise NotFound(worst.outline.name, f"{detail} {np.abs(worst.moves).max():.2f} px")


def _fitted(strip: Strip, part: Part, blocks: Blocks, outline: Outline, limits: Limits) -> _Seen:
    weights = beliefs(strip, part, blocks, 0.5 * limits.min_contrast)
    check_seen(strip, part, weights, outline.fewest, limits, outline.name)
    fit = tukey_fit(outline.design, -blocks.shift, weights, ROUNDS)
    width = better_width(blocks, fit.weights, outline.width_px)
    moves = outline.design @ fit.parameters
    settled = bool(np.abs(moves).max() < SETTLED_PX) and abs(width / outline.width_px - 1.0) < SETTLED_WIDTH
    better = outline._replace(parameters=outline.parameters + fit.parameters, width_px=width)
    return _Seen(better, blocks, weights, fit, moves, settled)


def _measured(strip: Strip, part: Part, seen: _Seen) -> Measured:
    used = seen.fit.weights > 0.0
    return Measured(
        parameters=seen.outline.parameters,
        spread=covariance(seen.outline.design, seen.fit, seen.weights),
        used=used,
        appearance=appearance(strip, part, seen.blocks, seen.fit.weights, seen.outline.width_px),
        inliers=float(np.count_nonzero(used) / used.size),
        residual_px=seen.fit.spread,
    )
