"""Where things are: rigid places in the plane. Lengths in mm, angles in degrees counter-clockwise from above."""

from __future__ import annotations

import math
from typing import NamedTuple


class Place(NamedTuple):
    """A frame seen from its parent; `a @ b` is b's place seen from a's parent."""

    x_mm: float
    y_mm: float
    t_deg: float = 0.0

    def __matmul__(self, inner: Place) -> Place:
        x, y = self.point(inner.x_mm, inner.y_mm)
        return Place(x, y, self.t_deg + inner.t_deg)

    def point(self, x_mm: float, y_mm: float) -> tuple[float, float]:
        """A point given in this frame, seen from the parent."""
        c, s = math.cos(math.radians(self.t_deg)), math.sin(math.radians(self.t_deg))
        return self.x_mm + c * x_mm - s * y_mm, self.y_mm + s * x_mm + c * y_mm

    def back(self) -> Place:
        """The parent seen from this frame."""
        c, s = math.cos(math.radians(self.t_deg)), math.sin(math.radians(self.t_deg))
        return Place(-c * self.x_mm - s * self.y_mm, s * self.x_mm - c * self.y_mm, -self.t_deg)


def turned_about(centre: tuple[float, float], dx_mm: float, dy_mm: float, dt_deg: float) -> Place:
    """The motion that turns by dt about a fixed centre, then shifts by dx, dy."""
    return Place(dx_mm, dy_mm) @ Place(*centre, dt_deg) @ Place(-centre[0], -centre[1])
