"""Which of many points form a square lattice, and their whole-number places in it. Any rotation, mirror and view.

The lattice is followed from point to point, with the steps that it has just there: in a picture taken askew they
change in length and direction from one side of the board to the other. Good for tilts up to some 50 degrees.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Place = tuple[int, int]

CATCH = 0.25  # a point this close (in steps) to its expected place belongs to the lattice
ACROSS = 0.5  # sine of the least angle between two steps
LEAST_STEP_PX = 1e-6
NEIGHBOURS = 8
WAYS: tuple[tuple[int, int], ...] = ((0, 1), (0, -1), (1, 1), (1, -1))  # which step, and its sign


class Lattice(NamedTuple):
    """The largest connected lattice: members (n,) into the points, their places (n, 2) from 0, two steps (2, 2) px."""

    members: IntArray
    places: IntArray
    steps_px: FloatArray

    @property
    def size(self) -> tuple[int, int]:
        """How many places there are along either step."""
        along, across = (self.places.max(0) + 1).tolist()
        return int(along), int(across)


def find_lattice(points_px: FloatArray) -> Lattice | None:
    """The largest lattice among points (n, 2), None when there is none. The steps are the mean ones."""
    left = set(range(len(points_px)))
    best: dict[int, Place] = {}
    while len(left) > len(best):  # those left over could still be more
        seed = min(left)
        steps = _steps_at(points_px, seed)
        group = _grow(points_px, seed, steps) if steps is not None else {seed: (0, 0)}
        left -= group.keys()
        best = max(best, group, key=len)
    return _lattice(points_px, best)


def _lattice(points: FloatArray, group: dict[int, Place]) -> Lattice | None:
    members = np.array(list(group), dtype=np.int64)
    places = np.array(list(group.values()), dtype=np.int64).reshape(-1, 2)
    if len(members) < 4 or np.linalg.matrix_rank(places - places[0]) < 2:
        return None
    design = np.column_stack([places, np.ones(len(places))])
    steps = np.linalg.lstsq(design, points[members], rcond=None)[0][:2]
    return Lattice(members, places - places.min(0), np.asarray(steps, np.float64))


def _steps_at(points: FloatArray, seed: int) -> FloatArray | None:
    """The two shortest steps (2, 2) from a point to others that do not lie in one direction."""
    ways = points - points[seed]
    length = np.hypot(*ways.T)
    length[length < LEAST_STEP_PX] = math.inf
    nearest = [index for index in np.argsort(length)[:NEIGHBOURS].tolist() if math.isfinite(length[index])]
    if not nearest:
        return None
    first = ways[nearest[0]]
    for index in nearest[1:]:
        cross = float(first[0] * ways[index][1] - first[1] * ways[index][0])
        if abs(cross) > ACROSS * length[nearest[0]] * length[index]:
            return np.array([first, ways[index]])
    return None


def _grow(points: FloatArray, seed: int, steps: FloatArray) -> dict[int, Place]:
    """All points reached from the seed step by step, with their places; no place is given twice."""
    places, local, taken = {seed: (0, 0)}, {seed: steps}, {(0, 0)}
    queue = deque([seed])
    while queue:
        index = queue.popleft()
        for axis, sign in WAYS:
            column, row = places[index]
            place = (column + sign, row) if axis == 0 else (column, row + sign)
            other = _point_near(points, points[index] + sign * local[index][axis], local[index][axis])
            if other is None or other in places or place in taken:
                continue
            local[other] = local[index].copy()
            local[other][axis] = (local[index][axis] + sign * (points[other] - points[index])) / 2
            places[other] = place
            taken.add(place)
            queue.append(other)
    return places


def _point_near(points: FloatArray, place: FloatArray, step: FloatArray) -> int | None:
    """The point next to an expected place, None when it is too far away."""
    away = (points[:, 0] - place[0]) ** 2 + (points[:, 1] - place[1]) ** 2
    nearest = int(away.argmin())
    return nearest if away[nearest] < CATCH**2 * (step[0] ** 2 + step[1] ** 2) else None
