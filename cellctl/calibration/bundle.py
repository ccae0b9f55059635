"""The refinement of the hand-eye solution: all parameters at once, every robot pose free within its repeatability.

Each pose touches only its own three corrections, so these are eliminated pose by pose (Schur complement) and what is
left is a 12 x 12 system: a solution takes a few milliseconds, and the inverse of that system is the covariance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import QUARTER, FloatArray, Kind, Linear, Noise, Setup, plane_points_mm, rotation
from cellctl.geometry import Pose, wrap_deg

PARAMETERS = (
    "a11_px_per_mm", "a12_px_per_mm", "a21_px_per_mm", "a22_px_per_mm", "offset_u_px", "offset_v_px",
    "board_x_mm", "board_y_mm", "board_t_rad", "k1_per_px2", "centre_u_px", "centre_v_px",
)  # fmt: skip
SHARED = len(PARAMETERS)  # before the three corrections of each pose
LENS = slice(9, 12)
LENS_SD = np.array([1e-9, 100.0, 100.0])  # k1: 4 px at a 5 MP picture's corner; how far the lens' centre may be off, px
MOST_STEPS = 30
ENOUGH = 1e-6  # part of the cost, and squared sigmas: a smaller gain means nothing
DAMPING = (1e-9, 1e9)  # first, last


class Normal(NamedTuple):
    """Normal equations at one point: `s` the shared parameters, `p` the corrections of each of n poses."""

    cost: float
    ss: FloatArray  # (12, 12)
    sp: FloatArray  # (n, 12, 3)
    pp: FloatArray  # (n, 3, 3)
    s: FloatArray  # gradient (12,)
    p: FloatArray  # gradient (n, 3)

    @property
    def _size(self) -> FloatArray:
        """What the shared parameters are scaled by: their mix of px, mm and 1/px^2 cannot be solved as it is."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.ss), 1e-200)), np.float64)

    def step(self, damping: float) -> FloatArray:
        """The change of all unknowns that minimises, with Marquardt's damping."""
        pp_inverse = np.linalg.inv(self.pp + damping * self.pp * np.eye(3))
        carried = self.sp @ pp_inverse
        shared = self.ss + damping * self.ss * np.eye(SHARED) - (carried @ self.sp.transpose(0, 2, 1)).sum(0)
        right = self.s - (carried @ self.p[..., None]).sum(0)[:, 0]
        size = self._size
        by_shared = -np.linalg.lstsq(shared / np.outer(size, size), right / size, rcond=None)[0] / size
        by_pose = -np.einsum("nij,nj->ni", pp_inverse, self.p + by_shared @ self.sp)
        return np.concatenate([by_shared, by_pose.ravel()])

    def covariance(self) -> FloatArray:
        """Of the shared parameters (12, 12), the robot's errors marginalised."""
        size = self._size
        left = self.ss - (self.sp @ np.linalg.inv(self.pp) @ self.sp.transpose(0, 2, 1)).sum(0)
        inverse: FloatArray = np.linalg.inv(left / np.outer(size, size)) / np.outer(size, size)
        return inverse

    def pose_variances(self) -> FloatArray:
        """Of the corrections (n, 3), in the robot's own variances."""
        pp_inverse = np.linalg.inv(self.pp)
        carried = self.sp @ pp_inverse
        whole = pp_inverse + carried.transpose(0, 2, 1) @ self.covariance() @ carried
        return np.asarray(np.diagonal(whole, axis1=1, axis2=2), np.float64)


