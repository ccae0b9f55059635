"""Real pictures that tests use when they are there: OpenCV's 13 pictures of a chessboard, 9 x 6 inner corners."""

from pathlib import Path

import pytest

FOLDERS = (
    Path(__file__).parents[2] / "shared/data/chessboards",
    Path("/usr/share/doc/opencv-doc/examples/data"),  # Debian's package opencv-doc
)


def chessboards() -> list[Path]:
    """Their files; skips the test when they are not there."""
    for folder in FOLDERS:
        if len(found := sorted(folder.glob("left[01][0-9].jpg"))) == 13:
            return found
    pytest.skip("no real pictures: apt-get install opencv-doc (an image of Debian may leave out /usr/share/doc)")
