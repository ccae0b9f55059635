"""A strict Modbus TCP server over a bank of registers. Knows nothing of the cell.

Several clients, pipelined and fragmented requests, answers in order, bounded memory per client.
Sources: MODBUS Messaging on TCP/IP Implementation Guide V1.0b (connections, header, unit ids), MODBUS Application
Protocol V1.1b3 (section 4.1: broadcast on a serial line).
"""

import asyncio
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import Enum
from socket import SO_LINGER, SO_SNDBUF, SOL_SOCKET
from typing import NamedTuple

from simulators.modbus_bank import Bank
from simulators.modbus_frames import BadFrame, Request, frame, split_frames
from simulators.modbus_identity import ANONYMOUS, Identity
from simulators.modbus_requests import WRITING, respond

GATEWAY_TARGET_SILENT = 11
MOST_PENDING = 64  # delayed answers per client before its requests are no longer read
RECEIVE_BYTES = 512  # taken from one client before the others have their turn
SEND_BYTES = 1 << 16  # answers that the kernel keeps for a client which does not read them
QUIET_S = 10.0  # a client that has been quiet for so long gives way when there are too many


class Units(Enum):
    """Whom a server serves by the unit id of a request."""

    OWN = "own"  # its unit id, and 0 and 255, which mean the device that is directly on TCP/IP
    ANY = "any"  # every unit id, as many PLCs do
    GATEWAY = "gateway"  # as on a serial line: its unit id; 0 is a broadcast, which is executed and not answered


class Exchange(NamedTuple):
    """One request and what came of it."""

    at_s: float  # time.monotonic()
    client: str  # host:port
    transaction: int
    unit: int
    request: bytes
    answer: bytes | None


@dataclass
class Troubles:
    """What goes wrong between server and client; delays are wall seconds, since the client's deadlines are."""

    mute: bool = False  # requests are neither executed nor answered
    exception: int | None = None  # answer to everything, without executing it
    delay_s: float = 0.0
    drop_answers: int = 0  # so many requests are executed and not answered
    cut_answers: int = 0  # so many requests are executed, then the connection breaks instead of an answer


def _ignore(exchange: Exchange) -> None:
    """Do nothing."""


class ModbusServer:
    """Serves one bank on TCP. `port` is known after start(); `listener` is told of every request."""

    def __init__(
        self,
        bank: Bank,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        unit_id: int = 1,
        units: Units = Units.OWN,
        identity: Identity = ANONYMOUS,
        lacking: Iterable[int] = (),
        most_clients: int = 16,
    ) -> None:
        self.bank = bank
        self.identity = identity
        self.troubles = Troubles()
        self.host = host
        self.port = port
        self.units = units
        self.lacking = frozenset(lacking)  # function codes that it does not know
        self.requests = 0
        self.functions: Counter[int] = Counter()  # that were asked for
        self.listener: Callable[[Exchange], None] = _ignore
        self._unit_id = unit_id
        self._most_clients = most_clients
        self._clients: set[_Client] = set()
        self._server: asyncio.Server | None = None

    async def start(self) -> None:
        """Listen."""
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Client(self), self.host, self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Stop listening and break all connections. May be called twice."""
        server, self._server = self._server, None
        if server is not None:
            server.close()
            self.break_connections()
            await server.wait_closed()

    def break_connections(self) -> None:
        """Reset every client's connection."""
        for client in list(self._clients):
            client.reset()

    def joined(self, client: "_Client") -> bool:
        """Whether one more client is served: the longest quiet one gives way to it, if any was quiet long enough."""
        if len(self._clients) >= self._most_clients:
            quietest = min(self._clients, key=lambda other: other.heard_s)
            if time.monotonic() - quietest.heard_s < QUIET_S:
                return False
            quietest.reset()
            self._clients.discard(quietest)
        self._clients.add(client)
        return True

    def left(self, client: "_Client") -> None:
        """Forget a client."""
        self._clients.discard(client)

    def answer(self, client: str, request: Request) -> bytes | None:
        """Execute one request; None when nothing is answered."""
        self.requests += 1
        self.functions[request.pdu[0]] += 1
        answer = self._answer(request.unit, request.pdu)
        self.listener(Exchange(time.monotonic(), client, *request, answer))
        return answer

    def _answer(self, unit: int, pdu: bytes) -> bytes | None:
        troubles = self.troubles
        if troubles.mute:
            return None
        if troubles.exception is not None:
            return bytes((pdu[0] | 0x80, troubles.exception))
        if self.units is Units.GATEWAY and unit == 0:
            self._broadcast(pdu)
            return None
        if not self._serves(unit):
            return bytes((pdu[0] | 0x80, GATEWAY_TARGET_SILENT))
        answer = respond(self.bank, self.identity, pdu, self.lacking)
        if troubles.drop_answers:
            troubles.drop_answers -= 1
            return None
        return answer

    def _serves(self, unit: int) -> bool:
        if self.units is Units.ANY:
            return True
        return unit == self._unit_id or (self.units is Units.OWN and unit in (0, 255))

    def _broadcast(self, pdu: bytes) -> None:
        """Only what writes makes sense to all at once; nobody answers."""
        if pdu[0] in WRITING:
            respond(self.bank, self.identity, pdu, self.lacking)


