"""Requests, structures and flags of the Video for Linux API on 64-bit machines. Pure.

Source: the kernel's include/uapi/linux/videodev2.h and v4l2-controls.h. Every parser takes exactly as many bytes as its
request's argument has and accepts any content: what a field means is checked where it is used.
"""

import struct
from enum import IntFlag
from typing import NamedTuple

CAPTURE = 1  # buffer type VIDEO_CAPTURE
MMAP = 1
FIELD_ANY, FIELD_NONE = 0, 1

QUERYCAP = 0x80685600
ENUM_FMT = 0xC0405602
G_FMT = 0xC0D05604
S_FMT = 0xC0D05605
REQBUFS = 0xC0145608
QUERYBUF = 0xC0585609
QBUF = 0xC058560F
DQBUF = 0xC0585611
STREAMON = 0x40045612
STREAMOFF = 0x40045613
G_PARM = 0xC0CC5615
G_CTRL = 0xC008561B
S_CTRL = 0xC008561C
QUERYMENU = 0xC02C5625
G_SELECTION = 0xC040565E
S_SELECTION = 0xC040565F
QUERY_EXT_CTRL = 0xC0E85667

CAN_CAPTURE, CAN_STREAM, HAS_DEVICE_CAPS = 0x1, 0x0400_0000, 0x8000_0000
NEXT_CONTROL = 0x8000_0000
CROP, CROP_DEFAULT = 0x0, 0x1
INTEGER, BOOLEAN, MENU, BUTTON, INTEGER_MENU = 1, 2, 3, 4, 9
DISABLED = 0x1

AUTO_GAIN, GAIN = 0x0098_0912, 0x0098_0913
MIRRORED, UPSIDE_DOWN = 0x0098_0914, 0x0098_0915
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE, EXPOSURE_AUTO_PRIORITY = 0x009A_0901, 0x009A_0902, 0x009A_0903
EXPOSURE_MANUAL = 1
EXPOSURE_STEP_US = 100.0  # unit of EXPOSURE_ABSOLUTE

_CAPABILITY = struct.Struct("=16s32s32sIII12x")
_FORMAT_NAME = struct.Struct("=III32sI16x")
_FORMAT = struct.Struct("=I4x12I152x")
_BUFFERS = struct.Struct("=III8x")
_BUFFER = struct.Struct("=5I4xqq16xIIQI12x")
_PARAMETERS = struct.Struct("=5I184x")
_CONTROL = struct.Struct("=Ii")
_CONTROL_FACTS = struct.Struct("=II32sqqQqI4x4x4x16x128x")
_CHOICE = struct.Struct("=II32s4x")
_SELECTION = struct.Struct("=III4i36x")
_WORD = struct.Struct("=i")


Bytes = bytes | bytearray


class Flag(IntFlag):
    """Of a buffer: what is wrong with its picture, and what its time stamp means."""

    ERROR = 0x0040
    CLOCK_MASK = 0xE000
    CLOCK_MONOTONIC = 0x2000
    SOURCE_MASK = 0x0007_0000
    START_OF_EXPOSURE = 0x0001_0000


class Capability(NamedTuple):
    """Who is behind a device node."""

    driver: str
    card: str
    bus: str
    can: int

    @property
    def captures(self) -> bool:
        """Can it be asked for pictures by this driver's means?"""
        return bool(self.can & CAN_CAPTURE) and bool(self.can & CAN_STREAM)


class Format(NamedTuple):
    """A picture's format as the device has set it."""

    width_px: int
    height_px: int
    fourcc: str
    field: int
    line_bytes: int
    picture_bytes: int


class Place(NamedTuple):
    """Where a buffer's memory is found, and by what clock it is stamped."""

    offset: int
    length: int
    flags: Flag


class Filled(NamedTuple):
    """A buffer that came back with a picture."""

    buffer: int
    used_bytes: int
    flags: Flag
    stamp_ns: int
    sequence: int


class Control(NamedTuple):
    """A control: what it is called and what it may be set to."""

    number: int
    kind: int
    name: str
    minimum: int
    maximum: int
    step: int
    default: int
    flags: int


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("utf-8", "replace")


def fourcc_code(fourcc: str) -> int:
    """Four characters as the number of a pixel format."""
    return int.from_bytes(fourcc.encode("ascii"), "little")


def fourcc_name(code: int) -> str:
    """The four characters of a pixel format's number."""
    return code.to_bytes(4, "little").decode("ascii", "replace")


def blank(request: int) -> bytearray:
    """Room for a request's argument."""
    return bytearray(request >> 16 & 0x3FFF)


def capability(data: Bytes) -> Capability:
    """Answer to QUERYCAP; of a device with several nodes what this one can."""
    driver, card, bus, _version, all_nodes, this_node = _CAPABILITY.unpack(data)
    can = this_node if all_nodes & HAS_DEVICE_CAPS else all_nodes
    return Capability(_text(driver), _text(card), _text(bus), can)


