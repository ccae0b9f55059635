"""Boards that a lens can be calibrated with, and how a person writes them down.

chessboard:9x6:25mm              inner corners along x and y, side of a square
dots:9x7:1.2mm:0.6mm:0.9mm       dots along x and y, pitch, diameter of a dot, diameter of the origin's dot
charuco:8x6:20mm:15mm:4x4_50     squares along x and y, side of a square, side of a marker, dictionary
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.board import DotBoard

FORMS = "chessboard:9x6:25mm, dots:9x7:1.2mm:0.6mm:0.9mm or charuco:8x6:20mm:15mm:4x4_50"
MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 0.001, "in": 25.4, "": 1.0}
LEAST_MM, MOST_MM = 0.001, 10_000.0
MOST_ALONG = 99
DICTIONARIES = {
    name.removeprefix("DICT_").lower(): int(getattr(cv2.aruco, name))
    for name in dir(cv2.aruco)
    if name.startswith("DICT_")
}


@dataclass(frozen=True, slots=True)
class Chessboard:
    """Inner corners: where four squares meet. `points_mm` row by row."""

    columns: int
    rows: int
    square_mm: float

    @property
    def points_mm(self) -> NDArray[np.float64]:
        """(columns * rows, 2)."""
        return _grid(self.columns, self.rows, self.square_mm)

    @property
    def text(self) -> str:
        """For people."""
        return f"a chessboard of {self.columns} x {self.rows} inner corners"


@dataclass(frozen=True, slots=True)
class CharucoBoard:
    """A chessboard with markers in its white squares; squares are counted, its points are the inner corners."""

    columns: int
    rows: int
    square_mm: float
    marker_mm: float
    dictionary: str

    @property
    def points_mm(self) -> NDArray[np.float64]:
        """((columns - 1) * (rows - 1), 2), in the order of the corners' numbers."""
        return _grid(self.columns - 1, self.rows - 1, self.square_mm)

    @property
    def text(self) -> str:
        """For people."""
        return f"a ChArUco board of {self.columns} x {self.rows} squares with markers of {self.dictionary}"


Board = Chessboard | CharucoBoard | DotBoard


def board_text(board: Board) -> str:
    """A board for people."""
    if isinstance(board, DotBoard):
        return f"a board of {board.columns} x {board.rows} dots with a larger one at a corner"
    return board.text


def parse_board(text: str) -> Board:
    """The board that is written like one of the forms above. Raises ValueError with what is wrong and the forms."""
    kind, *fields = text.strip().split(":")
    builders: dict[str, Callable[[list[str]], Board]] = {"chessboard": _chessboard, "dots": _dots, "charuco": _charuco}
    if kind not in builders:
        raise ValueError(f"board {text!r}: no such board; write {FORMS}")
    try:
        return builders[kind](fields)
    except ValueError as error:
        raise ValueError(f"board {text!r}: {error}; write {FORMS}") from None


def _chessboard(fields: list[str]) -> Chessboard:
    size, square = _fields(fields, "COLUMNSxROWS:SQUARE")
    columns, rows = _counts(size, least=3)
    return Chessboard(columns, rows, _length_mm("square", square))


def _dots(fields: list[str]) -> DotBoard:
    size, pitch, dot, origin = _fields(fields, "COLUMNSxROWS:PITCH:DOT:ORIGIN_DOT")
    columns, rows = _counts(size, least=3)
    lengths = [_length_mm(name, value) for name, value in (("pitch", pitch), ("dot", dot), ("origin dot", origin))]
    return DotBoard(columns, rows, *lengths)


def _charuco(fields: list[str]) -> CharucoBoard:
    size, square, marker, dictionary = _fields(fields, "COLUMNSxROWS:SQUARE:MARKER:DICTIONARY")
    columns, rows = _counts(size, least=3)
    square_mm, marker_mm = _length_mm("square", square), _length_mm("marker", marker)
    if not marker_mm < square_mm:
        raise ValueError(f"the marker must be smaller than the square (got {marker_mm:g} and {square_mm:g} mm)")
    name = dictionary.removeprefix("DICT_").lower()
    if name not in DICTIONARIES:
        raise ValueError(f"no dictionary {dictionary!r}; there are {', '.join(sorted(DICTIONARIES))}")
    return CharucoBoard(columns, rows, square_mm, marker_mm, name)


def _fields(fields: list[str], form: str) -> list[str]:
    wanted = form.count(":") + 1
    if len(fields) != wanted:
        raise ValueError(f"{wanted} fields {form} are wanted after the name (got {len(fields)})")
    return fields


def _counts(text: str, least: int) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,4})x(\d{1,4})", text)
    if not match or not all(least <= int(count) <= MOST_ALONG for count in match.groups()):
        raise ValueError(f"COLUMNSxROWS must be two numbers of {least} to {MOST_ALONG} like 9x6 (got {text!r})")
    return int(match[1]), int(match[2])


def _length_mm(name: str, text: str) -> float:
    match = re.fullmatch(r"(\d{1,9}(?:\.\d{0,9})?|\.\d{1,9})([a-z]{0,2})", text)
    if not match or match[2] not in MM:
        units = ", ".join(unit for unit in MM if unit)
        raise ValueError(f"{name} must be a length like 25mm, in {units} or without a unit in mm (got {text!r})")
    length_mm = float(match[1]) * MM[match[2]]
    if not (math.isfinite(length_mm) and LEAST_MM <= length_mm <= MOST_MM):
        raise ValueError(f"{name} must be {LEAST_MM:g} to {MOST_MM:g} mm (got {length_mm:g} mm)")
    return length_mm


def _grid(columns: int, rows: int, step_mm: float) -> NDArray[np.float64]:
    row, column = np.divmod(np.arange(columns * rows), columns)
    return np.column_stack([column, row]) * step_mm
