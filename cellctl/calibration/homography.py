"""Plane-to-plane maps: the closed solution from points, and what it says about a picture of a flat board."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def homography(points: FloatArray, seen: FloatArray) -> FloatArray:
    """The map (3, 3) from points (k, 2) of a plane to where they are seen (k, 2), k >= 4, without distortion.

    Direct linear solution on normalised points. Source: R. Hartley, In defence of the eight-point algorithm, 1997.
    """
    to_unit, unit = _normalised(points)
    from_seen, seen_unit = _normalised(seen)
    x, y, (u, v) = unit[:, 0], unit[:, 1], seen_unit.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    rows_u = np.column_stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u])
    rows_v = np.column_stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v])
    found = np.linalg.svd(np.concatenate([rows_u, rows_v]), full_matrices=False)[2][-1].reshape(3, 3)
    whole = np.linalg.inv(from_seen) @ found @ to_unit
    scale = whole[2] @ [*points.mean(0), 1.0]  # positive depth at the board's middle
    return np.asarray(whole / scale, np.float64)


def mapped(matrix: FloatArray, points: FloatArray) -> FloatArray:
    """Where a map (3, 3) takes points (..., 2)."""
    moved = points @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(moved[..., :2] / moved[..., 2:], np.float64)


def local_steps(matrix: FloatArray, points: FloatArray) -> FloatArray:
    """Derivative of the map at points (k, 2): (k, 2, 2), a column for each direction of the plane."""
    seen = mapped(matrix, points)
    depth = points @ matrix[2, :2] + matrix[2, 2]
    return np.asarray((matrix[:2, :2] - seen[:, :, None] * matrix[2, :2]) / depth[:, None, None], np.float64)


def _normalised(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A similarity (3, 3) that brings points about 0 at a mean distance of sqrt 2, and the points brought there."""
    middle = points.mean(0)
    scale = math.sqrt(2) / max(float(np.hypot(*(points - middle).T).mean()), 1e-12)
    matrix = np.array([[scale, 0.0, -scale * middle[0]], [0.0, scale, -scale * middle[1]], [0.0, 0.0, 1.0]])
    return matrix, (points - middle) * scale
