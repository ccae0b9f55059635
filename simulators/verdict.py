"""How a battery truly lies in its seat: the judge of every assembly."""

import math
from dataclasses import dataclass

from simulators.place import Place
from simulators.supply import Displacement


@dataclass(frozen=True)
class Rectangle:
    """Width along x, height along y, centred on its frame."""

    width_mm: float
    height_mm: float

    def corners(self) -> list[tuple[float, float]]:
        """The four corners, counter-clockwise from the lower left."""
        w, h = self.width_mm / 2, self.height_mm / 2
        return [(-w, -h), (w, -h), (w, h), (-w, h)]


@dataclass(frozen=True)
class Fit:
    """Clearance is the smallest gap between a battery corner and the seat's wall; below 0 it does not go in."""

    clearance_mm: float
    corner_errors_mm: tuple[float, float, float, float]
    off_corners_mm: tuple[float, float, float, float]

    @property
    def good(self) -> bool:
        """Whether the battery lies in its seat."""
        return self.clearance_mm >= 0.0

    @property
    def worst_mm(self) -> float:
        """Placement error: the largest distance of a corner from where the ideal battery has it."""
        return max(self.corner_errors_mm)

    @property
    def off_mm(self) -> float:
        """The largest distance of a true corner from where it would be if this very battery lay in the middle."""
        return max(self.off_corners_mm)


@dataclass(frozen=True)
class Verdict:
    """One unit as the world saw it when its carrier left."""

    number: int
    carrier_id: int
    base: Displacement
    battery: Displacement
    fit: Fit | None  # None: there is no battery in the seat
    released_good: bool
    cycle_s: float  # world seconds from arrival to release


def fit(seat: Rectangle, battery: Rectangle, drawing: Rectangle, mark: int, seat_from_battery: Place) -> Fit:
    """Judge a battery in its seat.

    The clearance is exact for a rigid rectangle in a rectangular pocket: the pocket is convex, so the battery is
    inside when its four corners are. The placement error compares what can be seen of the battery, its corner
    number `mark` and the edges there, with a battery made to the drawing and seated in the middle; so a battery
    that is a little too long is not counted as a misplaced one. `off_corners_mm` counts that too: they compare this
    very battery with itself in the middle of the seat.
    """
    inside = [
        min(seat.width_mm / 2 - abs(x), seat.height_mm / 2 - abs(y))
        for x, y in (seat_from_battery.point(*corner) for corner in battery.corners())
    ]
    (mark_x, mark_y), (drawn_x, drawn_y) = battery.corners()[mark], drawing.corners()[mark]
    errors = []
    for ideal_x, ideal_y in drawing.corners():
        x, y = seat_from_battery.point(mark_x + ideal_x - drawn_x, mark_y + ideal_y - drawn_y)
        errors.append(math.hypot(x - ideal_x, y - ideal_y))
    off = [math.dist(seat_from_battery.point(*corner), corner) for corner in battery.corners()]
    return Fit(min(inside), (errors[0], errors[1], errors[2], errors[3]), (off[0], off[1], off[2], off[3]))
