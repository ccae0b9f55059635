"""All outlines of a picture as points with directions, for a search that knows nothing of place or size. Pure."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from cellctl.vision.features import Floats, Pixels, Singles

LEAST_CONTRAST = 15.0  # grey levels
GOOD_CONTRAST = 60.0  # more of it does not make an outline a better one
SCALE = 4  # the search works on a picture of a quarter of the size
STEEP = 3.0  # Sobel response of an edge of one grey level, blurred a little
KEPT = 0.5  # an outline is followed down to this part of the least contrast


class Edgels(NamedTuple):
    """Points of outlines in the quarter picture: places (n,) and unit vectors (n,) towards the bright side."""

    u: Floats
    v: Floats
    along_u: Floats
    along_v: Floats
    width: int
    height: int


def find_edgels(pixels: Pixels) -> Edgels:
    """Points of all outlines with at least the least contrast."""
    small = pixels
    for _ in range(2):
        rows, columns = (size // 2 * 2 for size in small.shape)
        small = np.asarray(cv2.resize(small[:rows, :columns], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    soft = cv2.GaussianBlur(small, (5, 5), 1.0)
    gu, gv = cv2.Sobel(soft, cv2.CV_16S, 1, 0), cv2.Sobel(soft, cv2.CV_16S, 0, 1)
    thin = cv2.Canny(gu, gv, KEPT * STEEP * LEAST_CONTRAST, STEEP * LEAST_CONTRAST, L2gradient=True)
    v, u = np.nonzero(thin)
    du, dv = gu[v, u].astype(np.float64), gv[v, u].astype(np.float64)
    size = np.hypot(du, dv)
    return Edgels(u.astype(float), v.astype(float), du / size, dv / size, small.shape[1], small.shape[0])


def to_full(x: float) -> float:
    """A coordinate of the quarter picture in the picture."""
    return (x + 0.5) * SCALE - 0.5


def strip_across(pixels: Pixels, points: Floats, across: Floats, half_px: int) -> Singles:
    """Levels (n, 2 * half + 1) on short lines through points (n, 2), interpolated; outside the picture it is dark.

    `across` is the unit vector of each line (n, 2), or of all (2,).
    """
    k = np.arange(-half_px, half_px + 1)[:, None]
    at = (points[:, None] + across[..., None, :] * k).astype(np.float32)
    return np.asarray(cv2.remap(pixels, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0), np.float32)


def blocks_of(strip: Singles, size: int) -> Singles:
    """Means of so many neighbouring lines each."""
    count = len(strip) // size
    return np.asarray(strip[: count * size].reshape(count, size, -1).mean(axis=1), np.float32)
