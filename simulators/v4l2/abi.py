"""The V4L2 interface as the kernel's header has it (linux/videodev2.h on a 64-bit machine): numbers and layouts. Pure.

Written from the header for the simulator alone; the driver has its own, so that a mistake cannot cancel itself.
"""

from enum import IntEnum, IntFlag
from struct import Struct

READ, WRITE, BOTH = 2, 1, 3


def _request(direction: int, number: int, size: int) -> int:
    return direction << 30 | size << 16 | ord("V") << 8 | number


class Request(IntEnum):
    """ioctl numbers: direction, size of the argument, 'V', number."""

    QUERYCAP = _request(READ, 0, 104)
    ENUM_FMT = _request(BOTH, 2, 64)
    G_FMT = _request(BOTH, 4, 208)
    S_FMT = _request(BOTH, 5, 208)
    TRY_FMT = _request(BOTH, 64, 208)
    REQBUFS = _request(BOTH, 8, 20)
    QUERYBUF = _request(BOTH, 9, 88)
    QBUF = _request(BOTH, 15, 88)
    DQBUF = _request(BOTH, 17, 88)
    STREAMON = _request(WRITE, 18, 4)
    STREAMOFF = _request(WRITE, 19, 4)
    G_PARM = _request(BOTH, 21, 204)
    S_PARM = _request(BOTH, 22, 204)
    ENUMINPUT = _request(BOTH, 26, 80)
    G_CTRL = _request(BOTH, 27, 8)
    S_CTRL = _request(BOTH, 28, 8)
    QUERYCTRL = _request(BOTH, 36, 68)
    QUERYMENU = _request(BOTH, 37, 44)
    G_INPUT = _request(READ, 38, 4)
    S_INPUT = _request(BOTH, 39, 4)
    ENUM_FRAMESIZES = _request(BOTH, 74, 44)
    ENUM_FRAMEINTERVALS = _request(BOTH, 75, 52)
    G_SELECTION = _request(BOTH, 94, 64)
    S_SELECTION = _request(BOTH, 95, 64)
    QUERY_EXT_CTRL = _request(BOTH, 103, 232)


def reads(request: int) -> bool:
    """Does the kernel hand the argument to the device?"""
    return bool(request >> 30 & WRITE)


def answers(request: int) -> bool:
    """Does the device hand the argument back?"""
    return bool(request >> 30 & READ)


def size(request: int) -> int:
    """Bytes of the argument."""
    return request >> 16 & 0x3FFF


class Flag(IntFlag):
    """Flags of a buffer."""

    MAPPED = 0x1
    QUEUED = 0x2
    DONE = 0x4
    ERROR = 0x40
    MONOTONIC = 0x2000
    START_OF_EXPOSURE = 0x10000


class Event(IntFlag):
    """What poll() reports."""

    IN = 0x1
    ERR = 0x8
    HUP = 0x10
    RDNORM = 0x40


class ControlType(IntEnum):
    """Kinds of controls."""

    INTEGER = 1
    BOOLEAN = 2
    MENU = 3
    BUTTON = 4


CAPTURE = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
MEMORY_MMAP = 1
FIELD_NONE = 1
INPUT_CAMERA = 2
CAN_CAPTURE, EXT_PIX_FORMAT, CAN_STREAM, HAS_DEVICE_CAPS = 0x1, 0x200000, 0x4000000, 0x80000000
SUPPORTS_MMAP = 0x1
TIME_PER_FRAME = 0x1000
STEPWISE_SIZES, DISCRETE_INTERVALS = 3, 1
CROP, CROP_DEFAULT, CROP_BOUNDS = 0x0, 0x1, 0x2
NEXT_CONTROL, NEXT_COMPOUND = 0x80000000, 0x40000000
INACTIVE, EXECUTE_ON_WRITE = 0x10, 0x200
COLORSPACE_SRGB = 8
PRIVATE_MAGIC = 0xFEEDCAFE

NUMBER = Struct("<I")
CONTROL = Struct("<Ii")
CAPABILITY = Struct("<16s32s32s3I12x")
FORMAT_DESCRIPTION = Struct("<3I32sI16x")
FORMAT = Struct("<I4x12I152x")  # type; width height pixelformat field bytesperline sizeimage colorspace priv flags ...
REQUEST_BUFFERS = Struct("<4I4x")  # count type memory capabilities
BUFFER = Struct("<5I4xqq16s2IQI4xI4x")  # index type used flags field, s us, timecode, sequence memory offset length, fd
STREAM_PARAMETERS = Struct("<5I184x")  # type capability capturemode numerator denominator
QUERY_CONTROL = Struct("<2I32s4iI8x")  # id type name minimum maximum step default flags
QUERY_EXT_CONTROL = Struct("<2I32sqqQq4I16s128x")  # ... default flags size elements dimensions
QUERY_MENU = Struct("<2I32s4x")
INPUT = Struct("<I32s3I32x")
FRAME_SIZE = Struct("<3I6I8x")  # index format kind, min max step of width, of height
FRAME_INTERVAL = Struct("<5I2I24x")  # index format width height kind, numerator denominator
SELECTION = Struct("<3I4i36x")  # type target flags, left top width height


def text(words: str, length: int) -> bytes:
    """A string field, ended by a zero."""
    return words.encode("ascii", "replace")[: length - 1]
