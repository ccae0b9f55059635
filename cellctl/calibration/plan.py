"""Where the robot goes to calibrate a camera, and the accuracy that will give, before anything moves."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cellctl.calibration.accuracy import Predicted, covariance, predict
from cellctl.calibration.board import DotBoard
from cellctl.calibration.bundle import Bundle
from cellctl.calibration.errors import DegenerateMotion, PlanImpossible
from cellctl.calibration.motion import Spread, check_motion
from cellctl.calibration.scara import Noise, Setup, pose_array
from cellctl.calibration.view import (
    LENS_ALLOWANCE_PX,
    board_in_view,
    board_middle,
    board_px,
    picture_centre_px,
    pose_seeing,
)
from cellctl.geometry import Pose, Px

Reach = Callable[[Pose], bool]

GOLDEN_DEG = 137.508  # turning by it spreads any number of directions evenly
MM_PER_DEG = 0.5  # what turning by a degree costs against travelling a mm, for the order of the poses


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """What the poses should be like. `margin_mm` is how badly the camera's place is known."""

    count: int = 15
    rotation_deg: float = 25.0  # to either side of `start_deg`
    start_deg: float = 0.0
    travel_mm: float = 2.0  # to either side, in the picture's directions
    margin_mm: float = 1.0


class Plan(NamedTuple):
    """Robot poses in the order to visit them, and what they will give."""

    poses: tuple[Pose, ...]
    spread: Spread
    predicted: Predicted


def plan_hand_eye(
    setup: Setup,
    board: DotBoard,
    picture_px: tuple[int, int],
    reach: Reach,
    request: PlanRequest | None = None,
    noise: Noise | None = None,
) -> Plan:
    """Poses that keep the whole board in view with a margin and spread positions and rotations; deterministic.

    Rotations lie denser towards both ends, since they tell most. `reach` says whether the robot may go to a pose.
    Raises PlanImpossible when a pose cannot be made good or the poses left cannot tell the unknowns apart.
    """
    request = request or PlanRequest()
    poses = [_best_pose(setup, board, picture_px, reach, request, i) for i in range(request.count)]
    poses = _short_path(poses)
    try:
        spread = check_motion(poses)
    except DegenerateMotion as error:
        raise PlanImpossible(error.check, f"within view and reach {error.detail}") from error
    return Plan(tuple(poses), spread, predict_plan(setup, poses, board, picture_px, noise))


def predict_plan(
    setup: Setup,
    poses: Sequence[Pose],
    board: DotBoard,
    picture_px: tuple[int, int],
    noise: Noise | None = None,
) -> Predicted:
    """The accuracy that pictures at these poses will give, from the Jacobian alone: before anything moves."""
    centre = picture_centre_px(picture_px)
    pivot = setup.plane_map.mm_from_px(centre[None])[0]
    bundle = Bundle(setup.kind, pose_array(poses), board.points_mm, noise or Noise(), pivot, centre)
    u, v = centre.tolist()
    x = bundle.unknowns(setup)
    parameters = covariance(bundle, bundle.normal(x, bundle.px(x)))
    return predict(setup.plane_map, parameters, Px(u, v))


def plan_tool_centre(
    setup: Setup,
    board: DotBoard,
    picture_px: tuple[int, int],
    reach: Reach,
    rotations_deg: Sequence[float] = (-60.0, -45.0, -30.0, -15.0, 0.0, 15.0, 30.0, 45.0, 60.0),
) -> tuple[Pose, ...]:
    """Pure rotations of a held board (eye_to_hand) at the one place that keeps it best in view.

    Raises PlanImpossible when fewer than three of the rotations are in view and in reach.
    """
    u, v = picture_centre_px(picture_px).tolist()
    seen = [pose_seeing(setup, board_middle(board), Px(u, v), turn) for turn in rotations_deg]
    x_mm, y_mm = (np.max([pose[:2] for pose in seen], 0) + np.min([pose[:2] for pose in seen], 0)) / 2
    poses = [Pose(float(x_mm), float(y_mm), turn) for turn in rotations_deg]
    good = tuple(pose for pose in poses if board_in_view(setup, pose, board, picture_px) and reach(pose))
    if len(good) < 3:
        raise PlanImpossible(
            "tool centre",
            f"{len(good)} of {len(poses)} rotations keep the board in view and in reach, three are needed: hold "
            "the board nearer to its middle",
        )
    return good


