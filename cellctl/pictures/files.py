"""Pictures from files: PNG, TIFF, BMP and JPEG, mono of 8 or 16 bit or colour, as the 8 bit mono that vision measures.

Nothing is converted in silence: every file says in words what was done to it, and what cannot be used is refused
with its name, what is wrong and what to do.
"""

import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.pictures.header import Header, NotAPicture, header_of
from cellctl.vision.features import Pixels
from cellctl.vision.picture import SMALLEST_PX

SUFFIXES = frozenset({".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg"})
LARGEST_FILE = 512 * 1024 * 1024
LARGEST_PX = 100_000_000
FULL_BITS = 16
OPAQUE = {np.dtype(np.uint8): 255, np.dtype(np.uint16): 65535}
JPEG_QUALITY = 90


class PictureError(Exception):
    """A picture file cannot be used; the text is a sentence with its name."""


class Picture(NamedTuple):
    """A file's picture, uint8 (height, width), and what was done to it."""

    path: Path
    pixels: Pixels
    notes: tuple[str, ...]


def picture_paths(given: Sequence[Path]) -> list[Path]:
    """The picture files meant by these files and folders, in order; of a folder all that have a picture's suffix.

    Raises PictureError for what is not there and for a folder without pictures.
    """
    found: list[Path] = []
    for path in given:
        if path.is_dir():
            found += _in_folder(path)
        elif path.exists():
            found.append(path)
        else:
            raise PictureError(f"{path}: there is no such file or folder")
    return list(dict.fromkeys(found))


def _in_folder(folder: Path) -> list[Path]:
    try:
        inside = [
            path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
        ]
    except OSError as error:
        raise PictureError(f"{folder}: the folder cannot be read: {error.strerror}") from error
    if not inside:
        raise PictureError(f"{folder}: there is no picture in it ({', '.join(sorted(SUFFIXES))})")
    return sorted(inside, key=lambda path: [int(p) if p.isdigit() else p for p in re.split(r"(\d+)", path.name)])


def read_picture(path: Path, bits: int = FULL_BITS) -> Picture:
    """The picture of one file; `bits` says how many of a 16 bit picture the camera uses. Raises PictureError."""
    content = _content(path)
    try:
        header = header_of(content)
        _check_size(header)
        pixels, notes = _mono(_decoded(content), bits)
    except NotAPicture as error:
        raise PictureError(f"{path}: {error}") from None
    if header.more_pages:
        notes.append("first of several pages")
    if header.kind == "JPEG":
        notes.append("JPEG loses detail: good for a trial, not for teaching")
    return Picture(path, pixels, tuple(notes))


def _content(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise PictureError(f"{path}: there is no such file") from None
    except OSError as error:
        raise PictureError(f"{path}: cannot be read: {error.strerror}") from error
    if len(content) > LARGEST_FILE:
        raise PictureError(f"{path}: is larger than {LARGEST_FILE >> 20} MB")
    return content


def _check_size(header: Header) -> None:
    size = f"{header.width} x {header.height} px"
    if min(header.width, header.height) < SMALLEST_PX:
        raise NotAPicture(f"is {size}; at least {SMALLEST_PX} x {SMALLEST_PX} are needed")
    if header.width * header.height > LARGEST_PX:
        raise NotAPicture(f"claims {size}; more than {LARGEST_PX // 1_000_000} megapixels are not read")


def _decoded(content: bytes) -> NDArray[np.generic]:
    """The pixels as they are stored. Raises NotAPicture."""
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    finally:
        cv2.utils.logging.setLogLevel(before)
    if pixels is None:
        raise NotAPicture("is cut off or damaged, or of a kind that cannot be read: save it as a plain PNG or TIFF")
    return np.asarray(pixels)


def _mono(pixels: NDArray[np.generic], bits: int) -> tuple[Pixels, list[str]]:
    """One channel of 8 bit, and what was done. Raises NotAPicture."""
    if pixels.dtype not in OPAQUE:
        raise NotAPicture(f"has pixels of type {pixels.dtype}; 8 and 16 bit are read")
    notes: list[str] = []
    grey = pixels if pixels.ndim == 2 else _one_channel(pixels, notes)
    if grey.dtype == np.uint16:
        grey = _of_bits(grey, bits)
        notes.append(f"{bits} bit, divided by {2 ** (bits - 8)}")
    return np.ascontiguousarray(grey, np.uint8), notes


def _one_channel(pixels: NDArray[np.generic], notes: list[str]) -> NDArray[np.generic]:
    channels = pixels.shape[2]
    if channels in (2, 4) and (pixels[..., -1] != OPAQUE[pixels.dtype]).any():
        raise NotAPicture("is partly transparent: save it without transparency")
    if channels in (1, 2):
        return pixels[..., 0]
    if channels not in (3, 4):
        raise NotAPicture(f"has {channels} channels; mono and colour are read")
    blue, green, red = (pixels[..., i] for i in range(3))
    if np.array_equal(blue, green) and np.array_equal(green, red):
        return blue
    notes.append("colour, converted to grey")
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels[..., :3]), cv2.COLOR_BGR2GRAY))


def _of_bits(pixels: NDArray[np.generic], bits: int) -> NDArray[np.generic]:
    """The upper eight of so many bits, rounded. Raises NotAPicture when a value needs more, or hardly any is used."""
    brightest = int(np.max(pixels))
    if brightest >= 2**bits:
        raise NotAPicture(f"has values up to {brightest}: that is more than {bits} bit (--bits)")
    if bits == FULL_BITS and brightest < 2**12:
        needed = max(8, brightest.bit_length())
        raise NotAPicture(f"has 16 bit but no value above {brightest}: say how many the camera uses (--bits {needed}?)")
    step = 2 ** (bits - 8)
    return np.asarray(np.minimum((pixels.astype(np.uint32) + step // 2) // step, 255))


def write_picture(path: Path, bgr: NDArray[np.uint8]) -> None:
    """Write a drawn picture as JPEG, whole or not at all. Raises PictureError."""
    _, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    part = path.with_name(f".{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part.write_bytes(encoded.tobytes())
        os.replace(part, path)
    except OSError as error:
        raise PictureError(f"{path}: cannot be written: {error.strerror}") from error
