"""The refinement of the hand-eye solution: all parameters at once, every robot pose free within its repeatability."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellctl.calibration import distortion
from cellctl.calibration.adjustment import Normal
from cellctl.calibration.linear import Linear
from cellctl.calibration.parameters import (
    APPROACH,
    BELIEVED,
    BOARD,
    CENTRE,
    COEFFICIENTS,
    MATRIX,
    OFFSET,
    PERSPECTIVE,
    SHARED,
    SLOPE,
)
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import QUARTER, FloatArray, Kind, Setup, plane_points_mm, rotation
from cellctl.geometry import Pose, wrap_deg


class Shots(NamedTuple):
    """Pictures of the board at n poses.

    `poses` (n, 3) mm and rad, `dots_px` (n, m, 2) with nan for a dot that is not used, `heights_mm` (n,) of the
    robot's Z below the height that the map shall hold for, `scatter` (n, 3, 3): what three independent standard errors
    of the robot do to the pose.
    """

    poses: FloatArray
    dots_px: FloatArray
    heights_mm: FloatArray
    scatter: FloatArray

    @property
    def used(self) -> FloatArray:
        """1 for a dot that is used, else 0, (n, m, 1)."""
        return np.asarray(np.isfinite(self.dots_px[..., :1]), np.float64)


class _Seen(NamedTuple):
    """Where the board's points are at some unknowns: in the plane, before the lens, and how near, (n, m, ...)."""

    plane: FloatArray
    around: FloatArray  # from the pivot
    depth: FloatArray  # 1 for a telecentric lens
    flat: FloatArray


