"""Which of many points form a square lattice, and their whole-number places in it. Any rotation, scale and mirror."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Place = tuple[int, int]

NEAR = (0.7, 1.3)  # a neighbour's distance in units of the pitch
CATCH = 0.25  # a point this close (in pitches) to its expected place belongs to the lattice
AXIS_DEG = 20.0


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
    """The largest lattice among points (n, 2), None when there is none."""
    steps = _steps(points_px)
    if steps is None:
        return None
    neighbours = _neighbours(points_px, steps)
    left = set(range(len(points_px)))
    best: dict[int, Place] = {}
    while left:
        group = _grow(neighbours, min(left))
        left -= group.keys()
        best = max(best, group, key=len)
    places = np.array(list(best.values()), dtype=np.int64)
    return Lattice(np.array(list(best), dtype=np.int64), places - places.min(0), steps)


def _steps(points: FloatArray) -> FloatArray | None:
    """Two lattice steps, from the directions to near neighbours, which repeat every 90 degrees."""
    if len(points) < 4:
        return None
    ways = points[None] - points[:, None]
    distance = np.hypot(ways[..., 0], ways[..., 1])
    np.fill_diagonal(distance, np.inf)
    pitch = float(np.median(distance.min(1)))
    near = ways[(distance > NEAR[0] * pitch) & (distance < NEAR[1] * pitch)]
    if pitch <= 0 or not len(near):
        return None
    angle = np.arctan2(near[:, 1], near[:, 0])
    axis = float(np.angle(np.exp(4j * angle).sum())) / 4
    steps = []
    for direction in (axis, axis + math.pi / 2):
        off = np.angle(np.exp(1j * (angle - direction)))
        along = near[np.abs(off) < math.radians(AXIS_DEG)]
        if not len(along):
            return None
        steps.append(np.median(along, axis=0))
    return np.array(steps)


def _neighbours(points: FloatArray, steps: FloatArray) -> list[list[tuple[int, Place]]]:
    """For every point those that lie one step away, with that step."""
    ways = (points[None] - points[:, None]) @ np.linalg.pinv(steps)
    whole = np.rint(ways)
    one_step = (np.abs(whole).sum(-1) == 1) & (np.abs(ways - whole).max(-1) < CATCH)
    lists: list[list[tuple[int, Place]]] = [[] for _ in points]
    for start, end in np.argwhere(one_step).tolist():
        column, row = whole[start, end].tolist()
        lists[start].append((end, (int(column), int(row))))
    return lists


def _grow(neighbours: list[list[tuple[int, Place]]], seed: int) -> dict[int, Place]:
    """All points reached from the seed step by step, with their places; no place is given twice."""
    places = {seed: (0, 0)}
    taken = {(0, 0)}
    queue = deque([seed])
    while queue:
        index = queue.popleft()
        for other, (column, row) in neighbours[index]:
            place = (places[index][0] + column, places[index][1] + row)
            if other not in places and place not in taken:
                places[other] = place
                taken.add(place)
                queue.append(other)
    return places
