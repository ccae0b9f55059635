"""Pixel formats: from the bytes that a camera sends to grey levels. Pure.

Sources: PFNC 2.4 (Mono8 to Mono16, Mono10p, Mono12p), GigE Vision 2.0 (Mono10Packed, Mono12Packed), the V4L2 pages of
the Linux kernel (Y10P, YUYV). Rows follow each other without padding.

Vision measures 8 bit. A deeper picture is brought to 8 bit over its format's full range, rounded: what that loses is
0.3 grey levels of noise (rms), less than any sensor's own. A recorded 16 bit file is treated the same way, so a deep
picture measures alike now and later.
"""

from enum import Enum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Grey8 = NDArray[np.uint8]
Grey16 = NDArray[np.uint16]

BLOCK_GROUPS = 16_384  # groups unpacked at a time, so that what lies in between stays in the cache


class PixelError(ValueError):
    """These bytes are no picture of this format; the text goes on after the picture's name."""


class Part(NamedTuple):
    """One pixel of a group: `high` byte shifted left by `left`, and `mask`ed `low` byte shifted right by `right`."""

    high: int
    left: int
    low: int
    right: int
    mask: int


class Layout(NamedTuple):
    """How pixels lie in bytes: so many `parts` in a group of so many bytes."""

    group_bytes: int
    parts: tuple[Part, ...]


class Plain(Enum):
    """Layouts that need no unpacking."""

    BYTE = 1  # one byte is one pixel
    WORD = 2  # 16 bit, little-endian, the value in the low bits
    LUMA = 3  # every other byte is one pixel's luma


class PixelFormat(NamedTuple):
    """A format by the name its standard gives it. `code` is its PFNC number, 0 when it has none."""

    name: str
    bits: int
    code: int
    bits_on_the_wire: int
    layout: Layout | Plain

    def bytes_for(self, width_px: int, height_px: int) -> int:
        """Bytes of a whole picture."""
        return (width_px * height_px * self.bits_on_the_wire + 7) // 8

    @property
    def white(self) -> int:
        """The largest grey level."""
        return int((1 << self.bits) - 1)


_LSB_10 = Layout(5, (Part(1, 8, 0, 0, 0xFF), Part(2, 6, 1, 2, 0x3F), Part(3, 4, 2, 4, 0xF), Part(4, 2, 3, 6, 0x3)))
_LSB_12 = Layout(3, (Part(1, 8, 0, 0, 0xFF), Part(2, 4, 1, 4, 0xF)))
_PACKED_10 = Layout(3, (Part(0, 2, 1, 0, 0x3), Part(2, 2, 1, 4, 0x3)))
_PACKED_12 = Layout(3, (Part(0, 4, 1, 0, 0xF), Part(2, 4, 1, 4, 0xF)))
_MIPI_10 = Layout(5, tuple(Part(n, 2, 4, 2 * n, 0x3) for n in range(4)))

MONO8 = PixelFormat("Mono8", 8, 0x01080001, 8, Plain.BYTE)
MONO10 = PixelFormat("Mono10", 10, 0x01100003, 16, Plain.WORD)
MONO12 = PixelFormat("Mono12", 12, 0x01100005, 16, Plain.WORD)
MONO14 = PixelFormat("Mono14", 14, 0x01100025, 16, Plain.WORD)
MONO16 = PixelFormat("Mono16", 16, 0x01100007, 16, Plain.WORD)
MONO10P = PixelFormat("Mono10p", 10, 0x010A0046, 10, _LSB_10)
MONO12P = PixelFormat("Mono12p", 12, 0x010C0047, 12, _LSB_12)
MONO10PACKED = PixelFormat("Mono10Packed", 10, 0x010C0004, 12, _PACKED_10)
MONO12PACKED = PixelFormat("Mono12Packed", 12, 0x010C0006, 12, _PACKED_12)
RAW10P = PixelFormat("Y10P", 10, 0, 10, _MIPI_10)
YUYV = PixelFormat("YUYV", 8, 0, 16, Plain.LUMA)

FORMATS = (MONO8, MONO10, MONO12, MONO14, MONO16, MONO10P, MONO12P, MONO10PACKED, MONO12PACKED, RAW10P, YUYV)
BY_NAME = {pixel_format.name: pixel_format for pixel_format in FORMATS}


