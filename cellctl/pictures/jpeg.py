"""A camera's JPEG picture, as USB cameras send it."""

import cv2
import numpy as np
from numpy.typing import NDArray

BEGINNING, END = b"\xff\xd8", b"\xff\xd9"


def luma(content: bytes) -> NDArray[np.uint8]:
    """Its grey levels, (height, width). Raises ValueError for what is no whole JPEG; the text goes on after its name.

    cv2 makes a picture of a JPEG whose end is missing, too: grey where the rest was. So the end is looked for first.
    """
    if not content.startswith(BEGINNING) or not content.rstrip(b"\0").endswith(END):
        raise ValueError(f"is no whole JPEG: {len(content)} bytes that begin with {content[:2].hex() or 'nothing'}")
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error as error:
        raise ValueError(f"is a broken JPEG ({error.err})") from error
    if pixels is None:
        raise ValueError("is a broken JPEG")
    return np.asarray(pixels, np.uint8)
