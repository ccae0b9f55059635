"""How long a motion will take: what the arm can do, its S-shaped ramps, arches and blended legs. Pure.

A prediction for planning, for deadlines and for comparing an arm with its data sheet: nothing is commanded by it. All
axes of a motion point to point start and arrive together, so the slowest one rules; a straight line is as quick as its
own limits and every axis on it allow.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

from drivers.rcx import Arch, Motion, Point, Position
from drivers.reach import Limits, arm_angles_deg

RISE = 0.25  # of a ramp's time, in which its acceleration builds up, and as long it goes away again
SAMPLES = 64  # of a straight line, at which its axes are looked at
STILL = 1e-9  # mm or degrees: an axis that does not move
SEARCH_S = 1e-6

Four = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class Dynamics:
    """What an arm can do: axes 1, 2, 4 in degrees, axis 3 in mm, lines of the tool in mm.

    Accelerations are means over a ramp: top speed over the time to reach it. `overlap` is how near every axis must
    be to its end before the next motion may blend in (CONT). Speeds and accelerations are for `rated_kg`; a heavier
    load slows the ramps as a motor's torque does that also moves `moved_kg` of the arm itself.
    """

    axes_per_s: Four
    axes_per_s2: Four
    line_mm_per_s: float
    line_mm_per_s2: float
    overlap: Four
    moved_kg: float
    rated_kg: float

    def at_payload(self, kg: float) -> "Dynamics":
        """The same with this load."""
        share = (self.moved_kg + self.rated_kg) / (self.moved_kg + max(kg, self.rated_kg))
        first, second, third, fourth = (per_s2 * share for per_s2 in self.axes_per_s2)
        return replace(self, axes_per_s2=(first, second, third, fourth), line_mm_per_s2=self.line_mm_per_s2 * share)


# Catalogue: 6.1 m/s at the stretched arm, Z 1.1 m/s, R 1020 deg/s, 2 kg, standard cycle (25 mm up, 300 mm across,
# 25 mm down, and back, under an arch) 0.49 s. The catalogue states no accelerations: these give that cycle.
YK400XG = Dynamics(
    axes_per_s=(580.0, 670.0, 1100.0, 1020.0),
    axes_per_s2=(9200.0, 11000.0, 18000.0, 15000.0),
    line_mm_per_s=1000.0,
    line_mm_per_s2=10000.0,
    overlap=(0.687, 0.687, 1.22, 2.93),  # 2000 pulses
    moved_kg=3.0,
    rated_kg=2.0,
)


class Travel(NamedTuple):
    """One way from 0 to 1 with S-shaped ramps: how long it speeds up, cruises and slows down, and its top rate."""

    up_s: float
    cruise_s: float
    down_s: float
    top_per_s: float

    @property
    def takes_s(self) -> float:
        """From start to standing."""
        return self.up_s + self.cruise_s + self.down_s

    def done(self, since_s: float) -> float:
        """Which part of the way is behind the arm after so long."""
        if since_s <= 0 or since_s >= self.takes_s:
            return float(since_s > 0)
        if since_s < self.up_s:
            return self.top_per_s * self.up_s * _ramp_done(since_s / self.up_s)
        left_s = self.takes_s - since_s
        if left_s < self.down_s:
            return 1 - self.top_per_s * self.down_s * _ramp_done(left_s / self.down_s)
        return self.top_per_s * (self.up_s / 2 + since_s - self.up_s)

    def until_s(self, done: float) -> float:
        """How long it takes to come so far."""
        if done >= 1:
            return self.takes_s
        early_s, late_s = 0.0, self.takes_s
        while late_s - early_s > SEARCH_S:
            middle_s = (early_s + late_s) / 2
            early_s, late_s = (middle_s, late_s) if self.done(middle_s) < done else (early_s, middle_s)
        return late_s


class Timing(NamedTuple):
    """A motion's time, and when the next one may blend in."""

    takes_s: float
    may_follow_s: float


def timing(start: Position, motion: Motion, limits: Limits, dynamics: Dynamics) -> Timing:
    """How long the arm moves for this from standing at `start`, from its first acceleration to standing still.

    The elbow of `start` counts only for a motion point to point that changes it. Ends are not checked against limits.
    """
    begin, end = _axes(start.point, start.hand or motion.hand, limits), _axes(motion.to, motion.hand, limits)
    if motion.arch is not None:
        return _over_arch(begin, end, motion, motion.arch, dynamics)
    if motion.straight:
        return _ended(_line(start.point, motion, limits, dynamics), begin, end, dynamics)
    return _ended(_point_to_point(begin, end, motion, dynamics), begin, end, dynamics)


def duration_s(start: Position, motion: Motion, limits: Limits, dynamics: Dynamics) -> float:
    """How long the arm moves for this from standing at `start`."""
    return timing(start, motion, limits, dynamics).takes_s


