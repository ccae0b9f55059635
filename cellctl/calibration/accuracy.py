"""What a covariance of the hand-eye parameters means in um at the work."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from cellctl.calibration.bundle import LENS, LENS_SD, SHARED, Bundle, Normal
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import FloatArray, rotation
from cellctl.geometry import Px

TAUGHT_MM = 1.0  # a part lies within +-1 mm and +-1.5 deg of its taught place
TAUGHT_DEG = 1.5
MARK_MM = np.array([5.0, 3.0])  # a feature away from the view's middle


class Predicted(NamedTuple):
    """Expected error of the map, one sigma of the vector's length, um."""

    absolute_um: float  # where a point at the picture's centre is
    differential_um: float  # how far a part has moved from its taught place (+-1 mm, +-1.5 deg)


def covariance(bundle: Bundle, normal: Normal) -> FloatArray:
    """Covariance (12, 12) of PARAMETERS, the robot's errors marginalised, the offset at the mm frame's origin."""
    shift = np.eye(SHARED)  # offset = offset at the pivot - A @ pivot
    shift[4, 0:2] = shift[5, 2:4] = -bundle.pivot_mm
    moved: FloatArray = shift @ normal.covariance() @ shift.T
    return moved


def noise_factors(bundle: Bundle, x: FloatArray, dots_px: FloatArray) -> tuple[float, float]:
    """Found over stated noise of robot and dots, each over its own redundancy (variance components)."""
    normal = bundle.normal(x, dots_px)
    used_by_robot = float(normal.pose_variances().sum())
    used_by_lens = float((np.diag(normal.covariance())[LENS] / LENS_SD**2).sum())
    used_by_dots = SHARED + x[SHARED:].size - used_by_robot - used_by_lens
    robot = float((x[SHARED:] ** 2).sum()) / max(x[SHARED:].size - used_by_robot, 1e-9)
    dots = float(((bundle.px(x) - dots_px) ** 2).sum()) / bundle.noise.dot_sd_px**2
    return math.sqrt(robot), math.sqrt(dots / (dots_px.size - used_by_dots))


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
