"""`cellctl camera snap`: pictures of a camera of the cell as PNG files."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import click
import cv2
import numpy as np

from cellctl.desk.camera_link import Exposure, Which, at_desk
from cellctl.desk.commands import run_loop
from cellctl.learnt.references import write_whole
from cellctl.pictures.files import PictureError
from drivers.camera import Frame

FAST = [cv2.IMWRITE_PNG_COMPRESSION, 1]
BITS_OF_A_WORD = 16


class Order(NamedTuple):
    """What the command line asks for."""

    which: Which
    exposure: Exposure
    out: Path
    pictures: int
    deep: bool
    force: bool
    as_json: bool


def snap(order: Order) -> int:
    """Take and write the pictures, a line each. Raises SettingsError, DeviceError, PictureError, ClickException."""
    paths = _paths(order)
    for path in paths:
        if path.exists() and not order.force:
            raise PictureError(f"{path}: is there already (--force replaces it)")
    return run_loop(_snap(order, paths))


def _paths(order: Order) -> list[Path]:
    out = order.out if order.out.suffix else order.out.with_suffix(".png")
    if out.suffix.lower() != ".png":
        raise PictureError(f"{order.out}: pictures are written as PNG, so its name must end in .png")
    if order.pictures == 1:
        return [out]
    return [out.with_name(f"{out.stem}-{number:03}.png") for number in range(1, order.pictures + 1)]


async def _snap(order: Order, paths: list[Path]) -> int:
    async with at_desk(order.which, order.exposure) as camera:
        for path in paths:
            frame = await camera.grab()
            _write(path, frame, deep=order.deep)
            told = _told(path, frame)
            click.echo(json.dumps(told) if order.as_json else _line(told))
    return 0


def _write(path: Path, frame: Frame, *, deep: bool) -> None:
    """8 bit as vision sees it, or 16 bit with the format's values over the whole range, as PNG has them."""
    pixels = frame.deep() << np.uint16(BITS_OF_A_WORD - frame.pixel_format.bits) if deep else frame.pixels
    _, encoded = cv2.imencode(".png", pixels, FAST)
    try:
        write_whole(path, encoded.tobytes())
    except OSError as error:
        raise PictureError(f"{path}: cannot be written: {error.strerror}") from error


def _told(path: Path, frame: Frame) -> dict[str, Any]:
    return {
        "file": str(path),
        "camera": frame.camera_id,
        "width_px": frame.region.width_px,
        "height_px": frame.region.height_px,
        "pixel_format": frame.pixel_format.name,
        "exposure_us": frame.exposure_us,
        "gain_db": frame.gain_db,
        "grey_min": int(frame.pixels.min()),
        "grey_mean": round(float(frame.pixels.mean()), 1),
        "grey_max": int(frame.pixels.max()),
    }


def _line(told: dict[str, Any]) -> str:
    return (
        "{file}: camera {camera}, {width_px} x {height_px} {pixel_format}, {exposure_us:g} us {gain_db:g} dB, "
        "grey levels {grey_min} to {grey_max}, mean {grey_mean}"
    ).format(**told)
