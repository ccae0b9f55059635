"""The driver of a camera as cell.toml describes it."""

from functools import partial
from pathlib import Path

from cellctl.config_camera import JPEG, CameraConfig
from cellctl.pictures.files import FULL_BITS, PictureError, picture_paths, read_picture
from cellctl.pictures.jpeg import luma
from drivers.camera import Camera, Pixels, Setup
from drivers.file_camera import FileCamera, Files, Unusable
from drivers.gige import GigeCamera
from drivers.pixels import BY_NAME, MONO8
from drivers.v4l2 import V4l2Camera


def build_camera(name: str, camera: CameraConfig) -> Camera:
    """The driver; nothing is connected yet. `name` is what the operator calls it."""
    setup = Setup(camera.serial, camera.region, BY_NAME.get(camera.pixel_format, MONO8))
    if camera.driver == "v4l2":
        decode = luma if camera.pixel_format == JPEG else None
        return V4l2Camera(name, camera.address, setup, decode=decode, gain_db_per_step=camera.gain_db_per_step)
    if camera.driver == "files":
        bits = FULL_BITS if setup.pixel_format == MONO8 else setup.pixel_format.bits
        return FileCamera(name, camera.folder, setup, Files(_found, partial(_read, bits=bits)))
    return GigeCamera(name, camera.address, setup, packet_delay_us=camera.packet_delay_us)


def _found(folder: Path) -> list[Path]:
    try:
        return picture_paths([folder])
    except PictureError as error:
        raise Unusable(str(error)) from error


def _read(path: Path, bits: int) -> Pixels:
    try:
        return read_picture(path, bits).pixels
    except PictureError as error:
        raise Unusable(str(error)) from error
