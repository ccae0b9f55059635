"""The hand-eye problem in all six degrees of freedom: solve, leave out what is wrong, judge, refuse."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.errors import PosesDisagree
from cellctl.calibration.six_dof.adjust import MOTIONS, Known, Sightings, Sigmas, refined
from cellctl.calibration.six_dof.closed_form import Solution, closed_form, mean_target
from cellctl.calibration.six_dof.freedom import LEAST_POSES, Turns, check_freedom
from cellctl.calibration.six_dof.noise import robust_sigmas, screws_disagree, sigmas, swing_together, wrong
from cellctl.calibration.six_dof.pairs import Kind, Pairs
from cellctl.calibration.six_dof.rigid import FloatArray, inverse, rigid, rotation_from_vector

MOST_LEFT_OUT = 0.25  # more wrong sightings than this part: not outliers, something common is wrong
MOST_ROUNDS = 12
FOLDS = 5
START_ANGLES = 12  # about a single axis of rotation, on which the closed form has no opinion
FIRST_SIGMAS = Sigmas(1.0, 1.0, 0.5, 0.5)
CONGRUENT_DEG = 2.0  # noise of a sighting that could still be one; with more nothing agrees
EITHER = {"eye_in_hand": "eye_to_hand", "eye_to_hand": "eye_in_hand"}


class Errors(NamedTuple):
    """Root mean squares over sightings: where the target is seen against where it was expected."""

    place_mm: float
    turn_deg: float


@dataclass(frozen=True, eq=False)
class RobotCamera:
    """Where a camera is, and how well that is known.

    `camera` is tool_from_camera (eye_in_hand) or robot_from_camera (eye_to_hand), `target` is robot_from_target or
    tool_from_target. `covariance` (6, 6), mm and rad: of the camera's place and turn along the axes of its carrier.
    """

    kind: Kind
    camera: FloatArray
    target: FloatArray
    covariance: FloatArray
    sigmas: Sigmas  # noise found
    residual: Errors
    hold_out: Errors
    pairs: Pairs  # those that were used
    left_out: tuple[str, ...]
    turns: Turns
    late_s: float | None  # what is left of the robot's delay, and its sigma
    late_sd_s: float | None
    known: Known | None = None


class _Fit(NamedTuple):
    adjustment: Sightings
    x: FloatArray
    used: NDArray[np.bool_]  # of the poses that were given


def solve(pairs: Pairs, along_axis_mm: float | None = None) -> RobotCamera:
    """Find the camera from robot poses and sightings of a fixed (eye_in_hand) or held (eye_to_hand) target.

    Closed form from what turns alike, Levenberg-Marquardt over X and Z, noise of each kind found from the residuals,
    wrong sightings left out and named. `along_axis_mm` is the camera's place along the axis of rotation where there
    is only one. Raises DegenerateMotion when the motion cannot tell where the camera is, PosesDisagree when no camera
    explains the poses.
    """
    turns = check_freedom(pairs.kind, pairs.robot, along_axis_known=along_axis_mm is not None)
    known = None if along_axis_mm is None else Known(turns.directions[0], along_axis_mm)
    fit = _fit(pairs, known)
    _check_agreement(pairs, fit, known)
    turns = check_freedom(pairs.kind, pairs.robot[fit.used], along_axis_known=known is not None)
    return _result(pairs, fit, turns, known)


def _fit(pairs: Pairs, known: Known | None) -> _Fit:
    """Solve and leave out what is wrong, again and again until that settles."""
    used = ~screws_disagree(pairs)
    if used.sum() < LEAST_POSES:
        used = np.ones(len(pairs), np.bool_)
    near, noise = _start(pairs.only(np.flatnonzero(used)), known)
    for _ in range(MOST_ROUNDS):
        adjustment, x = refined(pairs.only(np.flatnonzero(used)), near, noise, known)
        near = adjustment.near
        off = replace(adjustment, pairs=pairs).residuals(x)
        before, used = used, ~wrong(off, robust_sigmas(off))
        if used.sum() < LEAST_POSES:
            return _Fit(adjustment, x, before & False)
        noise = sigmas(off[used], len(x))
        if np.array_equal(before, used):
            break
    adjustment, x = refined(pairs.only(np.flatnonzero(used)), near, noise, known)
    return _Fit(adjustment, x, used)


def _start(pairs: Pairs, known: Known | None) -> tuple[Solution, Sigmas]:
    """The closed form; with a single axis of rotation the best of several turns about it."""
    first = closed_form(pairs)
    if known is None:
        rough = Sightings(pairs, first, FIRST_SIGMAS)
        return first, robust_sigmas(rough.residuals(rough.start))
    tried = [refined(pairs, start, FIRST_SIGMAS, known) for start in _turned(pairs, first, known)]
    best, x = min(tried, key=lambda one: one[0].cost(one[1]))
    return best.near, robust_sigmas(best.residuals(x))


def _turned(pairs: Pairs, first: Solution, known: Known) -> Iterator[Solution]:
    for angle in np.arange(START_ANGLES) * (2 * math.pi / START_ANGLES):
        turn = rotation_from_vector(known.direction * angle)
        camera = rigid(turn @ first.camera[:3, :3], first.camera[:3, 3])
        yield Solution(camera, mean_target(pairs, camera))


# -- judging ---------------------------------------------------------------------------------------------------------


def _agrees(pairs: Pairs, fit: _Fit) -> bool:
    noise, out = fit.adjustment.sigmas, 1 - float(fit.used.mean())
    return out <= MOST_LEFT_OUT and max(noise.tilt_deg, noise.roll_deg) <= CONGRUENT_DEG


def _check_agreement(pairs: Pairs, fit: _Fit, known: Known | None) -> None:
    if _agrees(pairs, fit):
        return
    other = replace(pairs, robot=inverse(pairs.robot))
    if _agrees(other, _fit(other, known)):
        raise PosesDisagree(
            "convention",
            f"the poses do not fit a camera that is {_words(pairs.kind)}, but do when the robot's or the target's are "
            f"inverted: check which of robot_from_tool and tool_from_robot, camera_from_target and target_from_camera "
            f"the columns are, or whether the camera is {_words(EITHER[pairs.kind])}",
        )
    noise, bad = fit.adjustment.sigmas, int((~fit.used).sum())
    worst_deg = max(noise.tilt_deg, noise.roll_deg)
    raise PosesDisagree(
        "residual",
        f"no camera explains the poses: {bad} of {len(pairs)} are wrong and the others disagree by {worst_deg:.2g} deg "
        f"and {max(noise.lateral_mm, noise.depth_mm):.2g} mm (one sigma): check that robot and camera poses of a row "
        "belong to the same moment, their units, and that target and camera are fixed firmly",
        poses=tuple(np.flatnonzero(~fit.used).tolist()),
    )


def _words(kind: str) -> str:
    return kind.replace("_", " ")


# -- the result ------------------------------------------------------------------------------------------------------


def _result(pairs: Pairs, fit: _Fit, turns: Turns, known: Known | None) -> RobotCamera:
    adjustment, x = fit.adjustment, fit.x
    off = adjustment.residuals(x)
    whole = adjustment.normal(x).covariance()
    if pairs.swing is not None:
        whole = whole * swing_together(off)
    late = None if pairs.swing is None else (float(x[MOTIONS]), math.sqrt(float(whole[MOTIONS, MOTIONS])))
    return RobotCamera(
        kind=pairs.kind,
        camera=adjustment.near.camera,
        target=adjustment.near.target,
        covariance=_along_the_carrier(adjustment.near.camera, whole[:6, :6]),
        sigmas=adjustment.sigmas,
        residual=root_mean_squares(off),
        hold_out=_hold_out(adjustment),
        pairs=adjustment.pairs,
        left_out=tuple(pairs.names[i] for i in np.flatnonzero(~fit.used).tolist()),
        turns=turns,
        late_s=late[0] if late else None,
        late_sd_s=late[1] if late else None,
        known=known,
    )


def _along_the_carrier(camera: FloatArray, inner: FloatArray) -> FloatArray:
    """A covariance along the camera's own axes, turned to those of what carries it."""
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = camera[:3, :3]
    return np.asarray(both @ inner @ both.T, np.float64)


def _hold_out(adjustment: Sightings) -> Errors:
    """Leave every fifth sighting out in turn and expect it from the others."""
    every, off = np.arange(len(adjustment.pairs)), []
    for fold in range(FOLDS):
        out = every % FOLDS == fold
        if out.all() or not out.any():
            continue
        rest, x = refined(adjustment.pairs.only(every[~out]), adjustment.near, adjustment.sigmas, adjustment.known)
        off.append(replace(rest, pairs=adjustment.pairs.only(every[out])).residuals(x))
    return root_mean_squares(np.concatenate(off))


def root_mean_squares(residuals: FloatArray) -> Errors:
    """Of sightings' residuals (n, 6), mm and rad."""
    place, turn = ((residuals[:, part] ** 2).sum(1).mean() for part in (slice(0, 3), slice(3, 6)))
    return Errors(math.sqrt(float(place)), math.degrees(math.sqrt(float(turn))))
