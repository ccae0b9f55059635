"""What every camera driver offers, and what a picture is."""

import asyncio
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class Frame:
    """One whole picture, owned by the receiver. Times are host monotonic nanoseconds."""

    pixels: Pixels  # (height, width), read-only
    frame_id: int
    exposure_start_ns: int  # not before the trigger of this very picture
    received_ns: int
    device_ns: int  # the camera's own clock
    exposure_us: float
    gain_db: float
    camera_id: str  # serial number


class Camera(Protocol):
    """A triggered camera. Incomplete or stale pictures are never delivered."""

    @property
    def name(self) -> str:
        """What the operator calls it, for instance "camera 1"."""

    async def open(self) -> None:
        """Connect, check that the serial number is the configured one, set the format, arm.

        Raises LinkLost, Mismatch, Refused, Unavailable.
        """

    async def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> None:
        """Set exposure and gain; raises Refused when the camera reads back another value."""

    async def grab(self, *, within_s: float = 1.0, exposed: asyncio.Event | None = None) -> Frame:
        """Trigger and return the picture whose exposure began after this call.

        `exposed` is set as soon as the exposure is over: from then on whatever the camera looks at may move.

        Raises FrameLost, NoAnswer, LinkLost.
        """

    async def close(self) -> None:
        """Let the camera go. May be called at any time, also twice."""
