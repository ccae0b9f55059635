"""Offsets of blocks of pixels against a blurred step, and how far each is to be believed. Pure."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple, Protocol

import numpy as np

from cellctl.vision.features import Floats, Singles
from cellctl.vision.robust import middle

SPAN_PX = 16  # the tables reach so far to either side
PER_PX = 128  # table entries
FARTHEST_PX = 3.0  # a block whose offset is larger has locked on something else


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


class Stepped(Protocol):
    """What knows the height of each block's step."""

    @property
    def height(self) -> Floats:
        """Grey levels."""


def typical_height(offsets: Stepped, least: float) -> float:
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
