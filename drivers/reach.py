"""Where the arm may be sent: our own model of its reach, asked before anything goes to the controller. Pure."""

import math
from dataclasses import dataclass

from drivers.rcx import RIGHTY, Point


@dataclass(frozen=True, slots=True)
class Limits:
    """Reach and soft limits of the arm as the cell may use it; the defaults are a YK400XG's.

    Axes as the controller has them: 1 and 2 turn the arms, 4 turns the tool, z points down, r = 1 + 2 + 4.
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
    axis_4_deg: float = 360.0

    def objection(self, to: Point, *, hand: int) -> str:
        """Why this target is out of bounds, with the numbers; "" when it is not."""
        if not all(math.isfinite(number) for number in to):
            return f"target {to} is no position"
        reach_mm = math.hypot(to.x_mm, to.y_mm)
        ranges = (
            ("reach", reach_mm, self.inner_reach_mm, self.outer_reach_mm, "mm"),
            ("z", to.z_mm, self.z_min_mm, self.z_max_mm, "mm"),
            ("r", to.r_deg, self.r_min_deg, self.r_max_deg, "deg"),
        )
        return _outside(to, ranges) or _outside(to, self._axes(to, hand))

    def objection_to_line(self, start: Point, to: Point) -> str:
        """Why the straight way between two allowed points is out of bounds; "" when it is not."""
        dx, dy = to.x_mm - start.x_mm, to.y_mm - start.y_mm
        length_2 = dx * dx + dy * dy
        share = -(start.x_mm * dx + start.y_mm * dy) / length_2 if length_2 > 0 else 0.0
        share = min(max(share, 0.0), 1.0)
        nearest_mm = math.hypot(start.x_mm + share * dx, start.y_mm + share * dy)
        if nearest_mm >= self.inner_reach_mm:
            return ""
        return (
            f"the line from {start} to {to} passes {nearest_mm:.1f} mm from the column, "
            f"inside the inner reach of {self.inner_reach_mm:g} mm"
        )

    def _axes(self, to: Point, hand: int) -> tuple[tuple[str, float, float, float, str], ...]:
        axis_1_deg, axis_2_deg = arm_angles_deg(to.x_mm, to.y_mm, (self.arm_1_mm, self.arm_2_mm), hand=hand)
        return (
            ("axis 1", axis_1_deg, -self.axis_1_deg, self.axis_1_deg, "deg"),
            ("axis 4", to.r_deg - axis_1_deg - axis_2_deg, -self.axis_4_deg, self.axis_4_deg, "deg"),
        )


def arm_angles_deg(x_mm: float, y_mm: float, arms_mm: tuple[float, float], *, hand: int) -> tuple[float, float]:
    """Axes 1 and 2 with the second arm's end at X, Y; a place out of reach is taken as the nearest in its direction."""
    a, b = arms_mm
    cosine = min(max((x_mm**2 + y_mm**2 - a * a - b * b) / (2 * a * b), -1.0), 1.0)
    axis_2 = math.acos(cosine) * (1 if hand == RIGHTY else -1)
    elbow = math.atan2(b * math.sin(axis_2), a + b * cosine)
    return math.degrees(math.remainder(math.atan2(y_mm, x_mm) - elbow, math.tau)), math.degrees(axis_2)


def _outside(to: Point, ranges: tuple[tuple[str, float, float, float, str], ...]) -> str:
    for name, value, low, high, unit in ranges:
        if not low <= value <= high:
            return f"target {to}: {name} {value:.3f} {unit} is outside {low:g} .. {high:g} {unit}"
    return ""
