"""A simulated GigE Vision camera: control protocol, exposures in world time, pictures onto the wire.

The picture itself is the world's business: `picture(Exposure)` is called in a worker thread and returns what the sensor
saw. World time stands while a picture is rendered and sent, so that a fast world does not see a slow camera; and the
last packet leaves no earlier (in world time) than a gigabit link would have delivered it.
"""

import asyncio
import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from simulators import genicam, gvcp
from simulators.clock import Clock
from simulators.gige_faults import Faults
from simulators.gvcp import Command, Identity, Registers, Request, Status
from simulators.gvsp import Block, Order, Picture, Sender, Target, unavailable

GVCP_PORT = 3956
LARGEST_PACKET = 16_000  # of 16,640 bytes that the kernel charges a receiver for such a packet
READ_OUT_S = 0.003  # world seconds from the end of exposure to the first line on the link
WIRE_S_PER_BYTE = 8.25e-9  # 1 Gb/s and its overhead
QUICK_S = 0.010  # wall seconds that sending takes here, well above the usual
MOST_WAITING = 4  # exposed pictures that wait for the link; a real camera's buffer is as small
CONTROL_BITS = 0x3
WATCH_S = 0.1
CLOSE_WITHIN_S = 1.0

Seen = NDArray[np.uint8]


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


class _Channel(asyncio.DatagramProtocol):
    """One control socket; the broadcast one only hears discoveries."""

    def __init__(self, received: Callable[[bytes, Target], None]) -> None:
        self._received = received

    def datagram_received(self, data: bytes, addr: Target) -> None:
        self._received(data, addr)


