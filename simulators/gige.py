"""A simulated GigE Vision camera: its control channel, with pictures from `simulators.gige_imaging`.

The picture itself is the world's business: `picture(Exposure)` is called in a worker thread and returns what the sensor
saw in the middle of the exposure.
"""

import asyncio
import socket
from collections.abc import Callable
from typing import Self

import numpy as np

from simulators import genicam, gvcp
from simulators.clock import Clock
from simulators.gige_control import Control
from simulators.gige_faults import Faults
from simulators.gige_formats import Seen
from simulators.gige_imaging import ACTION, LINE, SOFTWARE, Exposure, Imaging
from simulators.gige_link import Counts
from simulators.gige_registers import Identity, Registers
from simulators.gvcp import Command, Forced, Request, Status
from simulators.gvsp import Target

__all__ = ["Counts", "Exposure", "GigeCameraServer"]

GVCP_PORT = 3956
LARGEST_PACKET = 16_000  # of 16,640 bytes that the kernel charges a receiver for such a packet


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
        device = {
            "release_control": self._let_go,
            "other_controller": self._take_elsewhere,
            "reboot": self._reboot,
        }
        self.faults = Faults(rng if rng is not None else np.random.default_rng(0), device)
        self._imaging = Imaging(self.registers, self.faults, picture, clock, self.counts)
        self._control = Control(self.registers, self.counts, self._imaging.stop_acquisition)
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
        self._watch = asyncio.create_task(self._control.watch())

    async def close(self) -> None:
        """Stop. Raises what `picture` raised."""
        self._control.release()
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
        """Put a fault in force (see Faults); raises ValueError for what it cannot do."""
        self.faults.inject(fault, **params)

    def _let_go(self) -> None:
        self._control.release()

    def _take_elsewhere(self) -> None:
        self._control.take_elsewhere()

    def _reboot(self, for_s: float = 1.0) -> None:
        """Power off and on: silent for so long (wall seconds), then as new, but at its present address."""
        self.faults.stay_away(for_s)
        self._control.release()
        self.registers.restart()
        self._imaging.restart()
        self._answered = None

    def _on_broadcast(self, data: bytes, client: Target) -> None:
        request = gvcp.decode(data)
        if request is None or self.faults.silent:
            return
        if request.command == Command.FORCE_IP:
            self._be_forced(request)
        # A client that finds us through another interface would wait there for our pictures.
        if not client[0].startswith("127."):
            return
        if request.command == Command.ACTION:
            self._on_datagram(data, client)
        if request.command == Command.DISCOVERY:
            self._transport.sendto(gvcp.answer(request, Status.OK, self.registers.discovery()), client)

    def _be_forced(self, request: Request) -> None:
        """Take another address, if it is meant and nobody controls it. Whoever asked looks for it anew."""
        wanted = gvcp.forced(request.body)
        if wanted is None or wanted.mac != self.registers.mac or self._control.holder or self._moving:
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
        self._imaging.link.move(wanted.ip)

    def _on_datagram(self, data: bytes, client: Target) -> None:
        request = gvcp.decode(data)
        if request is None:
            self.counts.malformed += 1
            return
        if self.faults.silent:
            return
        if request.command == Command.PACKET_RESEND:
            self._resend(request, client)
            return
        # An answer was lost and the client asks once more: it must not, for instance, trigger twice.
        known = self._answered
        reply = known[2] if known and known[:2] == (client, data) else self._execute(request, client)
        self._answered = (client, data, reply)
        if reply and request.wants_answer and not self.faults.take("lost_acks"):
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
        self._control.hear(client)
        match request.command:
            case Command.DISCOVERY:
                status = Status.INVALID_HEADER if request.body else Status.OK
                return gvcp.answer(request, status, self.registers.discovery())
            case Command.READ_REGISTER | Command.READ_MEMORY:
                return self._read(request, client)
            case Command.ACTION:
                return self._start_by_action(request)
            case Command.WRITE_REGISTER | Command.WRITE_MEMORY:
                return self._write(request, client)
        return gvcp.answer(request, Status.NOT_IMPLEMENTED)

    def _start_by_action(self, request: Request) -> bytes:
        """A start signal for all cameras with the same keys. One that is not meant does not answer."""
        wanted = gvcp.action(request.body)
        if wanted is None:
            return gvcp.answer(request, Status.INVALID_HEADER)
        keys = self.registers["ActionDeviceKey"], self.registers["ActionGroupKey"]
        meant = keys == wanted[:2] and self.registers["ActionGroupMask"] & wanted.group_mask
        if not meant or self._control.holder is None:
            return b""
        self._imaging.trigger(ACTION)
        return gvcp.answer(request, Status.OK)

    def _read(self, request: Request, client: Target) -> bytes:
        wanted = gvcp.reads(request)
        if wanted is None:
            return gvcp.answer(request, Status.INVALID_HEADER)
        found = b"" if request.command == Command.READ_REGISTER else gvcp.WORD.pack(wanted[0][0])
        for address, length in wanted:
            allowed = self._control.may_read(client, address)
            data = self.registers.read(address, length) if allowed else Status.ACCESS_DENIED
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
            refused = self.faults.on("refuse_control")
            return self._control.ask(gvcp.WORD.unpack(data)[0], client, refused=refused)
        if client != self._control.holder:
            return Status.ACCESS_DENIED
        if address == genicam.SWITCHOVER_KEY:
            return self._control.set_key(gvcp.WORD.unpack(data)[0])
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
            self._imaging.link.test_packet()
        elif address == genicam.TIMESTAMP_CONTROL and value & genicam.TIMESTAMP_LATCH_BIT:
            self._imaging.latch()
        elif address == table["AcquisitionStart"].address:
            self._imaging.start_acquisition()
        elif address == table["AcquisitionStop"].address:
            self._imaging.stop_acquisition()
        elif address == table["TriggerSoftware"].address:
            self._imaging.trigger(SOFTWARE)

    def _resend(self, request: Request, client: Target) -> None:
        wanted = gvcp.resend(request.body)
        holder = self._control.holder
        if wanted is not None and holder is not None and client[0] == holder[0]:
            self._imaging.link.resend(wanted)


def _loop_s() -> float:
    return asyncio.get_running_loop().time()