def _best_pose(
    setup: Setup, board: DotBoard, picture_px: tuple[int, int], reach: Reach, request: PlanRequest, index: int
) -> Pose:
    """The wanted pose, or the nearest to it in rotation and position that is in view and in reach."""
    seen = False
    for turn_deg, u, v in _wishes(request, index):
        at = _clipped_to_view(setup, board, picture_px, request.margin_mm, turn_deg, (u, v))
        if at is None:
            continue
        seen = True
        pose = pose_seeing(setup, board_middle(board), at, turn_deg)
        if reach(pose):
            return pose
    why = "the robot cannot go there" if seen else "the board does not fit into the picture"
    raise PlanImpossible(
        "reach" if seen else "view",
        f"pose {index + 1} of {request.count}: {why} at any rotation between {request.start_deg:g} and "
        f"{request.start_deg + _turn_part(request, index) * request.rotation_deg:g} deg with {request.margin_mm:g} mm "
        "margin: " + ("move the board or choose another start rotation" if seen else "use a smaller board or margin"),
    )


def _wishes(request: PlanRequest, index: int) -> Iterator[tuple[float, float, float]]:
    """Rotation in deg and place in mm along u and v: first as wanted, then ever smaller."""
    direction = math.radians(GOLDEN_DEG * index)
    radius = request.travel_mm * (1.0 if index % 3 else 0.5)
    for part in (1.0, 0.8, 0.6, 0.4, 0.2, 0.0):
        turn_deg = request.start_deg + part * _turn_part(request, index) * request.rotation_deg
        for nearer in (1.0, 0.5, 0.0):
            yield turn_deg, nearer * radius * math.cos(direction), nearer * radius * math.sin(direction)


def _turn_part(request: PlanRequest, index: int) -> float:
    """From -1 to 1 over all poses, denser at the ends."""
    return -math.cos(math.pi * index / max(1, request.count - 1))


def _clipped_to_view(
    setup: Setup,
    board: DotBoard,
    picture_px: tuple[int, int],
    margin_mm: float,
    turn_deg: float,
    wish_mm: tuple[float, float],
) -> Px | None:
    """Where the board's middle may appear, nearest to the wish, so that all of it is seen; None if it is too large."""
    around = board_px(setup, Pose(0.0, 0.0, turn_deg), np.vstack([board.outline_mm, board.centre_mm]))
    extent = around[:-1] - around[-1]
    margin = margin_mm / setup.plane_map.mm_per_px + LENS_ALLOWANCE_PX
    low, high = margin - extent.min(0), np.array(picture_px) - 1 - margin - extent.max(0)
    if np.any(low > high):
        return None
    wish = picture_centre_px(picture_px) + np.array(wish_mm) / setup.plane_map.mm_per_px
    u, v = np.clip(wish, low, high).tolist()
    return Px(u, v)


def _short_path(poses: list[Pose]) -> list[Pose]:
    """The same poses in an order of short travel: sorted by rotation, then improved by reversing stretches."""
    path = sorted(poses, key=lambda pose: (pose.t_deg, pose.x_mm, pose.y_mm))
    better = True
    while better:
        better = False
        for i in range(len(path) - 1):
            for j in range(i + 1, len(path)):
                turned = path[:i] + path[i : j + 1][::-1] + path[j + 1 :]
                if _length(turned) < _length(path) - 1e-9:
                    path, better = turned, True
    return path


def _length(path: list[Pose]) -> float:
    return sum(
        math.hypot(b.x_mm - a.x_mm, b.y_mm - a.y_mm) + MM_PER_DEG * abs(b.t_deg - a.t_deg)
        for a, b in itertools.pairwise(path)
    )
