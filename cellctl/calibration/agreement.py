"""Do the pictures and the robot's poses fit one camera? If not: whose fault is it?"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple, NoReturn

import numpy as np

from cellctl.calibration.errors import PosesDisagree
from cellctl.calibration.linear import Linear, grid_fits
from cellctl.calibration.plane_map import SCALE_RANGE_PX_PER_MM, Lens
from cellctl.calibration.problem import (
    WORST_SD,
    Fit,
    Problem,
    fit_problem,
    pose_fits,
    poses_out,
    prediction_error_mm,
    without_bad_dots,
)
from cellctl.calibration.scara import FloatArray, Kind

MOST_OUTLIERS = 0.25  # more poses out than this part: not outliers, something common is wrong
MOST_LEFT_OUT = 0.1  # up to this part of the poses is left out, named in the result, and the rest used
MOST_SCALE_ERROR: dict[Lens, float] = {"telecentric": 0.02, "pinhole": 0.1}  # board pitch against robot travel
MOST_BENT_PX: dict[Lens, float] = {"telecentric": 1.5, "pinhole": 30.0}  # what a lens may bend the board, rms
SUSPECTS = 4  # poses tried as the outlier: the worst one may be a good pose that a bad one has pulled away


class LeftOut(NamedTuple):
    """A pose that was not used, by its number in the order of taking, and what is odd about it."""

    number: int
    why: str


def check_dots(problem: Problem) -> None:
    """Raise PosesDisagree when too many pictures show no flat, even board at all, whatever the poses."""
    fits = grid_fits(problem.shots.dots_px, problem.board_mm)
    even = problem.board_mm @ fits[:, :, :2].transpose(0, 2, 1) + fits[:, None, :, 2]
    rms_px = np.sqrt(((problem.shots.dots_px - even) ** 2).mean((1, 2)))
    scales = np.linalg.svd(fits[:, :, :2], compute_uv=False)
    odd = (scales.min(1) < SCALE_RANGE_PX_PER_MM[0]) | (scales.max(1) > SCALE_RANGE_PX_PER_MM[1])
    bent_px = max(WORST_SD * problem.noise.dot_sd_px, MOST_BENT_PX[problem.lens])
    bad = np.flatnonzero(odd | (rms_px > bent_px)).tolist()
    if len(bad) > MOST_OUTLIERS * len(rms_px):
        raise PosesDisagree(
            "dots",
            f"the dots of {len(bad)} of {len(rms_px)} pictures are not those of the board (worst {rms_px.max():.1f} px "
            f"rms off an even grid, {scales.min():.3g} to {scales.max():.3g} px/mm): check which board is described",
            poses=tuple(bad),
        )


def agreeing(problem: Problem) -> tuple[Fit, tuple[LeftOut, ...]]:
    """The fit of all poses that agree, and the few that do not.

    Raises PosesDisagree, naming the most likely cause, when no camera explains nine in ten of them.
    """
    fit = without_bad_dots(fit_problem(problem))
    if _agrees(fit):
        return fit, ()
    _blame_convention(problem)
    rest, left_out = _without_outliers(fit)
    if _agrees(rest):
        if len(left_out) > MOST_LEFT_OUT * len(problem.numbers):
            _blame_poses(left_out, len(rest.problem.numbers))
        return rest, tuple(left_out)
    _blame_everything(fit)


def _agrees(fit: Fit) -> bool:
    return _right_scale(fit.linear, fit.problem.lens) and not poses_out(fit)


def _right_scale(linear: Linear, lens: Lens) -> bool:
    return abs(linear.scale - 1) <= MOST_SCALE_ERROR[lens]


def _blame_convention(problem: Problem) -> None:
    """Raise when one of the usual mistakes, undone, makes all poses fit."""
    for sentence, other in _other_conventions(problem):
        if _right_scale(other.linear, other.lens) and _agrees(fit_problem(other)):
            count = len(problem.numbers)
            raise PosesDisagree("convention", f"{sentence}: with that changed all {count} pictures agree")


def _other_conventions(problem: Problem) -> Iterator[tuple[str, Problem]]:
    poses = problem.shots.poses
    other: Kind = "eye_to_hand" if problem.kind == "eye_in_hand" else "eye_in_hand"
    yield "the sign of the robot's R is wrong", problem.with_poses(poses * (1, 1, -1))
    yield (
        "the sign of the robot's X or Y is wrong, or X and Y are swapped",
        problem.with_poses(poses * (1, -1, 1)),
    )
    yield "the board is read mirrored", problem.with_poses(poses * (1, -1, -1))
    yield f"the camera is described as {problem.kind} but is {other}", problem._replace(kind=other)


def _without_outliers(fit: Fit) -> tuple[Fit, list[LeftOut]]:
    """Take poses away, the one without which the rest agrees best first, until the rest agrees or too few are left."""
    left_out: list[LeftOut] = []
    most = int(MOST_OUTLIERS * len(fit.problem.numbers))
    while poses_out(fit) and len(left_out) < most:
        every = range(len(fit.problem.numbers))
        without = {
            i: without_bad_dots(fit_problem(fit.problem.only([j for j in every if j != i])))
            for i in poses_out(fit)[:SUSPECTS]
        }
        worst = min(without, key=lambda i: without[i].cost)
        left_out.append(LeftOut(fit.problem.numbers[worst], _how_seen(fit, without[worst], worst)))
        fit = without[worst]
    return fit, sorted(left_out)


def _how_seen(fit: Fit, rest: Fit, index: int) -> str:
    """What is odd about one pose: its dots, or where they are all together."""
    rms_px = pose_fits(fit)[index].rms_px
    if rms_px > WORST_SD * fit.problem.noise.dot_sd_px:
        return f"the dots fit the board to {rms_px:.2f} px rms only"
    away_mm = prediction_error_mm(rest, fit.problem.only([index]))[0]
    return f"the board is seen {_length_um(away_mm):.0f} um from its place"


def _length_um(away_mm: FloatArray) -> float:
    return float(np.hypot(*away_mm)) * 1000


def _blame_poses(left_out: list[LeftOut], rest: int) -> NoReturn:
    names = ", ".join(str(one.number) for one in left_out)
    raise PosesDisagree(
        "outlier",
        f"pose{'s' * (len(left_out) > 1)} {names} against the other {rest}: {left_out[0].why}; take the "
        "pictures again, and if it stays look for play, a collision, or dirt on the board",
        poses=tuple(one.number - 1 for one in left_out),
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
    if not bad:
        raise PosesDisagree("scale", f"board and robot differ in scale by {fit.linear.scale:.3f}: check the board")
    worst = pose_fits(fit)[bad[0]]
    raise PosesDisagree(
        "residual",
        f"{len(bad)} of {len(fit.problem.numbers)} poses do not fit one camera; the worst is pose {worst.number} (dots "
        f"{worst.rms_px:.2f} px rms, robot {math.hypot(worst.dx_um, worst.dy_um):.0f} um and {worst.dt_mdeg:.0f} mdeg "
        "off): check that board and camera are fixed firmly and that the robot repeats as stated",
        poses=tuple(fit.problem.numbers[i] - 1 for i in bad),
    )
