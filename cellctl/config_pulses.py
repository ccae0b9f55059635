"""The controller's own units, when the integrator has read them from its parameters: pulses and soft limits."""

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from cellctl.strict_toml import Contradiction, Settings
from drivers.rcx import Pulses
from drivers.reach import PulseLimits

AXES = 4
Ratios = Annotated[list[Annotated[float, Field(gt=0, le=100_000)]], Field(min_length=AXES, max_length=AXES)]
Counts = Annotated[list[Annotated[int, Field(ge=-(2**30), le=2**30)]], Field(min_length=AXES, max_length=AXES)]


class PulseConfig(Settings):
    """Of axes 1, 2, 3 (Z) and 4 (R). Every target is then also checked against the controller's own soft limits."""

    per_deg_or_mm: Ratios = Field(description="Pulses per degree of axes 1, 2 and 4, and per mm of axis 3")
    lowest: Counts = Field(description="Soft limits on the negative side, as the controller's parameters have them")
    highest: Counts = Field(description="Soft limits on the positive side")

    def contradictions(self) -> Iterator[Contradiction]:
        """Limits are in order."""
        for axis, (low, high) in enumerate(zip(self.lowest, self.highest, strict=True), 1):
            if low >= high:
                yield "lowest", f"of axis {axis} must be below its highest = {high}"

    @property
    def limits(self) -> PulseLimits:
        """The same for the model of the arm."""
        first, second, third, fourth = self.per_deg_or_mm
        return PulseLimits((first, second, third, fourth), Pulses(*self.lowest), Pulses(*self.highest))
