"""What carries camera 1, and where that is while the tool stands somewhere. Pure.

Camera 1 is on the tool, which turns with R, or on the second arm, which turns with the axes of X and Y alone and does
not move with Z. Both have their origin on the tool's axis, so only their directions differ: the tool's is R, the second
arm's is its own, from the elbow to the tool. Millimetres of camera 1's map are in this frame, the mount.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Mm, Pose, wrap_deg
from drivers.rcx import LEFTY, RIGHTY
from drivers.reach import arm_angles_deg

Part = Literal["tool", "arm_2"]
Elbow = Literal["righty", "lefty"]
FLAGS: dict[Elbow, int] = {"righty": RIGHTY, "lefty": LEFTY}
FORM_RAD = 2e-6  # how well the second arm's direction follows from X and Y, besides the robot's repeatability


class OutOfReach(ValueError):
    """The arm cannot bring the camera there."""


class Stop(NamedTuple):
    """A pose of the tool, robot_from_tool, and the side of the elbow it is reached with."""

    tool: Pose
    elbow: Elbow


@dataclass(frozen=True, slots=True)
class Mount:
    """The carrier of camera 1, and the arm with the elbow that production works with."""

    part: Part
    arm_1_mm: float
    arm_2_mm: float
    elbow: Elbow

    def frame(self, robot_from_tool: Pose, elbow: Elbow | None = None) -> Pose:
        """robot_from_mount while the tool stands there."""
        if self.part == "tool":
            return robot_from_tool
        axis_1_deg, axis_2_deg = self._angles_deg(robot_from_tool, elbow or self.elbow)
        return robot_from_tool._replace(t_deg=wrap_deg(axis_1_deg + axis_2_deg))

    def tool_showing(self, point: Mm, axis: Mm, r_deg: float, elbow: Elbow | None = None) -> Pose:
        """Where the tool stands, turned by R, with a point of the mount, the camera's `axis`, over a point of the cell.

        Raises OutOfReach.
        """
        if self.part == "tool":
            there = Pose(0.0, 0.0, r_deg).point(*axis)
            return Pose(point.x_mm - there.x_mm, point.y_mm - there.y_mm, r_deg)
        arm_2_deg = self._arm_2_deg(point, axis, elbow or self.elbow)
        there = Pose(0.0, 0.0, arm_2_deg).point(*axis)
        return Pose(point.x_mm - there.x_mm, point.y_mm - there.y_mm, r_deg)

    def axes_deg(self, stop: Stop) -> tuple[float, float]:
        """Axes 1 and 2 of the arm at a stop."""
        return self._angles_deg(stop.tool, stop.elbow)

    def elbow_and_tool(self, axis_1_deg: float, axis_2_deg: float) -> tuple[Mm, Mm]:
        """Where elbow and tool are when the axes stand like this."""
        elbow = Pose(0.0, 0.0, axis_1_deg).point(self.arm_1_mm, 0.0)
        return elbow, Pose(*elbow, axis_1_deg + axis_2_deg).point(self.arm_2_mm, 0.0)

    def scatter(self, stops: Sequence[Stop], sd_mm: float, sd_deg: float) -> NDArray[np.float64]:
        """What three independent standard errors of the robot do to the mount at stops, (n, 3, 3) mm, mm, rad by error.

        The second arm's direction follows from X and Y, so it errs with them, and not with R.
        """
        each = np.zeros((len(stops), 3, 3))
        each[:, 0, 0] = each[:, 1, 1] = sd_mm
        each[:, 2, 2] = math.radians(sd_deg) if self.part == "tool" else FORM_RAD
        for turned, stop in zip(each, stops if self.part == "arm_2" else (), strict=False):
            first, second = np.radians(self._angles_deg(stop.tool, stop.elbow))
            turned[2, :2] = -np.array([np.cos(first), np.sin(first)]) * sd_mm / (self.arm_2_mm * np.sin(second))
        return each

    def _angles_deg(self, tool: Pose, elbow: Elbow) -> tuple[float, float]:
        return arm_angles_deg(tool.x_mm, tool.y_mm, (self.arm_1_mm, self.arm_2_mm), hand=FLAGS[elbow])

    def _arm_2_deg(self, point: Mm, axis: Mm, elbow: Elbow) -> float:
        """Direction of the second arm with the camera over a point: the camera ends a second arm that is longer."""
        along_mm, aside_mm = self.arm_2_mm + axis.x_mm, axis.y_mm
        longer_mm, aside_deg = math.hypot(along_mm, aside_mm), math.degrees(math.atan2(aside_mm, along_mm))
        far_mm = math.hypot(*point)
        low_mm, high_mm = abs(self.arm_1_mm - longer_mm), self.arm_1_mm + longer_mm
        if not low_mm < far_mm < high_mm:
            raise OutOfReach(
                f"camera 1 on the second arm comes {low_mm:.1f} to {high_mm:.1f} mm far from the first axis, "
                f"({point.x_mm:.1f}, {point.y_mm:.1f}) is {far_mm:.1f} mm away"
            )
        axis_1_deg, axis_2_deg = arm_angles_deg(*point, (self.arm_1_mm, longer_mm), hand=FLAGS[elbow])
        if math.copysign(1.0, axis_2_deg - aside_deg) != math.copysign(1.0, axis_2_deg):
            raise OutOfReach(
                f"camera 1 comes over ({point.x_mm:.1f}, {point.y_mm:.1f}) with the elbow on no {elbow} side"
            )
        return wrap_deg(axis_1_deg + axis_2_deg - aside_deg)
