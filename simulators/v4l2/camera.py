"""A simulated V4L2 camera: the device, its sensor, and the file through which clients reach it."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Self

from simulators.clock import Clock
from simulators.gige import Exposure
from simulators.v4l2.device import Device
from simulators.v4l2.faults import Faults
from simulators.v4l2.formats import Bytes
from simulators.v4l2.fuse_mount import FuseFile
from simulators.v4l2.in_process import OpenDevice
from simulators.v4l2.port import Port
from simulators.v4l2.sensor import Counts, Sensor, Timing


class V4l2CameraServer:
    """A camera behind the file `path`, or for clients of this process only when that is None; see `open_here`.

    An async context manager, or start() and close() it. `picture` gets an Exposure in a worker thread and returns the
    (height, width) uint8 picture. An exception in it ends the camera's taking of pictures and is raised by close().
    """

    def __init__(
        self,
        device: Device,
        picture: Callable[[Exposure], Bytes],
        clock: Clock,
        *,
        path: Path | None = None,
        timing: Timing | None = None,
    ) -> None:
        self.device = device
        self._port = Port(device)
        self._faults = Faults(self._port)
        self._sensor = Sensor(self._port, self._faults, picture, clock, timing or Timing())
        self._file = FuseFile(self._port, path) if path is not None else None

    @property
    def serial(self) -> str:
        """What clients take for its serial number."""
        return self.device.serial

    @property
    def counts(self) -> Counts:
        """What it did since its start."""
        return self._sensor.counts

    def inject(self, fault: str, **params: object) -> None:
        """Put a fault in force (see Faults); raises ValueError for what it cannot do."""
        self._faults.inject(fault, **params)

    def open_here(self, _path: str = "") -> OpenDevice:
        """Open the device from this process, without a file; raises OSError as open(2) does."""
        return OpenDevice(self._port)

    async def start(self) -> None:
        """Put the file there and wait for clients; raises OSError when that cannot be."""
        if self._file is not None:
            await asyncio.to_thread(self._file.mount)
            self._sensor.pages.append(self._file)
        self._sensor.start()

    async def close(self) -> None:
        """Take it away. Raises what `picture` raised."""
        try:
            await self._sensor.close()
        finally:
            if self._file is not None:
                await asyncio.to_thread(self._file.close)

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *exception: object) -> None:
        await self.close()
