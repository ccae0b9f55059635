"""What a hand-eye solution consists of, and how much of it is believed before any picture is taken."""

from __future__ import annotations

import math

import numpy as np

from cellctl.calibration.plane_map import Lens
from cellctl.calibration.scara import FloatArray

PARAMETERS = (
    "a11_px_per_mm", "a12_px_per_mm", "a21_px_per_mm", "a22_px_per_mm", "offset_u_px", "offset_v_px",
    "board_x_mm", "board_y_mm", "board_t_rad",
    "k1_per_px2", "centre_u_px", "centre_v_px", "k2_per_px4", "k3_per_px6", "p1_per_px", "p2_per_px",
    "perspective_x_per_mm", "perspective_y_per_mm", "slope_u_px_per_mm", "slope_v_px_per_mm", "approach_per_mm",
)  # fmt: skip
SHARED = len(PARAMETERS)  # before the three corrections of each pose
MATRIX, OFFSET, BOARD = slice(0, 4), slice(4, 6), slice(6, 9)
CENTRE = slice(10, 12)
COEFFICIENTS = (9, 12, 13, 14, 15)  # in distortion.py's order
PERSPECTIVE, SLOPE, APPROACH = slice(16, 18), slice(18, 20), 20
BELIEVED = slice(9, SHARED)  # those with a prior

CENTRE_SD_PX = 100.0  # how far a lens' centre may be off the picture's
TILT_SD_DEG = 3.0
NEAREST_MM = 50.0  # working distance of a pinhole camera, at least
FIXED = 1e-9  # part of what would matter: so little is as good as nothing
BENT: dict[Lens, tuple[float, ...]] = {  # what each term may bend the picture's corner by, part of the radius
    "telecentric": (0.0025, FIXED, FIXED, FIXED, FIXED),
    "pinhole": (0.2, 0.2, 0.1, 0.005, 0.005),
}


def prior_sd(lens: Lens, picture_px: tuple[int, int], px_per_mm: float) -> FloatArray:
    """Sigmas (12,) of the parameters from k1 on about "no lens, no tilt"; tiny for what this lens does not have."""
    corner_px = math.hypot(*picture_px) / 2
    powers = (2, 4, 6, 1, 1)
    k1, *others = (bent / corner_px**power for bent, power in zip(BENT[lens], powers, strict=True))
    tilt = math.tan(math.radians(TILT_SD_DEG))
    seen = 1.0 if lens == "pinhole" else FIXED
    perspective, approach = seen * tilt / NEAREST_MM, seen / NEAREST_MM
    slope = tilt * px_per_mm
    return np.array([k1, CENTRE_SD_PX, CENTRE_SD_PX, *others, perspective, perspective, slope, slope, approach])