class GigeCameraServer:
    """A camera at `ip` (any of 127.0.0.0/8), port 3956; use it as an async context manager or start() and close() it.

    `picture` gets an Exposure in a worker thread and returns the (height, width) uint8 picture, which it must not change
    afterwards. An exception in it ends the camera's taking of pictures and is raised by close().
    """

    def __init__(
        self,
        ip: str,
        serial: str,
        picture: Callable[[Exposure], Seen],
        clock: Clock,
        *,
        name: str = "",
        sensor: tuple[int, int] = (2592, 1944),
        rng: np.random.Generator | None = None,
        largest_packet: int = LARGEST_PACKET,
    ) -> None:
        self.ip = ip
        self.serial = serial
        self.counts = Counts()
        self.registers = Registers(Identity(ip, serial, name), sensor, largest_packet)
        self.faults = Faults(rng if rng is not None else np.random.default_rng(0))
        self._picture = picture
        self._clock = clock
        self._controller: Target | None = None
        self._heard_s = 0.0
        self._answered: tuple[Target, bytes, bytes] | None = None
        self._later: set[asyncio.TimerHandle] = set()
        self._session = 0  # counts acquisitions; an exposure of an earlier one is not sent
        self._acquiring = False
        self._block = 0
        self._exposing_until_s = self._link_free_s = -1.0
        self._previous: Picture | None = None
        self._free_run: asyncio.Task[None] | None = None

    # Life

    async def start(self) -> None:
        """Bind the sockets; raises OSError when the address is taken."""
        self._waiting: asyncio.Queue[_Shot | None] = asyncio.Queue(MOST_WAITING + 1)
        self._transport = await self._listen(self.ip, self._on_datagram, shared=False)
        try:
            self._ear = await self._listen("255.255.255.255", self._on_broadcast, shared=True)
            self._sender = Sender(self.ip)
        except OSError:
            self._transport.close()
            raise
        self._worker = ThreadPoolExecutor(1, thread_name_prefix=f"camera {self.serial}")
        self._pipeline = asyncio.create_task(self._take_pictures())
        self._watch = asyncio.create_task(self._watch_controller())

    async def close(self) -> None:
        """Stop. Raises what `picture` raised."""
        self._release()
        self._watch.cancel()
        for handle in self._later:
            handle.cancel()
        with suppress(asyncio.QueueFull):
            self._waiting.put_nowait(None)
        _done, running = await asyncio.wait([self._pipeline, self._watch], timeout=CLOSE_WITHIN_S)
        for task in running:
            task.cancel()
            await asyncio.wait([task])
        self._transport.close()
        self._ear.close()
        self._worker.shutdown()
        self._sender.close()
        await asyncio.sleep(0)  # let the transports close their sockets
        if not self._pipeline.cancelled() and self._pipeline.done():
            self._pipeline.result()

    async def __aenter__(self) -> Self:
        await self.start()
        return self

    async def __aexit__(self, *exception: object) -> None:
        await self.close()

    async def _listen(
        self, ip: str, received: Callable[[bytes, Target], None], *, shared: bool
    ) -> asyncio.DatagramTransport:
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        listener.setblocking(False)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, int(shared))
            listener.bind((ip, GVCP_PORT))
        except OSError as error:
            listener.close()
            raise OSError(error.errno, f"camera {self.serial} at {ip}:{GVCP_PORT}: {error.strerror}") from error
        loop = asyncio.get_running_loop()
        transport, _protocol = await loop.create_datagram_endpoint(lambda: _Channel(received), sock=listener)
        return transport

    def inject(self, fault: str, **params: object) -> None:
        """Put a fault in force (see Faults), or `release_control`; raises ValueError for what it cannot do."""
        if fault == "release_control" and not params:
            self._release()
            return
        self.faults.inject(fault, **params)

    # Control channel

    def _on_broadcast(self, data: bytes, client: Target) -> None:
        request = gvcp.decode(data)
        if request is None or request.command != Command.DISCOVERY or self.faults.on("mute"):
            return
        # A client that finds us through another interface would wait there for our pictures.
        if client[0].startswith("127."):
            self._transport.sendto(gvcp.answer(request, Status.OK, self.registers.discovery()), client)

    def _on_datagram(self, data: bytes, client: Target) -> None:
        request = gvcp.decode(data)
        if request is None:
            self.counts.malformed += 1
            return
        if self.faults.on("mute"):
            return
        if request.command == Command.PACKET_RESEND:
            self._resend(request, client)
            return
        # An answer was lost and the client asks once more: it must not, for instance, trigger twice.
        known = self._answered
        reply = known[2] if known and known[:2] == (client, data) else self._execute(request, client)
        self._answered = (client, data, reply)
        if request.wants_answer and not self.faults.take("lost_acks"):
            self._reply(request, reply, client)

    def _reply(self, request: Request, reply: bytes, client: Target) -> None:
        delay_ms = self.faults.pending_ms
        if not delay_ms:
            self._transport.sendto(reply, client)
            return
        self._transport.sendto(gvcp.wait_for(request, delay_ms + 100), client)
        self._later = {h for h in self._later if not h.cancelled() and h.when() > _loop_s()}
        self._later.add(asyncio.get_running_loop().call_later(delay_ms / 1e3, self._transport.sendto, reply, client))

    def _execute(self, request: Request, client: Target) -> bytes:
        if client == self._controller:
            self._heard_s = time.monotonic()
        match request.command:
            case Command.DISCOVERY:
                return gvcp.answer(request, Status.OK, self.registers.discovery())
            case Command.READ_REGISTER | Command.READ_MEMORY:
                return self._read(request)
            case Command.WRITE_REGISTER | Command.WRITE_MEMORY:
                return self._write(request, client)
        return gvcp.answer(request, Status.NOT_IMPLEMENTED)

    def _read(self, request: Request) -> bytes:
        wanted = gvcp.reads(request)
        if wanted is None:
            return gvcp.answer(request, Status.INVALID_HEADER)
        found = b"" if request.command == Command.READ_REGISTER else gvcp.WORD.pack(wanted[0][0])
        for address, length in wanted:
            data = self.registers.read(address, length)
            if isinstance(data, Status):
                return gvcp.answer(request, data)
            found += data
        return gvcp.answer(request, Status.OK, found)

    def _write(self, request: Request, client: Target) -> bytes:
        values = gvcp.writes(request)
        if values is None:
            return gvcp.answer(request, Status.INVALID_HEADER)
        done = 0
        for address, data in values:
            status = self._write_one(address, data, client)
            if status:
                return gvcp.answer(request, status)
            done += 1
        count = done if request.command == Command.WRITE_REGISTER else 4 * done
        return gvcp.answer(request, Status.OK, gvcp.WORD.pack(count))

    def _write_one(self, address: int, data: bytes, client: Target) -> Status:
        if address == genicam.CONTROL_PRIVILEGE:
            return self._privilege(gvcp.WORD.unpack(data)[0], client)
        if client != self._controller:
            return Status.ACCESS_DENIED
        if self.faults.on("stuck_exposure") and address == self.registers.table["ExposureNs"].address:
            return Status.OK
        status = self.registers.write(address, data, busy=self._acquiring)
        if not status:
            self._act(address, gvcp.WORD.unpack(data)[0])
        return status

    def _act(self, address: int, value: int) -> None:
        """What follows from a register's new value."""
        table = self.registers.table
        if address == genicam.STREAM_PACKET and value & gvcp.TEST_PACKET_BIT:
            if target := self._target():
                self._sender.test_packet(self._packet_size(), target)
        elif address == genicam.TIMESTAMP_CONTROL and value & genicam.TIMESTAMP_LATCH_BIT:
            self.registers["GevTimestampHigh"], self.registers["GevTimestampLow"] = divmod(_ticks(), 1 << 32)
        elif address == table["AcquisitionStart"].address:
            self._start_acquisition()
        elif address == table["AcquisitionStop"].address:
            self._stop_acquisition()
        elif address == table["TriggerSoftware"].address:
            self._trigger()

    def _privilege(self, value: int, client: Target) -> Status:
        if self._controller not in (None, client):
            self.counts.controllers_refused += 1
            return Status.ACCESS_DENIED
        if value & CONTROL_BITS:
            self._controller, self._heard_s = client, time.monotonic()
            self.registers["GevCCP"] = value & CONTROL_BITS
        else:
            self._release()
        return Status.OK

    def _release(self) -> None:
        self._controller = None
        self.registers["GevCCP"] = 0
        self._stop_acquisition()

    async def _watch_controller(self) -> None:
        """Let a controller go that is not heard for the heartbeat time; wall time, for it is no part of the world."""
        while True:
            await asyncio.sleep(WATCH_S)
            silent_ms = (time.monotonic() - self._heard_s) * 1e3
            if self._controller is not None and silent_ms > self.registers["GevHeartbeatTimeout"]:
                self._release()

    # Exposure, in world time

    def _start_acquisition(self) -> None:
        if self._acquiring:
            return
        self._session += 1
        self._acquiring, self._block = True, 0
        self._sender.forget()
        if not self.registers["TriggerMode"]:
            self._free_run = asyncio.create_task(self._run_free())

    def _stop_acquisition(self) -> None:
        self._session += 1
        self._acquiring = False
        if self._free_run is not None:
            self._free_run.cancel()
            self._free_run = None

    async def _run_free(self) -> None:
        at_s = self._clock.now()
        while True:
            self._expose()
            at_s = max(at_s + self.registers["FramePeriodUs"] / 1e6, self._clock.now())
            await self._clock.sleep_until(at_s)

    def _trigger(self) -> None:
        self.counts.triggers += 1
        if self.registers["TriggerMode"] and not self.faults.take("ignore_trigger"):
            self._expose()
        else:
            self.counts.triggers_missed += 1

    def _expose(self) -> None:
        """Begin an exposure, unless one is under way or the camera's memory is full."""
        start_s, registers = self._clock.now(), self.registers
        busy = start_s < self._exposing_until_s or self._waiting.qsize() >= MOST_WAITING
        if busy or not self._acquiring or self._pipeline.done():
            self.counts.triggers_missed += 1
            return
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
        self._waiting.put_nowait(_Shot(exposure, _ticks(), end_s, due_s, hold, self._session))

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
        seen = await asyncio.get_running_loop().run_in_executor(self._worker, self._render, shot.exposure)
        stale, true = self.faults.stale()
        if stale and self._previous is not None:
            await self._send(self._previous, shot)
        exposure = shot.exposure
        picture = Picture(seen, shot.ticks, exposure.offset_x, exposure.offset_y, seen.shape[0])
        if true:
            await self._send(picture, shot)
        self._previous = picture

    def _render(self, exposure: Exposure) -> Seen:
        seen = self._picture(exposure)
        if seen.shape != (exposure.height, exposure.width) or seen.dtype != np.uint8:
            raise ValueError(
                f"camera {self.serial}: the picture is {seen.shape} {seen.dtype}, "
                f"and must be {(exposure.height, exposure.width)} uint8"
            )
        return seen[: len(seen) // 2] if self.faults.take("wrong_size") else seen

    # Onto the wire

    def _target(self) -> Target | None:
        port = self.registers["GevSCPHostPort"] & 0xFFFF
        return (socket.inet_ntoa(gvcp.WORD.pack(self.registers["GevSCDA"])), port) if port else None

    def _packet_size(self) -> int:
        return self.registers["GevSCPS"] & gvcp.PACKET_SIZE_MASK

    async def _send(self, picture: Picture, shot: _Shot) -> None:
        """All packets in a burst that ends when a real link would have delivered the last one."""
        clock = self._clock
        await clock.sleep_until(max(shot.end_s, shot.due_s - QUICK_S * clock.speed))
        target = self._target()
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
        block = Block(number, picture, self._packet_size(), target)
        self._sender.keep(block)
        order = self.faults.on_their_way(block.order())
        self.counts.packets += block.last + 1
        trailer = order == block.last
        delay_s = self.registers["GevSCPD"] / genicam.TICKS_PER_S
        self._sender.send(block, order[~trailer], target, delay_s)
        return block, order[trailer]

    def _resend(self, request: Request, client: Target) -> None:
        wanted, target = gvcp.resend(request.body), self._target()
        if wanted is None or target is None or self._controller is None or client[0] != self._controller[0]:
            return
        block = self._sender.kept(wanted.block)
        if block is None or self.faults.on("resend_unavailable"):
            self._sender.datagram(unavailable(wanted.block, wanted.first), target)
            return
        order = self.faults.resent(np.arange(wanted.first, min(wanted.last, block.sendable) + 1))
        self.counts.packets_resent += order.size
        self._sender.at_once(block, order)


def _ticks() -> int:
    """The camera's own clock. It runs in wall time: to the controller, which is not accelerated, it is a good one."""
    return time.monotonic_ns()


def _loop_s() -> float:
    return asyncio.get_running_loop().time()
