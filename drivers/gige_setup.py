"""What is set on a GigE Vision camera before it takes pictures, each value read back. Blocking calls.

A calibration holds for whole, unmirrored pixels of one part of the sensor, so whatever bins, thins out, mirrors or
replaces the picture is switched off, and a camera that keeps it on is refused.
"""

import threading
import time
from dataclasses import dataclass
from typing import NamedTuple

from drivers.aravis import Device, Value
from drivers.aravis_library import ACCESS_DENIED, NO_LINK, AravisError
from drivers.camera import Region, Setup, Trigger
from drivers.errors import Mismatch, Refused

CONTROL_RETRY_S = 0.1
HEARTBEAT_MARGIN_S = 0.5
DELAY_TOLERANCE_US = 1.0
SOFTWARE_SOURCE = "Software"
CHUNK_MODE, CHUNK_SELECTOR, CHUNKS = "ChunkModeActive", "ChunkSelector", ("ExposureTime", "Gain")
LONGEST_CHUNKS = 65_536
# Present on some cameras only. First what changes the size of a picture, then what changes its content.
PLAIN: tuple[tuple[str, Value], ...] = (
    ("BinningHorizontal", 1),
    ("BinningVertical", 1),
    ("DecimationHorizontal", 1),
    ("DecimationVertical", 1),
    ("ReverseX", False),
    ("ReverseY", False),
    ("TestPattern", "Off"),
    ("ExposureAuto", "Off"),
    ("GainAuto", "Off"),
)


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which camera, and how it is to be."""

    name: str
    address: str
    setup: Setup
    socket_buffer_bytes: int | None = None
    packet_delay_us: float = 0.0
    exposure: tuple[float, float] | None = None  # us and dB; None: as the camera has it

    @property
    def where(self) -> str:
        """For messages."""
        return f"camera {self.setup.serial} at {self.address}"


def check_serial(device: Device, wanted: Wanted) -> None:
    """Raises Mismatch when another camera has this address."""
    serial = device.serial()
    if serial != wanted.setup.serial:
        detail = f"the camera at {wanted.address} has serial number {serial!r}, not {wanted.setup.serial!r}"
        raise Mismatch(wanted.name, detail)


def take_control(device: Device, stop: threading.Event) -> None:
    """Get control. A program that died keeps it until the camera's heartbeat time is over: wait that long."""
    if device.is_controller:
        return
    until = time.monotonic() + device.integer("GevHeartbeatTimeout") / 1e3 + HEARTBEAT_MARGIN_S
    while not stop.is_set():
        try:
            return device.take_control()
        except AravisError as error:
            if error.code != ACCESS_DENIED or time.monotonic() > until:
                raise
        stop.wait(CONTROL_RETRY_S)


class Payload(NamedTuple):
    """What a picture is on the wire: so many bytes, and whether its exposure and gain are among them."""

    size_bytes: int
    with_chunks: bool


def set_format(device: Device, wanted: Wanted) -> Payload:
    """Plain pixels of the region in the pixel format. Raises Refused, Mismatch, AravisError."""
    setup = wanted.setup
    device.clear_triggers()  # some cameras lock their format while they wait for a trigger
    for feature, value in PLAIN:
        if device.has(feature):
            _set(device, wanted.name, feature, value)
    _set_pixel_format(device, wanted)
    with_chunks = _set_chunks(device, wanted.name)
    region = Region(*device.set_region(*setup.region))
    if region != setup.region:
        raise Refused(wanted.name, "read-back", f"asked for {setup.region}, it set {region}")
    payload, needed = device.payload(), setup.pixel_format.bytes_for(region.width_px, region.height_px)
    most = needed + LONGEST_CHUNKS if with_chunks else needed
    if not needed <= payload <= most:
        detail = f"a picture has {payload} bytes, not the {needed} of {region} {setup.pixel_format.name}"
        raise Mismatch(wanted.name, detail)
    return Payload(payload, with_chunks)


def _set_chunks(device: Device, name: str) -> bool:
    """Have each picture bring its exposure time and gain, if the camera can; else nothing but pixels."""
    if not device.has(CHUNK_MODE):
        return False
    _set(device, name, CHUNK_MODE, True)
    if device.has(CHUNK_SELECTOR) and set(CHUNKS) <= set(device.choices(CHUNK_SELECTOR)):
        for chunk in CHUNKS:
            _set(device, name, CHUNK_SELECTOR, chunk)
            _set(device, name, "ChunkEnable", True)
        return True
    _set(device, name, CHUNK_MODE, False)
    return False


def set_packet_delay(device: Device, wanted: Wanted) -> None:
    """Room for another camera on the same wire. Raises Refused, AravisError."""
    got_us = device.set_packet_delay(wanted.packet_delay_us)
    if abs(got_us - wanted.packet_delay_us) > DELAY_TOLERANCE_US:
        detail = f"asked for {wanted.packet_delay_us:g} us between packets, it set {got_us:g} us"
        raise Refused(wanted.name, "read-back", detail)


def _set_pixel_format(device: Device, wanted: Wanted) -> None:
    pixel_format = wanted.setup.pixel_format
    known = device.choices("PixelFormat")
    if pixel_format.name not in known:
        detail = f"it has no pixel format {pixel_format.name}, but {', '.join(known)}"
        raise Refused(wanted.name, "not available", detail)
    if device.set_pixel_format(pixel_format.code) != pixel_format.code:
        raise Refused(wanted.name, "read-back", f"it did not take the pixel format {pixel_format.name}")


def _set(device: Device, name: str, feature: str, value: Value) -> None:
    """Set what is not so yet: many cameras have such a feature, and do not let it be written."""
    if device.value(feature, value) == value:
        return
    try:
        device.set_to(feature, value)
    except AravisError as error:
        if error.code in NO_LINK:
            raise
        raise Refused(name, "read-back", f"{feature} cannot be set to {value}: {error}") from error
    got = device.value(feature, value)
    if got != value:
        raise Refused(name, "read-back", f"{feature} must be {value}, and the camera keeps {got}")


def set_trigger(device: Device, wanted: Wanted, trigger: Trigger) -> None:
    """What makes it take a picture. Raises Refused, AravisError."""
    if trigger is Trigger.FREE:
        return device.clear_triggers()
    source = SOFTWARE_SOURCE if trigger is Trigger.SOFTWARE else wanted.setup.line
    known = device.choices("TriggerSource")
    if source not in known:
        raise Refused(wanted.name, "not available", f"it has no trigger source {source}, but {', '.join(known)}")
    device.set_trigger(source)
    if device.text("TriggerMode") != "On" or device.text("TriggerSource") != source:
        raise Refused(wanted.name, "read-back", f"it did not take the trigger source {source}")