def through_s(
    start: Position, motions: Sequence[Motion], limits: Limits, dynamics: Dynamics, *, turn_s: float = 0.0
) -> float:
    """How long several motions take, one after the other, each that `blends` overlapped by the next.

    `turn_s`: how long the next command takes to follow an END.
    """
    at, begins_s, ends_s = start, 0.0, 0.0
    for motion in motions:
        takes_s, may_follow_s = timing(at, motion, limits, dynamics)
        ends_s = max(ends_s, begins_s + takes_s)
        begins_s = (begins_s + may_follow_s if motion.blends else ends_s) + turn_s
        at = Position(motion.to, motion.hand)
    return ends_s


def _axes(at: Point, hand: int, limits: Limits) -> Four:
    first, second = arm_angles_deg(at.x_mm, at.y_mm, (limits.arm_1_mm, limits.arm_2_mm), hand=hand)
    return first, second, at.z_mm, at.r_deg - first - second


def _point_to_point(begin: Four, end: Four, motion: Motion, dynamics: Dynamics) -> Travel:
    by = tuple(abs(b - a) for a, b in zip(begin, end, strict=True))
    return _travel(_rate(dynamics.axes_per_s, by), _rate(dynamics.axes_per_s2, by), motion)


def _line(start: Point, motion: Motion, limits: Limits, dynamics: Dynamics) -> Travel:
    """The steepest stretch of each axis rules over the whole line."""
    places = [_between(start, motion.to, k / SAMPLES) for k in range(SAMPLES + 1)]
    axes = [_axes(place, motion.hand, limits) for place in places]
    steepest = [max(abs(after[k] - before[k]) for before, after in pairwise(axes)) * SAMPLES for k in range(4)]
    by = (*steepest, math.dist(start[:3], motion.to[:3]))
    return _travel(
        _rate((*dynamics.axes_per_s, dynamics.line_mm_per_s), by),
        _rate((*dynamics.axes_per_s2, dynamics.line_mm_per_s2), by),
        motion,
    )


def _over_arch(begin: Four, end: Four, motion: Motion, arch: Arch, dynamics: Dynamics) -> Timing:
    """Up, across, down: the way across begins before the top is reached and ends when the way down has begun."""
    over, above = (*begin[:2], arch.top_z_mm, begin[3]), (*end[:2], arch.top_z_mm, end[3])
    up = _point_to_point(begin, over, motion, dynamics)
    across = _point_to_point(over, above, motion, dynamics)
    down = _point_to_point(above, end, motion, dynamics)
    across_begins_s = up.until_s(1 - _share(arch.rise_mm, begin[2] - arch.top_z_mm))
    across_ends_s = across_begins_s + across.takes_s
    early_s = down.until_s(_share(arch.sink_mm, end[2] - arch.top_z_mm)) if arch.sink_mm else 0.0
    down_begins_s = max(across_ends_s - early_s, up.takes_s)
    last = _ended(down, above, end, dynamics)
    return Timing(
        max(down_begins_s + last.takes_s, across_ends_s), max(down_begins_s + last.may_follow_s, across_ends_s)
    )


def _ended(travel: Travel, begin: Four, end: Four, dynamics: Dynamics) -> Timing:
    """When every axis is within its overlap."""
    shares = [
        within / abs(b - a) for within, a, b in zip(dynamics.overlap, begin, end, strict=True) if abs(b - a) > STILL
    ]
    return Timing(travel.takes_s, travel.until_s(max(1 - min(shares, default=0.0), 0.0)))


def _travel(speed_per_s: float, accel_per_s2: float, motion: Motion) -> Travel:
    """The quickest way from 0 to 1 within a share of these rates per second."""
    if math.isinf(accel_per_s2):
        return Travel(0.0, 0.0, 0.0, math.inf)
    accel = accel_per_s2 * motion.ramps.accel_pct / 100
    decel = accel_per_s2 * motion.ramps.decel_pct / 100
    top = min(speed_per_s * motion.speed_pct / 100, math.sqrt(2 * accel * decel / (accel + decel)))
    up_s, down_s = top / accel, top / decel
    return Travel(up_s, max(1 / top - (up_s + down_s) / 2, 0.0), down_s, top)


def _rate(limits: Sequence[float], by: Sequence[float]) -> float:
    """The highest rate of the whole way at which no axis passes its limit."""
    rates = (limit / way for limit, way in zip(limits, by, strict=True) if way > STILL)
    return min(rates, default=math.inf)


def _ramp_done(u: float) -> float:
    """The way of a ramp after a share of its time, in units of top rate times its time: 1/2 at its end."""
    peak = 1 / (1 - RISE)
    if u < RISE:
        return peak * u**3 / (6 * RISE)
    if u <= 1 - RISE:
        return peak * (u * u / 2 - RISE * u / 2 + RISE * RISE / 6)
    return u - 0.5 + peak * (1 - u) ** 3 / (6 * RISE)


def _share(part: float, whole: float) -> float:
    return min(max(part / whole, 0.0), 1.0) if whole > STILL else 0.0


def _between(start: Point, end: Point, share: float) -> Point:
    return Point(*(a + (b - a) * share for a, b in zip(start, end, strict=True)))
