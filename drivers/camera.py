"""What every camera driver offers, and what a picture is."""

import asyncio
from collections.abc import AsyncGenerator
from dataclasses import astuple, dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers import pixels
from drivers.pixels import MONO8, Grey16, PixelFormat

Pixels = NDArray[np.uint8]


class Region(NamedTuple):
    """A part of the sensor in its own pixels: never binned, thinned out or mirrored."""

    left_px: int
    top_px: int
    width_px: int
    height_px: int

    def __str__(self) -> str:
        return f"{self.width_px} x {self.height_px} px at {self.left_px}, {self.top_px}"


@dataclass(frozen=True, slots=True)
class Setup:
    """Which camera it must be, and how it has to take pictures. `line` is the input of the hardware trigger."""

    serial: str
    region: Region
    pixel_format: PixelFormat = MONO8
    line: str = "Line0"


class Trigger(StrEnum):
    """What makes the camera take a picture."""

    SOFTWARE = "software"  # grab()
    LINE = "line"  # its hardware input
    FREE = "free"  # nothing: one after the other


class State(StrEnum):
    """How a driver stands to its camera."""

    OFFLINE = "offline"
    CONNECTING = "connecting"
    READY = "ready"  # open, takes no pictures
    ARMED = "armed"
    FAULTED = "faulted"  # of no use any more until it is opened again


class StateChange(NamedTuple):
    """Since `at_ns` (host monotonic) the camera is in this state."""

    state: State
    why: str
    at_ns: int


@dataclass(frozen=True, slots=True)
class Counters:
    """What happened to pictures and packets, since the driver's object was made."""

    delivered: int = 0
    stale: int = 0  # of earlier triggers, or doubled: dropped
    incomplete: int = 0
    overrun: int = 0  # nobody asked for them in time: dropped
    gaps: int = 0  # counted by the camera, never seen here
    packets_resent: int = 0
    packets_missing: int = 0

    def __add__(self, other: "Counters") -> "Counters":
        return Counters(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))


class Health(NamedTuple):
    """How the camera is. `answers`: its control channel works now. None: this camera does not tell."""

    state: State
    why: str
    answers: bool
    temperature_c: float | None = None
    packet_bytes: int | None = None
    last_picture_s: float | None = None  # age of the newest picture that came whole
    has_clock: bool | None = None  # False: pictures are told apart by their order alone


@dataclass(frozen=True, slots=True)
class Frame:
    """One whole picture, owned by the receiver. Times are host monotonic nanoseconds.

    `pixels` is what vision measures: always 8 bit. Of a deeper format they are its values over the full range,
    rounded (`drivers.pixels`); `payload` is what the camera sent, and `deep()` unpacks it.
    """

    pixels: Pixels  # (height, width), read-only
    frame_id: int
    gap: int  # pictures that the camera counted just before this one and that never came
    exposure_start_ns: int  # not before the trigger of this very picture
    received_ns: int
    device_ns: int  # the camera's own clock; 0: it has none, the start is reckoned back from the arrival
    exposure_us: float  # as the camera read it back
    gain_db: float
    camera_id: str  # serial number
    region: Region
    pixel_format: PixelFormat
    payload: Pixels  # (bytes,), read-only

    def deep(self) -> Grey16:
        """Grey levels in the format's own depth, 0 to `pixel_format.white`, (height, width)."""
        width_px, height_px = self.region.width_px, self.region.height_px
        return pixels.full_depth(self.payload, self.pixel_format, width_px, height_px)


class Camera(Protocol):
    """A camera. Incomplete or stale pictures are never delivered; waiting for one has a deadline."""

    @property
    def name(self) -> str:
        """What the operator calls it, for instance "camera 1"."""

    @property
    def counters(self) -> Counters:
        """What happened since this object was made, all connections together."""

    @property
    def state(self) -> StateChange:
        """How it stands now."""

    def states(self) -> AsyncGenerator[StateChange, None]:
        """The present state, then every change; a reader that is slow misses the oldest."""

    async def open(self) -> None:
        """Connect anew, check the serial number, set region and format, exposure and gain as last configured, arm.

        Ends armed for grab(). Raises LinkLost, NoAnswer, Mismatch, Refused, Unavailable.
        """

    async def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> None:
        """Set exposure and gain; raises Refused when the camera reads back another value."""

    async def arm(self, trigger: Trigger = Trigger.SOFTWARE) -> None:
        """Take pictures from now on by this trigger; raises Refused when the camera has no such trigger."""

    async def disarm(self) -> None:
        """Take no more pictures; those not yet asked for are dropped."""

    async def grab(self, *, within_s: float = 1.0, exposed: asyncio.Event | None = None) -> Frame:
        """Trigger and return the picture whose exposure began after this call.

        `exposed` is set as soon as the exposure is over: from then on whatever the camera looks at may move.

        Raises FrameLost, NoAnswer, LinkLost, Refused (not armed for it).
        """

    async def next_frame(self, *, within_s: float = 1.0) -> Frame:
        """The next picture by the line, in order (four may wait, then the oldest is dropped), or the newest free one.

        Raises FrameLost, NoAnswer, LinkLost, Refused (not armed for it).
        """

    async def health(self) -> Health:
        """Ask the camera how it is; one that does not answer is an answer too."""

    async def close(self) -> None:
        """Let the camera go. May be called at any time, also twice."""
