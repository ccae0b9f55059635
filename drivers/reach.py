"""Where the arm may be sent: our own model of its reach, asked before anything goes to the controller. Pure.

Axes as the controller has them: 1 and 2 turn the arms, 3 is z and points down, 4 turns the tool; r = 1 + 2 + 4.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from drivers.rcx import LEFTY, RIGHTY, Arch, Point, Position, Pulses

ALONG_MM = 5.0  # between the places of a straight way that are looked at
SIDES = {RIGHTY: "righty", LEFTY: "lefty", 0: "unknown"}
Range = tuple[str, float, float, float, str]  # name, value, low, high, unit


class Axes(NamedTuple):
    """The four axes."""

    axis_1_deg: float
    axis_2_deg: float
    z_mm: float
    axis_4_deg: float


class PulseLimits(NamedTuple):
    """The controller's pulses: how many per degree or mm of each axis, and its soft limits as they are set."""

    per: tuple[float, float, float, float]
    low: Pulses
    high: Pulses


@dataclass(frozen=True, slots=True)
class Limits:
    """Reach and soft limits of the arm as the cell may use it; the defaults are a YK400XG's.

    `pulses` when the controller's pulses are known; then every target is also checked against its own soft limits.
    """

    arm_1_mm: float = 225.0
    arm_2_mm: float = 175.0
    inner_reach_mm: float = 133.0  # the elbow ends at 132.4
    outer_reach_mm: float = 399.5
    z_min_mm: float = 0.0
    z_max_mm: float = 150.0
    r_min_deg: float = -360.0
    r_max_deg: float = 360.0
    axis_1_deg: float = 140.0  # to either side
    axis_2_deg: float = 144.0
    axis_4_deg: float = 360.0
    singular_deg: float = 6.0  # with axis 2 nearer to stretched arms no straight line can be followed
    pulses: PulseLimits | None = None

    def objection(self, to: Point, *, hand: int) -> str:
        """Why this target is out of bounds, with the numbers; "" when it is not."""
        if not all(math.isfinite(number) for number in to):
            return f"target {to} is no position"
        reach_mm = math.hypot(to.x_mm, to.y_mm)
        ranges: tuple[Range, ...] = (
            ("reach", reach_mm, self.inner_reach_mm, self.outer_reach_mm, "mm"),
            ("z", to.z_mm, self.z_min_mm, self.z_max_mm, "mm"),
            ("r", to.r_deg, self.r_min_deg, self.r_max_deg, "deg"),
        )
        why = _outside(ranges) or _outside(self._axis_ranges(to, hand)) or self._pulse_objection(to, hand)
        return f"target {to}: {why}" if why else ""

    def objection_to_line(self, start: Position, to: Point, *, hand: int) -> str:
        """Why the straight way from where the arm stands to an allowed point is out of bounds; "" when it is not."""
        if start.hand and start.hand != hand:
            return (
                f"a straight line cannot change the elbow from {SIDES[start.hand]} to {SIDES[hand]}: "
                "move point to point with that hand first"
            )
        return next((why for place in _along(start.point, to) if (why := self._line_objection(place, hand))), "")

    def objection_to_arch(self, start: Position, to: Point, arch: Arch, *, hand: int) -> str:
        """Why this arch is none; "" when it is one."""
        if start.hand and start.hand != hand:
            return f"an arch cannot change the elbow from {SIDES[start.hand]} to {SIDES[hand]}"
        if min(arch.rise_mm, arch.sink_mm) < 0 or not all(map(math.isfinite, arch)):
            return f"{arch} is no arch: its parts are lengths, 0 or more"
        ends = (("start", start.point.z_mm, arch.rise_mm), ("target", to.z_mm, arch.sink_mm))
        for end, z_mm, below_mm in ends:
            if not self.z_min_mm <= arch.top_z_mm <= z_mm - below_mm:
                return (
                    f"the arch's top at z {arch.top_z_mm:.3f} mm with {below_mm:g} mm below it is not between "
                    f"{self.z_min_mm:g} mm and its {end} at z {z_mm:.3f} mm"
                )
        return ""

    def axes(self, to: Point, *, hand: int) -> Axes:
        """The axes with the tool there; a place out of reach is taken as the nearest in its direction."""
        axis_1_deg, axis_2_deg = arm_angles_deg(to.x_mm, to.y_mm, (self.arm_1_mm, self.arm_2_mm), hand=hand)
        return Axes(axis_1_deg, axis_2_deg, to.z_mm, to.r_deg - axis_1_deg - axis_2_deg)

    def in_pulses(self, to: Point, *, hand: int) -> Pulses:
        """The same in pulses; raises ValueError when they are not known."""
        axes, per = self.axes(to, hand=hand), self._known_pulses().per
        return Pulses(*(round(value * ratio) for value, ratio in zip(axes, per, strict=True)))

    def from_pulses(self, pulses: Pulses) -> Position:
        """Where the tool is with the axes like this; raises ValueError when pulses are not known."""
        ratios = self._known_pulses().per
        q1_deg, q2_deg, z_mm, q4_deg = (count / ratio for count, ratio in zip(pulses, ratios, strict=True))
        q1, q12 = math.radians(q1_deg), math.radians(q1_deg + q2_deg)
        x_mm = self.arm_1_mm * math.cos(q1) + self.arm_2_mm * math.cos(q12)
        y_mm = self.arm_1_mm * math.sin(q1) + self.arm_2_mm * math.sin(q12)
        return Position(Point(x_mm, y_mm, z_mm, q1_deg + q2_deg + q4_deg), RIGHTY if q2_deg >= 0 else LEFTY)

    def _known_pulses(self) -> PulseLimits:
        if self.pulses is None:
            raise ValueError("the controller's pulses per degree and mm are not configured")
        return self.pulses

    def _axis_ranges(self, to: Point, hand: int) -> tuple[Range, ...]:
        axes = self.axes(to, hand=hand)
        return (
            ("axis 1", axes.axis_1_deg, -self.axis_1_deg, self.axis_1_deg, "deg"),
            ("axis 2", axes.axis_2_deg, -self.axis_2_deg, self.axis_2_deg, "deg"),
            ("axis 4", axes.axis_4_deg, -self.axis_4_deg, self.axis_4_deg, "deg"),
        )

    def _pulse_objection(self, to: Point, hand: int) -> str:
        if self.pulses is None:
            return ""
        each = zip(self.in_pulses(to, hand=hand), self.pulses.low, self.pulses.high, strict=True)
        return _outside((f"axis {k}", count, low, high, "pulses") for k, (count, low, high) in enumerate(each, 1))

    def _line_objection(self, place: Point, hand: int) -> str:
        from_column_mm = math.hypot(place.x_mm, place.y_mm)
        if from_column_mm < self.inner_reach_mm:
            return (
                f"the straight line passes {from_column_mm:.1f} mm from the column, "
                f"inside the inner reach of {self.inner_reach_mm:g} mm"
            )
        axis_2_deg = self.axes(place, hand=hand).axis_2_deg
        if abs(axis_2_deg) < self.singular_deg:
            return (
                f"the straight line passes {place}, where the arms are stretched (axis 2 at {axis_2_deg:.1f} deg): "
                "a line cannot be followed there, move point to point"
            )
        why = _outside(self._axis_ranges(place, hand))
        return f"the straight line passes {place}: {why}" if why else ""


