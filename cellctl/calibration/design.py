"""Which of many possible poses tell most: optimum design of experiments for the hand-eye problem.

Every pose carries information about the shared parameters, whatever is seen there; informations add up. Chosen is the
set whose sum makes the expected error at the work smallest (A-optimal; Fedorov's exchange).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.accuracy import MARK_MM, TAUGHT_DEG, TAUGHT_MM, from_pivot, jacobian_at_mm
from cellctl.calibration.bundle import Bundle
from cellctl.calibration.parameters import BELIEVED, SHARED
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import FloatArray, rotation

ABSOLUTE_UM, DIFFERENTIAL_UM = 10.0, 1.0  # what is wanted, and so what the two kinds of error are measured in
OFF_CENTRE = 0.3  # places that count beside the picture's middle, parts of its size
LITTLE = 1e-9  # of the largest information: keeps sums of few poses solvable
WORTH = 1e-3  # part by which an exchange must lower the error


class Choice(NamedTuple):
    """How many poses are wanted, and how many at most of one group; `groups` (n,) are numbered from 0."""

    wanted: int
    groups: NDArray[np.intp]
    most_of_one: int

    def full(self, chosen: list[int]) -> NDArray[np.bool_]:
        """Which poses cannot be added any more, (n,)."""
        taken = np.bincount(self.groups[chosen], minlength=int(self.groups.max()) + 1)
        full = taken[self.groups] >= self.most_of_one
        full[chosen] = True
        return np.asarray(full, np.bool_)


def best_poses(bundle: Bundle, x: FloatArray, wanted: FloatArray, choice: Choice) -> list[int]:
    """Indices of the poses of a bundle that together make trace(wanted C) least; see `wanted_errors`."""
    each, prior, moved = informations(bundle, x), np.zeros((SHARED, SHARED)), from_pivot(bundle, x)
    prior[BELIEVED, BELIEVED] = np.diag(1 / bundle.believed_sd**2)
    size = np.sqrt(np.diag(each.sum(0) + prior))
    each, prior, wanted = (part / np.outer(size, size) for part in (each, prior, moved.T @ wanted @ moved))
    chosen: list[int] = []
    total = prior + np.eye(SHARED) * LITTLE
    while len(chosen) < choice.wanted and not choice.full(chosen).all():
        best = _best(each, total, wanted, choice.full(chosen))[0]
        chosen.append(best)
        total = total + each[best]
    return _exchanged(each, wanted, total, choice, chosen)


def informations(bundle: Bundle, x: FloatArray) -> FloatArray:
    """What each picture tells of PARAMETERS, the robot's error at it eliminated, (n, 21, 21)."""
    count, weight = len(bundle.shots.poses), bundle.shots.used[..., None] / bundle.dot_sd_px
    by_shared, by_pose = ((part * weight).reshape(count, -1, part.shape[-1]) for part in bundle.jacobian(x))
    turned = by_shared.transpose(0, 2, 1)
    own = np.linalg.inv(by_pose.transpose(0, 2, 1) @ by_pose + np.eye(3))
    mixed = turned @ by_pose
    return np.asarray(turned @ by_shared - mixed @ own @ mixed.transpose(0, 2, 1), np.float64)


def wanted_errors(camera: PlaneMap, picture_px: tuple[int, int]) -> FloatArray:
    """W (21, 21) of PARAMETERS: trace(W C) is the expected error squared, over the picture and of differences."""
    size, middle = np.array(picture_px, float), (np.array(picture_px, float) - 1) / 2
    signs = np.array([(0, 0), (-1, -1), (1, -1), (-1, 1), (1, 1)])
    places_mm = camera.mm_from_px(middle + OFF_CENTRE * signs * size)
    total = np.zeros((SHARED, SHARED))
    for place in places_mm:
        there = jacobian_at_mm(camera, place) * 1000 / ABSOLUTE_UM
        total += there.T @ there / len(places_mm)
    return total + _differences(camera, places_mm[0] + MARK_MM)


def _differences(camera: PlaneMap, taught_mm: FloatArray) -> FloatArray:
    taught, total = jacobian_at_mm(camera, taught_mm), np.zeros((SHARED, SHARED))
    moves = ((1.0, 0.0, 1.0), (-1.0, 0.0, -1.0), (0.0, 1.0, -1.0), (0.0, -1.0, 1.0))
    for x, y, turn in moves:
        moved = jacobian_at_mm(camera, taught_mm + np.array([x, y]) * TAUGHT_MM)
        lever = rotation(np.radians(turn * TAUGHT_DEG)) - np.eye(2)
        change = (moved - taught + lever @ moved) * 1000 / DIFFERENTIAL_UM
        total += change.T @ change / len(moves)
    return total


def _best(each: FloatArray, total: FloatArray, wanted: FloatArray, full: NDArray[np.bool_]) -> tuple[int, float]:
    """The pose whose information, added to the total, leaves the least error; and that error squared."""
    left = np.einsum("ij,nji->n", wanted, np.linalg.inv(total + each))
    left[full] = np.inf
    best = int(left.argmin())
    return best, float(left[best])


def _exchanged(each: FloatArray, wanted: FloatArray, total: FloatArray, choice: Choice, chosen: list[int]) -> list[int]:
    """Exchange one pose for a better one as long as that helps."""
    error, idle, place = float(np.trace(wanted @ np.linalg.inv(total))), 0, 0
    while idle < len(chosen):
        others = chosen[:place] + chosen[place + 1 :]
        without = total - each[chosen[place]]
        best, left = _best(each, without, wanted, choice.full(others))
        idle += 1
        if left < error * (1 - WORTH):
            total, error, chosen[place], idle = without + each[best], left, best, 0
        place = (place + 1) % len(chosen)
    return sorted(chosen)
