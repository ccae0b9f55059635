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
from cellctl.calibration.bundle import Bundle, Shots
from cellctl.calibration.design import Choice, best_poses, wanted_errors
from cellctl.calibration.errors import DegenerateMotion, PlanImpossible
from cellctl.calibration.motion import Spread, check_motion
from cellctl.calibration.parameters import prior_sd
from cellctl.calibration.plane_map import Lens
from cellctl.calibration.scara import FloatArray, Noise, Setup, pose_array
from cellctl.calibration.view import (
    LENS_ALLOWANCE_PX,
    board_in_view,
    board_middle,
    board_px,
    picture_centre_px,
    pose_seeing,
)
from cellctl.geometry import Mm, Pose, Px
from cellctl.keep_out import Area, touched_at, touched_on_the_way
from cellctl.mount import Elbow, Mount, OutOfReach, Stop

TURNS = 13  # rotations that are considered, over the whole range
MOST_AT_ONE_TURN = 0.2  # part of the poses: whatever one rotation of the tool has for errors of its own is averaged
MM_PER_DEG = 0.5  # what turning by a degree costs against travelling a mm, for the order of the poses
ELBOW_MM = 1000.0  # and what swinging the elbow over costs


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """What the poses should be like. `margin_mm` is how badly the camera's place is known."""

    count: int = 15
    rotation_deg: float = 25.0  # to either side of `start_deg`
    start_deg: float = 0.0
    travel_mm: float = 5.0  # to either side, in the picture's directions, as far as the board stays in view
    margin_mm: float = 1.0


@dataclass(frozen=True, eq=False)
class Task:
    """What is to be calibrated: the camera as it is believed to stand, the board, and the arm that moves.

    `reaches` says whether the robot may stop somewhere. The mount is that of the camera (eye_in_hand), or the tool
    which holds the board (eye_to_hand).
    """

    setup: Setup
    board: DotBoard
    picture_px: tuple[int, int]
    mount: Mount
    reaches: Callable[[Stop], bool]
    areas: Sequence[Area] = ()  # that arms and tool keep out of
    lens: Lens = "telecentric"

    def possible(self, stop: Stop) -> bool:
        """Whether the robot may stop there."""
        return self.reaches(stop) and not touched_at(self.mount, stop, self.areas)

    def frame(self, stop: Stop) -> Pose:
        """The pose that the calibration is about: robot_from_mount."""
        return self.mount.frame(stop.tool, stop.elbow)

    def stop_seeing(self, point: Mm, at: Px, turn_deg: float, elbow: Elbow | None = None) -> Stop:
        """The stop, with this R, at which a point of the board appears at a place in the picture. OutOfReach."""
        elbow = elbow or self.mount.elbow
        if self.setup.kind == "eye_to_hand":
            return Stop(pose_seeing(self.setup, point, at, turn_deg), elbow)
        axis, over = self.setup.plane_map.mm_at(at), self.setup.board.point(*point)
        return Stop(self.mount.tool_showing(over, axis, turn_deg, elbow), elbow)


class Plan(NamedTuple):
    """Stops of the robot in the order to visit them, the mount's poses there, and what they will give."""

    stops: tuple[Stop, ...]
    poses: tuple[Pose, ...]  # robot_from_mount
    spread: Spread
    predicted: Predicted

    @property
    def text(self) -> str:
        """What they will give, for people."""
        return (
            f"{self.predicted.absolute_um:.1f} um absolute and {self.predicted.differential_um:.2f} um for differences "
            f"expected (one sigma), rotation over {self.spread.rotation_deg:.0f} deg"
        )


def plan_hand_eye(task: Task, request: PlanRequest | None = None, noise: Noise | None = None) -> Plan:
    """The stops that tell most of those that keep the whole board in view, with a margin, and in reach; deterministic.

    A camera on the second arm turns only when the elbow changes sides, so both sides are used. Raises PlanImpossible
    when too few stops are possible, or when they cannot tell the unknowns apart, saying what cannot be seen.
    """
    request, noise = request or PlanRequest(), noise or Noise()
    possible = _possible_stops(task, request)
    chosen = [possible[i] for i in _best(task, possible, request.count, noise)]
    stops = _short_path(chosen, task.mount.elbow)
    _check_way(task, stops)
    poses = [task.frame(stop) for stop in stops]
    try:
        spread = check_motion(poses)
    except DegenerateMotion as error:
        raise PlanImpossible(error.check, f"within view and reach {error.detail}") from error
    return Plan(tuple(stops), tuple(poses), spread, predict_plan(task, stops, noise))


