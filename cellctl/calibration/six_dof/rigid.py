"""Rigid motions in space as arrays: motions (..., 4, 4) mm, rotations (..., 3, 3), rotation vectors (..., 3) rad."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

SMALL_RAD = 1e-6


def cross_matrix(vectors: FloatArray) -> FloatArray:
    """The matrices (..., 3, 3) that multiply like a cross product with these vectors (..., 3)."""
    matrices = np.zeros((*vectors.shape, 3))
    for row, column, axis in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        matrices[..., row, column] = vectors[..., axis]
        matrices[..., column, row] = -vectors[..., axis]
    return matrices


def rotation_from_vector(vectors: FloatArray) -> FloatArray:
    """Rotations about these vectors by their length (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    cross = cross_matrix(vectors)
    sine = np.sinc(angle / np.pi)
    versine = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + sine * cross + versine * cross @ cross, np.float64)


def vector_from_rotation(rotations: FloatArray) -> FloatArray:
    """Rotation vectors of length 0 to pi, by way of the quaternion, which is exact near pi as well."""
    quaternions = quaternion_from_rotation(rotations)
    imaginary, real = quaternions[..., :3], quaternions[..., 3]
    length = np.linalg.norm(imaginary, axis=-1)
    whole = 2 * np.arctan2(length, real)
    per_length = np.where(length > SMALL_RAD, whole / np.where(length > SMALL_RAD, length, 1.0), 2.0)
    return np.asarray(imaginary * per_length[..., None], np.float64)


def rotation_from_quaternion(quaternions: FloatArray) -> FloatArray:
    """Rotations of quaternions (..., 4), x y z w, which need not be of length 1."""
    unit = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
    imaginary, real = unit[..., :3], unit[..., 3, None, None]
    cross = cross_matrix(imaginary)
    return np.asarray(np.eye(3) + 2 * (real * cross + cross @ cross), np.float64)


def quaternion_from_rotation(rotations: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4), x y z w with w >= 0, from the largest of Shepperd's four forms."""
    r = np.asarray(rotations, np.float64)
    trace = np.trace(r, axis1=-2, axis2=-1)
    outer = r + np.swapaxes(r, -1, -2)  # 4 v v^T off the diagonal
    skew = np.stack([r[..., 2, 1] - r[..., 1, 2], r[..., 0, 2] - r[..., 2, 0], r[..., 1, 0] - r[..., 0, 1]], -1)
    forms = np.empty((*r.shape[:-2], 4, 4))  # each row: the quaternion times four times one of its members
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    forms[..., :3, :3] = outer
    forms[..., np.arange(3), np.arange(3)] = 1 + 2 * diagonal - trace[..., None]
    forms[..., :3, 3] = forms[..., 3, :3] = skew
    forms[..., 3, 3] = 1 + trace
    best = np.argmax(np.diagonal(forms, axis1=-2, axis2=-1), axis=-1)
    chosen = np.take_along_axis(forms, best[..., None, None], axis=-2)[..., 0, :]
    unit = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
    return np.asarray(np.where(unit[..., 3:] < 0, -unit, unit), np.float64)


def rigid(rotations: ArrayLike, places_mm: ArrayLike) -> FloatArray:
    """Motions out of rotations (..., 3, 3) and places (..., 3)."""
    turn, place = np.asarray(rotations, np.float64), np.asarray(places_mm, np.float64)
    motions = np.zeros((*place.shape[:-1], 4, 4))
    motions[..., :3, :3], motions[..., :3, 3], motions[..., 3, 3] = turn, place, 1.0
    return motions


def inverse(motions: FloatArray) -> FloatArray:
    """The motions that undo these."""
    back = np.swapaxes(motions[..., :3, :3], -1, -2)
    return rigid(back, -(back @ motions[..., :3, 3, None])[..., 0])


def nearest_rotation(matrices: FloatArray) -> FloatArray:
    """The rotations (..., 3, 3) nearest to matrices, least squares over their entries."""
    left, _, right = np.linalg.svd(matrices)
    turned = np.sign(np.linalg.det(left @ right))
    left = left.copy()
    left[..., :, 2] *= turned[..., None]
    return np.asarray(left @ right, np.float64)


def mean_motion(motions: FloatArray) -> FloatArray:
    """One motion (4, 4) in the middle of many that lie close together."""
    return rigid(nearest_rotation(motions[:, :3, :3].mean(0)), motions[:, :3, 3].mean(0))


def right_jacobian(vectors: FloatArray) -> FloatArray:
    """How much rotations turn, seen from their own frame, per change of their vectors (..., 3): (..., 3, 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    cross = cross_matrix(vectors)
    far = np.where(angle > 1e-4, angle, 1.0)
    first = np.where(angle > 1e-4, (1 - np.cos(far)) / far**2, 1 / 2)
    second = np.where(angle > 1e-4, (far - np.sin(far)) / far**3, 1 / 6)
    return np.asarray(np.eye(3) - first * cross + second * cross @ cross, np.float64)


def left_jacobian_inverse(vectors: FloatArray) -> FloatArray:
    """How rotation vectors (..., 3) change when their rotations are turned from outside, (..., 3, 3)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    cross = cross_matrix(vectors)
    half = np.where(angle > 1e-4, angle / 2, 1.0)
    factor = np.where(angle > 1e-4, (1 - half / np.tan(half)) / np.where(angle > 1e-4, angle, 1.0) ** 2, 1 / 12)
    return np.asarray(np.eye(3) - cross / 2 + factor * cross @ cross, np.float64)
