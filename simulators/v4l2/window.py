"""Which part of the sensor a simulated V4L2 camera reads, in which format and how often. Pure.

The verbs take an ioctl's bytes and give them back filled in; refusals are OSError as the kernel's.
"""

import errno
from collections.abc import Iterable
from typing import NamedTuple

from simulators.v4l2 import abi
from simulators.v4l2.formats import FORMATS, Format

WIDTH_STEP, HEIGHT_STEP, SMALLEST = 4, 2, 16
SLOWEST, FASTEST = 1.0, 60.0  # pictures per second
INTERVALS = (60, 30, 15, 10, 5)
MILLI = 1000


class Window(NamedTuple):
    """The part of the sensor that is read, in px."""

    left: int
    top: int
    width: int
    height: int


class Readout:
    """Format, window and rate."""

    def __init__(self, sensor: tuple[int, int], formats: Iterable[str], rate_hz: float, padding_bytes: int) -> None:
        self.sensor = sensor
        self.formats: list[Format] = [known for known in FORMATS.values() if not formats or known.fourcc in formats]
        self.format = self.formats[0]
        self.window = Window(0, 0, *sensor)
        self.rate_hz = rate_hz
        self._padding_bytes = padding_bytes

    @property
    def line_bytes(self) -> int:
        """From one line of a picture in memory to the next; 0 for a compressed one."""
        return self._line_bytes(self.format, self.window.width)

    @property
    def picture_bytes(self) -> int:
        """Room for one picture."""
        return (self.line_bytes or self.window.width) * self.window.height

    def _line_bytes(self, chosen: Format, width: int) -> int:
        return 0 if chosen.compressed else chosen.line_bytes(width) + self._padding_bytes

    def describe_format(self, data: bytes) -> bytes:
        """VIDIOC_ENUM_FMT."""
        index, kind, *_ = abi.FORMAT_DESCRIPTION.unpack(data)
        if kind != abi.CAPTURE or index >= len(self.formats):
            raise OSError(errno.EINVAL, f"no format {index}")
        one = self.formats[index]
        return abi.FORMAT_DESCRIPTION.pack(index, kind, int(one.compressed), abi.text(one.description, 32), one.code)

    def get_format(self, data: bytes) -> bytes:
        """VIDIOC_G_FMT."""
        for_capture(abi.FORMAT.unpack(data)[0])
        return self._packed(self.format, self.window.width, self.window.height)

    def try_format(self, data: bytes) -> bytes:
        """VIDIOC_TRY_FMT: what S_FMT would set."""
        return self._packed(*self._nearest(data))

    def set_format(self, data: bytes) -> bytes:
        """VIDIOC_S_FMT: the nearest that the camera can do, as the interface demands; the window keeps its corner."""
        chosen, width, height = self._nearest(data)
        self.format = chosen
        self.window = self._inside(Window(self.window.left, self.window.top, width, height))
        return self._packed(chosen, width, height)

    def _nearest(self, data: bytes) -> tuple[Format, int, int]:
        kind, width, height, code, *_ = abi.FORMAT.unpack(data)
        for_capture(kind)
        chosen = next((one for one in self.formats if one.code == code), self.formats[0])
        return chosen, *self._size(width, height)

    def _size(self, width: int, height: int) -> tuple[int, int]:
        wide = max(SMALLEST, min(width, self.sensor[0])) // WIDTH_STEP * WIDTH_STEP
        high = max(SMALLEST, min(height, self.sensor[1])) // HEIGHT_STEP * HEIGHT_STEP
        return wide, high

    def _inside(self, window: Window) -> Window:
        left = min(max(window.left, 0), self.sensor[0] - window.width) // WIDTH_STEP * WIDTH_STEP
        top = min(max(window.top, 0), self.sensor[1] - window.height) // HEIGHT_STEP * HEIGHT_STEP
        return window._replace(left=left, top=top)

    def _packed(self, chosen: Format, width: int, height: int) -> bytes:
        line = self._line_bytes(chosen, width)
        total = (line or width) * height
        fields = (width, height, chosen.code, abi.FIELD_NONE, line, total, abi.COLORSPACE_SRGB, abi.PRIVATE_MAGIC)
        return abi.FORMAT.pack(abi.CAPTURE, *fields, 0, 0, 0, 0)

    def describe_sizes(self, data: bytes) -> bytes:
        """VIDIOC_ENUM_FRAMESIZES: all sizes up to the sensor's, in steps."""
        index, code, *_ = abi.FRAME_SIZE.unpack(data)
        if index or all(one.code != code for one in self.formats):
            raise OSError(errno.EINVAL, "no further sizes")
        spans = SMALLEST, self.sensor[0], WIDTH_STEP, SMALLEST, self.sensor[1], HEIGHT_STEP
        return abi.FRAME_SIZE.pack(index, code, abi.STEPWISE_SIZES, *spans)

    def describe_intervals(self, data: bytes) -> bytes:
        """VIDIOC_ENUM_FRAMEINTERVALS."""
        index, code, width, height, *_ = abi.FRAME_INTERVAL.unpack(data)
        if index >= len(INTERVALS) or all(one.code != code for one in self.formats):
            raise OSError(errno.EINVAL, "no further intervals")
        return abi.FRAME_INTERVAL.pack(index, code, width, height, abi.DISCRETE_INTERVALS, 1, INTERVALS[index])

    def get_selection(self, data: bytes) -> bytes:
        """VIDIOC_G_SELECTION: the window, or the whole sensor."""
        kind, target, flags, *_ = abi.SELECTION.unpack(data)
        for_capture(kind)
        if target not in (abi.CROP, abi.CROP_DEFAULT, abi.CROP_BOUNDS):
            raise OSError(errno.EINVAL, f"no selection {target}")
        window = self.window if target == abi.CROP else Window(0, 0, *self.sensor)
        return abi.SELECTION.pack(kind, target, flags, *window)

    def set_selection(self, data: bytes) -> bytes:
        """VIDIOC_S_SELECTION: the window and with it the format's size, for there is no scaler."""
        kind, target, flags, left, top, width, height = abi.SELECTION.unpack(data)
        for_capture(kind)
        if target != abi.CROP:
            raise OSError(errno.EINVAL, f"selection {target} cannot be set")
        self.window = self._inside(Window(left, top, *self._size(width, height)))
        return abi.SELECTION.pack(kind, target, flags, *self.window)

    def get_parameters(self, data: bytes) -> bytes:
        """VIDIOC_G_PARM: the time from picture to picture."""
        for_capture(abi.STREAM_PARAMETERS.unpack(data)[0])
        return abi.STREAM_PARAMETERS.pack(abi.CAPTURE, abi.TIME_PER_FRAME, 0, MILLI, round(self.rate_hz * MILLI))

    def set_parameters(self, data: bytes) -> bytes:
        """VIDIOC_S_PARM: the same, to be the nearest possible; 0 leaves it."""
        _kind, _capability, _mode, numerator, denominator = abi.STREAM_PARAMETERS.unpack(data)
        if numerator and denominator:
            self.rate_hz = min(max(denominator / numerator, SLOWEST), FASTEST)
        return self.get_parameters(data)


def for_capture(kind: int) -> None:
    """The argument must be about a capture stream; EINVAL."""
    if kind != abi.CAPTURE:
        raise OSError(errno.EINVAL, f"no stream of kind {kind}")
