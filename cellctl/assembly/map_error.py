"""What the error of a camera's map does to a part's difference from the taught one. Pure.

The error of a map is the same for the taught and the found part. Each of them errs in its own frame, so nearly all of
it cancels; what is left grows with the distance and the angle between them. An offset of camera 2's map against the
tool's rotation centre is left over when a battery lies turned in the cup: that is how the tool centre comes in.
"""

import math
from typing import NamedTuple

import numpy as np

from cellctl.calibration.accuracy import Mark, pose_jacobian
from cellctl.calibration.plane_map import PlaneMap
from cellctl.geometry import Pose
from cellctl.placement import Errors, Floats

STEPS = Pose(1.0, 0.0, 0.0), Pose(0.0, 1.0, 0.0), Pose(0.0, 0.0, 1.0)
STEP = np.array([1.0, 1.0, math.radians(1.0)])
DEG_TO_RAD = np.diag([1.0, 1.0, math.pi / 180.0])


class MapError(NamedTuple):
    """Linear about the taught pose: parts lie within some mm and degrees of it."""

    taught: Pose  # of the part in the map's frame
    parameters: Errors  # of the calibration
    slopes: Floats  # (3, 3, parameters): the part's error per mm, mm, rad that it lies away from its taught pose

    @classmethod
    def of(cls, name: str, plane: PlaneMap, covariance: Floats, taught: Pose, mark: Mark) -> "MapError":
        """From the covariance of a map's PARAMETERS; `mark` is what is measured of the part, in the part's frame."""
        here, *there = (
            DEG_TO_RAD @ pose_jacobian(plane, pose, mark) for pose in (taught, *(taught @ step for step in STEPS))
        )
        slopes = np.stack([(jacobian - here) / step for jacobian, step in zip(there, STEP.tolist(), strict=True)])
        return cls(taught, Errors.of(name, covariance), slopes)

    def at(self, found: Pose) -> Errors:
        """3 rows of the found part."""
        return self.parameters.mapped(np.tensordot(twist(self.taught, found), self.slopes, 1))


def twist(taught: Pose, found: Pose) -> Floats:
    """By how much a pose near the taught one deviates from it, in its own frame: x mm, y mm, turn rad."""
    off = taught.inverse() @ found
    return np.array([off.x_mm, off.y_mm, math.radians(off.t_deg)])