def predict_plan(task: Task, stops: Sequence[Stop], noise: Noise | None = None) -> Predicted:
    """The accuracy that pictures at these stops will give, from the Jacobian alone: before anything moves."""
    bundle, x = _expected(task, stops, noise or Noise())
    parameters = covariance(bundle, x, bundle.normal(x))
    u, v = picture_centre_px(task.picture_px).tolist()
    return predict(task.setup.plane_map, parameters, Px(u, v))


def plan_tool_centre(
    task: Task, rotations_deg: Sequence[float] = (-60.0, -45.0, -30.0, -15.0, 0.0, 15.0, 30.0, 45.0, 60.0)
) -> tuple[Pose, ...]:
    """Pure rotations of a held board (eye_to_hand) at the one place that keeps it best in view.

    Raises PlanImpossible when fewer than three of the rotations are in view and in reach.
    """
    setup, board = task.setup, task.board
    u, v = picture_centre_px(task.picture_px).tolist()
    seen = [pose_seeing(setup, board_middle(board), Px(u, v), turn) for turn in rotations_deg]
    x_mm, y_mm = (np.max([pose[:2] for pose in seen], 0) + np.min([pose[:2] for pose in seen], 0)) / 2
    poses = [Pose(float(x_mm), float(y_mm), turn) for turn in rotations_deg]
    good = tuple(
        pose
        for pose in poses
        if board_in_view(setup, pose, board, task.picture_px) and task.possible(Stop(pose, task.mount.elbow))
    )
    if len(good) < 3:
        raise PlanImpossible(
            "tool centre",
            f"{len(good)} of {len(poses)} rotations keep the board in view and in reach, three are needed: hold "
            "the board nearer to its middle",
        )
    return good


# -- what is possible ------------------------------------------------------------------------------------------------


def _possible_stops(task: Task, request: PlanRequest) -> list[Stop]:
    """Every stop that is considered, in view and in reach. Raises PlanImpossible when there are too few."""
    seen, reached = 0, []
    for elbow, turn_deg in _turns(task, request):
        for at in _places(task, request, turn_deg, elbow):
            seen += 1
            stop = _stop(task, at, turn_deg, elbow)
            if stop is not None and task.possible(stop):
                reached.append(stop)
    if len(reached) < request.count:
        _refuse(task, request, seen, len(reached))
    return reached


def _turns(task: Task, request: PlanRequest) -> Iterator[tuple[Elbow, float]]:
    """Elbow and R. R does not turn a camera on the second arm, the elbow's side does."""
    if task.mount.part == "arm_2":
        yield "righty", request.start_deg
        yield "lefty", request.start_deg
        return
    for turn_deg in np.linspace(-request.rotation_deg, request.rotation_deg, TURNS).tolist():
        yield task.mount.elbow, request.start_deg + turn_deg


def _places(task: Task, request: PlanRequest, turn_deg: float, elbow: Elbow) -> Iterator[Px]:
    """Where the board's middle may appear so that all of it is seen: an even grid; none if the board is too large."""
    middle, board = picture_centre_px(task.picture_px), task.board
    centred = _stop(task, Px(*middle.tolist()), turn_deg, elbow)
    if centred is None:
        return
    around = board_px(task.setup, task.frame(centred), np.vstack([board.outline_mm, board.centre_mm]))
    extent = around[:-1] - around[-1]
    px_per_mm = 1 / task.setup.plane_map.mm_per_px
    margin = request.margin_mm * px_per_mm + LENS_ALLOWANCE_PX
    low, high = margin - extent.min(0), np.array(task.picture_px) - 1 - margin - extent.max(0)
    if np.any(low > high):
        return
    travel = request.travel_mm * px_per_mm
    low, high = np.maximum(low, middle - travel), np.minimum(high, middle + travel)
    per_side = 5 if task.mount.part == "arm_2" else 3
    for u, v in itertools.product(*(np.linspace(a, b, per_side).tolist() for a, b in zip(low, high, strict=True))):
        yield Px(u, v)


