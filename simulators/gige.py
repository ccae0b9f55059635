"""A simulated GigE Vision camera: its control channel, with pictures from `simulators.gige_imaging`.

The picture itself is the world's business: `picture(Exposure)` is called in a worker thread and returns what the sensor
saw in the middle of the exposure.
"""

import asyncio
import socket
import time
from collections.abc import Callable
from typing import Self

import numpy as np

from simulators import genicam, gvcp
from simulators.clock import Clock
from simulators.gige_faults import Faults
from simulators.gige_formats import Seen
from simulators.gige_imaging import LINE, SOFTWARE, Counts, Exposure, Imaging, ticks
from simulators.gvcp import Command, Forced, Identity, Registers, Request, Status
from simulators.gvsp import Target

__all__ = ["Counts", "Exposure", "GigeCameraServer"]

GVCP_PORT = 3956
LARGEST_PACKET = 16_000  # of 16,640 bytes that the kernel charges a receiver for such a packet
CONTROL_BITS = 0x3
WATCH_S = 0.1


class _Channel(asyncio.DatagramProtocol):
    """One control socket; the broadcast one only hears discoveries."""

    def __init__(self, received: Callable[[bytes, Target], None]) -> None:
        self._received = received

    def datagram_received(self, data: bytes, addr: Target) -> None:
        self._received(data, addr)


class GigeCameraServer:
    """A camera at `ip` (any of 127.0.0.0/8), port 3956; use it as an async context manager or start() and close() it.

    `picture` gets an Exposure in a worker thread and returns the (height, width) picture, uint8 or uint16 over the
    whole range, which must not change afterwards. An exception in it ends the camera's taking of pictures and is
    raised by close().
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
        self._imaging = Imaging(self.registers, self.faults, picture, clock, self.counts)
        self._controller: Target | None = None
        self._heard_s = 0.0
        self._answered: tuple[Target, bytes, bytes] | None = None
        self._later: set[asyncio.TimerHandle] = set()
        self._moving: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Bind the sockets; raises OSError when the address is taken."""
        self._transport = await self._listen(self.ip, self._on_datagram, shared=False)
        try:
            self._ear = await self._listen("255.255.255.255", self._on_broadcast, shared=True)
            self._imaging.start(self.ip)
        except OSError:
            self._transport.close()
            raise
        self._watch = asyncio.create_task(self._watch_controller())

    async def close(self) -> None:
        """Stop. Raises what `picture` raised."""
        self._release()
        for handle in self._later:
            handle.cancel()
        for task in filter(None, (self._watch, self._moving)):
            task.cancel()
            await asyncio.wait([task])
        self._transport.close()
        self._ear.close()
        await self._imaging.close()

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

    def pulse_line(self) -> None:
        """A rising edge at the hardware input Line0."""
        self._imaging.trigger(LINE)

    def inject(self, fault: str, **params: object) -> None:
        """Put a fault in force (see Faults), or `release_control`; raises ValueError for what it cannot do."""
        if fault == "release_control" and not params:
            self._release()
            return
        self.faults.inject(fault, **params)

    def _on_broadcast(self, data: bytes, client: Target) -> None:
        request = gvcp.decode(data)
        if request is None or self.faults.on("mute"):
            return
        if request.command == Command.FORCE_IP:
            self._be_forced(request)
        if request.command != Command.DISCOVERY:
            return
        # A client that finds us through another interface would wait there for our pictures.
        if client[0].startswith("127."):
            self._transport.sendto(gvcp.answer(request, Status.OK, self.registers.discovery()), client)

    def _be_forced(self, request: Request) -> None:
        """Take another address, if it is meant and nobody controls it. Whoever asked looks for it anew."""
        wanted = gvcp.forced(request.body)
        if wanted is None or wanted.mac != self.registers.mac or self._controller or self._moving:
            return
        self._moving = asyncio.create_task(self._move(wanted))

    async def _move(self, wanted: Forced) -> None:
        try:
            transport = await self._listen(wanted.ip, self._on_datagram, shared=False)
        except OSError:  # not ours, or taken: the camera stays where it is
            return
        finally:
            self._moving = None
        self._transport.close()
        self._transport, self.ip = transport, wanted.ip
        self.registers.move(wanted.ip, wanted.mask)
        self._imaging.move(wanted.ip)

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
        status = self.registers.write(address, data, busy=self._imaging.acquiring)
        if not status:
            self._act(address, gvcp.WORD.unpack(data)[0])
        return status

    def _act(self, address: int, value: int) -> None:
        """What follows from a register's new value."""
        table = self.registers.table
        if address == genicam.STREAM_PACKET and value & gvcp.TEST_PACKET_BIT:
            self._imaging.test_packet()
        elif address == genicam.TIMESTAMP_CONTROL and value & genicam.TIMESTAMP_LATCH_BIT:
            self.registers["GevTimestampHigh"], self.registers["GevTimestampLow"] = divmod(ticks(), 1 << 32)
        elif address == table["AcquisitionStart"].address:
            self._imaging.start_acquisition()
        elif address == table["AcquisitionStop"].address:
            self._imaging.stop_acquisition()
        elif address == table["TriggerSoftware"].address:
            self._imaging.trigger(SOFTWARE)

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
        self._imaging.stop_acquisition()

    async def _watch_controller(self) -> None:
        """Let a controller go that is not heard for the heartbeat time; wall time, for it is no part of the world."""
        while True:
            await asyncio.sleep(WATCH_S)
            silent_ms = (time.monotonic() - self._heard_s) * 1e3
            if self._controller is not None and silent_ms > self.registers["GevHeartbeatTimeout"]:
                self._release()

    def _resend(self, request: Request, client: Target) -> None:
        wanted = gvcp.resend(request.body)
        if wanted is not None and self._controller is not None and client[0] == self._controller[0]:
            self._imaging.resend(wanted)


def _loop_s() -> float:
    return asyncio.get_running_loop().time()
