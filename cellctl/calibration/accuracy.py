"""What a covariance of the hand-eye parameters means in um at the work."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from cellctl.calibration import distortion
from cellctl.calibration.adjustment import Normal
from cellctl.calibration.bundle import Bundle
from cellctl.calibration.parameters import (
    APPROACH,
    BELIEVED,
    CENTRE,
    COEFFICIENTS,
    MATRIX,
    OFFSET,
    PERSPECTIVE,
    SHARED,
    SLOPE,
)
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import QUARTER, FloatArray, rotation
from cellctl.geometry import Mm, Pose, Px

TAUGHT_MM = 1.0  # a part lies within +-1 mm and +-1.5 deg of its taught place
TAUGHT_DEG = 1.5
MARK_MM = np.array([5.0, 3.0])  # a feature away from the view's middle


class Predicted(NamedTuple):
    """Expected error of the map, one sigma of the vector's length, um."""

    absolute_um: float  # where a point at the picture's centre is
    differential_um: float  # how far a part has moved from its taught place (+-1 mm, +-1.5 deg)


class Mark(NamedTuple):
    """What is measured of a part, in the part's own frame: a point, and two points of the edge of its direction."""

    point: Mm
    line: tuple[Mm, Mm]


# -- the parameters' own covariance ----------------------------------------------------------------------------------


def covariance(bundle: Bundle, x: FloatArray, normal: Normal) -> FloatArray:
    """Covariance (21, 21) of PARAMETERS, the robot's errors marginalised, the map's at the mm origin."""
    moved = from_pivot(bundle, x)
    whole = moved @ normal.covariance() @ moved.T
    return np.asarray((whole + whole.T) / 2, np.float64)


def from_pivot(bundle: Bundle, x: FloatArray) -> FloatArray:
    """How the map's numbers at the origin depend on those at the pivot, (21, 21); see Bundle.setup."""
    pivot, matrix, perspective = bundle.pivot_mm, x[MATRIX].reshape(2, 2), x[PERSPECTIVE]
    depth = 1 - float(perspective @ pivot)
    shift = np.eye(SHARED)
    shift[4, 0:2] = shift[5, 2:4] = -pivot
    numbers = x[:SHARED].copy()
    numbers[OFFSET] -= matrix @ pivot
    for part in (MATRIX, OFFSET, PERSPECTIVE, SLOPE, slice(APPROACH, APPROACH + 1)):
        shift[part] /= depth
        shift[part, PERSPECTIVE] += np.outer(numbers[part], pivot) / depth**2
    return shift


def noise_factors(bundle: Bundle, x: FloatArray) -> tuple[float, float]:
    """Found over stated noise of robot and dots, each over its own redundancy (variance components)."""
    normal = bundle.normal(x)
    own = np.diagonal(normal.own_covariances(), axis1=1, axis2=2)
    used_by_robot = float(own.sum())
    used_by_belief = float((np.diag(normal.covariance())[BELIEVED] / bundle.believed_sd**2).sum())
    used_by_dots = SHARED + x[SHARED:].size - used_by_robot - used_by_belief
    robot = float((x[SHARED:] ** 2).sum()) / max(x[SHARED:].size - used_by_robot, 1e-9)
    dots = float((bundle.residuals_px(x) ** 2).sum()) / bundle.dot_sd_px**2
    return math.sqrt(robot), math.sqrt(dots / max(2 * float(bundle.shots.used.sum()) - used_by_dots, 1.0))


# -- points ----------------------------------------------------------------------------------------------------------


def point_jacobian(camera: PlaneMap, point: Px) -> FloatArray:
    """How the mm of one px depend on PARAMETERS, (2, 21)."""
    mm = np.array(camera.mm_at(point))
    flat = camera.undistorted_px(np.array(point))
    lens, by_coefficients = distortion.jacobians(flat - np.array(camera.distortion_centre_px), camera.coefficients)
    nearer = lens / (1 + float(mm @ np.array(camera.perspective_per_mm)))
    by_parameter = np.zeros((2, SHARED))
    by_parameter[:, 0:2], by_parameter[:, 2:4] = np.outer(nearer[:, 0], mm), np.outer(nearer[:, 1], mm)
    by_parameter[:, OFFSET] = nearer
    by_parameter[:, list(COEFFICIENTS)] = by_coefficients
    by_parameter[:, CENTRE] = np.eye(2) - lens
    by_parameter[:, PERSPECTIVE] = -np.outer(nearer @ flat, mm)
    return np.asarray(-np.linalg.solve(camera.jacobian(mm[None])[0], by_parameter), np.float64)


def predict(camera: PlaneMap, parameters: FloatArray, centre: Px) -> Predicted:
    """Expected errors at `centre` from the covariance (21, 21) of PARAMETERS."""
    absolute = _sd_um(point_jacobian(camera, centre), parameters)
    taught_mm = np.array(camera.mm_at(centre)) + MARK_MM
    taught = jacobian_at_mm(camera, taught_mm)
    half = 1 / math.sqrt(3)  # the variance is quadratic, so these corners give the mean over the whole range
    squares = []
    for x, y, turn in itertools.product((-half, half), repeat=3):
        moved = jacobian_at_mm(camera, taught_mm + np.array([x, y]) * TAUGHT_MM)
        lever = rotation(math.radians(turn * TAUGHT_DEG)) - np.eye(2)
        squares.append(_sd_um(moved - taught + lever @ moved, parameters) ** 2)
    return Predicted(absolute, math.sqrt(sum(squares) / len(squares)))


def jacobian_at_mm(camera: PlaneMap, point_mm: FloatArray) -> FloatArray:
    """`point_jacobian` at the px that show a point (2,) of the plane."""
    u, v = camera.px_from_mm(point_mm[None])[0].tolist()
    return point_jacobian(camera, Px(u, v))


def _sd_um(jacobian: FloatArray, parameters: FloatArray) -> float:
    return math.sqrt(max(0.0, float(np.trace(jacobian @ parameters @ jacobian.T)))) * 1000


# -- poses -----------------------------------------------------------------------------------------------------------


def pose_jacobian(camera: PlaneMap, pose: Pose, mark: Mark) -> FloatArray:
    """How a measured pose, in its part's frame, depends on PARAMETERS, (3, 21): mm, mm, deg."""
    point, start, end = (
        jacobian_at_mm(camera, np.array(pose.point(*part))) for part in (mark.point, mark.line[0], mark.line[1])
    )
    way = np.subtract(pose.point(*mark.line[1]), pose.point(*mark.line[0]))
    turn_rad = (QUARTER @ way) @ (end - start) / float(way @ way)
    to_part = rotation(-math.radians(pose.t_deg))
    place = to_part @ point - np.outer(QUARTER @ np.array(mark.point), turn_rad)
    return np.vstack([place, np.degrees(turn_rad)])
