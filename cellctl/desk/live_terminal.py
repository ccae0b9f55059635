"""A grey picture as characters of a terminal: two pixels each, an upper and a lower half. Pure."""

import cv2
import numpy as np

from drivers.camera import Pixels

HALF = "\N{UPPER HALF BLOCK}"
GREYS, FIRST_GREY = 24, 232  # of the 256 colours that terminals have
HOME, RESET, REST_OF_LINE, BELOW = "\x1b[H", "\x1b[0m", "\x1b[K", "\x1b[J"


def drawn(pixels: Pixels, columns: int, lines: int, caption: str) -> str:
    """The picture with its caption below, in so many columns and lines."""
    small = _fitted(pixels, columns, 2 * (lines - 2)) // np.uint8(-(-256 // GREYS))
    rows = [_row(small[top], small[top + 1]) for top in range(0, len(small), 2)]
    return HOME + "\n".join([*rows, caption[:columns] + REST_OF_LINE]) + BELOW


def _fitted(pixels: Pixels, columns: int, rows: int) -> Pixels:
    """As large as fits, sides in proportion, an even number of rows."""
    scale = min(columns / pixels.shape[1], max(rows, 2) / pixels.shape[0])
    width, height = max(1, int(pixels.shape[1] * scale)), max(2, int(pixels.shape[0] * scale) // 2 * 2)
    return np.asarray(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def _row(upper: Pixels, lower: Pixels) -> str:
    """One line of characters; a colour is said only where it changes."""
    parts: list[str] = []
    before: tuple[int, int] | None = None
    for pair in zip(upper.tolist(), lower.tolist(), strict=True):
        if pair != before:
            parts.append(f"\x1b[38;5;{FIRST_GREY + pair[0]};48;5;{FIRST_GREY + pair[1]}m")
            before = pair
        parts.append(HALF)
    return "".join(parts) + RESET + REST_OF_LINE
