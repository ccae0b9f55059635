"""The strokes that pictures about calibrations are drawn with."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]
Box = tuple[int, int, int, int]  # left, top, right, bottom

PAPER: Colour = (250, 250, 250)
INK: Colour = (40, 40, 40)
FAINT: Colour = (190, 190, 190)
PALE: Colour = (225, 215, 200)
ALERT: Colour = (40, 40, 210)
FARTHEST = 4000  # beyond it cv2's whole numbers overflow


def frame(canvas: Picture, box: Box, title: str) -> None:
    """A part of the canvas, with its title."""
    cv2.rectangle(canvas, box[:2], box[2:], FAINT, 1)
    write(canvas, (box[0] + 10, box[1] + 20), title, 0.42)


def arrow(canvas: Picture, start: NDArray[np.float64], end: NDArray[np.float64], colour: Colour) -> None:
    """An arrow, cut where it leaves the canvas far behind."""
    end = np.clip(end, -FARTHEST, FARTHEST)
    cv2.arrowedLine(canvas, whole(start), whole(end), colour, 1, cv2.LINE_AA, 0, 0.25)


def whole(point: NDArray[np.float64]) -> tuple[int, int]:
    """The pixel next to a point."""
    u, v = np.rint(point).astype(int).tolist()
    return u, v


def hue(index: int, count: int) -> Colour:
    """One of so many colours that differ."""
    hsv = np.array([[[int(120 * index / max(1, count)) + 30, 200, 150]]], np.uint8)
    blue, green, red = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0].tolist()
    return blue, green, red


def write(canvas: Picture, place: tuple[int, int], text: str, size: float = 0.47) -> None:
    """Text that begins at a place."""
    cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, INK, 1, cv2.LINE_AA)
