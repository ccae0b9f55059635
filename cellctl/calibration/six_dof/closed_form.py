"""A first solution of A X = X B without iteration: rotation by quaternions, then place by least squares."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cellctl.calibration.six_dof.pairs import Pairs, motion_indices, motions
from cellctl.calibration.six_dof.rigid import (
    FloatArray,
    cross_matrix,
    inverse,
    mean_motion,
    quaternion_from_rotation,
    rigid,
    rotation_from_quaternion,
)

LEAST_REAL = 0.1  # of a quaternion: beyond 168 deg its sign, and so its sense of rotation, is in doubt


class Solution(NamedTuple):
    """X and Z of `pairs`, (4, 4) each."""

    camera: FloatArray
    target: FloatArray


def closed_form(pairs: Pairs) -> Solution:
    """X and Z, each motion counted alike (Chou and Kamel's linear quaternion form, Tsai's and Lenz's place)."""
    indices = motion_indices(len(pairs))
    arm, eye = motions(pairs.arm, indices), motions(pairs.target, indices)
    turn = _rotation(arm[:, :3, :3], eye[:, :3, :3])
    rows = (arm[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (eye[:, :3, 3] @ turn.T - arm[:, :3, 3]).reshape(-1)
    camera = rigid(turn, np.linalg.lstsq(rows, right, rcond=1e-6)[0])
    return Solution(camera, mean_target(pairs, camera))


def mean_target(pairs: Pairs, camera: FloatArray) -> FloatArray:
    """Z for a given X: the mean of where the poses put the target."""
    return mean_motion(inverse(pairs.arm) @ camera @ pairs.target)


def _rotation(arm: FloatArray, eye: FloatArray) -> FloatArray:
    """The rotation (3, 3) that carries the axes of `eye` to those of `arm`, from qa q - q qb = 0."""
    a, b = quaternion_from_rotation(arm), quaternion_from_rotation(eye)
    sure = (a[:, 3] > LEAST_REAL) & (b[:, 3] > LEAST_REAL)
    difference = (_product(a, 1.0) - _product(b, -1.0))[sure]
    smallest = np.linalg.eigh(np.einsum("nij,nik->jk", difference, difference))[1][:, 0]
    return rotation_from_quaternion(smallest)


def _product(quaternions: FloatArray, side: float) -> FloatArray:
    """Matrices (n, 4, 4) that multiply with a quaternion from the left (side 1) or from the right (-1)."""
    matrices = quaternions[:, 3, None, None] * np.eye(4)
    matrices[:, :3, :3] += side * cross_matrix(quaternions[:, :3])
    matrices[:, :3, 3] += quaternions[:, :3]
    matrices[:, 3, :3] -= quaternions[:, :3]
    return np.asarray(matrices, np.float64)
