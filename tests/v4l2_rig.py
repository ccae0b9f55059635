"""A simulated V4L2 camera for tests, behind a FUSE file or in this process, and how to get drivers for it."""

import asyncio
import os
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from drivers.camera import Frame, Pixels, Region, Setup, Trigger
from drivers.pixels import MONO8, PixelFormat
from drivers.v4l2 import V4l2Camera
from drivers.v4l2_node import KernelNode
from simulators.clock import Clock
from simulators.gige import Exposure
from simulators.v4l2 import Device, V4l2CameraServer, why_not

SMALL = (640, 480)
FULL = (2592, 1944)


@cache
def fuse_is_missing() -> str:
    """Why FUSE files cannot be tested here, or nothing."""
    return why_not()


def needs_fuse() -> None:
    """Skip a test that is about the file itself; strict runs must not."""
    if reason := fuse_is_missing():
        if os.environ.get("CELLCTL_STRICT") and Path("/dev/fuse").exists():
            pytest.fail(f"FUSE is there and cannot be used: {reason}")
        pytest.skip(reason)


class Scene:
    """Another random picture for each exposure."""

    def __init__(self, size: tuple[int, int], seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        self.pictures = rng.integers(0, 256, (4, size[1], size[0]), dtype=np.uint8)
        self.exposures: list[Exposure] = []

    def __call__(self, exposure: Exposure) -> Pixels:
        self.exposures.append(exposure)
        return self.seen(len(self.exposures), exposure)

    def seen(self, number: int, exposure: Exposure) -> Pixels:
        rows = slice(exposure.offset_y, exposure.offset_y + exposure.height)
        columns = slice(exposure.offset_x, exposure.offset_x + exposure.width)
        return self.pictures[number % 4][rows, columns]

    def number_of(self, pixels: Pixels) -> int | None:
        """Which of the exposures so far gave these pixels: the newest; None when none did."""
        for number in range(len(self.exposures), max(0, len(self.exposures) - 4), -1):
            if np.array_equal(self.seen(number, self.exposures[number - 1]), pixels):
                return number
        return None

    def was_seen_in(self, frame: Frame) -> bool:
        return self.number_of(frame.pixels) is not None


class Rig:
    """A simulated camera, and how to get drivers for it."""

    def __init__(self, server: V4l2CameraServer, scene: Scene, size: tuple[int, int], path: Path | None) -> None:
        self.server, self.scene, self.size, self.path = server, scene, size, path

    def camera(
        self, *, serial: str = "SN1", pixel_format: PixelFormat = MONO8, region: Region | None = None, **options: object
    ) -> V4l2Camera:
        setup = Setup(serial, region or Region(0, 0, *self.size), pixel_format)
        opener: Callable[[str], object] = KernelNode if self.path else self.server.open_here
        return V4l2Camera("camera 1", str(self.path or "/dev/video0"), setup, open_node=opener, **options)

    @asynccontextmanager
    async def open_camera(self, **options: object) -> AsyncIterator[V4l2Camera]:
        camera = self.camera(**options)
        try:
            await camera.open()
            yield camera
        finally:
            await camera.close()


@asynccontextmanager
async def rig(
    size: tuple[int, int] = SMALL, *, speed: float = 20.0, path: Path | None = None, **options: object
) -> AsyncIterator[Rig]:
    """`path`: where the file is to be; None: no file, the driver calls the device in this process."""
    scene = Scene(size)
    device = Device("SN1", size, **options)
    async with V4l2CameraServer(device, scene, Clock(speed), path=path) as server:
        yield Rig(server, scene, size, path)


FRONTS = ["file", "process"]


def where(front: str, folder: Path) -> Path | None:
    if front == "process":
        return None
    needs_fuse()
    return folder / "video0"


async def until(true: Callable[[], bool], within_s: float = 5.0) -> None:
    async with asyncio.timeout(within_s):
        while not true():
            await asyncio.sleep(0.005)


@asynccontextmanager
async def armed(trigger: Trigger, **options: object) -> AsyncIterator[tuple[Rig, V4l2Camera]]:
    async with rig(**options) as r, r.open_camera() as camera:
        await camera.arm(trigger)
        yield r, camera
