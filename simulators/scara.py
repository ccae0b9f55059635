"""The geometry and the limits of a four-axis arm: a YK400XG, and its successor YK400XE. Pure.

Sign conventions: x forward, y left, z DOWN from the top of its stroke, angles counter-clockwise from above.
Joints: j1 and j2 turn the two arms, z is the third axis, j4 turns the tool; r = j1 + j2 + j4.
"""

import math
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Literal, NamedTuple

ARM_1_MM, ARM_2_MM = 225.0, 175.0
SAME_MM = 1e-9
MOVED_KG = 3.0  # what the motors move besides the payload, as felt at the tool
CATALOGUE_KG = 2.0  # the payload of the catalogue's cycle time; less does not make the arm quicker


class Hand(IntEnum):
    """The side of the elbow, by the controller's flag. Righty is j2 > 0."""

    RIGHTY = 1
    LEFTY = 2


class ToolPose(NamedTuple):
    """The tool flange in robot coordinates."""

    x_mm: float
    y_mm: float
    z_mm: float
    r_deg: float


class Joints(NamedTuple):
    """The four axes."""

    j1_deg: float
    j2_deg: float
    z_mm: float
    j4_deg: float

    @property
    def hand(self) -> Hand:
        """The side on which the elbow is."""
        return Hand.RIGHTY if self.j2_deg >= 0 else Hand.LEFTY


class Unreachable(Exception):
    """The arm cannot go there: no such position, outside an axis, or out on the way, or the other hand.

    Or there is no such curve: an arc through two equal positions or three on a line, an arch below its ends.
    """

    def __init__(self, kind: Literal["position", "axis", "way", "hand", "same", "line", "arch"], detail: str) -> None:
        super().__init__(detail)
        self.kind = kind


@dataclass(frozen=True, slots=True)
class Scara:
    """One type of arm. Axes in the order of `Joints`; speeds and accelerations per second and second squared.

    Accelerations are the peaks of the S-shaped ramps, see `simulators.profile`.
    """

    name: str
    lowest: Joints
    highest: Joints
    fastest: tuple[float, float, float, float]
    steepest: tuple[float, float, float, float]
    line_mm_per_s: float
    line_mm_per_s2: float
    pulses: tuple[float, ...]  # per degree, degree, mm, degree
    payload_kg: float

    def within(self, joints: Joints) -> Joints:
        """The same joints; raises Unreachable when an axis would leave its range."""
        for axis, (value, low, high) in enumerate(zip(joints, self.lowest, self.highest, strict=True), 1):
            if not low - SAME_MM <= value <= high + SAME_MM:
                raise Unreachable("axis", f"axis {axis} would stand at {value:.3f}, outside {low:g} .. {high:g}")
        return joints

    def inverse(self, pose: ToolPose, hand: Hand) -> Joints:
        """The joints of this tool pose with the elbow on that side; raises Unreachable outside any limit."""
        return self.within(inverse(pose, hand))

    def as_set(self, *, pulse_scale: float, margin_deg: float) -> "Scara":
        """The same with other pulses, and with soft limits of both arms by so much inside their range."""
        a, b, z, r = self.lowest
        c, d, down, turn = self.highest
        return replace(
            self,
            lowest=Joints(a + margin_deg, b + margin_deg, z, r),
            highest=Joints(c - margin_deg, d - margin_deg, down, turn),
            pulses=tuple(ratio * pulse_scale for ratio in self.pulses),
        )

    def quickness(self, payload_kg: float) -> float:
        """The share of the steepest acceleration that is left with this payload."""
        return (MOVED_KG + CATALOGUE_KG) / (MOVED_KG + max(payload_kg, CATALOGUE_KG))


# 580 and 670 deg/s are 6.1 m/s at the stretched arm. The accelerations make the catalogue's standard cycle
# (there and back: 25 mm up, 300 mm across, 25 mm down, half of each vertical leg under the horizontal one)
# take 0.49 s. Nobody has published the pulse ratios of the XG; they are taken from the XE.
YK400XG = Scara(
    name="YK400XG",
    lowest=Joints(-140.0, -144.0, 0.0, -360.0),
    highest=Joints(140.0, 144.0, 150.0, 360.0),
    fastest=(580.0, 670.0, 1100.0, 1020.0),
    steepest=(12270.0, 14670.0, 24000.0, 20000.0),
    line_mm_per_s=1000.0,
    line_mm_per_s2=13330.0,
    pulses=(2912.711, 2912.711, 1638.4, 682.6667),
    payload_kg=5.0,
)
# Ranges as read from a controller in the field; the catalogue's standard cycle of 0.41 s.
YK400XE = Scara(
    name="YK400XE",
    lowest=Joints(-385506 / 2912.711, -437972 / 2912.711, -1707 / 1638.4, -360.0),
    highest=Joints(380555 / 2912.711, 439198 / 2912.711, 250000 / 1638.4, 360.0),
    fastest=(570.0, 660.0, 1100.0, 2600.0),
    steepest=(19000.0, 23000.0, 34000.0, 40000.0),
    line_mm_per_s=1000.0,
    line_mm_per_s2=13330.0,
    pulses=(2912.711, 2912.711, 1638.4, 682.6667),
    payload_kg=4.0,
)
MODELS = {scara.name.lower(): scara for scara in (YK400XG, YK400XE)}


def forward(joints: Joints) -> ToolPose:
    """The tool pose of these joints."""
    q1, q12 = math.radians(joints.j1_deg), math.radians(joints.j1_deg + joints.j2_deg)
    x_mm = ARM_1_MM * math.cos(q1) + ARM_2_MM * math.cos(q12)
    y_mm = ARM_1_MM * math.sin(q1) + ARM_2_MM * math.sin(q12)
    return ToolPose(x_mm, y_mm, joints.z_mm, joints.j1_deg + joints.j2_deg + joints.j4_deg)


def inverse(pose: ToolPose, hand: Hand) -> Joints:
    """The joints of this tool pose with the elbow on that side; raises Unreachable when there are none."""
    reach_mm = math.hypot(pose.x_mm, pose.y_mm)
    cosine = (reach_mm**2 - ARM_1_MM**2 - ARM_2_MM**2) / (2 * ARM_1_MM * ARM_2_MM)
    if not abs(cosine) <= 1 + SAME_MM:
        raise Unreachable("position", f"{reach_mm:.1f} mm from the column, the arms span 400 mm")
    q2 = math.acos(min(max(cosine, -1.0), 1.0)) * (1 if hand is Hand.RIGHTY else -1)
    elbow = math.atan2(ARM_2_MM * math.sin(q2), ARM_1_MM + ARM_2_MM * cosine)
    q1 = math.remainder(math.atan2(pose.y_mm, pose.x_mm) - elbow, math.tau)
    j1_deg, j2_deg = math.degrees(q1), math.degrees(q2)
    return Joints(j1_deg, j2_deg, pose.z_mm, pose.r_deg - j1_deg - j2_deg)
