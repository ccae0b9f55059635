"""Areas that the robot must keep out of, and whether a stop or the way between two stops touches one. Pure.

The arms are lines from the first axis to the elbow and on to the tool; an area is drawn half an arm's width larger
than what stands there. Point to point, both axes turn evenly from one stop to the next.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from cellctl.geometry import Mm
from cellctl.mount import Mount, Stop

STEP_DEG = 1.0  # the way is looked at every so often


class Area(NamedTuple):
    """A rectangle of the robot frame, mm."""

    name: str
    x_min_mm: float
    x_max_mm: float
    y_min_mm: float
    y_max_mm: float

    def touches(self, start: Mm, end: Mm) -> bool:
        """Whether a straight piece goes through (Liang and Barsky)."""
        first, last = 0.0, 1.0
        limits = ((self.x_min_mm, self.x_max_mm), (self.y_min_mm, self.y_max_mm))
        for at, to, (low, high) in zip(start, end, limits, strict=True):
            way = to - at
            if way == 0.0:
                if not low <= at <= high:
                    return False
                continue
            near, far = sorted(((low - at) / way, (high - at) / way))
            first, last = max(first, near), min(last, far)
        return first <= last


def touched_at(mount: Mount, stop: Stop, areas: Sequence[Area]) -> str:
    """Name of the area that the arm touches while it stands there, "" for none."""
    return _touched(mount, mount.axes_deg(stop), areas)


def touched_on_the_way(mount: Mount, start: Stop, end: Stop, areas: Sequence[Area]) -> str:
    """Name of the first area that the arm touches between two stops, "" for none."""
    if not areas:
        return ""
    return next((name for axes in _way(mount, start, end) if (name := _touched(mount, axes, areas))), "")


def _touched(mount: Mount, axes_deg: tuple[float, float], areas: Sequence[Area]) -> str:
    elbow, tool = mount.elbow_and_tool(*axes_deg)
    pieces = (Mm(0.0, 0.0), elbow), (elbow, tool)
    return next((area.name for area in areas if any(area.touches(*piece) for piece in pieces)), "")


def _way(mount: Mount, start: Stop, end: Stop) -> Iterator[tuple[float, float]]:
    """Axes 1 and 2 on the way, both ends included."""
    (a1, a2), (b1, b2) = mount.axes_deg(start), mount.axes_deg(end)
    steps = max(1, math.ceil(max(abs(b1 - a1), abs(b2 - a2)) / STEP_DEG))
    for number in range(steps + 1):
        share = number / steps
        yield a1 + (b1 - a1) * share, a2 + (b2 - a2) * share
