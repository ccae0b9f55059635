"""Where the centre of a round dot appears to be: not where its centre is seen, when there is perspective.

A disk seen askew is an ellipse whose middle lies beside the picture of the disk's centre, away from the far side. What
a finder measures is that middle (more exactly the centre of area of the seen shape, which the lens' distortion moves
a little further). Source: J. Heikkila, Geometric camera calibration using circular control points, 2000.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

CORNERS = 64  # of the polygon that stands for a disk: its centre is right to 0.3 % of the shift
_ANGLES = np.arange(CORNERS) * (2 * math.pi / CORNERS)
RING = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])


def disk_centres(see: Callable[[FloatArray], FloatArray], points: FloatArray, diameters: FloatArray) -> FloatArray:
    """Centres of area (N, 2) in the picture of disks of these diameters (N,) around points (N, 2) of a plane.

    `see` maps points (M, 2) of the plane to (M, 2) px.
    """
    around = points[:, None] + RING * (diameters / 2)[:, None, None]
    outline = see(around.reshape(-1, 2)).reshape(around.shape)
    middle = outline.mean(1, keepdims=True)
    start = outline - middle
    end = np.roll(start, -1, axis=1)
    cross = start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]
    moment = ((start + end) * cross[..., None]).sum(1)
    return np.asarray(middle[:, 0] + moment / (3 * cross.sum(1))[:, None], np.float64)
