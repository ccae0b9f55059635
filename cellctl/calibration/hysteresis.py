"""How far stops differ with the side from which the arm comes: what a one-sided approach takes away."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellctl.calibration.board_pose import seen_boards
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import FloatArray
from cellctl.geometry import Pose

UNITS = np.array([1000.0, 1000.0, 1000.0])  # mm, mm, deg to um, um, mdeg


class Approach(NamedTuple):
    """The side from which a stop is approached: -1 = from below in that coordinate, +1 = from above."""

    x: int
    y: int
    r: int

    @property
    def text(self) -> str:
        """For people."""
        return " ".join(f"{'-' if side < 0 else '+'}{name}" for name, side in zip(("x", "y", "R"), self, strict=True))

    def start(self, at: Pose, back_mm: float, back_deg: float) -> Pose:
        """Where the approach begins."""
        return Pose(at.x_mm + self.x * back_mm, at.y_mm + self.y * back_mm, at.t_deg + self.r * back_deg)


USED = Approach(-1, -1, -1)  # the side from which every measuring stop of the cell is approached
APPROACHES = tuple(Approach(*sides) for sides in itertools.product((-1, 1), repeat=3))


class Hysteresis(NamedTuple):
    """Mean stop of each approach against that of the used one, (8, 3) um, um, mdeg, and what it is worth."""

    difference: FloatArray  # in the order of APPROACHES
    difference_sd: FloatArray  # (3,) one sigma of a difference
    stop_sd: FloatArray  # (3,) one sigma of one stop

    def worst(self, lever_mm: float) -> tuple[Approach, float]:
        """The approach that moves a corner at this lever most, and by how many um."""
        away_um = np.hypot(*self.difference[:, :2].T) + np.abs(self.difference[:, 2]) * math.radians(1.0) * lever_mm
        index = int(away_um.argmax())
        return APPROACHES[index], float(away_um[index])

    def worst_sd_um(self, lever_mm: float) -> float:
        """One sigma of such a figure."""
        turned = self.difference_sd[2] * math.radians(1.0) * lever_mm
        return float(math.sqrt(float((self.difference_sd[:2] ** 2).sum()) + float(turned) ** 2))

    def table(self) -> list[str]:
        """For people."""
        rows = [f"{'approach from':<18}{'x um':>9}{'y um':>9}{'R mdeg':>9}   against the side that is used"]
        for approach, figures in zip(APPROACHES, self.difference.tolist(), strict=True):
            used = "   used" if approach == USED else ""
            rows.append(f"{approach.text:<18}" + "".join(f"{value:>+9.1f}" for value in figures) + used)
        for name, sigmas in (("known to +-", self.difference_sd), ("one stop +-", self.stop_sd)):
            rows.append(f"{name:<18}" + "".join(f"{sd:>9.1f}" for sd in sigmas.tolist()) + "   1 sigma")
        return rows


def stops_by_board(camera: PlaneMap, board: Pose, dots_px: FloatArray, board_mm: FloatArray) -> FloatArray:
    """Where the tool truly stood, (n, 3) mm, mm, deg, by pictures (n, m, 2) of a board that is known."""
    x_mm, y_mm = board_mm.mean(0).tolist()
    place = board @ Pose(x_mm, y_mm, 0.0)
    seen = [Pose(x, y, math.degrees(t)) for x, y, t in seen_boards(camera, dots_px, board_mm).tolist()]
    return np.array([place @ tool_from_board.inverse() for tool_from_board in seen], float)


def hysteresis(approaches: Sequence[Approach], stops: FloatArray) -> Hysteresis:
    """Compare stops (n, 3) mm, mm, deg at one place. ValueError unless every approach was made equally often, twice."""
    repeats, left = divmod(len(stops), len(APPROACHES))
    counts = {approach: list(approaches).count(approach) for approach in APPROACHES}
    if left or repeats < 2 or set(counts.values()) != {repeats} or stops.shape != (len(approaches), 3):
        raise ValueError(f"hysteresis: every approach must be made equally often, at least twice (got {counts})")
    found = stops * UNITS
    groups = np.stack([found[[one == approach for one in approaches]] for approach in APPROACHES])
    means = groups.mean(1)
    scatter = np.sqrt(((groups - means[:, None]) ** 2).sum((0, 1)) / (len(found) - len(APPROACHES)))
    return Hysteresis(means - means[APPROACHES.index(USED)], scatter * math.sqrt(2 / repeats), scatter)
