"""What the line supplies: where the next base and battery lie, and how far their sizes are from the drawing.

Carrier and table scatter are the paper's; the base's angle is drawn as the ten rows of its Table 2 were spread.
Sizes: the drawing allows +-0.08 mm; a released series holds Cpk 1.33 against that (sd 0.02 mm), cut off at the limit.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

SIZE_LIMIT_MM = 0.08


@dataclass(frozen=True)
class Displacement:
    """Turned by dt about the part's rotation centre, then shifted by dx, dy, against where it should lie."""

    dx_mm: float = 0.0
    dy_mm: float = 0.0
    dt_deg: float = 0.0


@dataclass(frozen=True)
class Sizes:
    """Deviations from the drawing."""

    seat_width_mm: float = 0.0
    seat_height_mm: float = 0.0
    battery_width_mm: float = 0.0
    battery_height_mm: float = 0.0


@dataclass(frozen=True)
class Delivery:
    """One base on its carrier and one battery on the table."""

    base: Displacement
    battery: Displacement
    sizes: Sizes
    has_base: bool = True


@dataclass
class Scatter:
    """How the line scatters; every field is a named imperfection."""

    base_x_mm: float = 0.05
    base_y_mm: float = 0.15
    base_t_mean_deg: float = 0.135
    base_t_sd_deg: float = 0.228
    battery_xy_mm: float = 1.0
    battery_t_deg: float = 1.0
    size_sd_mm: float = 0.02


class Supply:
    """Deliveries one after the other: first those that were queued, then random ones."""

    def __init__(self, rng: np.random.Generator, scatter: Scatter) -> None:
        self._rng = rng
        self.scatter = scatter
        self.queue: deque[Delivery] = deque()

    def next(self) -> Delivery:
        """The next pair. Random numbers are drawn for each pair, queued or not, so later pairs do not depend on it."""
        drawn = self._draw()
        return self.queue.popleft() if self.queue else drawn

    def _draw(self) -> Delivery:
        rng, s = self._rng, self.scatter
        x, y, bx, by, bt = rng.uniform(-1.0, 1.0, 5)
        turn = rng.normal(s.base_t_mean_deg, s.base_t_sd_deg)
        sizes = np.clip(rng.normal(0.0, s.size_sd_mm, 4), -SIZE_LIMIT_MM, SIZE_LIMIT_MM)
        return Delivery(
            base=Displacement(float(x * s.base_x_mm), float(y * s.base_y_mm), float(turn)),
            battery=Displacement(float(bx * s.battery_xy_mm), float(by * s.battery_xy_mm), float(bt * s.battery_t_deg)),
            sizes=Sizes(*(float(d) for d in sizes)),
        )
