"""The planar hand-eye problem of a SCARA with a telecentric camera: model, linear start, and bundle.

All rotations of a SCARA are about one direction, so AX = XB and CX = XD are rank deficient: the z part of X cannot
be seen, and general solvers fail or run away. In the plane the problem is well posed:

    eye_in_hand: q = R(-r) (T + R(p) g - t)     q in the tool frame,  T, p = the board in the robot frame
    eye_to_hand: q = t + R(r) (T + R(p) g)      q in the robot frame, T, p = the board in the tool frame
    undistorted px = A (q - q0) + b0            q0 a fixed point near the view's middle, for a good condition
    px = undistorted + (undistorted - c) k1 |undistorted - c|^2

g are the board's points; t, r the robot's pose, each with a small correction whose size the robot's repeatability
limits. `eye_in_hand` also serves a camera on the second arm when t, r are that arm's pose instead of the tool's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.plane_map import PlaneMap
from cellctl.geometry import Pose, wrap_deg

FloatArray = NDArray[np.float64]
Kind = Literal["eye_in_hand", "eye_to_hand"]

PARAMETERS = (
    "a11_px_per_mm", "a12_px_per_mm", "a21_px_per_mm", "a22_px_per_mm", "offset_u_px", "offset_v_px",
    "board_x_mm", "board_y_mm", "board_t_rad", "k1_per_px2", "centre_u_px", "centre_v_px",
)  # fmt: skip
SHARED = len(PARAMETERS)  # before the three corrections of each pose
LENS_CENTRE_SD_PX = 100.0  # how far the distortion's centre may lie from the picture's
LENS_K1_SD_PER_PX2 = 1e-9  # 4 px at the corner of a 5 MP picture: far more than a telecentric lens has
QUARTER = np.array([[0.0, -1.0], [1.0, 0.0]])  # derivative of a rotation at 0


@dataclass(frozen=True, slots=True)
class Noise:
    """One-sigma noise per axis: the robot's repeatability (+-0.01 mm, +-0.004 deg are 3 sigma), a dot's place."""

    robot_sd_mm: float = 0.0033
    robot_sd_deg: float = 0.00133
    dot_sd_px: float = 0.03

    def __post_init__(self) -> None:
        values = (self.robot_sd_mm, self.robot_sd_deg, self.dot_sd_px)
        if not all(math.isfinite(value) and value > 0 for value in values):
            raise ValueError(f"calibration noise: all three figures must be above 0 (got {values})")


class Setup(NamedTuple):
    """What is believed: the camera, and the board's pose in the robot frame (eye_in_hand) or the tool frame."""

    kind: Kind
    plane_map: PlaneMap
    board: Pose


class Linear(NamedTuple):
    """Linear solution. `scale` is the board's pitch over the robot's travel, 1 when both are right."""

    matrix: FloatArray
    offset: FloatArray
    board_mm: FloatArray
    board_rad: float
    scale: float


def rotation(angle_rad: FloatArray | float) -> FloatArray:
    """Rotation matrices (..., 2, 2)."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def pose_array(poses: Sequence[Pose]) -> FloatArray:
    """Poses as (n, 3): mm, mm, rad."""
    table = np.array(poses, float).reshape(-1, 3)
    table[:, 2] = np.radians(table[:, 2])
    return table


def plane_points_mm(kind: Kind, board: FloatArray, poses: FloatArray, board_mm: FloatArray) -> FloatArray:
    """Board points (m, 2) in the camera's plane, (n, m, 2) mm, for a board at (3,) and robot poses (n, 3), rad."""
    fixed = board[:2] + board_mm @ rotation(float(board[2])).T
    place = poses[:, None, :2]
    if kind == "eye_in_hand":
        seen: FloatArray = np.einsum("nij,nmj->nmi", rotation(-poses[:, 2]), fixed - place)
    else:
        seen = place + np.einsum("nij,mj->nmi", rotation(poses[:, 2]), fixed)
    return seen