def _stop(task: Task, at: Px, turn_deg: float, elbow: Elbow) -> Stop | None:
    try:
        return task.stop_seeing(board_middle(task.board), at, turn_deg, elbow)
    except OutOfReach:
        return None


def _refuse(task: Task, request: PlanRequest, seen: int, reached: int) -> None:
    start = f"{request.start_deg:g} +- {request.rotation_deg:g} deg with {request.margin_mm:g} mm margin"
    if seen < request.count:
        raise PlanImpossible(
            "view",
            f"the board does not fit into the picture at enough rotations ({seen} places at {start}, {request.count} "
            "are needed): use a smaller board, or turn it so that both elbows see it along the picture's sides"
            if task.mount.part == "arm_2"
            else f"the board does not fit into the picture at enough rotations ({seen} places at {start}, "
            f"{request.count} are needed): use a smaller board or margin",
        )
    raise PlanImpossible(
        "reach",
        f"the robot cannot go to {seen - reached} of {seen} places at {start} where the board is in view, and "
        f"{request.count} are needed: move the board, turn less, or mind the keep-out areas",
    )


# -- what is best ----------------------------------------------------------------------------------------------------


def _best(task: Task, possible: Sequence[Stop], count: int, noise: Noise) -> list[int]:
    bundle, x = _expected(task, possible, noise)
    most = count if task.mount.part == "arm_2" else math.ceil(MOST_AT_ONE_TURN * count)
    turns = np.unique([stop.tool.t_deg for stop in possible], return_inverse=True)[1]
    choice = Choice(count, np.asarray(turns, np.intp), most)
    return best_poses(bundle, x, wanted_errors(task.setup.plane_map, task.picture_px), choice)


def _expected(task: Task, stops: Sequence[Stop], noise: Noise) -> tuple[Bundle, FloatArray]:
    """The adjustment that pictures at these stops will lead to, and its unknowns."""
    setup, board = task.setup, task.board
    centre = picture_centre_px(task.picture_px)
    pivot = setup.plane_map.mm_from_px(centre[None])[0]
    poses = pose_array([task.frame(stop) for stop in stops])
    shots = Shots(
        poses,
        np.zeros((len(poses), board.count, 2)),
        np.zeros(len(poses)),
        task.mount.scatter(stops, noise.robot_sd_mm, noise.robot_sd_deg),
    )
    believed = prior_sd(task.lens, task.picture_px, 1 / setup.plane_map.mm_per_px)
    bundle = Bundle(setup.kind, shots, board.points_mm, noise.dot_sd_px, pivot, centre, believed)
    return bundle, bundle.unknowns(setup)


# -- in which order --------------------------------------------------------------------------------------------------


def _short_path(stops: list[Stop], last: Elbow) -> list[Stop]:
    """The same stops in an order of short travel: sorted by elbow and rotation, improved by reversing stretches.

    It ends with the elbow on the given side.
    """
    path = sorted(stops, key=lambda stop: (stop.elbow == last, *stop.tool[::-1]))
    better = True
    while better:
        better = False
        for i in range(len(path) - 1):
            for j in range(i + 1, len(path)):
                turned = path[:i] + path[i : j + 1][::-1] + path[j + 1 :]
                if _length(turned) < _length(path) - 1e-9:
                    path, better = turned, True
    return path if path[-1].elbow == last else path[::-1]


def _check_way(task: Task, stops: list[Stop]) -> None:
    for number, (start, end) in enumerate(itertools.pairwise(stops), 1):
        if area := touched_on_the_way(task.mount, start, end, task.areas):
            why = "where the elbow changes sides" if start.elbow != end.elbow else "which lie on both sides of it"
            raise PlanImpossible(
                "keep-out",
                f"between pose {number} and {number + 1}, {why}, the arm would come through {area!r}: move the board, "
                "or what stands there",
            )


def _length(path: list[Stop]) -> float:
    return sum(
        math.hypot(b.tool.x_mm - a.tool.x_mm, b.tool.y_mm - a.tool.y_mm)
        + MM_PER_DEG * abs(b.tool.t_deg - a.tool.t_deg)
        + ELBOW_MM * (a.elbow != b.elbow)
        for a, b in itertools.pairwise(path)
    )
