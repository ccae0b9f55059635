"""Plane geometry of the cell. Pure functions; lengths in mm, angles in degrees, image points in px.

A pose named `a_from_b` takes coordinates in frame b to frame a, so names cancel when poses are composed:
`robot_from_tool @ tool_from_battery` is `robot_from_battery`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple


class Px(NamedTuple):
    """A point in a picture: u right, v down, origin at the centre of the top-left pixel."""

    u: float
    v: float


class Mm(NamedTuple):
    """A point in a plane of the cell."""

    x_mm: float
    y_mm: float


class Offset(NamedTuple):
    """A small motion: turn by `dt_deg` about a stated centre, then shift by `dx_mm`, `dy_mm`."""

    dx_mm: float
    dy_mm: float
    dt_deg: float


class Pose(NamedTuple):
    """A rigid motion of the plane, SE(2)."""

    x_mm: float
    y_mm: float
    t_deg: float

    def __matmul__(self, inner: Pose) -> Pose:
        """Compose: first `inner`, then `self`."""
        x_mm, y_mm = self.point(inner.x_mm, inner.y_mm)
        return Pose(x_mm, y_mm, wrap_deg(self.t_deg + inner.t_deg))

    def point(self, x_mm: float, y_mm: float) -> Mm:
        """Where a point of the inner frame lies in the outer one."""
        c, s = math.cos(math.radians(self.t_deg)), math.sin(math.radians(self.t_deg))
        return Mm(self.x_mm + c * x_mm - s * y_mm, self.y_mm + s * x_mm + c * y_mm)

    def inverse(self) -> Pose:
        """The motion that undoes this one."""
        c, s = math.cos(math.radians(self.t_deg)), math.sin(math.radians(self.t_deg))
        return Pose(-c * self.x_mm - s * self.y_mm, s * self.x_mm - c * self.y_mm, wrap_deg(-self.t_deg))


def wrap_deg(angle_deg: float) -> float:
    """The same angle in [-180, 180]."""
    return math.remainder(angle_deg, 360.0)


def direction_deg(start: Mm, end: Mm) -> float:
    """Direction of the line from start to end, counter-clockwise from +x."""
    return math.degrees(math.atan2(end.y_mm - start.y_mm, end.x_mm - start.x_mm))


def mean_pose(poses: Iterable[Pose]) -> Pose:
    """Mean of poses that lie close together; angles are averaged as directions."""
    x_mm, y_mm, t_deg = zip(*poses, strict=True)
    sine = sum(math.sin(math.radians(t)) for t in t_deg)
    cosine = sum(math.cos(math.radians(t)) for t in t_deg)
    return Pose(sum(x_mm) / len(x_mm), sum(y_mm) / len(y_mm), math.degrees(math.atan2(sine, cosine)))


def turned_about(centre: Mm, offset: Offset) -> Pose:
    """The motion that turns by dt about a centre that stays, then shifts by dx, dy."""
    shift = Pose(centre.x_mm + offset.dx_mm, centre.y_mm + offset.dy_mm, offset.dt_deg)
    return shift @ Pose(-centre.x_mm, -centre.y_mm, 0.0)


def offset_about(centre: Mm, taught: Pose, found: Pose) -> Offset:
    """How a part moved from its taught to its found pose, seen at a rotation centre (the paper's Table 2).

    `turned_about(centre, offset) @ taught == found`.
    """
    motion = found @ taught.inverse()
    there = motion.point(*centre)
    return Offset(there.x_mm - centre.x_mm, there.y_mm - centre.y_mm, motion.t_deg)


def compensation(centre: Mm, taught_mark: Mm, taught_line_deg: float, mark: Mm, line_deg: float) -> Offset:
    """The correction of eq. 12-16: turn about the rotation centre, then shift to the taught place.

    Corrected: directions instead of slopes (eq. 12, 13 lose the quadrant), atan2 in eq. 14, the taught mark
    measured from the rotation centre in eq. 15 and 16, and the sine outside the root in eq. 16.
    """
    dt_deg = wrap_deg(taught_line_deg - line_deg)  # eq. 12, 13
    x, y = mark.x_mm - centre.x_mm, mark.y_mm - centre.y_mm
    theta = math.atan2(y, x)  # eq. 14
    turned = theta + math.radians(dt_deg)
    dx = (taught_mark.x_mm - centre.x_mm) - math.hypot(x, y) * math.cos(turned)  # eq. 15
    dy = (taught_mark.y_mm - centre.y_mm) - math.hypot(x, y) * math.sin(turned)  # eq. 16
    return Offset(dx, dy, dt_deg)


def disagreement_mm(centre: Mm, taught: Pose, found: Pose) -> float:
    """How far the two forms of the correction, eq. 12-16 and poses, put the part from each other; 0 but for rounding.

    The part's origin is its mark and its x axis the reference line. The angle counts at 100 mm from the mark.
    """
    correction = compensation(centre, Mm(*taught[:2]), taught.t_deg, Mm(*found[:2]), found.t_deg)
    left = taught.inverse() @ turned_about(centre, correction) @ found
    return math.hypot(left.x_mm, left.y_mm, 100.0 * math.radians(left.t_deg))


def place_pose(robot_from_base: Pose, base_from_battery: Pose, tool_from_battery: Pose) -> Pose:
    """Where the tool must be so that the held battery comes to its taught place in the base."""
    return robot_from_base @ base_from_battery @ tool_from_battery.inverse()
