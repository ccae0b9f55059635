"""A simulated camera's sensor and link: exposures in world time, rendered, and sent as a gigabit link would.

The snapshot moment is the middle of the exposure. World time stands while a picture is rendered and sent, so that a
fast world does not see a slow camera; and the last packet leaves no earlier (in world time) than a gigabit link would
have delivered it.
"""

import asyncio
import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from simulators import genicam, gvcp
from simulators.clock import Clock
from simulators.genicam_chunks import with_chunks
from simulators.gige_faults import Faults
from simulators.gige_formats import Seen, pack
from simulators.gvcp import Registers, Resend
from simulators.gvsp import Block, Order, Picture, Sender, Target, unavailable

READ_OUT_S = 0.003  # world seconds from the end of exposure to the first line on the link
WIRE_S_PER_BYTE = 8.25e-9  # 1 Gb/s and its overhead
QUICK_S = 0.010  # wall seconds that sending takes here, well above the usual
SOFTWARE, LINE = 0, 1  # trigger sources
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


@dataclass
class Counts:
    """What the camera did since its start."""

    malformed: int = 0
    triggers: int = 0
    triggers_missed: int = 0
    frames: int = 0
    packets: int = 0
    packets_resent: int = 0
    controllers_refused: int = 0


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
        self.acquiring = False
        self._picture = picture
        self._clock = clock
        self._session = 0  # counts acquisitions; an exposure of an earlier one is not sent
        self._block = 0
        self._exposing_until_s = self._link_free_s = -1.0
        self._previous: Picture | None = None
        self._free_run: asyncio.Task[None] | None = None

    def start(self, ip: str) -> None:
        """Open the stream socket and begin to wait for triggers."""
        self._sender = Sender(ip)
        self._waiting: asyncio.Queue[_Shot | None] = asyncio.Queue(MOST_WAITING + 1)
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"simulated camera {ip}")
        self._pipeline = asyncio.create_task(self._take_pictures())

    def move(self, ip: str) -> None:
        """Send from another address; not while pictures are being taken."""
        self._sender.close()
        self._sender = Sender(ip)

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
        self._sender.close()
        if not self._pipeline.cancelled():
            self._pipeline.result()

    # Exposure, in world time

    def start_acquisition(self) -> None:
        """Be ready for triggers, or run free when the trigger is off."""
        if self.acquiring:
            return
        self._session += 1
        self.acquiring, self._block = True, 0
        self._sender.forget()
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
        due_s = max(end_s + READ_OUT_S, self._link_free_s) + registers["PayloadSize"] * WIRE_S_PER_BYTE
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
        return _Shot(exposure, ticks(), end_s, due_s, hold, self._session)

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
        seen = self._picture(exposure)
        if seen.shape != (exposure.height, exposure.width) or seen.dtype not in (np.uint8, np.uint16):
            raise ValueError(
                f"the camera was given a picture {seen.shape} {seen.dtype}, "
                f"and it must be {(exposure.height, exposure.width)} uint8 or uint16"
            )
        seen = seen[:: -1 if self.registers["ReverseY"] else 1, :: -1 if self.registers["ReverseX"] else 1]
        return seen[: len(seen) // 2] if self.faults.take("wrong_size") else seen

    # Onto the wire

    def target(self) -> Target | None:
        """Where packets go, if a client has said so."""
        port = self.registers["GevSCPHostPort"] & 0xFFFF
        return (socket.inet_ntoa(gvcp.WORD.pack(self.registers["GevSCDA"])), port) if port else None

    def packet_size(self) -> int:
        """Bytes in a packet, all headers included."""
        return self.registers["GevSCPS"] & gvcp.PACKET_SIZE_MASK

    async def _send(self, picture: Picture, shot: _Shot) -> None:
        """All packets in a burst that ends when a real link would have delivered the last one."""
        clock = self._clock
        await clock.sleep_until(max(shot.end_s, shot.due_s - QUICK_S * clock.speed))
        target = self.target()
        if target is None or self.faults.on("mute") or shot.session != self._session:
            return
        self._block = self._block % 0xFFFF + 1
        loop = asyncio.get_running_loop()
        block, last = await loop.run_in_executor(self._worker, self._burst, self._block, picture, target)
        await clock.sleep_until(shot.due_s)
        block.sendable = block.last
        if not self.faults.on("mute"):
            self._sender.at_once(block, last)
            self.counts.frames += 1

    def _burst(self, number: int, picture: Picture, target: Target) -> tuple[Block, Order]:
        """In the worker: send leader and payload. Returns the block, and the trailer if the network delivers it."""
        block = Block(number, picture, self.packet_size(), target)
        self._sender.keep(block)
        order = self.faults.on_their_way(block.order())
        self.counts.packets += block.last + 1
        trailer = order == block.last
        delay_s = self.registers["GevSCPD"] / genicam.TICKS_PER_S
        self._sender.send(block, order[~trailer], target, delay_s)
        return block, order[trailer]

    def test_packet(self) -> None:
        """One packet of the size set, to see whether the network takes it."""
        if target := self.target():
            self._sender.test_packet(self.packet_size(), target)

    def resend(self, wanted: Resend) -> None:
        """Send packets again that are still in memory."""
        target = self.target()
        if target is None:
            return
        block = self._sender.kept(wanted.block)
        if block is None or self.faults.on("resend_unavailable"):
            self._sender.datagram(unavailable(wanted.block, wanted.first), target)
            return
        order = self.faults.resent(np.arange(wanted.first, min(wanted.last, block.sendable) + 1))
        self.counts.packets_resent += order.size
        self._sender.at_once(block, order)


def ticks() -> int:
    """The camera's own clock. It runs in wall time: to the controller, which is not accelerated, it is a good one."""
    return time.monotonic_ns()