def eight_bit(payload: Bytes, pixel_format: PixelFormat, width_px: int, height_px: int) -> Grey8:
    """Grey levels 0 to 255 over the format's full range, rounded, (height, width). Of Mono8 a view, else a copy.

    Raises PixelError when the bytes are too few or too many, or a value is larger than the format allows.
    """
    _check_size(payload, pixel_format, width_px, height_px)
    shape = height_px, width_px
    if pixel_format.layout is Plain.BYTE:
        return payload.reshape(shape)
    if pixel_format.layout is Plain.LUMA:
        return np.ascontiguousarray(payload[::2]).reshape(shape)
    if isinstance(pixel_format.layout, Layout):
        narrow = np.empty(_room(pixel_format.layout, width_px * height_px), np.uint8)
        _unpack(payload, pixel_format, narrow)
        return narrow.reshape(-1)[: width_px * height_px].reshape(shape)
    return _narrow_words(_words(payload, pixel_format), pixel_format.bits).reshape(shape)


def full_depth(payload: Bytes, pixel_format: PixelFormat, width_px: int, height_px: int) -> Grey16:
    """Grey levels as the camera gave them, 0 to `white`, (height, width). Raises PixelError."""
    _check_size(payload, pixel_format, width_px, height_px)
    shape = height_px, width_px
    if isinstance(pixel_format.layout, Layout):
        deep = np.empty(_room(pixel_format.layout, width_px * height_px), np.uint16)
        _unpack(payload, pixel_format, deep)
        return deep.reshape(-1)[: width_px * height_px].reshape(shape)
    if pixel_format.layout is Plain.WORD:
        return _words(payload, pixel_format).astype(np.uint16).reshape(shape)
    return eight_bit(payload, pixel_format, width_px, height_px).astype(np.uint16)


def _check_size(payload: Bytes, pixel_format: PixelFormat, width_px: int, height_px: int) -> None:
    expected = pixel_format.bytes_for(width_px, height_px)
    if payload.ndim != 1 or payload.dtype != np.uint8 or payload.size != expected:
        seen = f"{payload.dtype} {payload.shape}"
        raise PixelError(f"is {seen}, not the {expected} bytes of {width_px} x {height_px} {pixel_format.name}")


def _words(payload: Bytes, pixel_format: PixelFormat) -> NDArray[np.uint16]:
    """The 16 bit values. A camera that puts its bits to the left would otherwise be taken for a bright one."""
    words = payload.view("<u2")
    brightest = int(words.max(initial=0))
    if brightest > pixel_format.white:
        raise PixelError(f"has values up to {brightest}, and {pixel_format.name} ends at {pixel_format.white}")
    return words


def _narrow_words(words: NDArray[np.uint16], bits: int) -> Grey8:
    narrow = np.empty(words.size, np.uint8)
    for first in range(0, words.size, BLOCK_GROUPS):
        narrow[first : first + BLOCK_GROUPS] = _narrowed(words[first : first + BLOCK_GROUPS], bits)
    return narrow


def _narrowed(values: NDArray[np.uint16], bits: int) -> NDArray[np.uint16]:
    """From so many bits to eight, rounded; the brightest values do not run over."""
    shift = bits - 8
    ceiling = np.uint16((255 << shift) - 1 + (1 << (shift - 1)))  # the largest value that rounds to 255
    return (np.minimum(values, ceiling) + np.uint16(1 << (shift - 1))) >> np.uint16(shift)


def _room(layout: Layout, count: int) -> tuple[int, int]:
    """Groups that hold `count` pixels, and pixels in a group."""
    return -(-count // len(layout.parts)), len(layout.parts)


def _unpack(payload: Bytes, pixel_format: PixelFormat, out: Grey8 | Grey16) -> None:
    """All groups into `out` (groups, pixels of a group), block by block; the last one may end with the picture."""
    layout = pixel_format.layout
    assert isinstance(layout, Layout)
    whole = payload.size // layout.group_bytes
    table = payload[: whole * layout.group_bytes].reshape(whole, layout.group_bytes)
    for first in range(0, whole, BLOCK_GROUPS):
        end = min(first + BLOCK_GROUPS, whole)
        _unpack_block(table[first:end], out[first:end], pixel_format)
    if whole < len(out):
        rest = np.zeros((1, layout.group_bytes), np.uint8)
        rest[0, : payload.size - whole * layout.group_bytes] = payload[whole * layout.group_bytes :]
        _unpack_block(rest, out[whole:], pixel_format)


def _unpack_block(groups: Bytes, out: Grey8 | Grey16, pixel_format: PixelFormat) -> None:
    layout, white = pixel_format.layout, np.uint16(pixel_format.white)
    assert isinstance(layout, Layout)
    columns = {n: groups[:, n].astype(np.uint16) for n in range(layout.group_bytes)}
    for number, part in enumerate(layout.parts):
        low = (columns[part.low] >> np.uint16(part.right)) & np.uint16(part.mask)
        value = ((columns[part.high] << np.uint16(part.left)) & white) | low
        out[:, number] = _narrowed(value, pixel_format.bits) if out.dtype == np.uint8 else value
