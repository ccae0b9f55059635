"""A simulated GigE Vision camera, and drivers for it."""

import asyncio
import itertools
import os
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import numpy as np

from drivers.camera import Frame, Region, Setup
from drivers.gige import GigeCamera
from simulators.clock import Clock
from simulators.gige import Exposure, GigeCameraServer

SMALL = (640, 480)
FULL = (2592, 1944)
_numbers = itertools.count(1)


def fresh_ip() -> str:
    """An address of this test process alone, so that test runs do not meet."""
    pid = os.getpid()
    return f"127.{64 + (pid >> 8) % 64}.{pid & 255}.{next(_numbers) % 250 + 1}"


def setup(size: tuple[int, int] = FULL, serial: str = "SN1", **more: Any) -> Setup:
    """The whole sensor."""
    return Setup(serial, Region(0, 0, *size), **more)


class Scene:
    """Another random picture for each exposure."""

    def __init__(self, size: tuple[int, int], seed: int = 1) -> None:
        rng = np.random.default_rng(seed)
        self.pictures = rng.integers(0, 256, (4, size[1], size[0]), dtype=np.uint8)
        self.exposures: list[Exposure] = []

    def __call__(self, exposure: Exposure) -> np.ndarray:
        self.exposures.append(exposure)
        return self.newest

    @property
    def newest(self) -> np.ndarray:
        return self.pictures[len(self.exposures) % 4]

    def was_seen_in(self, frame: Frame) -> bool:
        return bool(np.array_equal(frame.pixels, self.newest))


class Rig:
    """A simulated camera, and how to get drivers for it."""

    def __init__(self, server: GigeCameraServer, scene: Scene, size: tuple[int, int]) -> None:
        self.server, self.scene, self.size = server, scene, size

    @asynccontextmanager
    async def camera(self, wanted: Setup | None = None, **options: int) -> AsyncIterator[GigeCamera]:
        camera = GigeCamera("camera 1", self.server.ip, wanted or setup(self.size), **options)
        try:
            yield camera
        finally:
            await camera.close()

    @asynccontextmanager
    async def open_camera(self, wanted: Setup | None = None, **options: int) -> AsyncIterator[GigeCamera]:
        async with self.camera(wanted, **options) as camera:
            await camera.open()
            yield camera


@asynccontextmanager
async def rig(size: tuple[int, int] = SMALL, *, speed: float = 20.0, **options: int) -> AsyncIterator[Rig]:
    scene = Scene(size)
    async with GigeCameraServer(fresh_ip(), "SN1", scene, Clock(speed), sensor=size, **options) as server:
        yield Rig(server, scene, size)


def driver_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("camera 1")]


async def until_threads_end(within_s: float = 2.0) -> None:
    await until(lambda: not driver_threads(), within_s)


async def until(true: Callable[[], bool], within_s: float = 2.0) -> None:
    async with asyncio.timeout(within_s):
        while not true():  # what is awaited happens in other threads
            await asyncio.sleep(0.01)
