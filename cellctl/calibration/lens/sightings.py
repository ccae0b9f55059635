"""Any board in any picture, and many sightings as one set of views."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.board import DotBoard
from cellctl.calibration.dots import find_dots
from cellctl.calibration.errors import BoardNotFound
from cellctl.calibration.lens.boards import Board, CharucoBoard, Chessboard
from cellctl.calibration.lens.charuco import dictionary_seen, find_charuco
from cellctl.calibration.lens.chessboard import chessboard_size, find_chessboard
from cellctl.calibration.lens.model import Views

FloatArray = NDArray[np.float64]
Pixels = NDArray[np.uint8]

LEAST_SIZE_SEEN = 5  # inner corners along the longer side of something that is surely a chessboard


class Sighting(NamedTuple):
    """One board in one picture: its points (m, 2) px in board order, and which of them are seen (m,)."""

    points_px: FloatArray
    seen: NDArray[np.bool_]


def find_board(pixels: Pixels, board: Board) -> Sighting:
    """The board in a picture (height, width) uint8. Raises BoardNotFound."""
    try:
        if isinstance(board, DotBoard):
            dots = find_dots(pixels, board, mirrored=None)
            return Sighting(dots.centres_px, np.ones(board.count, np.bool_))
        if isinstance(board, CharucoBoard):
            return Sighting(*find_charuco(pixels, board))
        return Sighting(*find_chessboard(pixels, board))
    except ValueError as error:  # a picture too small for the finder
        raise BoardNotFound("picture", str(error)) from error


def views_of(sightings: Sequence[Sighting], board: Board, picture_px: tuple[int, int]) -> Views:
    """All sightings in pictures of one size."""
    return Views(
        board_mm=board.points_mm,
        points_px=np.array([sighting.points_px for sighting in sightings]),
        seen=np.array([sighting.seen for sighting in sightings]),
        picture_px=picture_px,
        diameters_mm=_diameters_mm(board) if isinstance(board, DotBoard) else None,
    )


def seen_instead(pictures: Sequence[Pixels], board: Board) -> str:
    """What is in pictures in which the board was not found, in words; empty when nothing like it is."""
    if isinstance(board, CharucoBoard):
        found = Counter(name for name, _ in filter(None, map(dictionary_seen, pictures)))
        texts = {name: f"markers of {name}" for name in found}
    elif isinstance(board, Chessboard):
        sizes = filter(None, map(chessboard_size, pictures))
        found = Counter(f"{max(size)}x{min(size)}" for size in sizes if max(size) >= LEAST_SIZE_SEEN)
        texts = {name: f"something like a chessboard of {name} inner corners" for name in found}
    else:
        return ""
    if not found:
        return ""
    name, count = found.most_common(1)[0]
    return f"{texts[name]} in {count} of {len(pictures)}"


def _diameters_mm(board: DotBoard) -> FloatArray:
    diameters = np.full(board.count, board.dot_mm)
    diameters[0] = board.origin_dot_mm
    return diameters
