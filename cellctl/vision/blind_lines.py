"""Straight edges anywhere in a picture, of any direction: for teaching, where nothing is known yet. Pure.

Points of outlines vote for lines (a Hough vote finds, it does not measure); along each of the best the longest
straight and clean stretch is then looked for in the full picture.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Px
from cellctl.vision.edgels import SCALE, Edgels, find_edgels, to_full
from cellctl.vision.features import ExpectedEdge, Floats, Pixels
from cellctl.vision.picture import checked
from cellctl.vision.plane import direction
from cellctl.vision.stretches import SHORTEST_PX, StraightOutline, follow_edge, longest_run

MOST_LINES = 12
SAME_PX = 6.0  # lines closer than this are one
GAP_PX = 64.0  # a line is followed over gaps up to this long
TURNS = 720  # directions of lines
TURN_STEP_RAD = 2.0 * math.pi / TURNS
TURN_SPREAD = 8  # steps: gradients of noisy pixels point so far off their line's normal
LOOKS_ACROSS = math.cos(math.radians(10.0))
FEWEST_POINTS = 12


class _Line(NamedTuple):
    """A line in the quarter picture: u cos(t) + v sin(t) = rho, t pointing to its bright side."""

    turn_rad: float
    rho: float


def find_lines(pixels: Pixels) -> list[StraightOutline]:
    """All straight edges, best first; bright and dark side of a stripe are two. Raises ValueError for no picture."""
    pixels = checked(pixels)
    edgels = find_edgels(pixels)
    turn = np.arctan2(edgels.along_v, edgels.along_u)
    free = np.ones(turn.size, bool)
    found: list[StraightOutline] = []
    for _ in range(MOST_LINES):
        line = _most_voted(edgels, turn, free)
        near = _near(edgels, turn, line, 2.5) & free
        if np.count_nonzero(near) < FEWEST_POINTS:
            break
        line = _fitted(edgels, turn, near)
        mine = _near(edgels, turn, line, 1.5) & free
        free &= ~(mine | near)
        outline = _clean(pixels, edgels, line, mine)
        if outline is not None and not any(_same_line(outline.edge, other.edge) for other in found):
            found.append(outline)
    return sorted(found, key=lambda outline: -outline.score)


def _most_voted(edgels: Edgels, turn: Floats, free: NDArray[np.bool_]) -> _Line:
    """The line with the most free points. Distances count from the middle of the picture: short levers, sharp votes."""
    middle_u, middle_v = edgels.width / 2.0, edgels.height / 2.0
    u, v = edgels.u[free] - middle_u, edgels.v[free] - middle_v
    steps = np.rint(turn[free] / TURN_STEP_RAD).astype(np.intp)
    reach = math.ceil(math.hypot(middle_u, middle_v)) + 1
    bins = 2 * reach + 1
    count = np.zeros(TURNS * bins)
    for off in range(-TURN_SPREAD, TURN_SPREAD + 1):
        turns = (steps + off) * TURN_STEP_RAD
        rho = np.rint(u * np.cos(turns) + v * np.sin(turns)).astype(np.intp) + reach
        count += np.bincount((steps + off) % TURNS * bins + rho, minlength=count.size)
    heights = cv2.GaussianBlur(count.reshape(TURNS, bins).astype(np.float32), (5, 3), 0)
    _, _, _, (column, row) = cv2.minMaxLoc(heights)
    t = row * TURN_STEP_RAD
    return _Line(t, column - reach + middle_u * math.cos(t) + middle_v * math.sin(t))


def _near(edgels: Edgels, turn: Floats, line: _Line, within: float) -> NDArray[np.bool_]:
    """Which points lie on a line and look across it."""
    away = edgels.u * math.cos(line.turn_rad) + edgels.v * math.sin(line.turn_rad) - line.rho
    return np.asarray((np.abs(away) < within) & (np.cos(turn - line.turn_rad) > LOOKS_ACROSS))


def _fitted(edgels: Edgels, turn: Floats, near: NDArray[np.bool_]) -> _Line:
    """The line through the points, by total least squares; it keeps its bright side."""
    points = np.stack([edgels.u[near], edgels.v[near]], axis=1)
    centre = points.mean(axis=0)
    normal = np.linalg.svd(points - centre, full_matrices=False)[2][1]
    if normal @ (np.cos(turn[near]).mean(), np.sin(turn[near]).mean()) < 0.0:
        normal = -normal
    return _Line(math.atan2(normal[1], normal[0]), float(centre @ normal))


def _clean(pixels: Pixels, edgels: Edgels, line: _Line, mine: NDArray[np.bool_]) -> StraightOutline | None:
    """The clean stretch of a line between its outermost points that hang together; None when it is too short."""
    c, s = math.cos(line.turn_rad), math.sin(line.turn_rad)
    first, last = longest_run(edgels.v[mine] * c - edgels.u[mine] * s, GAP_PX / SCALE)
    start, end = (Px(to_full(line.rho * c - t * s), to_full(line.rho * s + t * c)) for t in (first, last))
    return follow_edge(pixels, start, end, Px(c, s)) if math.dist(start, end) > SHORTEST_PX else None


def _same_line(one: ExpectedEdge, other: ExpectedEdge) -> bool:
    """Whether both ends of one lie on the other's line."""
    way = direction(other.start, other.end)
    away = [abs(way.u * (p.v - other.start.v) - way.v * (p.u - other.start.u)) for p in (one.start, one.end)]
    return max(away) < SAME_PX
