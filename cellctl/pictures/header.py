"""The size of a picture file, before it is decoded: a small file may claim a huge picture. Pure.

Sources: PNG (W3C, 5.2 and 11.2.1), TIFF 6.0 (section 2), BMP (BITMAPINFOHEADER), JPEG (ITU-T T.81, B.2.2).
"""

import struct
import zlib
from typing import NamedTuple

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
TIFF_WIDTH, TIFF_HEIGHT = 256, 257
TIFF_ENTRY = 12
TIFF_FORMATS = {3: "H", 4: "I"}  # SHORT and LONG
BMP_SMALLEST = 26
JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"
JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # the frame headers SOF0 to SOF15
JPEG_BARE = frozenset({0x01, *range(0xD0, 0xD8)})  # markers without a length


class NotAPicture(ValueError):
    """Why these bytes are none; the text goes on after the file's name."""


class Header(NamedTuple):
    """What a file claims to be."""

    kind: str
    width: int
    height: int
    more_pages: bool = False


def header_of(content: bytes) -> Header:
    """Kind and size of a whole picture file. Raises NotAPicture for other bytes, and cut-off or damaged ones."""
    try:
        if content.startswith(PNG_SIGNATURE):
            return _png(content)
        if content[:4] in (b"II*\0", b"MM\0*"):
            return _tiff(content)
        if content.startswith(b"BM"):
            return _bmp(content)
        if content.startswith(JPEG_START):
            return _jpeg(content)
    except (struct.error, IndexError):
        raise NotAPicture("is cut off: copy it again") from None
    begins = f"it begins with {content[:4].hex(' ')}" if content else "it is empty"
    raise NotAPicture(f"is no PNG, TIFF, BMP or JPEG: {begins}")


def _png(content: bytes) -> Header:
    """Every chunk is whole and has its check sum, and the last one ends the file."""
    at, kind = len(PNG_SIGNATURE), b""
    while kind != b"IEND":
        (length,) = struct.unpack_from(">I", content, at)
        kind, end = content[at + 4 : at + 8], at + 8 + length
        (expected,) = struct.unpack_from(">I", content, end)
        if zlib.crc32(content[at + 4 : end]) != expected:
            raise NotAPicture(f"is damaged: the check sum of its part {kind.decode('latin-1')!r} is wrong")
        at = end + 4
    width, height = struct.unpack_from(">II", content, len(PNG_SIGNATURE) + 8)
    return Header("PNG", width, height)


def _tiff(content: bytes) -> Header:
    order = "<" if content.startswith(b"II") else ">"
    (directory,) = struct.unpack_from(f"{order}I", content, 4)
    (count,) = struct.unpack_from(f"{order}H", content, directory)
    size: dict[int, int] = {}
    for number in range(count):
        at = directory + 2 + number * TIFF_ENTRY
        tag, kind = struct.unpack_from(f"{order}HH", content, at)
        if tag in (TIFF_WIDTH, TIFF_HEIGHT) and kind in TIFF_FORMATS:
            (size[tag],) = struct.unpack_from(order + TIFF_FORMATS[kind], content, at + 8)
    (following,) = struct.unpack_from(f"{order}I", content, directory + 2 + count * TIFF_ENTRY)
    if len(size) != 2:
        raise NotAPicture("is a TIFF that does not say its width and height")
    return Header("TIFF", size[TIFF_WIDTH], size[TIFF_HEIGHT], following != 0)


def _bmp(content: bytes) -> Header:
    (length,) = struct.unpack_from("<I", content, 2)
    (header,) = struct.unpack_from("<I", content, 14)
    if length > len(content):
        raise NotAPicture(f"is cut off: {len(content)} of {length} bytes are there, copy it again")
    if header < BMP_SMALLEST - 14:
        raise NotAPicture("is a BMP with a damaged header")
    layout = "<HH" if header == BMP_SMALLEST - 14 else "<ii"
    width, height = struct.unpack_from(layout, content, 18)
    return Header("BMP", width, abs(height))


def _jpeg(content: bytes) -> Header:
    if JPEG_END not in content[-64:]:
        raise NotAPicture("is cut off: a JPEG ends with an end mark, copy it again")
    at = len(JPEG_START)
    while True:
        if content[at] != 0xFF:
            raise NotAPicture("is a damaged JPEG: no mark where one must be")
        kind = content[at + 1]
        if kind in JPEG_SIZES:
            height, width = struct.unpack_from(">HH", content, at + 5)
            return Header("JPEG", width, height)
        step = 0 if kind in JPEG_BARE or kind == 0xFF else struct.unpack_from(">H", content, at + 2)[0]
        at += step + (1 if kind == 0xFF else 2)