def linear_start(
    kind: Kind,
    poses: FloatArray,
    dots_px: FloatArray,
    board_mm: FloatArray,
    nominal: tuple[Setup, FloatArray] | None = None,
) -> Linear:
    """Solve without distortion and without robot noise, in closed form.

    Per picture px = L g + d. L is A R(p) turned by the robot, so K = A R(p) is their mean turned back; with it d is
    linear in cos p and sin p, the board's place and the offset. `nominal` (a setup and the picture's centre px) adds
    what is known by drawing as weak equations, so that pictures without rotation can be solved as well.
    """
    middle = board_mm.mean(0)
    design = np.column_stack([board_mm - middle, np.ones(len(board_mm))])
    fits = np.stack([np.linalg.lstsq(design, dots, rcond=None)[0].T for dots in dots_px])
    turn = poses[:, 2] if kind == "eye_in_hand" else -poses[:, 2]
    common = np.mean(fits[:, :, :2] @ rotation(turn), axis=0)
    rows, right = _linear_rows(kind, poses, common), fits[:, :, 2].reshape(-1)
    if nominal is not None:
        rows, right = _with_nominal(rows, right, common, nominal, middle)
    p_cos, p_sin, *rest = np.linalg.lstsq(rows, right, rcond=None)[0].tolist()
    angle = math.atan2(p_sin, p_cos)
    place = rotation(angle) @ rest[:2] - rotation(angle) @ middle
    return Linear(common @ rotation(-angle), np.array(rest[2:]), place, angle, math.hypot(p_cos, p_sin))


def _linear_rows(kind: Kind, poses: FloatArray, common: FloatArray) -> FloatArray:
    """Columns: cos p, sin p, the board's middle turned by -p (2), the offset (2); two rows per picture."""
    count = len(poses)
    place = np.stack([poses[:, :2], -poses[:, :2] @ QUARTER.T], axis=-1)  # R(-p) t = place @ (cos p, sin p)
    if kind == "eye_in_hand":
        back = common @ rotation(-poses[:, 2])
        blocks = [-back @ place, back, np.broadcast_to(np.eye(2), (count, 2, 2))]
    else:
        blocks = [common @ place, common @ rotation(poses[:, 2]), np.broadcast_to(np.eye(2), (count, 2, 2))]
    return np.concatenate(blocks, axis=-1).reshape(-1, 6)


