"""Blocks of pixels along outlines, averaged along them: what is left is a short grey profile per block. Pure.

Pixels are taken where they lie; nothing is interpolated. Averaging 16 pixels along an outline leaves the information
about its place as it is and makes all that follows sixteen times smaller; what it blurs is known (`smear`).
Several outlines lie side by side in one strip, since small arrays cost by their number and not by their size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Px
from cellctl.vision.features import Floats, NotFound, Pixels, Singles
from cellctl.vision.robust import harmonics
from cellctl.vision.scan import Line, Scan

BLOCK_PX = 16  # pixels along a straight outline per block
BAND_PX = 8.0  # to either side of an outline, measured across it
SECTOR_PX = 20.0  # of a round outline per block
SECTORS = (24, 128)
SPARE_PX = 4


class Part(NamedTuple):
    """One outline's blocks in a strip."""

    where: slice
    pixels: int  # per mean
    smear: float  # px^2 that the averaging adds to the variance of the blur


class Strip(NamedTuple):
    """Mean levels (rows, blocks) and their signed distances from the assumed outline, px towards its bright side."""

    levels: Singles
    distance: Singles
    parts: tuple[Part, ...]

    def moved(self, towards_bright: Floats) -> Strip:
        """The same pixels about outlines that lie so much further (blocks,) towards their bright side."""
        return self._replace(distance=self.distance - towards_bright.astype(np.float32))


class Lane(NamedTuple):
    """Blocks of 16 columns (or rows) from `first` on, along a line."""

    scan: Scan
    line: Line
    first: int
    blocks: int

    def middles(self, every: int = 1) -> Floats:
        """Along, of the columns (or rows) that each block takes; `every` skips columns."""
        return np.arange(self.blocks, dtype=np.float64) * BLOCK_PX + (self.first + (BLOCK_PX - every) / 2.0)

    def half_px(self, reach_px: float) -> int:
        """Rows (or columns) to either side of the line that reach so far from it."""
        return math.ceil(reach_px / self.line.cosine)


def line_strip(pixels: Pixels, lanes: Sequence[Lane], reach_px: float, every: int = 1) -> Strip:
    """Blocks of straight outlines, `reach_px` to either side; `every` skips columns. Raises NotFound."""
    half = max(lane.half_px(reach_px) for lane in lanes)
    if min(pixels.shape) <= 2 * half:
        raise NotFound("view", f"the picture is smaller than the {2 * half + 1} px that are looked at across an edge")
    slope, height, step, side, most, cosine, first = _by_block(pixels, lanes, half)
    along = first + np.arange(0.0, BLOCK_PX, every)[:, None]
    across = height + slope * along
    whole = np.minimum(np.maximum(np.rint(across), half), most)
    offset = np.arange(-half, half + 1)
    start = (along * step + whole * np.abs(side)).astype(np.intp)
    taken = pixels.reshape(-1).take((offset[:, None] * side.astype(np.intp))[:, None] + start)
    levels = np.add.reduce(taken, axis=1, dtype=np.uint16).astype(np.float32)
    levels *= np.float32(1.0 / len(along))
    across -= whole
    middle = np.add.reduce(across, axis=0) / len(along)
    across -= middle
    across *= cosine
    distance = (offset[:, None] - np.sign(side) * middle) * cosine
    parts, begin = [], 0
    for lane in lanes:
        where = slice(begin, begin + lane.blocks)
        smear = float(np.square(across[:, where]).mean())
        parts.append(Part(where, len(along), smear))
        begin = where.stop
    return Strip(levels, distance.astype(np.float32), tuple(parts))


def _by_block(pixels: Pixels, lanes: Sequence[Lane], half: int) -> Floats:
    """For each block: slope and height (at 0) of its line, steps in the flat picture, highest row, cosine, begin."""
    rows = []
    for scan, line, _, _ in lanes:
        step, side = scan.strides(pixels)
        most = scan.limits(pixels)[1] - half - 1
        rows.append((line.slope, line.moved(0.0).height, step, side * scan.rising, most, line.cosine))
    table = np.empty((7, sum(lane.blocks for lane in lanes)))
    begin = 0
    for row, lane in zip(rows, lanes, strict=True):
        end = begin + lane.blocks
        table[:6, begin:end] = np.array(row)[:, None]
        table[6, begin:end] = np.arange(lane.first, lane.first + lane.blocks * BLOCK_PX, BLOCK_PX)
        begin = end
    return table


