"""One opened V4L2 device: format, buffers, stream. Calls block, but for those that fetch and give back a buffer."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers import pixels
from drivers import v4l2_abi as abi
from drivers.camera import Pixels, Region, Setup, Trigger
from drivers.errors import FrameLost, Garbled, Mismatch, Refused
from drivers.pixels import PixelError
from drivers.v4l2_abi import Filled, Flag
from drivers.v4l2_controls import Controls
from drivers.v4l2_node import NO_SUCH_REQUEST, Node, asked, formats, serial_number

BUFFERS = 8  # four pictures by the line may wait, and the camera must not run out meanwhile
FEWEST_BUFFERS = 2
UNKNOWN_INTERVAL_S = 0.2  # a camera that does not tell is taken for a slow one
JPEG = "MJPG"
FOURCC = {
    pixels.MONO8: "GREY",
    pixels.MONO10: "Y10 ",
    pixels.MONO12: "Y12 ",
    pixels.MONO14: "Y14 ",
    pixels.MONO16: "Y16 ",
    pixels.RAW10P: "Y10P",
    pixels.YUYV: "YUYV",
}
STAMPED_LATE = frozenset({"uvcvideo"})  # says start of exposure, and means the arrival of the first packet

Decode = Callable[[bytes], Pixels]
Opener = Callable[[str], Node]


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which camera, and how it is to be. With `decode` pictures come as JPEG, which that turns into (h, w) uint8."""

    name: str
    path: str
    setup: Setup
    open_node: Opener
    decode: Decode | None = None
    gain_db_per_step: float | None = None
    exposure: tuple[float, float] | None = None  # us and dB; None: as the camera has it

    @property
    def fourcc(self) -> str:
        """The format's four characters; raises Refused when V4L2 has no such format."""
        chosen = self.setup.pixel_format
        if self.decode is not None:
            return JPEG
        if chosen not in FOURCC:
            known = ", ".join(one.name for one in FOURCC)
            raise Refused(self.name, "format", f"V4L2 has no format {chosen.name}; it has {known}")
        return FOURCC[chosen]