@dataclass(frozen=True, eq=False)
class Bundle:
    """One adjustment of board points (m, 2); a least-squares problem for `adjustment.minimise`.

    The unknown vector holds PARAMETERS, with the map's numbers as seen from `pivot_mm` for a good condition, then
    three corrections of each pose in standard errors of the robot. Costs are in squared sigmas.
    """

    kind: Kind
    shots: Shots
    board_mm: FloatArray
    dot_sd_px: float
    pivot_mm: FloatArray
    lens_centre_px: FloatArray
    believed_sd: FloatArray  # of the parameters from k1 on

    def start(self, linear: Linear) -> FloatArray:
        """The unknowns at the linear solution."""
        offset = linear.offset + linear.matrix @ self.pivot_mm
        return self._unknowns(linear.matrix, offset, [*linear.board_mm, linear.board_rad])

    def unknowns(self, setup: Setup) -> FloatArray:
        """The unknowns at a given setup, without slope."""
        camera, (x_mm, y_mm, t_deg) = setup.plane_map, setup.board
        offset, perspective = camera.matrix @ self.pivot_mm + camera.offset_px, np.array(camera.perspective_per_mm)
        depth = 1 + float(perspective @ self.pivot_mm)
        x = self._unknowns(camera.matrix / depth, offset / depth, [x_mm, y_mm, math.radians(t_deg)])
        x[list(COEFFICIENTS)], x[CENTRE] = camera.coefficients, camera.distortion_centre_px
        x[PERSPECTIVE] = perspective / depth
        return x

    def _unknowns(self, matrix: FloatArray, offset: FloatArray, board: list[float]) -> FloatArray:
        x = np.zeros(SHARED + 3 * len(self.shots.poses))
        x[MATRIX], x[OFFSET], x[BOARD], x[CENTRE] = matrix.ravel(), offset, board, self.lens_centre_px
        return x

    def setup(self, x: FloatArray) -> Setup:
        """The setup at given unknowns. Raises ValueError when no camera is like that."""
        matrix, perspective = x[MATRIX].reshape(2, 2), x[PERSPECTIVE]
        depth = 1 - float(perspective @ self.pivot_mm)
        (a, b), (c, d) = (matrix / depth).tolist()
        u, v = ((x[OFFSET] - matrix @ self.pivot_mm) / depth).tolist()
        k1, *others = (float(x[index]) for index in COEFFICIENTS)
        tilted = (float(perspective[0]) / depth, float(perspective[1]) / depth)
        camera = PlaneMap(((a, b), (c, d)), (u, v), k1, (float(x[10]), float(x[11])), tilted, *others)
        return Setup(self.kind, camera, Pose(float(x[6]), float(x[7]), wrap_deg(math.degrees(float(x[8])))))

    def slope_px_per_mm(self, x: FloatArray) -> tuple[float, float]:
        """Shift of the picture per mm that the robot's Z grows."""
        depth = 1 - float(x[PERSPECTIVE] @ self.pivot_mm)
        return float(x[SLOPE][0]) / depth, float(x[SLOPE][1]) / depth

    def corrections(self, x: FloatArray) -> FloatArray:
        """What the poses are corrected by, (n, 3) mm and rad."""
        errors = x[SHARED:].reshape(-1, 3)
        return np.asarray(np.einsum("nij,nj->ni", self.shots.scatter, errors), np.float64)

    def px(self, x: FloatArray) -> FloatArray:
        """The board's points in the picture, (n, m, 2)."""
        away = self._seen(x).flat - x[CENTRE]
        return np.asarray(x[CENTRE] + distortion.distort(away, x[list(COEFFICIENTS)]), np.float64)

    def residuals_px(self, x: FloatArray) -> FloatArray:
        """Expected minus measured, 0 for dots that are not used, (n, m, 2)."""
        return np.where(self.shots.used > 0, self.px(x) - np.nan_to_num(self.shots.dots_px), 0.0)

    def jacobian(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of `px` by the shared parameters (n, m, 2, 21) and by the pose's errors (n, m, 2, 3)."""
        seen, perspective = self._seen(x), x[PERSPECTIVE]
        lens, by_coefficients = distortion.jacobians(seen.flat - x[CENTRE], x[list(COEFFICIENTS)])
        nearer = lens / seen.depth[..., None]
        by_flat = nearer @ seen.flat[..., None]  # a change of depth moves the point along itself
        by_plane = nearer @ x[MATRIX].reshape(2, 2) - by_flat * perspective
        by_board, by_pose = self._motion_jacobian(x, seen.plane)
        heights = self.shots.heights_mm[:, None, None, None]
        shared = np.zeros((*seen.plane.shape, SHARED))
        shared[..., MATRIX] = (nearer[..., :, None] * seen.around[..., None, None, :]).reshape(*seen.plane.shape, 4)
        shared[..., OFFSET] = nearer
        shared[..., BOARD] = by_plane @ by_board
        shared[..., list(COEFFICIENTS)] = by_coefficients
        shared[..., CENTRE] = np.eye(2) - lens
        shared[..., PERSPECTIVE] = -by_flat * seen.around[..., None, :]
        shared[..., SLOPE] = nearer * heights
        shared[..., APPROACH] = (-by_flat * heights)[..., 0]
        return shared, by_plane @ by_pose @ self.shots.scatter[:, None]

    def cost(self, x: FloatArray) -> float:
        """Sum of squares in sigmas: dots, robot, what is believed."""
        dots = (self.residuals_px(x) ** 2).sum() / self.dot_sd_px**2
        return float(dots + (x[SHARED:] ** 2).sum() + (self._surprise(x) ** 2).sum())

    def normal(self, x: FloatArray) -> Normal:
        """The normal equations at `x`."""
        count, weight = len(self.shots.poses), self.shots.used[..., None] / self.dot_sd_px
        by_shared, by_pose = ((part * weight).reshape(count, -1, part.shape[-1]) for part in self.jacobian(x))
        off = (self.residuals_px(x) / self.dot_sd_px).reshape(count, -1, 1)
        flat, turned = by_shared.reshape(-1, SHARED), by_pose.transpose(0, 2, 1)
        ss, s = flat.T @ flat, flat.T @ off.ravel()
        ss[BELIEVED, BELIEVED] += np.diag(1 / self.believed_sd**2)
        s[BELIEVED] += self._surprise(x) / self.believed_sd
        return Normal(
            cost=self.cost(x),
            ss=ss,
            sp=by_shared.transpose(0, 2, 1) @ by_pose,
            pp=turned @ by_pose + np.eye(3),
            s=s,
            p=(turned @ off)[..., 0] + x[SHARED:].reshape(-1, 3),
        )

    def _surprise(self, x: FloatArray) -> FloatArray:
        """How far the parameters from k1 on are from what is believed of them, in sigmas."""
        away = x[BELIEVED].copy()
        away[1:3] -= self.lens_centre_px
        return np.asarray(away / self.believed_sd, np.float64)

    def _seen(self, x: FloatArray) -> _Seen:
        poses, heights = self.shots.poses + self.corrections(x), self.shots.heights_mm[:, None, None]
        plane = plane_points_mm(self.kind, x[BOARD], poses, self.board_mm)
        around = plane - self.pivot_mm
        depth = 1 + around @ x[PERSPECTIVE][:, None] + heights * x[APPROACH]
        flat = (around @ x[MATRIX].reshape(2, 2).T + x[OFFSET] + heights * x[SLOPE]) / depth
        return _Seen(plane, around, depth, flat)

    def _motion_jacobian(self, x: FloatArray, plane: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the plane points by the board's pose and by the robot's, (n, m, 2, 3) each."""
        poses, hand = self.shots.poses + self.corrections(x), self.kind == "eye_in_hand"
        arm = (self.board_mm @ rotation(float(x[8])).T) @ QUARTER.T
        turn = rotation(-poses[:, 2] if hand else poses[:, 2])
        by_board, by_pose = np.empty((*plane.shape, 3)), np.empty((*plane.shape, 3))
        by_board[..., :2] = turn[:, None]
        by_board[..., 2] = arm @ turn.transpose(0, 2, 1)
        by_pose[..., :2] = -turn[:, None] if hand else np.eye(2)
        by_pose[..., 2] = -plane @ QUARTER.T if hand else (plane - poses[:, None, :2]) @ QUARTER.T
        return by_board, by_pose
