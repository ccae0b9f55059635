"""The dot board: dark dots on a bright plate, one larger dot at a corner."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class DotBoard:
    """Size of a dot board. Its frame: origin at the centre of dot (0, 0), the larger one; x along the columns' count.

    Board order of dots is row by row: index = row * columns + column.
    """

    columns: int = 9
    rows: int = 7
    pitch_mm: float = 1.2
    dot_mm: float = 0.6
    origin_dot_mm: float = 0.9

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 99 and 3 <= self.rows <= 99):
            raise ValueError(f"dot board: 3 to 99 columns and rows (got {self.columns} x {self.rows})")
        sizes = (self.dot_mm, self.origin_dot_mm, self.pitch_mm)
        if not all(math.isfinite(size) for size in sizes):
            raise ValueError(f"dot board: dot, origin dot and pitch must be finite (got {sizes})")
        if not 0 < 1.15 * self.dot_mm <= self.origin_dot_mm <= 0.85 * self.pitch_mm:
            raise ValueError(
                "dot board: the origin dot must be at least 15 % larger than a dot and at most 85 % of the pitch "
                f"(got dot {self.dot_mm:g}, origin dot {self.origin_dot_mm:g}, pitch {self.pitch_mm:g} mm)"
            )

    @property
    def count(self) -> int:
        """How many dots there are."""
        return self.columns * self.rows

    @property
    def points_mm(self) -> NDArray[np.float64]:
        """Centres of all dots in board order, (count, 2), mm in the board frame."""
        row, column = np.divmod(np.arange(self.count), self.columns)
        return np.column_stack([column, row]) * self.pitch_mm

    @property
    def outline_mm(self) -> NDArray[np.float64]:
        """Corners of the rectangle around all dots, (4, 2), mm in the board frame: what must stay in view."""
        edge = self.origin_dot_mm / 2
        right, top = (self.columns - 1) * self.pitch_mm + edge, (self.rows - 1) * self.pitch_mm + edge
        return np.array([[-edge, -edge], [right, -edge], [right, top], [-edge, top]])

    @property
    def centre_mm(self) -> NDArray[np.float64]:
        """Centre of the dots, (2,), mm in the board frame."""
        return np.array([self.columns - 1, self.rows - 1]) * self.pitch_mm / 2
