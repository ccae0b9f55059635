"""One hand-eye problem with its data, its fit, and how each pose fits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cellctl.calibration.bundle import SHARED, Bundle, minimise
from cellctl.calibration.scara import (
    FloatArray,
    Kind,
    Linear,
    Noise,
    linear_start,
    pose_array,
)
from cellctl.geometry import Pose

WORST_SD = 6.0  # a pose is out when its dots or its robot correction exceed this many of their sigmas


class PoseFit(NamedTuple):
    """How one pose fits: rms of its dots per axis, and the robot error it suggests."""

    pose: Pose
    rms_px: float
    dx_um: float
    dy_um: float
    dt_mdeg: float
    worst_sd: float  # the largest of these in its own sigmas


class Problem(NamedTuple):
    """Poses (n, 3) mm and rad, dots (n, m, 2) px, board (m, 2) mm."""

    kind: Kind
    poses: FloatArray
    dots_px: FloatArray
    board_mm: FloatArray
    noise: Noise
    picture_px: tuple[int, int]

    def only(self, keep: Sequence[int]) -> Problem:
        """The same with fewer poses."""
        return self._replace(poses=self.poses[list(keep)], dots_px=self.dots_px[list(keep)])


class Fit(NamedTuple):
    """A solved problem, good or bad."""

    problem: Problem
    bundle: Bundle
    linear: Linear
    x: FloatArray

    @property
    def residuals_px(self) -> FloatArray:
        """Expected minus measured dots, (n, m, 2)."""
        return self.bundle.px(self.x) - self.problem.dots_px

    @property
    def cost(self) -> float:
        """Sum of squares in sigmas."""
        return self.bundle.cost(self.x, self.problem.dots_px)


def checked_problem(
    kind: Kind,
    poses: Sequence[Pose],
    dots_px: FloatArray,
    board_mm: FloatArray,
    noise: Noise,
    picture_px: tuple[int, int],
) -> Problem:
    """Arrays of the right shape, or ValueError."""
    dots, board = np.asarray(dots_px, float), np.asarray(board_mm, float)
    if kind not in ("eye_in_hand", "eye_to_hand"):
        raise ValueError(f"hand-eye: kind must be eye_in_hand or eye_to_hand (got {kind!r})")
    if board.ndim != 2 or board.shape[1] != 2:
        raise ValueError(f"hand-eye: board points must be (m, 2) (got {board.shape})")
    if dots.shape != (len(poses), len(board), 2):
        raise ValueError(
            f"hand-eye: dots must be ({len(poses)}, {len(board)}, 2) for these poses and this board (got {dots.shape})"
        )
    table = pose_array(poses)
    if not (np.isfinite(dots).all() and np.isfinite(board).all() and np.isfinite(table).all()):
        raise ValueError("hand-eye: poses, dots and board points must be finite")
    if np.linalg.matrix_rank(board - board.mean(0)) < 2:
        raise ValueError("hand-eye: board points must not lie on one line")
    return Problem(kind, table, dots, board, noise, picture_px)


def fit_problem(problem: Problem) -> Fit:
    """Linear start and bundle, without judging."""
    linear = linear_start(problem.kind, problem.poses, problem.dots_px, problem.board_mm)
    centre = (np.array(problem.picture_px) - 1) / 2
    pivot = np.asarray(np.linalg.lstsq(linear.matrix, centre - linear.offset, rcond=None)[0], np.float64)
    bundle = Bundle(problem.kind, problem.poses, problem.board_mm, problem.noise, pivot, centre)
    return Fit(problem, bundle, linear, minimise(bundle, bundle.start(linear), problem.dots_px))


def pose_fits(fit: Fit) -> list[PoseFit]:
    """How each pose fits."""
    rms_px = np.sqrt((fit.residuals_px**2).mean((1, 2))).tolist()
    sigmas = fit.x[SHARED:].reshape(-1, 3)
    fits = []
    for pose, robot, rms in zip(fit.problem.poses, sigmas, rms_px, strict=True):
        worst = max(float(np.abs(robot).max()), rms / fit.problem.noise.dot_sd_px)
        x_mm, y_mm, t_rad = pose.tolist()
        dx, dy, dt = (robot * fit.bundle.robot_sd).tolist()
        where = Pose(x_mm, y_mm, math.degrees(t_rad))
        fits.append(PoseFit(where, rms, dx * 1000, dy * 1000, math.degrees(dt) * 1000, worst))
    return fits


def poses_out(fit: Fit) -> list[int]:
    """Indices of the poses that do not fit, the worst first."""
    fits = pose_fits(fit)
    bad = [i for i, pose in enumerate(fits) if not pose.worst_sd <= WORST_SD]
    return sorted(bad, key=lambda i: -fits[i].worst_sd)


def prediction_error_mm(fit: Fit, unseen: Problem) -> FloatArray:
    """Seen minus expected board centre at poses that were not part of the fit, (n, 2) mm."""
    bundle = replace(fit.bundle, poses=unseen.poses)
    x = np.concatenate([fit.x[:SHARED], np.zeros(3 * len(unseen.poses))])
    away_px = (unseen.dots_px - bundle.px(x)).mean(1)
    away_mm: FloatArray = np.linalg.lstsq(fit.x[:4].reshape(2, 2), away_px.T, rcond=None)[0].T
    return away_mm
