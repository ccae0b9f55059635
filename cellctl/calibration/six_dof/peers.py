"""OpenCV's five hand-eye methods on the same poses, judged as we judge ourselves: at poses left out of the fit."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from cellctl.calibration.six_dof.adjust import Known, Sightings, Sigmas, refined
from cellctl.calibration.six_dof.closed_form import Solution, closed_form, mean_target
from cellctl.calibration.six_dof.pairs import Pairs
from cellctl.calibration.six_dof.rigid import FloatArray, inverse, rigid
from cellctl.calibration.six_dof.solve import FOLDS, Errors, root_mean_squares

METHODS = {
    "Tsai": cv2.CALIB_HAND_EYE_TSAI,
    "Park": cv2.CALIB_HAND_EYE_PARK,
    "Horaud": cv2.CALIB_HAND_EYE_HORAUD,
    "Andreff": cv2.CALIB_HAND_EYE_ANDREFF,
    "Daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS,
}
OURS = "cellctl"
MOST_POSES = 100  # OpenCV pairs every pose with every other one


class Judged(NamedTuple):
    """One method: its errors at poses left out, or why there are none."""

    name: str
    hold_out: Errors | None
    why_not: str = ""


def opencv_camera(name: str, pairs: Pairs) -> FloatArray:
    """X (4, 4) by one of OpenCV's methods. Raises ValueError when it gives none."""
    gripper = pairs.robot if pairs.kind == "eye_in_hand" else inverse(pairs.robot)
    turns, places = list(gripper[:, :3, :3]), list(gripper[:, :3, 3])
    seen_turns, seen_places = list(pairs.target[:, :3, :3]), list(pairs.target[:, :3, 3])
    try:
        turn, place = cv2.calibrateHandEye(turns, places, seen_turns, seen_places, method=METHODS[name])
    except cv2.error as error:
        raise ValueError(str(error.err or error)) from None
    camera = rigid(np.asarray(turn, np.float64), np.asarray(place, np.float64)[:, 0])
    if not np.isfinite(camera).all():
        raise ValueError("gave no numbers")
    return camera


def compare(pairs: Pairs, sigmas: Sigmas, known: Known | None = None) -> list[Judged]:
    """Ours and OpenCV's five, each fitted to four fifths of (at most 100 of) the poses and judged at the last fifth."""
    even = np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), MOST_POSES)).astype(int))
    chosen = Pairs(pairs.kind, pairs.robot[even], pairs.target[even], tuple(pairs.names[i] for i in even.tolist()))
    return [_judged(name, chosen, sigmas, known) for name in (OURS, *METHODS)]


def _judged(name: str, pairs: Pairs, sigmas: Sigmas, known: Known | None) -> Judged:
    every, off = np.arange(len(pairs)), []
    for fold in range(FOLDS):
        rest, out = (pairs.only(np.flatnonzero(part)) for part in (every % FOLDS != fold, every % FOLDS == fold))
        try:
            solution = _solved(name, rest, sigmas, known)
        except (ValueError, np.linalg.LinAlgError) as error:
            return Judged(name, None, str(error))
        there = Sightings(out, solution, sigmas)
        off.append(there.residuals(there.start))
    return Judged(name, root_mean_squares(np.concatenate(off)))


def _solved(name: str, pairs: Pairs, sigmas: Sigmas, known: Known | None) -> Solution:
    if name == OURS:
        return refined(pairs, closed_form(pairs), sigmas, known)[0].near
    camera = opencv_camera(name, pairs)
    return Solution(camera, mean_target(pairs, camera))
