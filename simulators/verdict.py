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
    """How a battery lies in a seat."""

    clearance_mm: float  # the smallest gap between a corner and the seat's wall; below 0 the battery does not go in
    corner_errors_mm: tuple[float, ...]  # each corner from where it would be with this very battery in the middle

    @property
    def good(self) -> bool:
        """Whether the battery lies in its seat."""
        return self.clearance_mm >= 0.0

    @property
    def worst_mm(self) -> float:
        """Placement error: the largest distance of a corner from where it should be."""
        return max(self.corner_errors_mm)


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


def fit(seat: Rectangle, battery: Rectangle, seat_from_battery: Place) -> Fit:
    """Judge a battery in its seat.

    The clearance is exact for a rigid rectangle in a rectangular pocket: the pocket is convex, so the battery is
    inside when its four corners are.
    """
    corners = battery.corners()
    lying = [seat_from_battery.point(*corner) for corner in corners]
    inside = [min(seat.width_mm / 2 - abs(x), seat.height_mm / 2 - abs(y)) for x, y in lying]
    return Fit(min(inside), tuple(math.dist(*pair) for pair in zip(lying, corners, strict=True)))
