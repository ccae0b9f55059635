"""One hand-eye problem with its data, its fit, and how each pose fits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from cellctl.calibration.adjustment import minimise
from cellctl.calibration.bundle import Bundle, Shots
from cellctl.calibration.linear import Linear, linear_start
from cellctl.calibration.parameters import MATRIX, SHARED, prior_sd
from cellctl.calibration.plane_map import Lens
from cellctl.calibration.scara import FloatArray, Kind, Noise, pose_array
from cellctl.geometry import Pose

WORST_SD = 6.0  # a pose is out when its dots or its robot correction exceed this many of their sigmas
DOT_ROUNDS = 6
MOST_DOTS_OUT = 0.25  # of a picture: with more it is the picture that is wrong, and they are kept


@dataclass(frozen=True, eq=False)
class Looks:
    """What calibration saw: dots (n, m, 2) px of one board at n poses of the mount, or of the tool that holds it.

    `heights_mm` (n,): how far the robot's Z was below the height that the map shall hold for; without them all
    pictures were taken there. `scatter` (n, 3, 3): what three independent standard errors of the robot do to each
    pose (mount.py); without it they are the tool's x, y and R.
    """

    poses: Sequence[Pose]
    dots_px: FloatArray
    heights_mm: FloatArray | None = None
    scatter: FloatArray | None = None


class PoseFit(NamedTuple):
    """How one pose fits: rms of its dots per axis, and the robot error it suggests."""

    pose: Pose
    number: int  # in the order of taking, from 1
    rms_px: float
    dx_um: float
    dy_um: float
    dt_mdeg: float
    worst_sd: float  # the largest of these in its own sigmas


class Problem(NamedTuple):
    """Pictures of a board (m, 2) mm; `numbers` are those of the poses in the order of taking, from 1."""

    kind: Kind
    lens: Lens
    shots: Shots
    numbers: tuple[int, ...]
    board_mm: FloatArray
    noise: Noise
    picture_px: tuple[int, int]

    def only(self, keep: Sequence[int]) -> Problem:
        """The same with fewer poses."""
        index = list(keep)
        shots = Shots(*(part[index] for part in self.shots))
        return self._replace(shots=shots, numbers=tuple(self.numbers[i] for i in index))

    def with_poses(self, poses: FloatArray) -> Problem:
        """The same at other poses."""
        return self._replace(shots=self.shots._replace(poses=poses))

    @property
    def linear(self) -> Linear:
        """The closed-form solution."""
        return linear_start(self.kind, self.shots.poses, self.shots.dots_px, self.board_mm)


class Fit(NamedTuple):
    """A solved problem, good or bad."""

    problem: Problem
    bundle: Bundle
    linear: Linear
    x: FloatArray

    @property
    def cost(self) -> float:
        """Sum of squares in sigmas."""
        return self.bundle.cost(self.x)


def checked_problem(
    kind: Kind, lens: Lens, looks: Looks, board_mm: FloatArray, noise: Noise, picture_px: tuple[int, int]
) -> Problem:
    """Raise ValueError for shapes that do not belong together or numbers that are none."""
    count, points = len(looks.poses), len(board_mm)
    heights = np.zeros(count) if looks.heights_mm is None else np.asarray(looks.heights_mm, float)
    scatter = tool_scatter(noise, count) if looks.scatter is None else np.asarray(looks.scatter, float)
    dots, board, poses = np.asarray(looks.dots_px, float), np.asarray(board_mm, float), pose_array(looks.poses)
    if dots.shape != (count, points, 2) or heights.shape != (count,) or scatter.shape != (count, 3, 3):
        raise ValueError(
            f"hand-eye: dots must be {(count, points, 2)}, heights {(count,)}, scatter {(count, 3, 3)} for these poses "
            f"and this board (got {dots.shape}, {heights.shape}, {scatter.shape})"
        )
    if not all(np.isfinite(part).all() for part in (dots, heights, scatter, board, poses)):
        raise ValueError("hand-eye: poses, dots, heights, scatter and board points must be finite")
    if np.linalg.matrix_rank(board - board.mean(0)) < 2:
        raise ValueError("hand-eye: board points must not lie on one line")
    numbers = tuple(range(1, count + 1))
    return Problem(kind, lens, Shots(poses, dots, heights, scatter), numbers, board, noise, picture_px)


def tool_scatter(noise: Noise, count: int) -> FloatArray:
    """The robot's standard errors in x, y and R, at each of so many poses, (n, 3, 3)."""
    each = np.diag([noise.robot_sd_mm, noise.robot_sd_mm, math.radians(noise.robot_sd_deg)])
    return np.broadcast_to(each, (count, 3, 3))


