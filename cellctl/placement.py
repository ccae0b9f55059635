"""Where to place, and how sure we are: the errors of pictures, robot stops and teaching carried to the corners. Pure.

First-order propagation: every source is a small independent error of one pose in the chain
`robot_from_tool = robot_from_base @ base_from_battery @ inverse(tool_from_battery)`, with a standard deviation in
x and y and in angle, and a centre about which its angle acts. At a corner of the seated battery it contributes its
own x-y variance and its angle times the lever from its centre to that corner.
"""

import math
from typing import NamedTuple

from cellctl.geometry import Mm

P99_OF_A_CIRCLE = 3.035  # sqrt(-2 ln 0.01): 99 % of an isotropic plane normal lie within so many sigma


class Source(NamedTuple):
    """One independent error: sigma per axis, sigma of the angle, and the point about which the angle acts."""

    name: str
    sd_mm: float
    sd_deg: float
    centre: Mm  # in the battery frame


class Prediction(NamedTuple):
    """What is expected of a placement, at the worst of the four corners."""

    expected_mm: float  # root mean square
    p99_mm: float
    largest: str  # name of the largest source
    share: float  # its part of the variance

    @property
    def sentence(self) -> str:
        """For the log and the record."""
        return (
            f"expected {self.expected_mm * 1000:.0f} um, p99 {self.p99_mm * 1000:.0f} um, "
            f"largest share: {self.largest} ({self.share:.0%})"
        )


def predict(sources: list[Source], corners: list[Mm]) -> Prediction:
    """Propagate the sources to the corners of the battery and take the worst one."""
    worst = max(corners, key=lambda corner: sum(_variance(source, corner) for source in sources))
    shares = {source.name: _variance(source, worst) for source in sources}
    total = sum(shares.values())
    largest = max(shares, key=lambda name: shares[name])
    # Both axes together have `total`; taken as a circle, each axis has half of it.
    return Prediction(
        expected_mm=math.sqrt(total),
        p99_mm=P99_OF_A_CIRCLE * math.sqrt(total / 2),
        largest=largest,
        share=shares[largest] / total if total else 0.0,
    )


def _variance(source: Source, corner: Mm) -> float:
    lever_mm = math.hypot(corner.x_mm - source.centre.x_mm, corner.y_mm - source.centre.y_mm)
    return 2 * source.sd_mm**2 + (math.radians(source.sd_deg) * lever_mm) ** 2
