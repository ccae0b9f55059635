"""How a straight edge runs through the picture's columns or rows. Pure.

An edge that runs nearer to the picture's rows is scanned by columns, the others by rows. "Along" is the scanned
coordinate, "across" the one that is measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Px
from cellctl.vision.coarse import RoughLine
from cellctl.vision.covariance import as_matrix
from cellctl.vision.features import ExpectedEdge, Floats, Matrix, Pixels

Places: TypeAlias = NDArray[np.int64]


@dataclass(frozen=True)
class Scan:
    """How an edge is scanned: along columns (axis 0) or rows (axis 1)."""

    axis: int
    rising: int  # +1: brighter for larger `across`, else -1
    forward: bool  # the expected edge runs towards larger `along`

    @classmethod
    def of(cls, edge: ExpectedEdge) -> Scan:
        """The scan that suits an edge of any direction."""
        du, dv = edge.end.u - edge.start.u, edge.end.v - edge.start.v
        axis = 0 if abs(du) >= abs(dv) else 1
        left_is_greater = du < 0.0 if axis == 0 else dv > 0.0  # across grows to the left hand
        return cls(axis, 1 if left_is_greater == edge.bright_left else -1, (dv if axis else du) > 0.0)

    def along(self, p: Px) -> float:
        """The scanned coordinate of a point."""
        return p[self.axis]

    def across(self, p: Px) -> float:
        """The measured coordinate of a point."""
        return p[1 - self.axis]

    def point(self, along: float, across: float) -> Px:
        """The point with these coordinates."""
        return Px(along, across) if self.axis == 0 else Px(across, along)

    def limits(self, pixels: Pixels) -> tuple[int, int]:
        """Number of pixels along and across."""
        height, width = pixels.shape
        return (width, height) if self.axis == 0 else (height, width)

    def strides(self, pixels: Pixels) -> tuple[int, int]:
        """Steps in the flat picture along and across."""
        width = pixels.shape[1]
        return (1, width) if self.axis == 0 else (width, 1)


class Line(NamedTuple):
    """across = height + slope * (along - at)."""

    at: float
    height: float
    slope: float

    @classmethod
    def through(cls, scan: Scan, rough: RoughLine) -> Line:
        """A rough line in the scan's coordinates."""
        slope = rough.way[1 - scan.axis] / rough.way[scan.axis]
        return cls(scan.along(rough.point), scan.across(rough.point), slope)

    def across(self, along: Floats | Places) -> Floats:
        """Where the line is."""
        return np.asarray(self.height + self.slope * (along - self.at), np.float64)

    def moved(self, at: float) -> Line:
        """The same line, referred to another place along."""
        return Line(at, self.height + self.slope * (at - self.at), self.slope)

    @property
    def cosine(self) -> float:
        """Of the angle between the line and the scan direction."""
        return 1.0 / math.hypot(1.0, self.slope)


def stretch(scan: Scan, pixels: Pixels, one: Px, two: Px) -> tuple[int, int]:
    """The scanned range from one point to another, as far as it is in the picture."""
    ends = sorted((scan.along(one), scan.along(two)))
    return max(2, math.ceil(ends[0])), min(scan.limits(pixels)[0] - 3, math.floor(ends[1]))


def edge_covariance(scan: Scan, line: Line, start: Px, end: Px, spread: Floats) -> Matrix:
    """The covariance of height and slope at `line.at` as that of offset px and angle deg at the middle."""
    lever = (scan.along(start) + scan.along(end)) / 2.0 - line.at
    cosine = line.cosine
    to_right = cosine * (1.0 if scan.forward == (scan.axis == 0) else -1.0)
    to_angle = math.degrees(cosine * cosine) * (1.0 if scan.axis == 0 else -1.0)
    carried = np.array([[to_right, to_right * lever], [0.0, to_angle]])
    return as_matrix(carried @ spread @ carried.T)