def fit_problem(problem: Problem) -> Fit:
    """Linear start and bundle, without judging."""
    linear = problem.linear
    centre = (np.array(problem.picture_px) - 1) / 2
    pivot = np.asarray(np.linalg.lstsq(linear.matrix, centre - linear.offset, rcond=None)[0], np.float64)
    bundle = Bundle(
        kind=problem.kind,
        shots=problem.shots,
        board_mm=problem.board_mm,
        dot_sd_px=problem.noise.dot_sd_px,
        pivot_mm=pivot,
        lens_centre_px=centre,
        believed_sd=prior_sd(problem.lens, problem.picture_px, scale_px_per_mm(linear)),
    )
    return Fit(problem, bundle, linear, minimise(bundle, bundle.start(linear)))


def scale_px_per_mm(linear: Linear) -> float:
    """Mean scale of a linear solution."""
    return math.sqrt(max(abs(float(np.linalg.det(linear.matrix))), 1e-12))


def without_bad_dots(fit: Fit) -> Fit:
    """The fit without single dots that lie off by more than their noise, the worst first; dirt on a board."""
    given = fit.problem.shots.dots_px
    spoilt = np.zeros(
        len(given), np.bool_
    )  # pictures with so much dirt that they are wrong as a whole: kept to be seen
    for _ in range(DOT_ROUNDS):
        away = np.hypot(*np.moveaxis(fit.bundle.residuals_px(fit.x), -1, 0))
        away[spoilt] = 0.0
        bad = away > max(WORST_SD * fit.problem.noise.dot_sd_px, float(away.max()) / 2)
        if not bad.any():
            return fit
        shots = fit.problem.shots
        dots = np.where(bad[..., None], np.nan, shots.dots_px)
        spoilt |= np.isnan(dots[..., 0]).mean(1) > MOST_DOTS_OUT
        dots[spoilt] = given[spoilt]
        fit = fit_problem(fit.problem._replace(shots=shots._replace(dots_px=dots)))
    return fit


def pose_fits(fit: Fit) -> list[PoseFit]:
    """How each pose fits."""
    used = fit.problem.shots.used.sum((1, 2))
    rms_px = np.sqrt((fit.bundle.residuals_px(fit.x) ** 2).sum((1, 2)) / np.maximum(2 * used, 1)).tolist()
    sigmas = np.abs(fit.x[SHARED:]).reshape(-1, 3).max(1).tolist()
    fits = []
    for pose, number, robot, rms, sigma in zip(
        fit.problem.shots.poses, fit.problem.numbers, fit.bundle.corrections(fit.x), rms_px, sigmas, strict=True
    ):
        x_mm, y_mm, t_rad = pose.tolist()
        dx, dy, dt = robot.tolist()
        where = Pose(x_mm, y_mm, math.degrees(t_rad))
        worst = max(sigma, rms / fit.problem.noise.dot_sd_px)
        fits.append(PoseFit(where, number, rms, dx * 1000, dy * 1000, math.degrees(dt) * 1000, worst))
    return fits


def poses_out(fit: Fit) -> list[int]:
    """Indices of the poses that do not fit, the worst first."""
    fits = pose_fits(fit)
    bad = [i for i, pose in enumerate(fits) if not pose.worst_sd <= WORST_SD]
    return sorted(bad, key=lambda i: -fits[i].worst_sd)


def prediction_error_mm(fit: Fit, unseen: Problem) -> FloatArray:
    """Seen minus expected board centre at poses that were not part of the fit, (n, 2) mm."""
    bundle = replace(fit.bundle, shots=unseen.shots)
    x = np.concatenate([fit.x[:SHARED], np.zeros(3 * len(unseen.numbers))])
    away_px = -bundle.residuals_px(x).sum(1) / np.maximum(unseen.shots.used.sum(1), 1)
    away_mm: FloatArray = np.linalg.lstsq(fit.x[MATRIX].reshape(2, 2), away_px.T, rcond=None)[0].T
    return away_mm
