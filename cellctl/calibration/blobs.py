"""Round dark dots in a picture, seen squarely or askew: rough candidates, and one dot's centre to 1/100 px."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Pixels = NDArray[np.uint8]

LEVELS = (0.5, 0.4, 0.6, 0.3, 0.7, 0.2, 0.8, 0.1, 0.9)  # thresholds tried, as part of the picture's range
LEAST_AREA_PX = 20  # in the picture in which it is looked for: a dot of 5 px diameter
FILL = (0.6, 0.92)  # of the box around a disk; 0.785 squarely, less when seen askew
MOST_ASPECT = 1.8  # of that box: a tilt of 56 deg
ALIKE = 0.4  # area of the furthest dots, in units of the usual one, and of the nearest dots the other way round
SOFT = (0.3, 0.7)  # part of the contrast between which a pixel counts partly: the edge, not the flat areas
THIN = 3  # every third row and column is enough for a level
FEW_PX = 60  # but not in a window smaller than this


class Candidates(NamedTuple):
    """Round dark spots of one size family: centres (n, 2) and areas (n,) in px of the full picture."""

    centres_px: FloatArray
    areas_px: FloatArray


class Spot(NamedTuple):
    """One measured dot."""

    u: float
    v: float
    area_px: float
    bright: float  # level around it
    dark: float  # level in it


def find_candidates(pixels: Pixels, wanted: int, largest: float, halvings: int) -> Candidates:
    """Round dark spots whose areas agree: `wanted` of them, or those of the threshold that shows most.

    `largest` is the largest area that belongs to the family, in units of the usual one; the picture is halved so many
    times before: large dots are found faster, small ones not at all.
    """
    small = pixels
    for _ in range(halvings):
        small = np.asarray(cv2.resize(small, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8)
    low, high = np.percentile(small[::2, ::2], [1, 99]).tolist()
    best = Candidates(np.zeros((0, 2)), np.zeros(0))
    for part in LEVELS:
        mask = cv2.compare(small, low + part * (high - low), cv2.CMP_LT)
        found = _family(_round_spots(np.asarray(mask, np.uint8), 2**halvings), largest)
        if len(found.areas_px) == wanted:
            return found
        if len(found.areas_px) > len(best.areas_px):
            best = found
    return best


def _round_spots(mask: Pixels, shrink: int) -> Candidates:
    """Connected spots that are not much wider than high, filled like a disk, and clear of the picture's border."""
    stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=4)[2:4]
    left, top, width, height, area = stats[1:].T.astype(float)
    inside = (left > 0) & (top > 0) & (left + width < mask.shape[1]) & (top + height < mask.shape[0])
    fill, aspect = area / (width * height), width / height
    disk = (fill > FILL[0]) & (fill < FILL[1]) & (aspect > 1 / MOST_ASPECT) & (aspect < MOST_ASPECT)
    good = inside & disk & (area >= LEAST_AREA_PX)
    full = (centres[1:][good] + 0.5) * shrink - 0.5
    return Candidates(full, area[good] * shrink**2)


def _family(spots: Candidates, largest: float) -> Candidates:
    """Those of the most frequent size, and up to `largest` times as large."""
    areas = np.sort(spots.areas_px)
    if not len(areas):
        return spots
    alike = np.searchsorted(areas, areas * 1.3, "right") - np.searchsorted(areas, areas / 1.3, "left")
    usual = areas[int(alike.argmax())]
    good = (spots.areas_px > ALIKE * usual) & (spots.areas_px < largest / ALIKE * usual)
    return Candidates(spots.centres_px[good], spots.areas_px[good])


def measure_spot(pixels: Pixels, centre_px: FloatArray, shape_px: FloatArray) -> Spot | None:
    """Centre of one dark dot; None when the dot is cut by the picture's border.

    `shape_px` (2, 2) makes the dot's outline out of a circle of radius 1. Grey levels are stretched so that only the
    edge's middle counts partly; the centroid of that is as good as an edge fit and nearly free of the noise of the
    flat areas. Any symmetric blur and any tilt leave it unbiased.
    """
    turned, (long_px, short_px), _ = np.linalg.svd(shape_px)
    half = math.ceil(1.5 * long_px) + 6
    column, row = round(float(centre_px[0])), round(float(centre_px[1]))
    inside = min(column, row, pixels.shape[1] - 1 - column, pixels.shape[0] - 1 - row)
    if inside < long_px + 4:
        return None
    left, top = max(0, column - half), max(0, row - half)
    window = pixels[top : row + half + 1, left : column + half + 1]
    angle = 0 if long_px - short_px < 1 else round(math.degrees(math.atan2(turned[1, 0], turned[0, 0])) / 5) * 5
    core, disk, ring = (
        mask[top - row + half :, left - column + half :][: window.shape[0], : window.shape[1]]
        for mask in _masks(half, round(long_px), round(short_px), angle)
    )
    dark, bright = _level(window, core), _level(window, ring)
    if bright - dark < 4:
        return Spot(float(column), float(row), 0.0, bright, dark)
    weight = cv2.bitwise_and(cv2.LUT(window, _stretch(dark, bright)), disk)
    moments = cv2.moments(weight)
    total = max(moments["m00"], 1e-9)
    return Spot(left + moments["m10"] / total, top + moments["m01"] / total, total / 255, bright, dark)


def _level(window: Pixels, mask: Pixels) -> float:
    """Median level where the mask is set, from a part of the pixels when there are many."""
    thin = THIN if len(window) > FEW_PX else 1
    return float(np.median(window[::thin, ::thin][mask[::thin, ::thin] > 0]))


def _stretch(dark: float, bright: float) -> Pixels:
    """Look-up table: 255 where surely dot, 0 where surely plate, straight in between."""
    level = np.arange(256.0)
    part = (bright - level) / (bright - dark)
    return np.asarray(np.rint(np.clip((part - SOFT[0]) / (SOFT[1] - SOFT[0]), 0, 1) * 255), np.uint8)


@lru_cache(maxsize=64)
def _masks(half: int, long_px: int, short_px: int, angle_deg: int) -> tuple[Pixels, Pixels, Pixels]:
    """The dot's core, everything that may belong to it, and the plate around it, as (2 half + 1) squares."""
    axis = np.arange(-half, half + 1)
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    along, across = axis[None] * c + axis[:, None] * s, axis[:, None] * c - axis[None] * s
    margin = min(4.0, 0.3 * short_px + 1.0)

    def within(times: float, more: float) -> NDArray[np.bool_]:
        return (along / (times * long_px + more)) ** 2 + (across / (times * short_px + more)) ** 2 < 1

    core, disk = within(0.6, 0.5), within(1.25, margin)
    ring = within(1.45, 1.5 * margin) & ~within(1.25, 0.5 * margin)
    return tuple(np.asarray(mask * 255, np.uint8) for mask in (core, disk, ring))  # type: ignore[return-value]
