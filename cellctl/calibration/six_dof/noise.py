"""How noisy sightings are, from their residuals; and which of them are no noise but wrong."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.six_dof.adjust import Sigmas
from cellctl.calibration.six_dof.pairs import Pairs, motion_indices, motions
from cellctl.calibration.six_dof.rigid import FloatArray, vector_from_rotation

MEDIAN_OF_NORMAL = 0.6745  # median of |x| in sigmas
FEW = 5.0  # medians of few residuals are too small (Rousseeuw and Leroy 1987)
OUT_SQUARED = 27.86  # of six squared sigmas: one good sighting in 10,000 is beyond
SCREW_SD = 8.0
LEAST_MM, LEAST_DEG = 1e-7, 1e-9  # exact data have no noise; a sigma of 0 would divide by 0
COMPONENTS = ((0, 1), (2,), (3, 4), (5,))  # residuals of one kind: lateral, depth, tilt, roll


def robust_sigmas(residuals: FloatArray) -> Sigmas:
    """From medians, so that up to half of the sightings may be wrong. `residuals` (n, 6), mm and rad."""
    few = 1 + FEW / max(len(residuals) - 2, 1)
    spans = [few * float(np.median(np.abs(residuals[:, columns]))) / MEDIAN_OF_NORMAL for columns in COMPONENTS]
    return _sigmas(spans)


def sigmas(residuals: FloatArray, unknowns: int) -> Sigmas:
    """Root mean squares, corrected for the unknowns that were fitted. `residuals` (n, 6) of good sightings."""
    freedom = max(residuals.size - unknowns, 1) / residuals.size
    return _sigmas([math.sqrt(float((residuals[:, columns] ** 2).mean()) / freedom) for columns in COMPONENTS])


def wrong(residuals: FloatArray, expected: Sigmas) -> NDArray[np.bool_]:
    """Which sightings (n,) are too far off to be noise."""
    squared = ((residuals / expected.of_residuals) ** 2).sum(1)
    return np.asarray(squared > OUT_SQUARED, np.bool_)


def screws_disagree(pairs: Pairs) -> NDArray[np.bool_]:
    """Which poses (n,) turn by another angle than the camera saw, against most of the others.

    The angle of a motion is the same for the arm and for the camera whatever X is (screw congruence), so this needs
    no solution and no start.
    """
    first, second = motion_indices(len(pairs))
    angles = [
        np.linalg.norm(vector_from_rotation(motions(poses, (first, second))[:, :3, :3]), axis=1)
        for poses in (pairs.arm, pairs.target)
    ]
    away = np.abs(angles[0] - angles[1])
    of_pose = np.array([np.median(away[(first == i) | (second == i)]) for i in range(len(pairs))])
    usual = float(np.median(of_pose))
    return np.asarray(of_pose > SCREW_SD * max(usual, math.radians(LEAST_DEG)), np.bool_)


def swing_together(residuals: FloatArray) -> float:
    """How many residuals in a row say the same: 1 for white noise, more when neighbours in time are alike."""
    if len(residuals) < 20:
        return 1.0
    scaled = residuals / np.sqrt((residuals**2).mean(0))
    alike = min(max(float((scaled[1:] * scaled[:-1]).mean()), 0.0), 0.95)
    return (1 + alike) / (1 - alike)


def _sigmas(spans: list[float]) -> Sigmas:
    lateral, depth, tilt, roll = spans
    return Sigmas(
        max(lateral, LEAST_MM),
        max(depth, LEAST_MM),
        max(math.degrees(tilt), LEAST_DEG),
        max(math.degrees(roll), LEAST_DEG),
    )
