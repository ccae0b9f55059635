"""A pinhole camera from pictures of a flat board, in closed form and without distortion: where the adjustment starts.

Each homography H = K [r1 r2 t] gives two equations in the image of the absolute conic K^-T K^-1, because r1 and r2
are of one length and at right angles. Source: Z. Zhang, A flexible new technique for camera calibration, 2000.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.six_dof.rigid import nearest_rotation, vector_from_rotation

FloatArray = NDArray[np.float64]

FOCAL_RANGE = (0.2, 100.0)  # of a believable start, in widths of the picture
FAR_FOCAL = 5.0  # the start when the pictures show no perspective
MOST_OFF_CENTRE = 0.25  # of the start's principal point, in widths of the picture


def intrinsics(homographies: Sequence[FloatArray], picture_px: tuple[int, int]) -> FloatArray:
    """fx, fy, cx, cy (4,) px of maps (3, 3) from board mm to px; a guess when the pictures do not tell."""
    width = float(max(picture_px))
    middle = (np.array(picture_px, float) - 1) / 2
    to_unit = np.array([[1 / width, 0, -middle[0] / width], [0, 1 / width, -middle[1] / width], [0, 0, 1]])
    maps = [to_unit @ one / np.linalg.norm(to_unit @ one) for one in homographies]
    fx, fy, cx, cy = _free_centre(maps) or _centred(maps) or (FAR_FOCAL, FAR_FOCAL, 0.0, 0.0)
    return np.array([fx * width, fy * width, cx * width + middle[0], cy * width + middle[1]])


def board_pose(matrix: FloatArray, camera: FloatArray) -> FloatArray:
    """Rotation vector and place (6,) rad and mm of a board before a camera (4,) that shows it by this map (3, 3)."""
    fx, fy, cx, cy = camera.tolist()
    rays = np.linalg.inv([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]) @ matrix
    rays /= math.copysign((np.linalg.norm(rays[:, 0]) + np.linalg.norm(rays[:, 1])) / 2, float(rays[2, 2]))
    turn = nearest_rotation(np.column_stack([rays[:, 0], rays[:, 1], np.cross(rays[:, 0], rays[:, 1])]))
    return np.concatenate([vector_from_rotation(turn), rays[:, 2]])


def _free_centre(maps: list[FloatArray]) -> tuple[float, float, float, float] | None:
    """All four unknowns, for sensors without skew; None when the conic is no camera's."""
    if len(maps) < 3:
        return None
    rows = np.concatenate([_equations(one) for one in maps])
    b11, b22, b13, b23, b33 = np.linalg.svd(rows)[2][-1].tolist()
    if not (b11 * b22 > 0 and b11 * b33 > 0):
        return None
    cx, cy = -b13 / b11, -b23 / b22
    left = (b33 - b13**2 / b11 - b23**2 / b22) / b11
    return _believable((left, left * b11 / b22, cx, cy))


def _centred(maps: list[FloatArray]) -> tuple[float, float, float, float] | None:
    """One focal length, with the principal point in the picture's middle; None when there is no perspective."""
    rows = np.concatenate([_equations(one) for one in maps])
    design, right = rows[:, 0] + rows[:, 1], -rows[:, 4]
    inverse_square = float(design @ right / (design @ design))
    return _believable((1 / inverse_square, 1 / inverse_square, 0.0, 0.0)) if inverse_square > 0 else None


def _believable(found: tuple[float, float, float, float]) -> tuple[float, float, float, float] | None:
    """Focal lengths out of their squares, with the centre; None when no camera is like that."""
    fx2, fy2, cx, cy = found
    low, high = FOCAL_RANGE
    if not (low**2 < fx2 < high**2 and low**2 < fy2 < high**2 and max(abs(cx), abs(cy)) < MOST_OFF_CENTRE):
        return None
    return math.sqrt(fx2), math.sqrt(fy2), cx, cy


def _equations(matrix: FloatArray) -> FloatArray:
    """Two rows in b11, b22, b13, b23, b33 of the symmetric conic with b12 = 0."""
    first, second = matrix[:, 0], matrix[:, 1]
    return np.array([_row(first, second), _row(first, first) - _row(second, second)])


def _row(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.array([a[0] * b[0], a[1] * b[1], a[0] * b[2] + a[2] * b[0], a[1] * b[2] + a[2] * b[1], a[2] * b[2]])
