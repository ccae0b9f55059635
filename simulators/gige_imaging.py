"""A simulated camera's sensor and link: exposures in world time, rendered, and sent as a gigabit link would.

The snapshot moment is the middle of the exposure. World time stands while a picture is rendered and sent, so that a
fast world does not see a slow camera; and the last packet leaves no earlier (in world time) than a gigabit link would
have delivered it.
"""

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from typing import NamedTuple

import numpy as np

from simulators.clock import Clock
from simulators.genicam_chunks import with_chunks
from simulators.gige_faults import Faults
from simulators.gige_formats import Seen, pack, pattern
from simulators.gige_link import Counts, Link
from simulators.gige_registers import Registers
from simulators.gvsp import Picture

READ_OUT_S = 0.003  # world seconds from the end of exposure to the first line on the link
QUICK_S = 0.010  # wall seconds that sending takes here, well above the usual
SOFTWARE, LINE, ACTION = 0, 1, 2  # trigger sources
MOST_WAITING = 4  # exposed pictures that wait for the link; a real camera's buffer is as small
CLOSE_WITHIN_S = 1.0


class Exposure(NamedTuple):
    """One exposure: when (world seconds), how, and which part of the sensor (px)."""

    start_world_s: float
    exposure_us: float
    gain_db: float
    offset_x: int
    offset_y: int
    width: int
    height: int


class _Shot(NamedTuple):
    exposure: Exposure
    ticks: int
    end_s: float
    due_s: float
    hold: ExitStack
    session: int