@dataclass(frozen=True)
class Bundle:
    """One adjustment: poses (n, 3) mm and rad, board points (m, 2).

    The unknown vector holds PARAMETERS, with the offset at `pivot_mm` for a good condition, then the corrections
    dx, dy, dr of each pose in the robot's sigmas. Costs are in squared sigmas.
    """

    kind: Kind
    poses: FloatArray
    board_mm: FloatArray
    noise: Noise
    pivot_mm: FloatArray
    lens_centre_px: FloatArray

    @property
    def robot_sd(self) -> FloatArray:
        """Sigmas of dx, dy, dr: mm, mm, rad."""
        return np.array([self.noise.robot_sd_mm, self.noise.robot_sd_mm, math.radians(self.noise.robot_sd_deg)])

    def start(self, linear: Linear) -> FloatArray:
        """The unknowns at the linear solution."""
        offset = linear.offset + linear.matrix @ self.pivot_mm
        shared = [linear.matrix.ravel(), offset, linear.board_mm, [linear.board_rad, 0.0], self.lens_centre_px]
        return np.concatenate([*shared, np.zeros(3 * len(self.poses))])

    def unknowns(self, setup: Setup) -> FloatArray:
        """The unknowns at a given setup."""
        camera = setup.plane_map
        x_mm, y_mm, t_deg = setup.board
        offset = np.array(camera.offset_px) + camera.matrix @ self.pivot_mm
        shared = [camera.matrix.ravel(), offset, [x_mm, y_mm, math.radians(t_deg), camera.k1_per_px2]]
        return np.concatenate([*shared, camera.distortion_centre_px, np.zeros(3 * len(self.poses))])

    def setup(self, x: FloatArray) -> Setup:
        """The setup at given unknowns. Raises ValueError when no camera is like that."""
        matrix = x[:4].reshape(2, 2)
        camera = PlaneMap.from_arrays(matrix, x[4:6] - matrix @ self.pivot_mm, float(x[9]), x[10:12])
        return Setup(self.kind, camera, Pose(float(x[6]), float(x[7]), wrap_deg(math.degrees(float(x[8])))))

    def corrected(self, x: FloatArray) -> FloatArray:
        """The poses (n, 3) with their corrections."""
        poses: FloatArray = self.poses + x[SHARED:].reshape(-1, 3) * self.robot_sd
        return poses

    def px(self, x: FloatArray) -> FloatArray:
        """The board's points in the picture, (n, m, 2)."""
        plane = plane_points_mm(self.kind, x[6:9], self.corrected(x), self.board_mm)
        undistorted = (plane - self.pivot_mm) @ x[:4].reshape(2, 2).T + x[4:6]
        away = undistorted - x[10:12]
        distorted: FloatArray = undistorted + away * (x[9] * (away**2).sum(-1, keepdims=True))
        return distorted

    def jacobian(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of `px` by the shared parameters (n, m, 2, 12) and by the pose's corrections (n, m, 2, 3)."""
        plane = plane_points_mm(self.kind, x[6:9], self.corrected(x), self.board_mm)
        matrix, around = x[:4].reshape(2, 2), plane - self.pivot_mm
        away = around @ matrix.T + x[4:6] - x[10:12]
        radius2 = (away**2).sum(-1)[..., None, None]
        lens = np.eye(2) * (1 + x[9] * radius2) + 2 * x[9] * away[..., :, None] * away[..., None, :]
        by_plane = lens @ matrix
        by_board, by_pose = self._motion_jacobian(x, plane)
        shared = np.empty((*plane.shape, SHARED))
        shared[..., 0:4] = (lens[..., :, None] * around[..., None, None, :]).reshape(*plane.shape, 4)
        shared[..., 4:6] = lens
        shared[..., 6:9] = by_plane @ by_board
        shared[..., 9] = away * radius2[..., 0]
        shared[..., 10:12] = np.eye(2) - lens
        return shared, by_plane @ by_pose * self.robot_sd

    def _motion_jacobian(self, x: FloatArray, plane: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the plane points by the board's pose and by the robot's, (n, m, 2, 3) each."""
        poses, hand = self.corrected(x), self.kind == "eye_in_hand"
        arm = (self.board_mm @ rotation(float(x[8])).T) @ QUARTER.T
        turn = rotation(-poses[:, 2] if hand else poses[:, 2])
        by_board, by_pose = np.empty((*plane.shape, 3)), np.empty((*plane.shape, 3))
        by_board[..., :2] = turn[:, None]
        by_board[..., 2] = arm @ turn.transpose(0, 2, 1)
        by_pose[..., :2] = -turn[:, None] if hand else np.eye(2)
        by_pose[..., 2] = -plane @ QUARTER.T if hand else (plane - poses[:, None, :2]) @ QUARTER.T
        return by_board, by_pose

    def cost(self, x: FloatArray, dots_px: FloatArray) -> float:
        """Sum of squares in sigmas: dots, corrections, lens."""
        dots = ((self.px(x) - dots_px) ** 2).sum() / self.noise.dot_sd_px**2
        return float(dots + (x[SHARED:] ** 2).sum() + (self._lens(x) ** 2).sum())

    def normal(self, x: FloatArray, dots_px: FloatArray) -> Normal:
        """The normal equations at `x`."""
        sd, count = self.noise.dot_sd_px, len(self.poses)
        by_shared, by_pose = (part.reshape(count, -1, part.shape[-1]) / sd for part in self.jacobian(x))
        off = ((self.px(x) - dots_px) / sd).reshape(count, -1, 1)
        flat, turned = by_shared.reshape(-1, SHARED), by_pose.transpose(0, 2, 1)
        ss, s = flat.T @ flat, flat.T @ off.ravel()
        ss[LENS, LENS] += np.diag(1 / LENS_SD**2)
        s[LENS] += self._lens(x) / LENS_SD
        corrections = x[SHARED:].reshape(-1, 3)
        return Normal(
            cost=self.cost(x, dots_px),
            ss=ss,
            sp=by_shared.transpose(0, 2, 1) @ by_pose,
            pp=turned @ by_pose + np.eye(3),
            s=s,
            p=(turned @ off)[..., 0] + corrections,
        )

    def _lens(self, x: FloatArray) -> FloatArray:
        away = [x[9], *(x[10:12] - self.lens_centre_px)]
        return np.asarray(away / LENS_SD, np.float64)


def minimise(bundle: Bundle, x: FloatArray, dots_px: FloatArray) -> FloatArray:
    """Levenberg and Marquardt from `x`; the unknowns at the minimum."""
    damping, last = DAMPING
    with np.errstate(over="ignore", invalid="ignore"):  # a step too far is not taken
        normal = bundle.normal(x, dots_px)
        for _ in range(MOST_STEPS):
            step = normal.step(damping)
            trial = x + step
            gain = normal.cost - bundle.cost(trial, dots_px)
            if gain > 0:
                x, damping = trial, max(damping / 10, DAMPING[0])
                if gain < ENOUGH * (1.0 + normal.cost):
                    break
                normal = bundle.normal(x, dots_px)
            else:
                damping = max(damping * 100, 1e-3)
                if damping > last or abs(gain) < ENOUGH:
                    break
    return x