class Ring(NamedTuple):
    """The pixels about a circle of whole radius: their steps in the flat picture (count, rows, sectors).

    Distance of each mean from the circle, and its direction (rows, sectors); design (sectors, 3): radial shift by a
    shift of the centre and a growth.
    """

    places: NDArray[np.intp]
    distance: Singles
    cosine: Singles
    sine: Singles
    smear: float
    design: Floats


@lru_cache(maxsize=8)
def ring(radius: int, width: int, rows: int) -> Ring:
    """Made once per radius: pixels sorted into sectors, each sector's into rows of equal numbers by their distance."""
    sectors = min(max(round(2.0 * math.pi * radius / SECTOR_PX), SECTORS[0]), SECTORS[1])
    m = math.ceil(radius + BAND_PX) + 1
    v, u = np.mgrid[-m : m + 1, -m : m + 1]
    near = np.abs(np.hypot(u, v) - radius) <= BAND_PX + 0.5
    u, v = u[near], v[near]
    order = np.argsort(np.arctan2(v, u), kind="stable")
    u, v = (a[order][: a.size // sectors * sectors].reshape(sectors, -1) for a in (u, v))
    count = u.shape[1] // rows
    away = np.hypot(u, v) - radius
    inner = np.argsort(np.abs(away), axis=1, kind="stable")[:, : rows * count]  # the outermost are left over
    order = np.take_along_axis(inner, np.argsort(np.take_along_axis(away, inner, axis=1), axis=1), axis=1)
    u, v, away = (np.take_along_axis(a, order, axis=1).reshape(sectors, rows, count).T for a in (u, v, away))
    r = np.hypot(u, v)
    cosine, sine = (u / r).mean(axis=0), (v / r).mean(axis=0)
    phi = np.arctan2(sine.mean(axis=0), cosine.mean(axis=0))
    return Ring(
        np.ascontiguousarray(v * width + u, np.intp),
        away.mean(axis=0).astype(np.float32),
        cosine.astype(np.float32),
        sine.astype(np.float32),
        float(away.var(axis=0).mean()),
        harmonics(phi),
    )


def ring_strip(pixels: Pixels, about: Ring, centre: Px, growth_px: float, outward: int) -> Strip:
    """Sectors of the ring about a centre; `growth_px` more radius, `outward` +1 when it is brighter outside."""
    u, v = round(centre.u), round(centre.v)
    taken = pixels.reshape(-1).take(about.places + (v * pixels.shape[1] + u))
    levels = np.add.reduce(taken, axis=0, dtype=np.uint16).astype(np.float32)
    levels *= np.float32(1.0 / len(taken))
    distance = about.distance - about.cosine * np.float32(centre.u - u)
    distance -= about.sine * np.float32(centre.v - v)
    distance -= np.float32(growth_px)
    if outward < 0:
        levels, distance = levels[::-1], -distance[::-1]
    return Strip(levels, distance, (Part(slice(0, levels.shape[1]), len(taken), about.smear),))


def side_by_side(one: Strip, other: Strip) -> Strip:
    """Both strips in one; they have equally many rows."""
    begin = one.levels.shape[1]
    moved = [p._replace(where=slice(p.where.start + begin, p.where.stop + begin)) for p in other.parts]
    levels, distance = (np.concatenate(pair, axis=1) for pair in zip(one[:2], other[:2], strict=True))
    return Strip(levels, distance, (*one.parts, *moved))


def check_inside(pixels: Pixels, u: int, v: int, reach_px: float) -> None:
    """Raises NotFound when a circle about (u, v) leaves the picture."""
    height, width = pixels.shape
    r = reach_px + SPARE_PX
    if not (r <= u < width - r and r <= v < height - r):
        raise NotFound("view", f"the hole at ({u}, {v}) px is not wholly in the picture")
