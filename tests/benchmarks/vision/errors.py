"""Errors of measurements against the truth of the picture, with the Cramer-Rao bound of that very picture."""

import math
from dataclasses import dataclass, field

import numpy as np

from cellctl.geometry import Px
from tests.benchmarks.vision.regions import Straight
from tests.vision_regimes import Case, contrast
from tests.vision_scenes import HOLE_MM

FARTHEST_MM, FARTHEST_DEG, FARTHEST_CORNER_MM = 0.15, 1.5, 0.30  # beyond, a method has measured something else
SKIP_MM, BATTERY_EDGES_MM, BASE_EDGE_MM = 2.0, (9.0, 5.5), 14.0


@dataclass
class Errors:
    """Of one quantity and one method: errors, bounds and own sigmas in um or mdeg, and how often it failed."""

    error: list[float] = field(default_factory=list)
    bound: list[float] = field(default_factory=list)
    sigma: list[float] = field(default_factory=list)
    failures: int = 0

    def note(self, error: float, bound: float, sigma: float = math.nan) -> None:
        self.error.append(error)
        self.bound.append(bound)
        self.sigma.append(sigma)

    def add(self, other: "Errors") -> None:
        self.error += other.error
        self.bound += other.bound
        self.sigma += other.sigma
        self.failures += other.failures


def hole_bound_um(case: Case) -> float:
    """Per axis: 1 / (information per px * pi * radius)."""
    per_px = case.information * contrast("hole") ** 2
    return _um(case, 1.0 / math.sqrt(per_px * math.pi * HOLE_MM * case.view.optics.px_per_mm))


def edge_bounds(case: Case, length_mm: float, feature: str) -> tuple[float, float]:
    """Of the offset at the middle, um, and of the angle, mdeg: 1 / (I L) and 12 / (I L^3)."""
    per_px = case.information * contrast("edge" if feature == "edge" else "battery") ** 2
    length = length_mm * case.view.optics.px_per_mm
    return _um(case, 1.0 / math.sqrt(per_px * length)), 1e3 * math.degrees(math.sqrt(12.0 / (per_px * length**3)))


def corner_bound_um(case: Case, length_mm: float) -> float:
    """Across one edge, at the corner: its offset and its angle carried there."""
    offset_um, angle_mdeg = edge_bounds(case, length_mm, "battery")
    return math.hypot(offset_um, 1000.0 * (SKIP_MM + length_mm / 2) * math.radians(angle_mdeg * 1e-3))


def line_errors(case: Case, line: Straight, start: Px, end: Px) -> tuple[float, float]:
    """Offset of a line from the true one at its middle, um, and its turn, mdeg."""
    way = np.subtract(end, start) / math.dist(start, end)
    middle = np.add(start, end) / 2.0
    turn = math.atan2(line.way[1], line.way[0]) - math.atan2(way[1], way[0])
    turn = (turn + math.pi / 2) % math.pi - math.pi / 2
    away = middle - np.array(line.point)
    found = np.array(line.way) / math.hypot(*line.way)
    foot = np.array(line.point) + found * float(away @ found)
    offset = float(np.cross(np.append(way, 0.0), np.append(foot - middle, 0.0))[2]) / max(0.1, math.cos(turn))
    return _um(case, offset), 1e3 * math.degrees(turn)


def meeting(one: Straight, two: Straight) -> tuple[float, float]:
    """Where two lines meet."""
    system = np.array([one.way, np.negative(two.way)], float).T
    along = np.linalg.solve(system, np.subtract(two.point, one.point))[0]
    u, v = np.add(one.point, np.multiply(one.way, along))
    return float(u), float(v)


def across_um(case: Case, found: tuple[float, float], corner: Px, end: Px) -> float:
    """How far a found corner lies off the true edge from corner to end."""
    way = np.subtract(end, corner) / math.dist(corner, end)
    away = np.subtract(found, corner)
    return _um(case, float(way[0] * away[1] - way[1] * away[0]))


def _um(case: Case, px: float) -> float:
    return px * 1000.0 / case.view.optics.px_per_mm
