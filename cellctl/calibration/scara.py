"""The planar hand-eye problem of a SCARA with a telecentric camera: the model, and its linear solution.

All rotations of a SCARA are about one direction, so AX = XB and CX = XD are rank deficient: the z part of X cannot
be seen, and general solvers fail or run away. In the plane the problem is well posed:

    eye_in_hand: q = R(-r) (T + R(p) g - t)     q in the tool frame,  T, p = the board in the robot frame
    eye_to_hand: q = t + R(r) (T + R(p) g)      q in the robot frame, T, p = the board in the tool frame
    undistorted px = A q + b;  px = undistorted + (undistorted - c) k1 |undistorted - c|^2

g are the board's points; t, r the robot's pose. `bundle.py` refines the linear solution. `eye_in_hand` also serves a
camera on the second arm when t, r are that arm's pose instead of the tool's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.plane_map import PlaneMap
from cellctl.geometry import Pose

FloatArray = NDArray[np.float64]
Kind = Literal["eye_in_hand", "eye_to_hand"]

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
    return np.asarray(np.moveaxis(np.array([[c, -s], [s, c]]), (0, 1), (-2, -1)), np.float64)


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
        seen: FloatArray = (fixed - place) @ rotation(poses[:, 2])  # rows times R are columns times R(-r)
    else:
        seen = place + fixed @ rotation(-poses[:, 2])
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
    side_by_side = dots_px.transpose(1, 0, 2).reshape(len(design), -1)
    fits = np.linalg.lstsq(design, side_by_side, rcond=None)[0].reshape(3, -1, 2).transpose(1, 2, 0)
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
