"""What a covariance of the hand-eye parameters means in um at the work."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import SHARED, Bundle, FloatArray, rotation
from cellctl.geometry import Px

TAUGHT_MM = 1.0  # a part lies within +-1 mm and +-1.5 deg of its taught place
TAUGHT_DEG = 1.5
MARK_MM = np.array([5.0, 3.0])  # a feature away from the view's middle


class Predicted(NamedTuple):
    """Expected error of the map, one sigma of the vector's length, um."""

    absolute_um: float  # where a point at the picture's centre is
    differential_um: float  # how far a part has moved from its taught place (+-1 mm, +-1.5 deg)


def covariance(bundle: Bundle, x: FloatArray) -> FloatArray:
    """Covariance (12, 12) of PARAMETERS, the robot's errors marginalised, the offset at the mm frame's origin."""
    inverse, size = _inverse_normal(bundle.jacobian(x))
    inverse = inverse / np.outer(size, size)
    shift = np.eye(SHARED)  # offset = offset at the pivot - A @ pivot
    shift[4, 0:2] = shift[5, 2:4] = -bundle.pivot_mm
    return shift @ inverse[:SHARED, :SHARED] @ shift.T


def noise_factors(bundle: Bundle, x: FloatArray, dots_px: FloatArray) -> tuple[float, float]:
    """Found over stated noise of robot and dots, each over its own redundancy (variance components)."""
    residuals = bundle.residuals(x, dots_px)
    jacobian = bundle.jacobian(x)
    inverse, size = _inverse_normal(jacobian)
    scaled = jacobian / size
    leverage = ((scaled @ inverse) * scaled).sum(1)
    poses = slice(dots_px.size, dots_px.size + 3 * len(bundle.poses))
    robot = (residuals[poses] ** 2).sum() / max(float((1 - leverage[poses]).sum()), 1e-9)
    dots = (residuals[: dots_px.size] ** 2).sum() / float((1 - leverage[: dots_px.size]).sum())
    return math.sqrt(robot), math.sqrt(dots)


def _inverse_normal(jacobian: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverse of the normal matrix with unit columns (a mix of px, mm and 1/px^2 has none), and the columns' size."""
    size = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian / size
    return np.asarray(np.linalg.inv(scaled.T @ scaled), np.float64), np.asarray(size, np.float64)


def point_jacobian(camera: PlaneMap, point: Px) -> FloatArray:
    """How the mm of one px depend on PARAMETERS, (2, 12)."""
    mm = np.array(camera.mm_at(point))
    matrix, k1 = camera.matrix, camera.k1_per_px2
    away = matrix @ mm + np.array(camera.offset_px) - np.array(camera.distortion_centre_px)
    radius2 = float(away @ away)
    lens = np.eye(2) * (1 + k1 * radius2) + 2 * k1 * np.outer(away, away)
    by_parameter = np.zeros((2, SHARED))
    by_parameter[:, 0:2], by_parameter[:, 2:4] = np.outer(lens[:, 0], mm), np.outer(lens[:, 1], mm)
    by_parameter[:, 4:6] = lens
    by_parameter[:, 9] = radius2 * away
    by_parameter[:, 10:12] = np.eye(2) - lens
    return np.asarray(-np.linalg.solve(lens @ matrix, by_parameter), np.float64)


def predict(camera: PlaneMap, parameters: FloatArray, centre: Px) -> Predicted:
    """Expected errors at `centre` from the covariance (12, 12) of PARAMETERS."""
    absolute = _sd_um(point_jacobian(camera, centre), parameters)
    taught_mm = np.array(camera.mm_at(centre)) + MARK_MM
    taught = _jacobian_at_mm(camera, taught_mm)
    half = 1 / math.sqrt(3)  # the variance is quadratic, so these corners give the mean over the whole range
    squares = []
    for x, y, turn in itertools.product((-half, half), repeat=3):
        moved = _jacobian_at_mm(camera, taught_mm + np.array([x, y]) * TAUGHT_MM)
        lever = rotation(math.radians(turn * TAUGHT_DEG)) - np.eye(2)
        squares.append(_sd_um(moved - taught + lever @ moved, parameters) ** 2)
    return Predicted(absolute, math.sqrt(sum(squares) / len(squares)))


def _jacobian_at_mm(camera: PlaneMap, point_mm: FloatArray) -> FloatArray:
    u, v = camera.px_from_mm(point_mm[None])[0].tolist()
    return point_jacobian(camera, Px(u, v))


def _sd_um(jacobian: FloatArray, parameters: FloatArray) -> float:
    return math.sqrt(max(0.0, float(np.trace(jacobian @ parameters @ jacobian.T)))) * 1000
