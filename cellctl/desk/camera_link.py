"""The cell's cameras at the desk: only while no daemon owns them."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import NamedTuple

from cellctl.cameras import build_camera
from cellctl.config import CellConfig, load_config
from cellctl.config_camera import CameraConfig
from cellctl.desk.ownership import nobody_owns
from drivers.camera import Camera


class Which(NamedTuple):
    """A camera of the cell: 1 or 2."""

    config: Path
    number: int

    @property
    def name(self) -> str:
        """What the operator calls it."""
        return f"camera {self.number}"


class Exposure(NamedTuple):
    """What is asked for; None: as the camera has it, and 0 dB."""

    exposure_us: float | None
    gain_db: float | None


def camera_of(config: CellConfig, number: int) -> CameraConfig:
    """Its table in cell.toml."""
    return config.camera_1 if number == 1 else config.camera_2


@asynccontextmanager
async def at_desk(which: Which, exposure: Exposure) -> AsyncIterator[Camera]:
    """The camera, open and armed for grab(); it is let go afterwards.

    Raises ClickException (the daemon owns it), SettingsError, DeviceError.
    """
    config = load_config(which.config)
    wanted = camera_of(config, which.number)
    if wanted.driver != "files":
        await nobody_owns(config, which.name)
    camera = build_camera(which.name, wanted)
    try:
        await camera.open()
        if exposure.exposure_us is not None:
            await camera.configure(exposure_us=exposure.exposure_us, gain_db=exposure.gain_db or 0.0)
        yield camera
    finally:
        await camera.close()
