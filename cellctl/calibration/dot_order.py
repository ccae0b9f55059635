"""Which dot of the board each seen one is: the larger dot at a corner says how the board lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.board import DotBoard
from cellctl.calibration.errors import BoardNotFound
from cellctl.calibration.lattice import Lattice

FloatArray = NDArray[np.float64]

LEAST_ORIGIN_RATIO = 0.75  # part of the drawn area ratio of the origin dot


def board_order(
    lattice: Lattice, areas_px: FloatArray, board: DotBoard, mirrored: bool | None
) -> tuple[NDArray[np.int64], FloatArray]:
    """Index of the candidate for every dot in board order, and the area (n,) px that a usual dot would have there.

    `areas_px` are those of all candidates; `mirrored` None takes the board either way. Raises BoardNotFound.
    """
    usual, origin = _usual_areas(lattice.places, areas_px[lattice.members])
    corner, size = lattice.places[origin], np.array(lattice.size)
    _check_origin(float(areas_px[lattice.members[origin]] / usual[origin]), corner, size, board, len(usual))
    from_corner = np.abs(lattice.places - corner)
    steps = lattice.steps_px * np.where(corner == 0, 1, -1)[:, None]
    square = board.columns == board.rows  # such a board may be read along either side: take the one as described
    if lattice.size[0] != board.columns or (square and mirrored not in (None, _is_mirrored(steps))):
        from_corner, steps = from_corner[:, ::-1], steps[::-1]
    if mirrored not in (None, _is_mirrored(steps)):
        seen, described = ("as it is", "mirrored") if mirrored else ("mirrored", "as it is")
        raise BoardNotFound(
            "mirrored",
            f"the board appears {seen}, but this camera is described as seeing things {described}: is the plate "
            "upside down, the picture flipped, or the wrong camera set?",
            seen=len(usual),
            wanted=board.count,
        )
    order, expected = np.empty(board.count, dtype=np.int64), np.empty(board.count)
    index = from_corner[:, 1] * board.columns + from_corner[:, 0]
    order[index], expected[index] = lattice.members, usual
    return order, expected


def _usual_areas(places: NDArray[np.int64], areas: FloatArray) -> tuple[FloatArray, int]:
    """Areas that change evenly over the board, as they do when it is seen askew, and which dot exceeds its most."""
    design = np.column_stack([places, np.ones(len(places))])
    logarithm = np.log(areas)
    hat = design @ np.linalg.pinv(design)
    alone = (logarithm - hat @ logarithm) / np.maximum(1 - np.diag(hat), 0.1)  # each against the others
    origin = int(alone.argmax())
    others = np.arange(len(areas)) != origin
    found = np.linalg.lstsq(design[others], logarithm[others], rcond=None)[0]
    return np.asarray(np.exp(design @ found), np.float64), origin


def _check_origin(ratio: float, corner: NDArray[np.int64], size: NDArray[np.int64], board: DotBoard, seen: int) -> None:
    wanted = (board.origin_dot_mm / board.dot_mm) ** 2
    at_corner = bool(np.all((corner == 0) | (corner == size - 1)))
    if not at_corner or ratio < LEAST_ORIGIN_RATIO * wanted:
        raise BoardNotFound(
            "origin dot",
            f"the largest dot is {ratio:.2f} times a usual one ({wanted:.2f} wanted) and "
            f"{'at' if at_corner else 'not at'} a corner: clean the board, or is it another board?",
            seen=seen,
            wanted=board.count,
        )


def _is_mirrored(steps_px: FloatArray) -> bool:
    return bool(np.linalg.det(steps_px) < 0)
