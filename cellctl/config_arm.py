"""How quick the robot's arm is, as its data sheet or the integrator says, for predicting times."""

from dataclasses import replace
from typing import Annotated

from pydantic import Field

from cellctl.strict_toml import Settings
from drivers.motion import YK400XG, Dynamics

Turning = Annotated[float, Field(gt=0, le=100_000)]
Sliding = Annotated[float, Field(gt=0, le=1_000_000)]


class ArmSpeeds(Settings):
    """Top speeds, and mean accelerations over a ramp: top speed over the time to reach it. A YK400XG's by default."""

    axis_1_deg_per_s: Turning = Field(default=YK400XG.axes_per_s[0], description="Top speed of axis 1 (X) in deg/s")
    axis_2_deg_per_s: Turning = Field(default=YK400XG.axes_per_s[1], description="Top speed of axis 2 (Y) in deg/s")
    z_mm_per_s: Sliding = Field(default=YK400XG.axes_per_s[2], description="Top speed of Z in mm/s")
    r_deg_per_s: Turning = Field(default=YK400XG.axes_per_s[3], description="Top speed of R in deg/s")
    axis_1_deg_per_s2: Turning = Field(default=YK400XG.axes_per_s2[0], description="Acceleration of axis 1 in deg/s2")
    axis_2_deg_per_s2: Turning = Field(default=YK400XG.axes_per_s2[1], description="Acceleration of axis 2 in deg/s2")
    z_mm_per_s2: Sliding = Field(default=YK400XG.axes_per_s2[2], description="Acceleration of Z in mm/s2")
    r_deg_per_s2: Turning = Field(default=YK400XG.axes_per_s2[3], description="Acceleration of R in deg/s2")

    @property
    def dynamics(self) -> Dynamics:
        """The same for the prediction; lines, loads and overlaps as a YK400XG has them."""
        speeds = self.axis_1_deg_per_s, self.axis_2_deg_per_s, self.z_mm_per_s, self.r_deg_per_s
        ramps = self.axis_1_deg_per_s2, self.axis_2_deg_per_s2, self.z_mm_per_s2, self.r_deg_per_s2
        return replace(YK400XG, axes_per_s=speeds, axes_per_s2=ramps)
