"""The first look: three pictures tell roughly how the camera stands, so that the real poses can be planned."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from cellctl.calibration.board import DotBoard
from cellctl.calibration.errors import PosesDisagree
from cellctl.calibration.linear import linear_start
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import FloatArray, Setup, pose_array, rotation
from cellctl.calibration.view import picture_centre_px
from cellctl.geometry import Pose, Px, wrap_deg

MOST_ROUGH_SCALE_ERROR = 0.05
BACK = 0.12  # part of the picture by which a board that leaves it is brought back at a time


def rough_steps(
    drawn: Setup, start: Pose, dots_px: FloatArray, picture_px: tuple[int, int], step_mm: float = 2.0
) -> tuple[Pose, Pose]:
    """One step in X and one in Y from the start, each to the side that brings the board nearer to the middle.

    `dots_px` (m, 2) was seen at the start. Only the drawn direction and mirroring of the camera are relied on.
    """
    to_middle_px = picture_centre_px(picture_px) - dots_px.mean(0)
    to_middle_mm = np.linalg.solve(drawn.plane_map.matrix, to_middle_px)
    if drawn.kind == "eye_in_hand":  # the board moves in the picture against the camera
        to_middle_mm = -rotation(math.radians(start.t_deg)) @ to_middle_mm
    dx, dy = np.copysign(step_mm, to_middle_mm).tolist()
    return start._replace(x_mm=start.x_mm + dx), start._replace(y_mm=start.y_mm + dy)


def back_into_view(at: Px, sides: Sequence[str], picture_px: tuple[int, int]) -> Px:
    """Where to show the board next when it was meant to be at a place and left the picture at these sides."""
    width, height = picture_px
    du = ("left" in sides) - ("right" in sides)
    dv = ("top" in sides) - ("bottom" in sides)
    return Px(at.u + du * BACK * width, at.v + dv * BACK * height)


def rough_setup(
    drawn: Setup,
    poses: Sequence[Pose],
    dots_px: FloatArray,
    board: DotBoard,
    picture_px: tuple[int, int],
) -> Setup:
    """Where camera and board are, to some 0.1 mm in the picture, from pictures at the start, +dx and +dy.

    The camera's scale, direction and mirroring come from the pictures. How its place splits from the board's cannot
    be seen without turning, so that remains as drawn; further pictures with the tool turned settle that as well.
    Raises PosesDisagree when the board's size and the robot's travel contradict each other.
    """
    centre = picture_centre_px(picture_px)
    table = pose_array(poses)
    if len(poses) < 3 or np.linalg.matrix_rank(table[:, :2] - table[0, :2], tol=0.1) < 2:
        raise ValueError("rough setup: three pictures are needed: the start, a step in X and a step in Y")
    found = linear_start(drawn.kind, table, dots_px, board.points_mm, (drawn, centre))
    if abs(found.scale - 1) > MOST_ROUGH_SCALE_ERROR:
        raise PosesDisagree(
            "rough scale",
            f"the board's drawn size is {found.scale:.2f} times what the robot's travel says: check the board that "
            "is described, the signs of the robot's X and Y, and whether the picture is mirrored",
        )
    try:
        camera = PlaneMap.from_arrays(found.matrix, found.offset, 0.0, centre)
    except ValueError as error:
        raise PosesDisagree("camera", str(error)) from error
    x_mm, y_mm = found.board_mm.tolist()
    return Setup(drawn.kind, camera, Pose(x_mm, y_mm, wrap_deg(math.degrees(found.board_rad))))
