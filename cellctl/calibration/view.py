"""What a camera sees of the board at a robot pose, and which pose shows it where: for a setup, drawn or measured."""

from __future__ import annotations

import math

import numpy as np

from cellctl.calibration.board import DotBoard
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import FloatArray, Kind, Setup, plane_points_mm, pose_array, rotation
from cellctl.geometry import Mm, Pose, Px

LENS_ALLOWANCE_PX = 3.0  # what a lens may bend that is not known yet


def drawn_setup(
    kind: Kind,
    *,
    camera: Pose,
    mirrored: bool,
    px_per_mm: float,
    board: Pose,
    picture_px: tuple[int, int],
) -> Setup:
    """The setup as drawn.

    `camera`: where the picture's centre looks and the direction of its u axis, in the tool frame (eye_in_hand) or
    the robot frame (eye_to_hand). `board`: robot_from_board (eye_in_hand) or tool_from_board (eye_to_hand).
    """
    view = np.diag([1.0, -1.0 if mirrored else 1.0])
    matrix = px_per_mm * view @ rotation(-math.radians(camera.t_deg))
    centre = picture_centre_px(picture_px)
    offset = centre - matrix @ np.array([camera.x_mm, camera.y_mm])
    return Setup(kind, PlaneMap.from_arrays(matrix, offset, 0.0, centre), board)


def pose_seeing(setup: Setup, point: Mm, at: Px, rotation_deg: float) -> Pose:
    """The robot pose with this rotation at which a point of the board appears at a place in the picture."""
    x_mm, y_mm = setup.plane_map.mm_at(at)
    held = setup.board.point(*point)
    turn = Pose(0.0, 0.0, rotation_deg)
    if setup.kind == "eye_in_hand":
        there = turn.point(x_mm, y_mm)
        return Pose(held.x_mm - there.x_mm, held.y_mm - there.y_mm, rotation_deg)
    there = turn.point(*held)
    return Pose(x_mm - there.x_mm, y_mm - there.y_mm, rotation_deg)


def start_pose(setup: Setup, board: DotBoard, picture_px: tuple[int, int], rotation_deg: float = 0.0) -> Pose:
    """The pose at which the board is in the middle of the picture."""
    u, v = picture_centre_px(picture_px).tolist()
    return pose_seeing(setup, board_middle(board), Px(u, v), rotation_deg)


def board_in_view(setup: Setup, pose: Pose, board: DotBoard, picture_px: tuple[int, int]) -> bool:
    """Does the picture at this pose hold all of the board?"""
    try:
        outline = board_px(setup, pose, board.outline_mm)
    except ValueError:
        return False
    size = np.array(picture_px)
    return bool(np.all(outline > LENS_ALLOWANCE_PX) and np.all(outline < size - 1 - LENS_ALLOWANCE_PX))


def board_px(setup: Setup, pose: Pose, board_mm: FloatArray) -> FloatArray:
    """Where board points (m, 2) appear at a pose, (m, 2). Raises ValueError for points far outside the lens."""
    plane = plane_points_mm(setup.kind, pose_array([setup.board])[0], pose_array([pose]), board_mm)[0]
    return setup.plane_map.px_from_mm(plane)


def board_middle(board: DotBoard) -> Mm:
    """Centre of the dots in the board frame."""
    x_mm, y_mm = board.centre_mm.tolist()
    return Mm(x_mm, y_mm)


def picture_centre_px(picture_px: tuple[int, int]) -> FloatArray:
    """Centre of a picture of this width and height, (2,) px."""
    return (np.array(picture_px, float) - 1) / 2
