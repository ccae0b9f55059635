"""What the line supplies: where the next base and battery lie, and how far their sizes are from the drawing.

Carrier and table scatter are the paper's; the base's angle is drawn as the ten rows of its Table 2 were spread.
Sizes: the drawing allows +-0.08 mm; a released series holds Cpk 1.33 against that (sd 0.02 mm), cut off at the limit.
Edges are straight unless the scatter says otherwise; every part has a form of its own.
"""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
class Form:
    """How far the outlines of base and battery are from straight, 1 sigma; each seed is a pair like no other."""

    base_mm: float = 0.0
    battery_mm: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class Delivery:
    """One base on its carrier and one battery on the table."""

    base: Displacement
    battery: Displacement
    sizes: Sizes
    has_base: bool = True
    form: Form = Form()


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
    golden_sd_mm: float = 0.004  # sizes of golden pairs after the first, which is to the drawing
    golden_seat_mm: float = 0.0  # how exactly a person seats a golden battery, 1 sigma
    size_uniform: bool = False  # sizes spread evenly over all that the drawing allows
    base_form_mm: float = 0.0  # 1 sigma
    battery_form_mm: float = 0.0


class Supply:
    """Deliveries one after the other: first those that were queued, then random ones."""

    def __init__(self, rng: np.random.Generator, scatter: Scatter) -> None:
        self._rng = rng
        self.scatter = scatter
        self.queue: deque[Delivery] = deque()
        self._drawn = 0

    def next(self) -> Delivery:
        """The next pair. Random numbers are drawn for each pair, queued or not, so later pairs do not depend on it."""
        drawn = self._draw()
        return self.queue.popleft() if self.queue else drawn

    def _draw(self) -> Delivery:
        rng, s = self._rng, self.scatter
        x, y, bx, by, bt = rng.uniform(-1.0, 1.0, 5)
        turn = rng.normal(s.base_t_mean_deg, s.base_t_sd_deg)
        off = rng.normal(0.0, 1.0, 4)
        sizes = _evenly(off) if s.size_uniform else np.clip(off * s.size_sd_mm, -SIZE_LIMIT_MM, SIZE_LIMIT_MM)
        self._drawn += 1
        return Delivery(
            base=Displacement(float(x * s.base_x_mm), float(y * s.base_y_mm), float(turn)),
            battery=Displacement(float(bx * s.battery_xy_mm), float(by * s.battery_xy_mm), float(bt * s.battery_t_deg)),
            sizes=Sizes(*(float(d) for d in sizes)),
            form=Form(s.base_form_mm, s.battery_form_mm, self._drawn),
        )


def _evenly(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard normal numbers turned into numbers that are spread evenly within the limit."""
    return np.array([SIZE_LIMIT_MM * math.erf(number / math.sqrt(2.0)) for number in normal])
