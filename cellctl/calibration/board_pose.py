"""Where a board lies in the plane that a camera sees, by the camera's map."""

from __future__ import annotations

import numpy as np

from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import FloatArray


def seen_boards(camera: PlaneMap, dots_px: FloatArray, board_mm: FloatArray) -> FloatArray:
    """Middle and turn of the board in each picture, (n, 3) mm, mm, rad, from dots (n, m, 2) of a board (m, 2) mm.

    Least squares: the middle of the dots, and the turn that fits them best about it.
    """
    seen = camera.mm_from_px(dots_px.reshape(-1, 2)).reshape(dots_px.shape)
    around, middles = board_mm - board_mm.mean(0), seen.mean(1)
    off = seen - middles[:, None]
    along = (off * around).sum((1, 2))
    across = (around[:, 0] * off[..., 1] - around[:, 1] * off[..., 0]).sum(1)
    return np.column_stack([middles, np.arctan2(across, along)])
