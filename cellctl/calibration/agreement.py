"""Do the pictures and the robot's poses fit one camera? If not: whose fault is it?"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NoReturn

import numpy as np

from cellctl.calibration.errors import PosesDisagree
from cellctl.calibration.plane_map import SCALE_RANGE_PX_PER_MM
from cellctl.calibration.problem import WORST_SD, Fit, Problem, fit_problem, pose_fits, poses_out, prediction_error_mm
from cellctl.calibration.scara import Kind, Linear, linear_start

MOST_OUTLIERS = 0.25  # more poses out than this part: not outliers, something common is wrong
MOST_SCALE_ERROR = 0.02  # board pitch against robot travel
MOST_BENT_PX = 1.5  # what a lens may bend the board, rms
SUSPECTS = 4  # poses tried as the outlier: the worst one may be a good pose that a bad one has pulled away


def check_dots(problem: Problem) -> None:
    """Raise PosesDisagree when too many pictures show no flat, even board at all, whatever the poses."""
    design = np.column_stack([problem.board_mm, np.ones(len(problem.board_mm))])
    seen = problem.dots_px.transpose(1, 0, 2).reshape(len(design), -1)
    even = np.linalg.lstsq(design, seen, rcond=None)[0]
    rms_px = np.sqrt(((seen - design @ even) ** 2).reshape(len(design), -1, 2).mean((0, 2)))
    scales = np.linalg.svd(even[:2].reshape(2, -1, 2).transpose(1, 0, 2), compute_uv=False)
    odd = (scales.min(1) < SCALE_RANGE_PX_PER_MM[0]) | (scales.max(1) > SCALE_RANGE_PX_PER_MM[1])
    bad = np.flatnonzero(odd | (rms_px > max(WORST_SD * problem.noise.dot_sd_px, MOST_BENT_PX))).tolist()
    if len(bad) > MOST_OUTLIERS * len(rms_px):
        raise PosesDisagree(
            "dots",
            f"the dots of {len(bad)} of {len(rms_px)} pictures are not those of the board (worst {rms_px.max():.1f} px "
            f"rms off an even grid, {scales.min():.3g} to {scales.max():.3g} px/mm): check which board is described",
            poses=tuple(bad),
        )


def check_agreement(fit: Fit) -> None:
    """Raise PosesDisagree unless all poses fit, naming the most likely cause."""
    if _agrees(fit):
        return
    _blame_convention(fit.problem)
    _blame_outliers(fit)
    _blame_everything(fit)


def _agrees(fit: Fit) -> bool:
    return _right_scale(fit.linear) and not poses_out(fit)


def _right_scale(linear: Linear) -> bool:
    return abs(linear.scale - 1) <= MOST_SCALE_ERROR


def _blame_convention(problem: Problem) -> None:
    """Raise when one of the usual mistakes, undone, makes all poses fit."""
    for sentence, other in _other_conventions(problem):
        linear = linear_start(other.kind, other.poses, other.dots_px, other.board_mm)
        if _right_scale(linear) and _agrees(fit_problem(other)):
            raise PosesDisagree("convention", f"{sentence}: with that changed all {len(problem.poses)} pictures agree")


def _other_conventions(problem: Problem) -> Iterator[tuple[str, Problem]]:
    x, y, r = problem.poses.T
    other: Kind = "eye_to_hand" if problem.kind == "eye_in_hand" else "eye_in_hand"
    yield "the sign of the robot's R is wrong", problem._replace(poses=np.column_stack([x, y, -r]))
    yield (
        "the sign of the robot's X or Y is wrong, or X and Y are swapped",
        problem._replace(poses=np.column_stack([x, -y, r])),
    )
    yield "the board is read mirrored", problem._replace(poses=np.column_stack([x, -y, -r]))
    yield f"the camera is described as {problem.kind} but is {other}", problem._replace(kind=other)


def _blame_outliers(fit: Fit) -> None:
    """Raise when the rest agrees once a few poses are taken away."""
    keep = list(range(len(fit.problem.poses)))
    taken: list[int] = []
    for _ in range(int(MOST_OUTLIERS * len(keep))):
        suspects = poses_out(fit)[:SUSPECTS]
        without = {i: fit_problem(fit.problem.only([j for j in range(len(keep)) if j != i])) for i in suspects}
        if not without:
            return
        worst = min(without, key=lambda i: without[i].cost)
        seen = _how_seen(fit, without[worst], worst)
        fit = without[worst]
        taken.append(keep.pop(worst))
        if _agrees(fit):
            _blame_poses(taken, seen, len(keep))


def _how_seen(fit: Fit, rest: Fit, index: int) -> str:
    """What is odd about one pose: its dots, or where they are all together."""
    rms_px = pose_fits(fit)[index].rms_px
    if rms_px > WORST_SD * fit.problem.noise.dot_sd_px:
        return f"the dots fit the board to {rms_px:.2f} px rms only"
    away_mm = prediction_error_mm(rest, fit.problem.only([index]))[0]
    return f"the board is seen {float(np.hypot(*away_mm)) * 1000:.0f} um from its place"


def _blame_poses(taken: list[int], seen: str, rest: int) -> NoReturn:
    taken = sorted(taken)
    names = ", ".join(str(i + 1) for i in taken)
    raise PosesDisagree(
        "outlier",
        f"pose{'s' * (len(taken) > 1)} {names} against the other {rest}: {seen}; take the picture again, and if it "
        "stays look for play, a collision, or dirt on the board",
        poses=tuple(taken),
    )


def _blame_everything(fit: Fit) -> NoReturn:
    """Raise for a board of another size, or for poses that have nothing in common."""
    other_board = fit.problem._replace(board_mm=fit.problem.board_mm / fit.linear.scale)
    if _agrees(fit_problem(other_board)):
        raise PosesDisagree(
            "board scale",
            f"the board's drawn size is {fit.linear.scale:.3f} times what the robot's travel says: check that the "
            "right board is described, and the robot's units",
        )
    bad = poses_out(fit)
    worst = pose_fits(fit)[bad[0]]
    raise PosesDisagree(
        "residual",
        f"{len(bad)} of {len(fit.problem.poses)} poses do not fit one camera; the worst is pose {bad[0] + 1} (dots "
        f"{worst.rms_px:.2f} px rms, robot {math.hypot(worst.dx_um, worst.dy_um):.0f} um and {worst.dt_mdeg:.0f} mdeg "
        "off): check that board and camera are fixed firmly and that the robot repeats as stated",
        poses=tuple(bad),
    )
