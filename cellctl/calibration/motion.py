"""What a set of robot poses must offer so that hand-eye unknowns can be told apart. No pictures needed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellctl.calibration.errors import DegenerateMotion
from cellctl.geometry import Pose

LEAST_POSES = 5
LEAST_ROTATION_DEG = 30.0
LEAST_TRAVEL_MM = 1.0


class Spread(NamedTuple):
    """How far the poses lie apart: rotation, and travel along and across its longest direction."""

    rotation_deg: float
    travel_mm: float
    across_mm: float


def rotation_spread_deg(angles_deg: Sequence[float]) -> float:
    """The smallest arc of the circle that holds all angles."""
    on_circle = np.sort(np.asarray(angles_deg, float) % 360.0)
    gaps = np.diff(np.append(on_circle, on_circle[0] + 360.0))
    return float(360.0 - gaps.max())


def motion_spread(poses: Sequence[Pose]) -> Spread:
    """How far poses lie apart, leaving out the travel that the rotation alone explains.

    Travel along x + iy = a + b exp(i t), that is, turning about any fixed point of the tool, says nothing
    about the camera's direction: the map's rotation and the board's trade off exactly. So the travel that counts
    is what remains after the best such turn is taken away. It holds for both mounts.
    """
    table = np.array(poses, float).reshape(-1, 3)
    place = table[:, 0] + 1j * table[:, 1]
    turn = np.column_stack([np.ones(len(table)), np.exp(1j * np.radians(table[:, 2]))])
    free = place - turn @ np.linalg.lstsq(turn, place, rcond=None)[0]
    flat = np.column_stack([free.real, free.imag])
    along = np.linalg.svd(flat, full_matrices=False)[2]
    travel, across = np.ptp(flat @ along.T, axis=0).tolist()
    return Spread(rotation_spread_deg(table[:, 2].tolist()), travel, across)


def check_motion(poses: Sequence[Pose]) -> Spread:
    """The spread of the poses; raises DegenerateMotion when it is too small to solve the hand-eye."""
    if len(poses) < LEAST_POSES:
        raise DegenerateMotion(
            "pose count", f"{len(poses)} poses are given, at least {LEAST_POSES} are needed: plan more (15 is good)"
        )
    spread = motion_spread(poses)
    if spread.rotation_deg < LEAST_ROTATION_DEG:
        raise DegenerateMotion(
            "rotation spread",
            f"the tool turns by {spread.rotation_deg:.1f} deg in all, at least {LEAST_ROTATION_DEG:g} deg are "
            "needed: without rotation the camera's place, in x and in y, cannot be told from the board's; let the plan "
            "turn it by +-25 deg or more, or, for a camera on the second arm, use the elbow on both its sides",
        )
    if spread.travel_mm < LEAST_TRAVEL_MM:
        raise DegenerateMotion(
            "travel",
            f"apart from turning, the tool moves by {spread.travel_mm:.2f} mm in all, at least {LEAST_TRAVEL_MM:g} mm "
            "are needed: without travel the camera's direction cannot be told from the board's; spread the positions "
            "over +-2 mm in x and y",
        )
    if spread.across_mm < LEAST_TRAVEL_MM:
        raise DegenerateMotion(
            "travel on a line",
            f"apart from turning, the tool moves by {spread.travel_mm:.2f} mm along one line and only "
            f"{spread.across_mm:.2f} mm across it, at least {LEAST_TRAVEL_MM:g} mm are needed: across that line the "
            "picture's scale and direction would come from the board's drawing alone; spread the positions over +-2 mm "
            "in x and y",
        )
    return spread
