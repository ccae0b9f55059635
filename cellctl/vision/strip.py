"""Blocks of pixels along an outline, averaged along it: what is left is a short grey profile per block. Pure.

Pixels are taken where they lie; nothing is interpolated. Averaging 16 pixels along the outline leaves the information
about its place as it is and makes all that follows sixteen times smaller; what it blurs is known (`smear`).
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Px
from cellctl.vision.features import Floats, NotFound, Pixels, Singles
from cellctl.vision.scan import Line, Scan

BLOCK_PX = 16  # pixels along a straight outline per block
BAND_PX = 8.0  # to either side of an outline, measured across it
SECTOR_PX = 20.0  # of a round outline per block
SECTORS = (24, 128)
SPARE_PX = 4


class Strip(NamedTuple):
    """Mean levels (blocks, rows) and their signed distances from the assumed outline, px towards its bright side."""

    levels: Singles
    distance: Singles
    pixels: int  # per mean
    smear: float  # px^2 that the averaging adds to the variance of the blur

    def moved(self, towards_bright: Floats) -> Strip:
        """The same pixels about an outline that lies so much further (blocks,) towards its bright side."""
        return self._replace(distance=self.distance - towards_bright.astype(np.float32)[:, None])


def line_strip(
    pixels: Pixels, scan: Scan, line: Line, first: int, blocks: int, reach_px: float, every: int = 1
) -> Strip:
    """Blocks of 16 columns (or rows) from `first` on, `reach_px` to either side; `every` skips columns."""
    step, side = scan.strides(pixels)
    along = first + _order(blocks, every)
    across = line.across(along)
    half = math.ceil(reach_px / line.cosine)
    whole = np.minimum(np.maximum(np.rint(across), half), scan.limits(pixels)[1] - half - 1)
    base = along * step + whole.astype(np.int64) * side
    offset = np.arange(-half, half + 1) * scan.rising
    taken = pixels.reshape(-1).take((offset * side)[:, None] + base)
    count = BLOCK_PX // every
    levels = taken.reshape(offset.size, count, blocks).sum(axis=1, dtype=np.uint16).astype(np.float32)
    levels *= np.float32(1.0 / count)
    beside = (across - whole).reshape(count, blocks)
    middle = np.add.reduce(beside, axis=0) / count
    beside -= middle
    distance = (offset * scan.rising - (scan.rising * middle)[:, None]) * line.cosine
    smear = float(np.vdot(beside, beside)) / beside.size * line.cosine**2
    return Strip(np.ascontiguousarray(levels.T), distance.astype(np.float32), count, smear)


@lru_cache(maxsize=64)
def _order(blocks: int, every: int) -> NDArray[np.int64]:
    """Columns of all blocks, those of one rank within their block side by side: sums over blocks run fast so."""
    return np.asarray((np.arange(0, BLOCK_PX, every)[:, None] + np.arange(blocks) * BLOCK_PX).reshape(-1), np.int64)


class Ring(NamedTuple):
    """The pixels about a circle of whole radius: their steps in the flat picture (count, sectors * rows).

    Distance of each mean from the circle, and its direction (sectors, rows); design (sectors, 3): radial shift by a
    shift of the centre and a growth.
    """

    places: NDArray[np.intp]
    distance: Singles
    cosine: Singles
    sine: Singles
    smear: float
    design: Floats


@lru_cache(maxsize=8)
def ring(radius: int, width: int) -> Ring:
    """Made once per radius: pixels sorted into sectors, each sector's into rows of equal numbers by their distance."""
    sectors = min(max(round(2.0 * math.pi * radius / SECTOR_PX), SECTORS[0]), SECTORS[1])
    rows, m = 2 * math.ceil(BAND_PX) + 1, math.ceil(radius + BAND_PX) + 1
    v, u = np.mgrid[-m : m + 1, -m : m + 1]
    near = np.abs(np.hypot(u, v) - radius) <= BAND_PX + 0.5
    u, v = u[near], v[near]
    order = np.argsort(np.arctan2(v, u), kind="stable")
    u, v = (a[order][: a.size // sectors * sectors].reshape(sectors, -1) for a in (u, v))
    count = u.shape[1] // rows
    away = np.hypot(u, v) - radius
    inner = np.argsort(np.abs(away), axis=1, kind="stable")[:, : rows * count]  # the outermost are left over
    order = np.take_along_axis(inner, np.argsort(np.take_along_axis(away, inner, axis=1), axis=1), axis=1)
    u, v, away = (np.take_along_axis(a, order, axis=1).reshape(sectors, rows, count) for a in (u, v, away))
    r = np.hypot(u, v)
    cosine, sine = (u / r).mean(axis=2), (v / r).mean(axis=2)
    phi = np.arctan2(sine.mean(axis=1), cosine.mean(axis=1))
    return Ring(
        np.ascontiguousarray((v * width + u).reshape(-1, count).T.astype(np.intp)),
        away.mean(axis=2).astype(np.float32),
        cosine.astype(np.float32),
        sine.astype(np.float32),
        float(away.var(axis=2).mean()),
        harmonics(phi),
    )


def harmonics(phi: Floats) -> Floats:
    """Radial shift of a circle at these angles by a shift of its centre (u, v) and a growth: (n, 3)."""
    return np.stack([np.cos(phi), np.sin(phi), np.ones_like(phi)], axis=1)


def ring_strip(pixels: Pixels, about: Ring, centre: Px, growth_px: float, outward: int) -> Strip:
    """Sectors of the ring about a centre; `growth_px` more radius, `outward` +1 when it is brighter outside."""
    u, v = round(centre.u), round(centre.v)
    taken = pixels.reshape(-1).take(about.places + (v * pixels.shape[1] + u))
    count, (sectors, rows) = len(taken), about.distance.shape
    levels = taken.sum(axis=0, dtype=np.uint16).astype(np.float32).reshape(sectors, rows)
    levels *= np.float32(1.0 / count)
    distance = about.distance - about.cosine * np.float32(centre.u - u)
    distance -= about.sine * np.float32(centre.v - v)
    distance -= np.float32(growth_px)
    if outward < 0:
        levels, distance = levels[:, ::-1], -distance[:, ::-1]
    return Strip(levels, distance, count, about.smear)


def check_inside(pixels: Pixels, u: int, v: int, reach_px: float) -> None:
    """Raises NotFound when a circle about (u, v) leaves the picture."""
    height, width = pixels.shape
    r = reach_px + SPARE_PX
    if not (r <= u < width - r and r <= v < height - r):
        raise NotFound("view", f"the hole at ({u}, {v}) px is not wholly in the picture")
