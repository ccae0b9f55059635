"""Find a ChArUco board in a picture: OpenCV reads the markers, `corners` measures the corners between them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.errors import BoardNotFound
from cellctl.calibration.homography import homography, local_steps
from cellctl.calibration.lens.boards import DICTIONARIES, CharucoBoard
from cellctl.calibration.lens.chessboard import check_good, check_picture
from cellctl.calibration.lens.corners import WINDOW, refine_corners

FloatArray = NDArray[np.float64]
Pixels = NDArray[np.uint8]

LEAST_CORNERS = 8
LEAST_LINES = 3  # rows and columns that the corners seen must lie in
CLEAR = 0.8  # part of the white around a marker that is surely white


def find_charuco(pixels: Pixels, board: CharucoBoard) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Inner corners (m, 2) in the order of their numbers, and which are seen (m,). Raises BoardNotFound, ValueError."""
    check_picture(pixels)
    both_kinds = [_detected(pixels, board, legacy) for legacy in (False, True)]
    numbers, coarse, markers = max(both_kinds, key=lambda detected: len(detected[0]))
    wanted = len(board.points_mm)
    row, column = np.divmod(numbers, board.columns - 1)
    if len(numbers) < LEAST_CORNERS or min(len(set(row.tolist())), len(set(column.tolist()))) < LEAST_LINES:
        raise BoardNotFound(
            "corners",
            f"{len(numbers)} of {wanted} corners and {markers} markers of {board.dictionary}, {LEAST_CORNERS} corners "
            f"in {LEAST_LINES} rows and columns are needed",
            seen=len(numbers),
            wanted=wanted,
        )
    places = board.points_mm[numbers] / board.square_mm
    steps = local_steps(homography(places, coarse), places)
    band = min(WINDOW, CLEAR * (1 - board.marker_mm / board.square_mm) / 2)
    refined, good = refine_corners(pixels, coarse, steps, band)
    check_good(good, wanted)
    points, seen = np.zeros((wanted, 2)), np.zeros(wanted, np.bool_)
    points[numbers], seen[numbers] = refined, good
    return points, seen


def dictionary_seen(pixels: Pixels) -> tuple[str, int] | None:
    """The dictionary that most markers in the picture belong to, and how many do; None when there are none."""
    counts = {name: _marker_count(pixels, number) for name, number in sorted(DICTIONARIES.items())}
    best = max(counts, key=lambda name: counts[name])
    return (best, counts[best]) if counts[best] > 1 else None


def _detected(pixels: Pixels, board: CharucoBoard, legacy: bool) -> tuple[NDArray[np.int64], FloatArray, int]:
    """Numbers (k,) and rough places (k, 2) of corners, and how many markers; `legacy`: made before OpenCV 4.6."""
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[board.dictionary])
    drawn = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_mm, board.marker_mm, dictionary)
    drawn.setLegacyPattern(legacy)
    corners, numbers, _, markers = cv2.aruco.CharucoDetector(drawn).detectBoard(pixels)
    count = 0 if markers is None else len(markers)
    if numbers is None or corners is None:
        return np.zeros(0, np.int64), np.zeros((0, 2)), count
    return numbers.ravel().astype(np.int64), corners.reshape(-1, 2).astype(np.float64), count


def _marker_count(pixels: Pixels, dictionary: int) -> int:
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(dictionary))
    numbers = detector.detectMarkers(pixels)[1]
    return 0 if numbers is None else len(numbers)
