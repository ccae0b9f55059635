"""The newest picture of a camera as a JPEG, for any number of viewers; a viewer that is slow misses pictures."""

import asyncio
from typing import NamedTuple

import cv2
import numpy as np

from drivers.camera import Frame, Pixels

JPEG_QUALITY = 80
SATURATED = 250
STRIP_PX = 26


class Shown(NamedTuple):
    """What viewers see. `number` counts them."""

    number: int
    jpeg: bytes


class LiveView:
    """The newest picture. For one event loop."""

    def __init__(self) -> None:
        self._newest = Shown(0, b"")
        self._changed = asyncio.Event()

    def show(self, jpeg: bytes) -> None:
        """This is the newest now."""
        self._newest = Shown(self._newest.number + 1, jpeg)
        self._changed.set()
        self._changed = asyncio.Event()

    async def newer_than(self, number: int) -> Shown:
        """The newest picture as soon as it is newer than this one."""
        while self._newest.number <= number:
            await self._changed.wait()
        return self._newest


def smaller(pixels: Pixels, most_px: int) -> Pixels:
    """The picture so much smaller, by a whole factor, that neither side is longer than this."""
    factor = -(-max(pixels.shape) // most_px)
    if factor == 1:
        return pixels
    size = pixels.shape[1] // factor, pixels.shape[0] // factor
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)


def jpeg_of(pixels: Pixels, caption: str) -> bytes:
    """As a JPEG file's bytes, the caption below the picture."""
    strip = np.zeros((STRIP_PX, pixels.shape[1]), np.uint8)
    cv2.putText(strip, caption, (6, STRIP_PX - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 220, 1, cv2.LINE_AA)
    _, encoded = cv2.imencode(".jpg", np.vstack([pixels, strip]), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    return encoded.tobytes()


def caption_of(frame: Frame) -> str:
    """What helps to set light, exposure and lens."""
    pixels = frame.pixels
    white = 100 * float(np.count_nonzero(pixels >= SATURATED)) / pixels.size
    return (
        f"picture {frame.frame_id}, {frame.exposure_us:g} us {frame.gain_db:g} dB, grey levels {pixels.min()} to "
        f"{pixels.max()}, mean {pixels.mean():.0f}, {white:.1f} % white, sharpness {sharpness(pixels):.2f}"
    )


def sharpness(pixels: Pixels) -> float:
    """Mean difference of neighbouring pixels in grey levels: the largest value is the best focus of this scene."""
    along_u = cv2.absdiff(pixels[:, 1:], pixels[:, :-1])
    along_v = cv2.absdiff(pixels[1:], pixels[:-1])
    return float(along_u.mean() + along_v.mean())
