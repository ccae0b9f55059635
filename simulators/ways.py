"""The curves on which the arm moves: point to point, along a line, along an arc. Pure."""

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from simulators.scara import SAME_MM, Hand, Joints, Scara, ToolPose, Unreachable, forward, inverse

SAMPLES = 64  # at which a curve in space is checked against the axes' limits


class Way(Protocol):
    """A curve from fraction 0 to 1."""

    def joints_at(self, done: float) -> Joints:
        """The joints at this fraction."""


class Pace(NamedTuple):
    """Fractions of what the arm can: speed, acceleration, deceleration. `path_mm_per_s` instead, for a curve."""

    speed: float = 1.0
    accel: float = 1.0
    decel: float = 1.0
    path_mm_per_s: float | None = None


class Rates(NamedTuple):
    """What a way allows, in fractions of it per second: top speed, and the peak of an acceleration."""

    speed: float
    steepest: float


@dataclass(frozen=True, slots=True)
class JointWay:
    """Point to point: all axes start and arrive together."""

    start: Joints
    end: Joints

    def joints_at(self, done: float) -> Joints:
        """Straight in joint space."""
        return Joints(*between(self.start, self.end, done))


@dataclass(frozen=True, slots=True)
class LineWay:
    """The tool on a straight line, the elbow on one side."""

    start: ToolPose
    end: ToolPose
    hand: Hand

    @property
    def length_mm(self) -> float:
        """Of the line in space."""
        return math.dist(self.start[:3], self.end[:3])

    def joints_at(self, done: float) -> Joints:
        """Straight in space."""
        return inverse(ToolPose(*between(self.start, self.end, done)), self.hand)


@dataclass(frozen=True, slots=True)
class ArcWay:
    """The tool on an arc in the plane, the elbow on one side; z and r change evenly along it."""

    start: ToolPose
    end: ToolPose
    hand: Hand
    centre: tuple[float, float]
    sweep_rad: float  # counter-clockwise positive

    @property
    def length_mm(self) -> float:
        """Of the arc in space."""
        radius_mm = math.dist(self.centre, self.start[:2])
        return math.hypot(radius_mm * self.sweep_rad, self.end.z_mm - self.start.z_mm)

    def joints_at(self, done: float) -> Joints:
        """Round the centre."""
        cx, cy = self.centre
        dx, dy = self.start.x_mm - cx, self.start.y_mm - cy
        c, s = math.cos(self.sweep_rad * done), math.sin(self.sweep_rad * done)
        _, _, z_mm, r_deg = between(self.start, self.end, done)
        return inverse(ToolPose(cx + c * dx - s * dy, cy + s * dx + c * dy, z_mm, r_deg), self.hand)


def arc(start: ToolPose, via: ToolPose, end: ToolPose, hand: Hand) -> ArcWay:
    """The arc through three positions; raises Unreachable when they are no circle."""
    (ax, ay), (bx, by), (cx, cy) = start[:2], via[:2], end[:2]
    doubled = 2 * ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
    if min(math.dist(start[:2], via[:2]), math.dist(via[:2], end[:2]), math.dist(start[:2], end[:2])) < 1e-3:
        raise Unreachable("same", "two of the three positions are the same")
    if abs(doubled) < 1e-3:
        raise Unreachable("line", "the three positions lie on a line")
    b2, c2 = (bx - ax) ** 2 + (by - ay) ** 2, (cx - ax) ** 2 + (cy - ay) ** 2
    centre = ax + ((cy - ay) * b2 - (by - ay) * c2) / doubled, ay + ((bx - ax) * c2 - (cx - ax) * b2) / doubled
    first, last = (math.atan2(y - centre[1], x - centre[0]) for x, y in ((ax, ay), (cx, cy)))
    sweep = (last - first) % math.tau if doubled > 0 else -((first - last) % math.tau)
    return ArcWay(start, end, hand, centre, sweep)


def joint_rates(way: JointWay, scara: Scara) -> Rates:
    """As quick as the slowest axis."""
    slopes = tuple(abs(b - a) for a, b in zip(way.start, way.end, strict=True))
    return Rates(_rate(scara.fastest, slopes), _rate(scara.steepest, slopes))


def path_rates(way: LineWay | ArcWay, scara: Scara, path_mm_per_s: float | None = None) -> Rates:
    """As quick as the path and every axis on it allow; raises Unreachable when it leaves the range of one."""
    slopes = (*_steepest_joints(way, scara), way.length_mm)
    speed = path_mm_per_s or scara.line_mm_per_s
    return Rates(_rate((*scara.fastest, speed), slopes), _rate((*scara.steepest, scara.line_mm_per_s2), slopes))


def between(start: tuple[float, ...], end: tuple[float, ...], share: float) -> tuple[float, ...]:
    """Straight from start to end; exactly the end at 1."""
    return tuple(a + (b - a) * share for a, b in zip(start, end, strict=True)) if share != 1 else tuple(end)


def last_moved(way: Way) -> tuple[float, float, float]:
    """By how much the tool moves in x, y and r over the last hundredth of the way."""
    near, end = forward(way.joints_at(0.99)), forward(way.joints_at(1.0))
    return end.x_mm - near.x_mm, end.y_mm - near.y_mm, end.r_deg - near.r_deg


def _rate(limits: tuple[float, ...], slopes: tuple[float, ...]) -> float:
    """The highest rate of the whole way at which no axis passes its limit."""
    rates = (limit / slope for limit, slope in zip(limits, slopes, strict=True) if slope > SAME_MM)
    return min(rates, default=math.inf)


def _steepest_joints(way: LineWay | ArcWay, scara: Scara) -> tuple[float, ...]:
    """Each axis's largest change per fraction of the way."""
    scara.within(way.joints_at(1.0))
    try:
        joints = np.array([scara.within(way.joints_at(k / SAMPLES)) for k in range(SAMPLES + 1)])
    except Unreachable as outside:
        raise Unreachable("way", f"on the way: {outside}") from outside
    return tuple((np.abs(np.diff(joints, axis=0)).max(axis=0) * SAMPLES).tolist())