class Capture:
    """A device from opening to closing. Raises OSError as the system does, and DeviceError for what does not fit."""

    def __init__(self, wanted: Wanted) -> None:
        self._wanted = wanted
        self._maps: list[Pixels] = []
        self.streaming = False
        self.exposure = (0.0, 0.0)  # us and dB, as read back
        self.node = wanted.open_node(wanted.path)
        try:
            self._check_identity()
            self.controls = Controls(wanted.name, self.node)
            self.controls.unmirror()
            self._set_format()
            self.interval_s = self._interval_s()
            self._map_buffers()
            self.set_exposure(wanted.exposure)
        except BaseException:
            self.close()
            raise

    def _ask(self, request: int, argument: bytearray) -> bytearray:
        return asked(self.node, request, argument)

    def check(self) -> abi.Capability:
        """Ask the device what it is."""
        return abi.capability(self._ask(abi.QUERYCAP, abi.blank(abi.QUERYCAP)))

    # Opening

    def _check_identity(self) -> None:
        wanted, found = self._wanted, self.check()
        self.driver = found.driver
        if not found.captures:
            raise Mismatch(wanted.name, f"{wanted.path} ({found.card}) takes no pictures that can be streamed")
        serial = serial_number(wanted.path, found.bus)
        if serial != wanted.setup.serial:
            detail = f"the camera at {wanted.path} has serial number {serial!r}, not {wanted.setup.serial!r}"
            raise Mismatch(wanted.name, detail)

    def _set_format(self) -> None:
        """Set region and format. A device gives the nearest that it can: nothing but what was wanted will do."""
        wanted, fourcc = self._wanted, self._wanted.fourcc
        region = wanted.setup.region
        offered = formats(self.node)
        if fourcc not in offered:
            raise Refused(wanted.name, "format", f"{wanted.path} has no {fourcc}; it has {', '.join(offered)}")
        cropped = self._crop(region)
        got = abi.format_set(self._ask(abi.S_FMT, abi.ask_format(region.width_px, region.height_px, fourcc)))
        if (got.width_px, got.height_px, got.fourcc) != (region.width_px, region.height_px, fourcc):
            asked = f"{region.width_px} x {region.height_px} {fourcc}"
            detail = f"asked for {asked}, it set {got.width_px} x {got.height_px} {got.fourcc}"
            raise Refused(wanted.name, "read-back", detail)
        if cropped and self._cropped() != region:
            raise Refused(wanted.name, "read-back", f"it reads {self._cropped()}, not {region}")
        self._check_layout(got)

    def _crop(self, region: Region) -> bool:
        """Set which part of the sensor is read; False when the device always reads the same."""
        try:
            self._ask(abi.S_SELECTION, abi.ask_selection(*region))
        except OSError as error:
            if error.errno not in NO_SUCH_REQUEST:
                raise
            if region.left_px or region.top_px:
                detail = f"the device cannot read {region}: it always begins at its first pixel"
                raise Refused(self._wanted.name, "region", detail) from error
            return False
        return True

    def _cropped(self) -> Region:
        return Region(*abi.selection(self._ask(abi.G_SELECTION, abi.ask_selection())))

    def _check_layout(self, got: abi.Format) -> None:
        if got.field not in (abi.FIELD_ANY, abi.FIELD_NONE):
            raise Mismatch(self._wanted.name, f"{self._wanted.path} gives half pictures (field order {got.field})")
        chosen = self._wanted.setup.pixel_format
        self._line_bytes = chosen.bytes_for(got.width_px, 1)
        self._stride = max(got.line_bytes, self._line_bytes)
        self._picture_bytes = self._stride * got.height_px
        if self._wanted.decode is None and got.picture_bytes < self._picture_bytes:
            detail = f"pictures of {got.picture_bytes} bytes with {got.height_px} lines of {self._stride}"
            raise Garbled(self._wanted.name, detail)

    def _interval_s(self) -> float:
        """From one picture to the next."""
        try:
            found = abi.picture_interval_s(self._ask(abi.G_PARM, abi.ask_parameters()))
        except OSError as error:
            if error.errno not in NO_SUCH_REQUEST:
                raise
            found = None
        return min(found, 10.0) if found else UNKNOWN_INTERVAL_S

    def _map_buffers(self) -> None:
        count = abi.buffers_given(self._ask(abi.REQBUFS, abi.ask_buffers(BUFFERS)))
        if not FEWEST_BUFFERS <= count <= 8 * BUFFERS:
            raise Garbled(self._wanted.name, f"{self._wanted.path} gave {count} buffers")
        for index in range(count):
            place = abi.buffer_place(self._ask(abi.QUERYBUF, abi.ask_buffer(index)))
            self._check_clock(place.flags)
            if self._wanted.decode is None and place.length < self._picture_bytes:
                raise Garbled(self._wanted.name, f"buffer {index} has {place.length} bytes")
            try:
                self._maps.append(self.node.map(place.offset, place.length))
            except (ValueError, OverflowError) as error:
                raise Garbled(self._wanted.name, f"buffer {index} cannot be mapped: {error}") from error

    def _check_clock(self, flags: Flag) -> None:
        if flags & Flag.CLOCK_MASK != Flag.CLOCK_MONOTONIC:
            detail = f"{self._wanted.path} does not stamp pictures by the host's clock, so stale ones would pass"
            raise Mismatch(self._wanted.name, detail)

    # Setting

    def set_exposure(self, wanted: tuple[float, float] | None) -> tuple[float, float]:
        """Exposure in us and gain in dB, as the device reads them back; None leaves them."""
        if wanted is None:
            self.exposure = self.controls.exposure_us(), self.controls.gain_db(self._wanted.gain_db_per_step)
        else:
            exposure_us = self.controls.set_exposure(wanted[0])
            self.exposure = exposure_us, self.controls.set_gain(wanted[1], self._wanted.gain_db_per_step)
        return self.exposure

    def start(self, trigger: Trigger) -> None:
        """Take pictures by this from now on."""
        self.stop()
        self.controls.set_trigger(trigger, self._wanted.setup)
        self.streaming = True  # from the first buffer on there is something to stop
        for index in range(len(self._maps)):
            self.give_back(index)
        self._ask(abi.STREAMON, abi.stream_kind())

    def stop(self) -> None:
        """Take no more; pictures that were not fetched are dropped."""
        if self.streaming:
            self.streaming = False
            self._ask(abi.STREAMOFF, abi.stream_kind())

    def close(self) -> None:
        """Let the device go."""
        self._maps.clear()
        self.node.close()

    # Pictures

    def fetch(self) -> Filled | None:
        """The oldest picture, if there is one; does not wait. Raises Garbled."""
        try:
            filled = abi.buffer_filled(self._ask(abi.DQBUF, abi.ask_buffer()))
        except BlockingIOError:
            return None
        if filled.buffer >= len(self._maps):
            raise Garbled(self._wanted.name, f"a picture in buffer {filled.buffer} of {len(self._maps)}")
        return filled

    def give_back(self, index: int) -> None:
        """The buffer may be filled again; does not wait."""
        self._ask(abi.QBUF, abi.ask_buffer(index))

    def earliest_start_ns(self, filled: Filled) -> int:
        """Not before this the exposure began. Only some devices stamp its start; others the picture's end.

        Then it is exposure and read-out earlier, and a read-out takes no longer than from one picture to the next.
        """
        exact = filled.flags & Flag.SOURCE_MASK == Flag.START_OF_EXPOSURE and self.driver not in STAMPED_LATE
        return filled.stamp_ns - (0 if exact else round((self.exposure[0] * 1e-6 + self.interval_s) * 1e9))

    def flaw(self, filled: Filled) -> str:
        """Why a picture cannot be used, or nothing. Nobody may look at its pixels before this."""
        if filled.flags & Flag.ERROR:
            return f"picture {filled.sequence} came damaged (error flag of the driver)"
        if self._wanted.decode is None and filled.used_bytes < self._picture_bytes:
            return f"picture {filled.sequence} has {filled.used_bytes} of {self._picture_bytes} bytes"
        if not 0 < filled.used_bytes <= self._maps[filled.buffer].size:
            return f"picture {filled.sequence} says it has {filled.used_bytes} bytes"
        return ""

    def copy(self, filled: Filled) -> tuple[Pixels, Pixels]:
        """8 bit pixels (height, width) and what the camera sent, both read-only; one copy of what it sent.

        Raises FrameLost for bytes that are no picture.
        """
        data = self._maps[filled.buffer]
        try:
            picture, payload = self._decoded(data, filled) if self._wanted.decode else self._unpacked(data)
        except ValueError as error:
            raise FrameLost(self._wanted.name, f"picture {filled.sequence} {error}") from error
        for array in (picture, payload):
            array.flags.writeable = False
        return picture, payload

    def _unpacked(self, data: Pixels) -> tuple[Pixels, Pixels]:
        region = self._wanted.setup.region
        lines = data[: self._picture_bytes].reshape(region.height_px, self._stride)
        payload = lines[:, : self._line_bytes].copy().reshape(-1)
        chosen = self._wanted.setup.pixel_format
        return pixels.eight_bit(payload, chosen, region.width_px, region.height_px), payload

    def _decoded(self, data: Pixels, filled: Filled) -> tuple[Pixels, Pixels]:
        assert self._wanted.decode is not None
        region = self._wanted.setup.region
        picture = np.array(self._wanted.decode(data[: filled.used_bytes].tobytes()))
        if picture.shape != (region.height_px, region.width_px) or picture.dtype != np.uint8:
            raise PixelError(f"is {picture.dtype} {picture.shape}, not {region.width_px} x {region.height_px}")
        return picture, picture.reshape(-1)
