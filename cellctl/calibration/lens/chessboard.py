"""Find a chessboard in a picture: OpenCV says roughly where its corners are, `corners` says exactly."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.errors import BoardNotFound
from cellctl.calibration.homography import homography, local_steps
from cellctl.calibration.lens.boards import Chessboard
from cellctl.calibration.lens.corners import refine_corners

FloatArray = NDArray[np.float64]
Pixels = NDArray[np.uint8]

COARSE_PX = 1280  # longest side of the picture in which corners are looked for
LEAST_GOOD = 0.7  # part of the corners that must look like corners
SMALLEST = (4, 4)
LEAST_SIDE_PX = 64


def find_chessboard(pixels: Pixels, board: Chessboard) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Inner corners (m, 2) in board order, and which look like corners (m,). Raises BoardNotFound, ValueError."""
    check_picture(pixels)
    coarse = _coarse(pixels, (board.columns, board.rows))
    if coarse is None:
        raise BoardNotFound("not found", f"no {board.text.removeprefix('a ')}", wanted=board.columns * board.rows)
    steps = local_steps(homography(board.points_mm / board.square_mm, coarse), board.points_mm / board.square_mm)
    points, good = refine_corners(pixels, coarse, steps)
    check_good(good, len(good))
    return points, good


def check_picture(pixels: Pixels) -> None:
    """Raise ValueError for what is no mono picture of 8 bit and of a size that OpenCV searches."""
    if pixels.ndim != 2 or pixels.dtype != np.uint8 or min(pixels.shape) < LEAST_SIDE_PX:
        raise ValueError(
            f"board: the picture must be (height, width) uint8, at least {LEAST_SIDE_PX} px on each side "
            f"(got {pixels.dtype} {pixels.shape})"
        )


def check_good(good: NDArray[np.bool_], wanted: int) -> None:
    """Raise BoardNotFound when too few of the corners that are there look like corners."""
    if good.sum() < LEAST_GOOD * len(good):
        raise BoardNotFound(
            "corners",
            f"only {int(good.sum())} of {len(good)} corners are where black and white meet: look at focus, glare, and "
            "whether the squares are large enough in the picture",
            seen=int(good.sum()),
            wanted=wanted,
        )


def chessboard_size(pixels: Pixels) -> tuple[int, int] | None:
    """Inner corners along and across of whatever chessboard is in the picture, None when there is none."""
    small, _ = _shrunk(pixels)
    found, _, meta = cv2.findChessboardCornersSBWithMeta(
        small, SMALLEST, cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    )
    return (int(meta.shape[1]), int(meta.shape[0])) if found else None


def _coarse(pixels: Pixels, size: tuple[int, int]) -> FloatArray | None:
    """Corners to a pixel or two of the picture in which they were looked for, None when there are not exactly these."""
    small, shrink = _shrunk(pixels)
    found, corners = cv2.findChessboardCorners(
        small, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if not found:
        found, corners = cv2.findChessboardCornersSB(small, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found:
        return None
    return np.asarray((corners.reshape(-1, 2).astype(np.float64) + 0.5) * shrink - 0.5, np.float64)


def _shrunk(pixels: Pixels) -> tuple[Pixels, FloatArray]:
    """The picture no larger than needed, and px per px of it along both axes."""
    height, width = pixels.shape
    part = min(1.0, COARSE_PX / max(pixels.shape))
    size = (max(1, round(width * part)), max(1, round(height * part)))
    small = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8) if part < 1 else pixels
    return small, np.array([width / size[0], height / size[1]])
