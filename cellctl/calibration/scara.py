"""The planar hand-eye problem of a SCARA: the model.

All rotations of a SCARA are about one direction, so AX = XB and CX = XD are rank deficient: the z part of X cannot
be seen, and general solvers fail or run away. In the plane the problem is well posed:

    eye_in_hand: q = R(-r) (T + R(p) m - t)     q in the mount's frame, T, p = the board in the robot frame
    eye_to_hand: q = t + R(r) (T + R(p) m)      q in the robot frame,   T, p = the board in the tool frame
    flat px = (A q + b + s z) / (1 + g.q + h z);  px = c + distort(flat - c)      (see plane_map.py)

m are the board's points; t, r the pose of what carries the camera, the tool or the second arm (see mount.py), or of
the tool that holds the board; z is how far the robot's Z is below the height for which the map shall hold. `linear.py`
solves without lens and noise, `bundle.py` refines that.
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
