"""A simulated V4L2 camera's sensor: exposures in world time, rendered, and put into the buffers that clients queued.

The snapshot moment is the middle of the exposure. World time stands while a picture is rendered, so that a fast world
does not see a slow camera. Time stamps are the host's monotonic clock, as a kernel driver's are.
"""

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from simulators.clock import Clock
from simulators.gige import Exposure
from simulators.v4l2.abi import Flag
from simulators.v4l2.buffers import Buffer
from simulators.v4l2.faults import Faults
from simulators.v4l2.formats import Bytes, Format
from simulators.v4l2.port import Port


@dataclass(frozen=True, slots=True)
class Timing:
    """From the end of an exposure to the client, in world seconds; the defaults are a USB 3 camera's."""

    read_out_s: float = 0.003
    link_s_per_byte: float = 1 / 350e6


@dataclass
class Counts:
    """What the camera did since its start."""

    exposures: int = 0
    triggers_missed: int = 0
    delivered: int = 0
    without_buffer: int = 0
    dropped: int = 0


class _Picture(NamedTuple):
    """A picture as it is in memory: lines, or one run of compressed bytes."""

    coded: Bytes
    stamp_ns: int
    number: int


class Pages(Protocol):
    """Where clients see the memory of buffers."""

    def store(self, offset: int, data: NDArray[np.uint8]) -> None:
        """Show these bytes there."""


class Sensor:
    """Takes pictures while a client streams: by itself, or one for each trigger."""

    def __init__(
        self, port: Port, faults: Faults, picture: Callable[[Exposure], Bytes], clock: Clock, timing: Timing
    ) -> None:
        self.counts = Counts()
        self.pages: list[Pages] = []
        self._port, self._faults = port, faults
        self._picture, self._clock, self._timing = picture, clock, timing
        self._previous: _Picture | None = None
        self._last_s = float("-inf")
        self._seen = (0, 0)  # presses of the software trigger and pulses of the line that were answered

    def start(self) -> None:
        """Begin to wait for a client."""
        self._loop = asyncio.get_running_loop()
        self._news = asyncio.Event()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"simulated camera {self._port.device.serial}")
        self._port.wakes.append(self._wake)
        self._task = asyncio.create_task(self._run())

    async def close(self) -> None:
        """Stop. Raises what `picture` raised."""
        self._port.wakes.remove(self._wake)
        self._task.cancel()
        await asyncio.wait([self._task])
        self._worker.shutdown()
        if not self._task.cancelled():
            self._task.result()

    def _wake(self) -> None:
        self._loop.call_soon_threadsafe(self._news.set)

    async def _run(self) -> None:
        while True:
            await self._next_exposure()
            await self._take_picture()

    async def _next_exposure(self) -> None:
        """Return when an exposure begins."""
        device = self._port.device
        while True:
            self._news.clear()
            if device.streaming and not self._faults.on("freeze"):
                if device.controls.trigger == "free":
                    return await self._clock.sleep_until(self._last_s + 1 / device.readout.rate_hz)
                if self._triggered():
                    return None
            await self._news.wait()

    def _triggered(self) -> bool:
        """Did a trigger of the kind that is set come since the last look?"""
        now = self._port.device.controls.presses, self._faults.pulses
        came = [new - old for new, old in zip(now, self._seen, strict=True)]
        self._seen = now
        count = came[0 if self._port.device.controls.trigger == "software" else 1]
        taken = count > 0 and not self._faults.take("ignore_trigger")
        self.counts.triggers_missed += count - int(taken)
        return taken

    async def _take_picture(self) -> None:
        """Expose, render what is seen in the middle of that, deliver."""
        device, clock = self._port.device, self._clock
        with ExitStack() as hold:
            with clock.due_by(0.0):  # time stands while its own hold is being set
                exposure, chosen = self._exposure(clock.now()), device.readout.format
                end_s = exposure.start_world_s + exposure.exposure_us * 1e-6
                due_s = end_s + self._timing.read_out_s + device.readout.picture_bytes * self._timing.link_s_per_byte
                hold.enter_context(clock.due_by(due_s))
            began_ns = time.monotonic_ns()
            self._last_s = exposure.start_world_s
            number, buffer = self._begin()
            await clock.sleep_until((exposure.start_world_s + end_s) / 2)
            if buffer is None:
                return await clock.sleep_until(end_s)
            coded = await self._loop.run_in_executor(self._worker, self._render, exposure, chosen)
            await clock.sleep_until(due_s)
            stamp_ns = began_ns if device.start_of_exposure else time.monotonic_ns()
            await self._loop.run_in_executor(self._worker, self._deliver, buffer, _Picture(coded, stamp_ns, number))

    def _exposure(self, start_s: float) -> Exposure:
        device = self._port.device
        left, top, width, height = device.readout.window
        return Exposure(start_s, device.controls.exposure_us, device.controls.gain_db, left, top, width, height)

    def _begin(self) -> tuple[int, Buffer | None]:
        """Number of the picture, and its buffer unless the client has left none or the picture gets lost."""
        self.counts.exposures += 1
        if self._faults.take("drop"):
            self.counts.dropped += 1
            return self._port.count_picture(), None
        number, buffer = self._port.begin_picture()
        self.counts.without_buffer += buffer is None
        return number, buffer

    # In the worker thread

    def _render(self, exposure: Exposure, chosen: Format) -> Bytes:
        seen = self._picture(exposure)
        if seen.shape != (exposure.height, exposure.width) or seen.dtype != np.uint8:
            raise ValueError(
                f"the camera was given a picture {seen.shape} {seen.dtype}, "
                f"and it must be {(exposure.height, exposure.width)} uint8"
            )
        mirrored, upside_down = self._port.device.controls.flips
        return chosen.encode(seen[:: -1 if upside_down else 1, :: -1 if mirrored else 1])

    def _deliver(self, buffer: Buffer, picture: _Picture) -> None:
        """Into the buffer, with what is wrong with it."""
        stale, true = self._faults.stale()
        if stale and self._previous is not None:
            self._fill(buffer, self._previous, Flag(0))
            if not true or (another := self._port.another_buffer()) is None:
                return
            buffer = another
        if self._faults.on("stuck_sequence") and self._previous is not None:
            picture = picture._replace(number=self._previous.number)
        self._previous = picture
        if self._faults.take("wrong_size"):
            picture = picture._replace(coded=picture.coded[: len(picture.coded) // 2])
        self._fill(buffer, picture, Flag.ERROR if self._faults.take("error_flag") else Flag(0))

    def _fill(self, buffer: Buffer, picture: _Picture, flags: Flag) -> None:
        memory, coded = self._port.device.memory, picture.coded
        line = self._port.device.readout.line_bytes
        used = min(line * len(coded) if coded.ndim == 2 else coded.size, buffer.length)
        room = memory[buffer.offset : buffer.offset + used]
        if coded.ndim == 2:
            room.reshape(-1, line)[:, : coded.shape[1]] = coded[: used // line]
        else:
            room[:] = coded[:used]
        if flags & Flag.ERROR:
            room[used // 2 :] = 0  # what was lost on the way
        for pages in self.pages:
            pages.store(buffer.offset, room)
        buffer.used, buffer.flags, buffer.stamp_ns, buffer.sequence = used, flags, picture.stamp_ns, picture.number
        self._port.end_picture(buffer)
        self.counts.delivered += 1
