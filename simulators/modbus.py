"""A strict Modbus TCP server over a bank of registers. Knows nothing of the cell.

Several clients, pipelined and fragmented requests, answers in order; what is not Modbus TCP ends the connection.
"""

import asyncio
import struct
from dataclasses import dataclass

from simulators.modbus_bank import BadFrame, Bank, Identity, respond, split_frames

GATEWAY_TARGET_SILENT = 11
NOT_SIGNIFICANT_UNITS = (0, 255)  # what a client may send to a server that is directly on TCP/IP
MOST_PENDING = 64  # delayed answers per client before its requests are no longer read


@dataclass
class Troubles:
    """What goes wrong between server and client; delays are wall seconds, since the client's deadlines are."""

    mute: bool = False  # requests are neither executed nor answered
    exception: int | None = None  # answer to everything, without executing it
    delay_s: float = 0.0
    drop_answers: int = 0  # so many requests are executed and not answered
    cut_answers: int = 0  # so many requests are executed, then the connection breaks instead of an answer


class ModbusServer:
    """Serves one bank on TCP. `port` is known after start()."""

    def __init__(
        self,
        bank: Bank,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        unit_id: int = 1,
        identity: Identity | None = None,
        most_clients: int = 16,
    ) -> None:
        self.bank = bank
        self.identity = identity or Identity()
        self.troubles = Troubles()
        self.host = host
        self.port = port
        self.requests = 0
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
            client.abort()

    def joined(self, client: "_Client") -> bool:
        """Whether one more client is served."""
        if len(self._clients) >= self._most_clients:
            return False
        self._clients.add(client)
        return True

    def left(self, client: "_Client") -> None:
        """Forget a client."""
        self._clients.discard(client)

    def answer(self, unit: int, pdu: bytes) -> bytes | None:
        """Execute one request; None when nothing is answered."""
        self.requests += 1
        troubles = self.troubles
        if troubles.mute:
            return None
        if troubles.exception is not None:
            return bytes((pdu[0] | 0x80, troubles.exception))
        if unit != self._unit_id and unit not in NOT_SIGNIFICANT_UNITS:
            return bytes((pdu[0] | 0x80, GATEWAY_TARGET_SILENT))
        answer = respond(self.bank, self.identity, pdu)
        if troubles.drop_answers:
            troubles.drop_answers -= 1
            return None
        return answer


class _Client(asyncio.Protocol):
    """One connection."""

    def __init__(self, server: ModbusServer) -> None:
        self._server = server
        self._buffer = b""
        self._transport: asyncio.Transport | None = None
        self._pending: set[asyncio.TimerHandle] = set()
        self._ready_at_s = 0.0
        self._peer_reads = True

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if not self._server.joined(self):
            self.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.left(self)
        for timer in self._pending:
            timer.cancel()
        self._pending.clear()
        self._transport = None

    def abort(self) -> None:
        if self._transport is not None:
            self._transport.abort()

    def data_received(self, data: bytes) -> None:
        try:
            frames, self._buffer = split_frames(self._buffer + data)
        except BadFrame:
            self.abort()
            return
        for transaction, unit, pdu in frames:
            if self._transport is None or self._transport.is_closing():
                return
            self._serve(transaction, unit, pdu)

    def _serve(self, transaction: int, unit: int, pdu: bytes) -> None:
        answer = self._server.answer(unit, pdu)
        if self._server.troubles.cut_answers:
            self._server.troubles.cut_answers -= 1
            self.abort()
        elif answer is not None:
            self._send(struct.pack(">HHHB", transaction, 0, len(answer) + 1, unit) + answer)

    def _send(self, frame: bytes) -> None:
        """At once, or after the delay and never before an earlier answer."""
        assert self._transport is not None
        loop = asyncio.get_running_loop()
        delay_s = self._server.troubles.delay_s
        if not self._pending and delay_s <= 0:
            self._transport.write(frame)
            return
        self._ready_at_s = max(loop.time() + delay_s, self._ready_at_s + 1e-6)

        def send_now() -> None:
            self._pending.discard(timer)
            if self._transport is not None:
                self._transport.write(frame)
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