def _with_nominal(
    rows: FloatArray, right: FloatArray, common: FloatArray, nominal: tuple[Setup, FloatArray], middle: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Add that the picture's centre looks at the drawn place and that the board lies where drawn, weighted low."""
    setup, picture_centre = nominal
    axis = setup.plane_map.mm_from_px(picture_centre[None])[0]
    board = np.array(setup.board.point(*middle.tolist()))
    looks = np.zeros((2, 6))
    looks[:, :2] = common @ np.column_stack([axis, -QUARTER @ axis])
    looks[:, 4:] = np.eye(2)
    lies = np.zeros((2, 6))
    lies[:, :2] = -np.column_stack([board, -QUARTER @ board])
    lies[:, 2:4] = np.eye(2)
    weight = 1e-3  # 2 mm of the drawing weigh as much as 2 um of the robot
    lies *= 1.0 / setup.plane_map.mm_per_px
    more = np.concatenate([looks, lies]) * weight
    wanted = np.concatenate([picture_centre, np.zeros(2)]) * weight
    return np.concatenate([rows, more]), np.concatenate([right, wanted])


@dataclass(frozen=True)
class Bundle:
    """The whole adjustment: residuals and Jacobian in units of sigma, for poses (n, 3), board points (m, 2).

    The unknown vector holds PARAMETERS (with the offset at `pivot_mm`), then dx, dy, dr of each pose.
    """

    kind: Kind
    poses: FloatArray
    board_mm: FloatArray
    noise: Noise
    pivot_mm: FloatArray
    lens_centre_px: FloatArray

    def start(self, linear: Linear) -> FloatArray:
        """The unknowns at the linear solution."""
        offset = linear.offset + linear.matrix @ self.pivot_mm
        board = [*linear.board_mm, linear.board_rad]
        shared = np.concatenate([linear.matrix.ravel(), offset, board, [0.0], self.lens_centre_px])
        return np.concatenate([shared, np.zeros(3 * len(self.poses))])

    def unknowns(self, setup: Setup) -> FloatArray:
        """The unknowns at a given setup."""
        camera = setup.plane_map
        x_mm, y_mm, t_deg = setup.board
        offset = np.array(camera.offset_px) + camera.matrix @ self.pivot_mm
        lens = [camera.k1_per_px2, *camera.distortion_centre_px]
        shared = np.concatenate([camera.matrix.ravel(), offset, [x_mm, y_mm, math.radians(t_deg)], lens])
        return np.concatenate([shared, np.zeros(3 * len(self.poses))])

    def setup(self, x: FloatArray) -> Setup:
        """The setup at given unknowns. Raises ValueError when no camera is like that."""
        matrix = x[:4].reshape(2, 2)
        camera = PlaneMap.from_arrays(matrix, x[4:6] - matrix @ self.pivot_mm, float(x[9]), x[10:12])
        return Setup(self.kind, camera, Pose(float(x[6]), float(x[7]), wrap_deg(math.degrees(float(x[8])))))

    def plane_mm(self, x: FloatArray) -> FloatArray:
        """The board's points in the camera's plane, (n, m, 2) mm, with the corrected poses."""
        poses = self.poses + x[SHARED:].reshape(-1, 3)
        return plane_points_mm(self.kind, x[6:9], poses, self.board_mm)

    def px(self, x: FloatArray) -> FloatArray:
        """The board's points in the picture, (n, m, 2)."""
        undistorted = (self.plane_mm(x) - self.pivot_mm) @ x[:4].reshape(2, 2).T + x[4:6]
        away = undistorted - x[10:12]
        distorted: FloatArray = undistorted + away * (x[9] * (away**2).sum(-1, keepdims=True))
        return distorted

    def residuals(self, x: FloatArray, dots_px: FloatArray) -> FloatArray:
        """Everything over its sigma: dots, then the poses' corrections, then the lens."""
        dots = (self.px(x) - dots_px).ravel() / self.noise.dot_sd_px
        return np.concatenate([dots, x[SHARED:] / self._pose_sd(), self._lens(x)])

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Derivative of `residuals`, analytic, (2 n m + 3 n + 3, 12 + 3 n)."""
        count, dots = len(self.poses), len(self.board_mm)
        top = np.zeros((count, dots, 2, SHARED + 3 * count))
        matrix, q = x[:4].reshape(2, 2), self.plane_mm(x)
        away = (q - self.pivot_mm) @ matrix.T + x[4:6] - x[10:12]
        radius2 = (away**2).sum(-1)[..., None, None]
        lens = np.eye(2) * (1 + x[9] * radius2) + 2 * x[9] * away[..., :, None] * away[..., None, :]
        top[..., 0:4] = (lens[..., :, None] * (q - self.pivot_mm)[..., None, None, :]).reshape(count, dots, 2, 4)
        top[..., 4:6] = lens
        top[..., 9] = away * radius2[..., 0]
        top[..., 10:12] = np.eye(2) - lens
        by_board, by_pose = self._motion_jacobian(x, q)
        by_plane = lens @ matrix
        top[..., 6:9] = by_plane @ by_board
        for i in range(count):
            top[i, :, :, SHARED + 3 * i : SHARED + 3 * i + 3] = by_plane[i] @ by_pose[i]
        return np.concatenate([top.reshape(-1, top.shape[-1]) / self.noise.dot_sd_px, self._prior_rows(count)])

    def _motion_jacobian(self, x: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the plane points by the board's pose and by each robot pose, (n, m, 2, 3) each."""
        poses = self.poses + x[SHARED:].reshape(-1, 3)
        arm = (self.board_mm @ rotation(float(x[8])).T) @ QUARTER.T
        hand = self.kind == "eye_in_hand"
        turn = rotation(-poses[:, 2] if hand else poses[:, 2])
        by_board, by_pose = np.zeros((*q.shape, 3)), np.zeros((*q.shape, 3))
        by_board[..., :2] = turn[:, None]
        by_board[..., 2] = np.einsum("nij,mj->nmi", turn, arm)
        by_pose[..., :2] = -turn[:, None] if hand else np.eye(2)
        by_pose[..., 2] = -q @ QUARTER.T if hand else (q - poses[:, None, :2]) @ QUARTER.T
        return by_board, by_pose

    def _prior_rows(self, count: int) -> FloatArray:
        width = SHARED + 3 * count
        rows = np.zeros((3 * count + 3, width))
        rows[: 3 * count, SHARED:] = np.diag(1 / self._pose_sd())
        rows[3 * count :, 9:12] = np.diag(1 / np.array([LENS_K1_SD_PER_PX2, LENS_CENTRE_SD_PX, LENS_CENTRE_SD_PX]))
        return rows

    def _pose_sd(self) -> FloatArray:
        sd = [self.noise.robot_sd_mm, self.noise.robot_sd_mm, math.radians(self.noise.robot_sd_deg)]
        return np.tile(sd, len(self.poses))

    def _lens(self, x: FloatArray) -> FloatArray:
        return np.array([x[9] / LENS_K1_SD_PER_PX2, *((x[10:12] - self.lens_centre_px) / LENS_CENTRE_SD_PX)])


def solve(bundle: Bundle, start: FloatArray, dots_px: FloatArray) -> FloatArray:
    """Least squares from `start`; the unknowns at the minimum."""
    from scipy.optimize import least_squares  # here, since it takes longer to load than the solution takes

    def residuals(x: FloatArray) -> FloatArray:
        return bundle.residuals(x, dots_px)

    found = least_squares(residuals, start, jac=bundle.jacobian, method="lm", x_scale="jac", max_nfev=100)
    return np.asarray(found.x, dtype=np.float64)