def arm_angles_deg(x_mm: float, y_mm: float, arms_mm: tuple[float, float], *, hand: int) -> tuple[float, float]:
    """Axes 1 and 2 with the second arm's end at X, Y; a place out of reach is taken as the nearest in its direction."""
    a, b = arms_mm
    cosine = min(max((x_mm**2 + y_mm**2 - a * a - b * b) / (2 * a * b), -1.0), 1.0)
    axis_2 = math.acos(cosine) * (1 if hand == RIGHTY else -1)
    elbow = math.atan2(b * math.sin(axis_2), a + b * cosine)
    return math.degrees(math.remainder(math.atan2(y_mm, x_mm) - elbow, math.tau)), math.degrees(axis_2)


def _along(start: Point, to: Point) -> Iterable[Point]:
    """Places of a straight way: the one nearest to the column, both ends, and some between."""
    dx, dy = to.x_mm - start.x_mm, to.y_mm - start.y_mm
    length_mm = math.hypot(dx, dy)
    steps = max(math.ceil(length_mm / ALONG_MM), 1)
    nearest = -(start.x_mm * dx + start.y_mm * dy) / length_mm**2 if length_mm > 0 else 0.0
    for share in (min(max(nearest, 0.0), 1.0), *(k / steps for k in range(steps + 1))):
        yield Point(*(a + share * (b - a) for a, b in zip(start, to, strict=True)))


def _outside(ranges: Iterable[Range]) -> str:
    for name, value, low, high, unit in ranges:
        if not low <= value <= high:
            digits = 0 if unit == "pulses" else 3
            return f"{name} {value:.{digits}f} {unit} is outside {low:g} .. {high:g} {unit}"
    return ""