class _Client(asyncio.BufferedProtocol):
    """One connection."""

    def __init__(self, server: ModbusServer) -> None:
        self.heard_s = time.monotonic()
        self._server = server
        self._name = ""
        self._received = memoryview(bytearray(RECEIVE_BYTES))
        self._rest = b""
        self._transport: asyncio.Transport | None = None
        self._pending: set[asyncio.TimerHandle] = set()
        self._ready_at_s = 0.0
        self._peer_reads = True

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._name = "{}:{}".format(*transport.get_extra_info("peername")[:2])
        transport.get_extra_info("socket").setsockopt(SOL_SOCKET, SO_SNDBUF, SEND_BYTES)
        if not self._server.joined(self):
            self.reset()

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.left(self)
        for timer in self._pending:
            timer.cancel()
        self._pending.clear()
        self._transport = None

    def reset(self) -> None:
        """RST, so that the other side knows at once."""
        if self._transport is not None and not self._transport.is_closing():
            sock = self._transport.get_extra_info("socket")
            sock.setsockopt(SOL_SOCKET, SO_LINGER, struct.pack("ii", 1, 0))
            self._transport.abort()

    def get_buffer(self, sizehint: int) -> memoryview:
        return self._received

    def buffer_updated(self, nbytes: int) -> None:
        self.heard_s = time.monotonic()
        try:
            requests, self._rest = split_frames(self._rest + self._received[:nbytes])
        except BadFrame:
            self.reset()
            return
        for request in requests:
            if self._transport is None or self._transport.is_closing():
                return
            self._serve(request)

    def _serve(self, request: Request) -> None:
        answer = self._server.answer(self._name, request)
        if self._server.troubles.cut_answers:
            self._server.troubles.cut_answers -= 1
            self.reset()
        elif answer is not None:
            self._send(frame(request._replace(pdu=answer)))

    def _send(self, data: bytes) -> None:
        """At once, or after the delay and never before an earlier answer."""
        assert self._transport is not None
        loop = asyncio.get_running_loop()
        delay_s = self._server.troubles.delay_s
        if not self._pending and delay_s <= 0:
            self._transport.write(data)
            return
        self._ready_at_s = max(loop.time() + delay_s, self._ready_at_s + 1e-6)

        def send_now() -> None:
            self._pending.discard(timer)
            if self._transport is not None:
                self._transport.write(data)
            self._flow()

        timer = loop.call_at(self._ready_at_s, send_now)
        self._pending.add(timer)
        self._flow()

    def pause_writing(self) -> None:
        self._peer_reads = False
        self._flow()

    def resume_writing(self) -> None:
        self._peer_reads = True
        self._flow()

    def _flow(self) -> None:
        """Read requests only while their answers go out."""
        if self._transport is None or self._transport.is_closing():
            return
        if self._peer_reads and len(self._pending) < MOST_PENDING:
            self._transport.resume_reading()
        else:
            self._transport.pause_reading()
