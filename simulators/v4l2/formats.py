"""What a simulated camera's picture looks like in memory, format by format. cv2 compresses the MJPG one."""

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
JPEG_QUALITY = 95
MIDDLE_CHROMA = 128


class Format(NamedTuple):
    """One pixel format: its four characters, the bits of a pixel in memory, and how an 8 bit picture becomes it."""

    fourcc: str
    description: str
    bits: int
    encode: Callable[[Bytes], Bytes]  # (height, width) -> (height, bytes of a line), or all bytes of a compressed one
    compressed: bool = False

    @property
    def code(self) -> int:
        """The four characters as a number."""
        return int.from_bytes(self.fourcc.encode(), "little")

    def line_bytes(self, width_px: int) -> int:
        """Bytes of a line without padding; 0 for a compressed format."""
        return 0 if self.compressed else -(-width_px * self.bits // 8)


def _grey(picture: Bytes) -> Bytes:
    return picture


def _words(shift: int) -> Callable[[Bytes], Bytes]:
    def encode(picture: Bytes) -> Bytes:
        return (picture.astype("<u2") << shift).view(np.uint8)

    return encode


def _raw_10_packed(picture: Bytes) -> Bytes:
    """MIPI RAW10: four pixels' upper eight bits, then a byte with the lower two of each, which are zero here."""
    height, width = picture.shape
    packed = np.zeros((height, width // 4, 5), np.uint8)
    packed[:, :, :4] = picture.reshape(height, width // 4, 4)
    return packed.reshape(height, -1)


def _luma_chroma(picture: Bytes) -> Bytes:
    pairs = np.full((*picture.shape, 2), MIDDLE_CHROMA, np.uint8)
    pairs[:, :, 0] = picture
    return pairs.reshape(picture.shape[0], -1)


def _jpeg(picture: Bytes) -> Bytes:
    done, coded = cv2.imencode(".jpg", np.ascontiguousarray(picture), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise ValueError(f"a picture of {picture.shape} cannot be coded as JPEG")
    return np.asarray(coded, np.uint8).reshape(-1)


FORMATS = {
    wanted.code: wanted
    for wanted in (
        Format("GREY", "8-bit Greyscale", 8, _grey),
        Format("Y10 ", "10-bit Greyscale", 16, _words(2)),
        Format("Y10P", "10-bit Greyscale (MIPI Packed)", 10, _raw_10_packed),
        Format("Y12 ", "12-bit Greyscale", 16, _words(4)),
        Format("Y16 ", "16-bit Greyscale", 16, _words(8)),
        Format("YUYV", "YUYV 4:2:2", 16, _luma_chroma),
        Format("MJPG", "Motion-JPEG", 8, _jpeg, compressed=True),
    )
}