def ask_format_name(index: int) -> bytearray:
    """Argument of ENUM_FMT."""
    return bytearray(_FORMAT_NAME.pack(index, CAPTURE, 0, b"", 0))


def format_name(data: Bytes) -> str:
    """Answer to ENUM_FMT: four characters."""
    return fourcc_name(_FORMAT_NAME.unpack(data)[4])


def ask_format(width_px: int, height_px: int, fourcc: str) -> bytearray:
    """Argument of S_FMT."""
    return bytearray(_FORMAT.pack(CAPTURE, width_px, height_px, fourcc_code(fourcc), FIELD_NONE, *[0] * 8))


def format_set(data: Bytes) -> Format:
    """Answer to S_FMT: what the device made of it."""
    _kind, width_px, height_px, code, field, line_bytes, picture_bytes, *_ = _FORMAT.unpack(data)
    return Format(width_px, height_px, fourcc_name(code), field, line_bytes, picture_bytes)


def ask_buffers(count: int) -> bytearray:
    """Argument of REQBUFS."""
    return bytearray(_BUFFERS.pack(count, CAPTURE, MMAP))


def buffers_given(data: Bytes) -> int:
    """Answer to REQBUFS: how many."""
    return int(_BUFFERS.unpack(data)[0])


def ask_buffer(index: int = 0) -> bytearray:
    """Argument of QUERYBUF, QBUF and DQBUF."""
    return bytearray(_BUFFER.pack(index, CAPTURE, 0, 0, 0, 0, 0, 0, MMAP, 0, 0))


def buffer_place(data: Bytes) -> Place:
    """Answer to QUERYBUF."""
    _index, _kind, _used, flags, _field, _s, _us, _sequence, _memory, offset, length = _BUFFER.unpack(data)
    return Place(offset & 0xFFFF_FFFF, length, Flag(flags))


def buffer_filled(data: Bytes) -> Filled:
    """Answer to DQBUF. The stamp is seconds and microseconds of the clock that the flags name."""
    index, _kind, used, flags, _field, seconds, micros, sequence, *_ = _BUFFER.unpack(data)
    return Filled(index, used, Flag(flags), seconds * 1_000_000_000 + micros * 1000, sequence)


def stream_kind() -> bytearray:
    """Argument of STREAMON and STREAMOFF."""
    return bytearray(_WORD.pack(CAPTURE))


def ask_parameters() -> bytearray:
    """Argument of G_PARM."""
    return bytearray(_PARAMETERS.pack(CAPTURE, 0, 0, 0, 0))


def picture_interval_s(data: Bytes) -> float | None:
    """Answer to G_PARM: seconds from one picture to the next; None when the device does not tell."""
    *_, numerator, denominator = _PARAMETERS.unpack(data)
    return numerator / denominator if numerator and denominator else None


def ask_control(number: int, value: int = 0) -> bytearray:
    """Argument of G_CTRL and S_CTRL."""
    return bytearray(_CONTROL.pack(number, value))


def control_value(data: Bytes) -> int:
    """Answer to G_CTRL and S_CTRL."""
    return int(_CONTROL.unpack(data)[1])


def ask_control_after(number: int) -> bytearray:
    """Argument of QUERY_EXT_CTRL: the first control after this number."""
    return bytearray(_CONTROL_FACTS.pack(number | NEXT_CONTROL, 0, b"", 0, 0, 0, 0, 0))


def control_facts(data: Bytes) -> Control:
    """Answer to QUERY_EXT_CTRL."""
    number, kind, name, minimum, maximum, step, default, flags = _CONTROL_FACTS.unpack(data)
    return Control(number, kind, _text(name), minimum, maximum, step, default, flags)


def ask_choice(number: int, index: int) -> bytearray:
    """Argument of QUERYMENU."""
    return bytearray(_CHOICE.pack(number, index, b""))


def choice_name(data: Bytes) -> str:
    """Answer to QUERYMENU."""
    return _text(_CHOICE.unpack(data)[2])


def ask_selection(left_px: int = 0, top_px: int = 0, width_px: int = 0, height_px: int = 0) -> bytearray:
    """Argument of G_SELECTION and S_SELECTION: the part of the sensor that is read."""
    return bytearray(_SELECTION.pack(CAPTURE, CROP, 0, left_px, top_px, width_px, height_px))


def selection(data: Bytes) -> tuple[int, int, int, int]:
    """Answer to G_SELECTION and S_SELECTION: left, top, width, height in px."""
    *_, left_px, top_px, width_px, height_px = _SELECTION.unpack(data)
    return left_px, top_px, width_px, height_px