class Imaging:
    """The camera without its control channel; on the event loop, with one worker thread for what takes long."""

    def __init__(
        self, registers: Registers, faults: Faults, picture: Callable[[Exposure], Seen], clock: Clock, counts: Counts
    ) -> None:
        self.registers = registers
        self.faults = faults
        self.counts = counts
        self.link = Link(registers, faults, counts)
        self.acquiring = False
        self._picture = picture
        self._clock = clock
        self._session = 0  # counts acquisitions; an exposure of an earlier one is not sent
        self._exposing_until_s = self._link_free_s = -1.0
        self._previous: Picture | None = None
        self._free_run: asyncio.Task[None] | None = None
        self._booted_ns = 0

    def start(self, ip: str) -> None:
        """Open the stream socket and begin to wait for triggers."""
        self.link.open(ip)
        self._waiting: asyncio.Queue[_Shot | None] = asyncio.Queue(MOST_WAITING + 1)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"simulated camera {ip}")
        self._pipeline = asyncio.create_task(self._take_pictures())

    async def close(self) -> None:
        """Stop. Raises what `picture` raised."""
        self.stop_acquisition()
        with suppress(asyncio.QueueFull):
            self._waiting.put_nowait(None)
        _done, running = await asyncio.wait([self._pipeline], timeout=CLOSE_WITHIN_S)
        for task in running:
            task.cancel()
            await asyncio.wait([task])
        self._worker.shutdown()
        self.link.close()
        if not self._pipeline.cancelled():
            self._pipeline.result()

    def restart(self) -> None:
        """As after power-on; acquisition is stopped already."""
        self.link.begin_anew()
        self._previous = None
        self._booted_ns = time.monotonic_ns()

    def ticks(self) -> int:
        """The camera's own clock, in wall time: to the controller, which is not accelerated, it is a good one."""
        return time.monotonic_ns() - self._booted_ns

    def latch(self) -> None:
        """Keep the time of now for the controller to read."""
        if self.faults.on("clock_stands"):
            return
        self.registers["GevTimestampHigh"], self.registers["GevTimestampLow"] = divmod(self.ticks(), 1 << 32)

    # Exposure, in world time

    def start_acquisition(self) -> None:
        """Be ready for triggers, or run free when the trigger is off."""
        if self.acquiring:
            return
        self._session += 1
        self.acquiring = True
        self.link.begin_anew()
        if not self.registers["TriggerMode"]:
            self._free_run = asyncio.create_task(self._run_free())

    def stop_acquisition(self) -> None:
        """Take no more pictures; what is not sent yet is dropped."""
        self._session += 1
        self.acquiring = False
        if self._free_run is not None:
            self._free_run.cancel()
            self._free_run = None

    async def _run_free(self) -> None:
        at_s = self._clock.now()
        while True:
            self._expose()
            at_s = max(at_s + self.registers["FramePeriodUs"] / 1e6, self._clock.now())
            await self._clock.sleep_until(at_s)

    def trigger(self, source: int) -> None:
        """A start signal from one of the sources, SOFTWARE or LINE."""
        self.counts.triggers += 1
        awaited = self.registers["TriggerMode"] and self.registers["TriggerSource"] == source
        if awaited and not self.faults.take("ignore_trigger"):
            self._expose()
        else:
            self.counts.triggers_missed += 1

    def _expose(self) -> None:
        """Begin an exposure, unless one is under way or the camera's memory is full."""
        with self._clock.due_by(0.0):  # time stands while its own hold is being set
            start_s = self._clock.now()
            busy = start_s < self._exposing_until_s or self._waiting.qsize() >= MOST_WAITING
            if busy or not self.acquiring or self._pipeline.done():
                self.counts.triggers_missed += 1
            else:
                self._waiting.put_nowait(self._shot(start_s))

    def _shot(self, start_s: float) -> _Shot:
        """An exposure that begins now, and the hold on world time until its last packet is due."""
        registers = self.registers
        end_s = start_s + registers["ExposureNs"] / 1e9
        due_s = max(end_s + READ_OUT_S, self._link_free_s) + self.link.wire_s(registers["PayloadSize"])
        self._exposing_until_s, self._link_free_s = end_s, due_s
        hold = ExitStack()
        hold.enter_context(self._clock.due_by(due_s))
        exposure = Exposure(
            start_s,
            registers["ExposureNs"] / 1e3,
            registers["GainMillidB"] / 1e3,
            registers["OffsetX"],
            registers["OffsetY"],
            registers["Width"],
            registers["Height"],
        )
        return _Shot(exposure, self.ticks(), end_s, due_s, hold, self._session)

    async def _take_pictures(self) -> None:
        try:
            while (shot := await self._waiting.get()) is not None:
                with shot.hold:
                    if shot.session == self._session:
                        await self._take_picture(shot)
        finally:
            while not self._waiting.empty():
                if (shot := self._waiting.get_nowait()) is not None:
                    shot.hold.close()

    async def _take_picture(self, shot: _Shot) -> None:
        """Render what is seen in the middle of the exposure, then send it."""
        await self._clock.sleep_until((shot.exposure.start_world_s + shot.end_s) / 2)
        picture = await asyncio.get_running_loop().run_in_executor(self._worker, self._as_sent, shot)
        stale, true = self.faults.stale()
        if stale and self._previous is not None:
            await self._send(self._previous, shot)
        if true:
            await self._send(picture, shot)
        self._previous = picture

    def _as_sent(self, shot: _Shot) -> Picture:
        """In the worker."""
        pixel_format, exposure = self.registers["PixelFormat"], shot.exposure
        seen = self._render(exposure)
        place = exposure.offset_x, exposure.offset_y, exposure.width, seen.shape[0]
        data = pack(seen, pixel_format)
        has_chunks = bool(self.registers["ChunkModeActive"])
        if has_chunks:
            data = with_chunks(data, exposure.exposure_us, exposure.gain_db)
        return Picture(data, shot.ticks, *place, pixel_format, has_chunks)

    def _render(self, exposure: Exposure) -> Seen:
        number, size = self.registers["TestPattern"], (exposure.height, exposure.width)
        seen = pattern(number, size, self.counts.frames) if number else self._picture(exposure)
        if seen.shape != size or seen.dtype not in (np.uint8, np.uint16):
            raise ValueError(
                f"the camera was given a picture {seen.shape} {seen.dtype}, and it must be {size} uint8 or uint16"
            )
        seen = seen[:: -1 if self.registers["ReverseY"] else 1, :: -1 if self.registers["ReverseX"] else 1]
        return seen[: len(seen) // 2] if self.faults.take("wrong_size") else seen

    # Onto the wire

    async def _send(self, picture: Picture, shot: _Shot) -> None:
        """All packets in a burst that ends when a real link would have delivered the last one."""
        clock = self._clock
        spread_s = self.link.wire_s(picture.data.size) if self.faults.link_mbps else 0.0
        await clock.sleep_until(max(shot.end_s, shot.due_s - max(spread_s, QUICK_S * clock.speed)))
        target = self.link.target()
        if target is None or self.faults.silent or shot.session != self._session:
            return
        loop = asyncio.get_running_loop()
        block, last = await loop.run_in_executor(self._worker, self.link.burst, picture, target, clock.speed)
        await clock.sleep_until(shot.due_s)
        self.link.end(block, last)
