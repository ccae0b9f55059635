"""The golden parts that a person brings along: pairs of base and battery, and how exactly they are seated by hand."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from simulators.place import Place
from simulators.supply import Delivery, Form, Scatter, Sizes
from simulators.things import PERFECT

CARRIER = 9000


class GoldenParts:
    """Pair after pair; the first is to the drawing, the others nearly so."""

    def __init__(self, scatter: Scatter, stream: Callable[[str], np.random.Generator]) -> None:
        self._scatter = scatter
        self._stream = stream
        self._seating = stream("seating")
        self._pair = 1

    def next_pair(self) -> None:
        """The next pair is at hand."""
        self._pair += 1

    def delivery(self) -> Delivery:
        """Base and battery of this pair, as straight as parts are, where they should lie."""
        off_mm = self._stream(f"golden pair {self._pair}").normal(0.0, 1.0, 4) * self._scatter.golden_sd_mm
        sizes = Sizes(*off_mm.tolist()) if self._pair > 1 else Sizes()
        form = Form(self._scatter.base_form_mm, self._scatter.battery_form_mm, CARRIER + self._pair - 1)
        return replace(PERFECT, sizes=sizes, form=form)

    def seat(self) -> Place:
        """Where in its seat a person puts the battery."""
        x_mm, y_mm = (self._seating.normal(0.0, 1.0, 2) * self._scatter.golden_seat_mm).tolist()
        return Place(x_mm, y_mm)
