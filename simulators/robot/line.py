"""The controller's two fronts, TCP and a serial line on a pseudo terminal: bytes to lines and back, at line speed."""

import asyncio
import contextlib
import os
import socket
import tty
from collections.abc import Callable
from typing import Protocol

from simulators.clock import Clock

ETX, SYN, XON, XOFF = 0x03, 0x16, 0x11, 0x13
IAC = 0xFF
CONTROLS = (ETX, SYN)
KEPT_BYTES = 300  # of a line; more than the controller accepts
MOST_LINES = 64  # waiting to be worked on
BITS_PER_BYTE = 11  # start, 8 data, parity, stop
HIGH_WATER, LOW_WATER = 512, 128
READ_SIZE = 4096


class Framer:
    """Bytes to events: a text line, or a control byte that acts at once, even inside a half-received line."""

    def __init__(self) -> None:
        self._line = bytearray()
        self._telnet = 0

    def feed(self, data: bytes) -> list[str | int]:
        """The events that these bytes complete, in order."""
        events: list[str | int] = []
        for byte in data:
            if self._telnet or byte == IAC:
                self._swallow(byte)
            elif byte in CONTROLS:
                events.append(byte)
            elif byte in b"\r\n":
                if self._line.strip():
                    events.append(self._line.decode("latin-1"))
                self._line.clear()
            elif byte and len(self._line) < KEPT_BYTES:
                self._line.append(byte)
        return events

    def _swallow(self, byte: int) -> None:
        """IAC and a command, and an option behind WILL, WONT, DO, DONT."""
        if self._telnet == 0:
            self._telnet = 2
        elif self._telnet == 2 and 0xFB <= byte <= 0xFE:
            self._telnet = 1
        else:
            self._telnet = 0


class Pacer:
    """Hands bytes on at the pace of a line, in world time."""

    def __init__(self, clock: Clock, byte_s: float, sink: Callable[[bytes], None]) -> None:
        self.waiting = bytearray()
        self.paused = False
        self._clock, self._byte_s, self._sink = clock, byte_s, sink
        self._free_s = 0.0
        self._pump: asyncio.Task[None] | None = None

    def put(self, data: bytes) -> None:
        """Send after what is waiting."""
        self.waiting += data
        self.wake()

    def wake(self) -> None:
        """Go on, after a pause."""
        if self._pump is None or self._pump.done():
            self._free_s = max(self._free_s, self._clock.now())
            self._pump = asyncio.create_task(self._run())

    def clear(self) -> None:
        """Forget what is waiting."""
        self.waiting.clear()

    async def close(self) -> None:
        """Stop."""
        if self._pump is not None:
            self._pump.cancel()
            await asyncio.wait((self._pump,))

    async def _run(self) -> None:
        while self.waiting and not self.paused:
            await self._clock.sleep_until(self._free_s + self._byte_s)
            count = min(int((self._clock.now() - self._free_s) / self._byte_s + 1e-6), len(self.waiting))
            self._free_s += count * self._byte_s
            data = bytes(self.waiting[:count])
            del self.waiting[:count]
            if data:
                self._sink(data)


class Controller(Protocol):
    """What a front needs of the controller."""

    def joined(self, session: "Session") -> bool:
        """A client has come; False turns it away."""

    def left(self, session: "Session") -> None:
        """The client has gone."""

    def control(self, session: "Session", byte: int) -> None:
        """A control byte acts at once."""


class Carrier(Protocol):
    """What carries a session's bytes."""

    def write(self, data: bytes) -> None:
        """Bytes to the client."""

    def drop(self) -> None:
        """The link breaks."""


class Session:
    """One client: its lines wait in `lines`; None stands for those that were too many."""

    def __init__(self, controller: Controller, carrier: Carrier, *, greets: bool) -> None:
        self.lines: asyncio.Queue[str | None] = asyncio.Queue(MOST_LINES + 1)
        self.carrier = carrier
        self.greets = greets
        self._controller = controller
        self._framer = Framer()

    def heard(self, data: bytes) -> None:
        """Bytes from the client."""
        for event in self._framer.feed(data):
            if isinstance(event, int):
                self._controller.control(self, event)
            elif self.lines.qsize() < MOST_LINES:
                self.lines.put_nowait(event)
            elif not self.lines.full():
                self.lines.put_nowait(None)


class TcpFront(asyncio.Protocol):
    """One TCP connection."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._session = Session(controller, self, greets=True)
        self._transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the client or turn it away."""
        assert isinstance(transport, asyncio.Transport)
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._controller.joined(self._session):
            self._transport = transport
        else:
            transport.close()

    def data_received(self, data: bytes) -> None:
        """From the network."""
        if self._transport is not None:
            self._session.heard(data)

    def connection_lost(self, exc: Exception | None) -> None:
        """The client hung up, or we did."""
        if self._transport is not None:
            self._transport = None
            self._controller.left(self._session)

    def write(self, data: bytes) -> None:
        """Each call is one segment."""
        if self._transport is not None:
            self._transport.write(data)

    def drop(self) -> None:
        """Cut the connection."""
        if self._transport is not None:
            self._transport.abort()


class SerialFront:
    """A serial line on a pseudo terminal; `tty` is the path that a client opens."""

    def __init__(self, controller: Controller, clock: Clock, baud: int) -> None:
        self._fd, self._client_fd = os.openpty()  # the client's side stays open, so that clients may come and go
        tty.setraw(self._client_fd)
        os.set_blocking(self._fd, False)
        self.tty = os.ttyname(self._client_fd)
        self.session = Session(controller, self, greets=False)
        byte_s = BITS_PER_BYTE / baud
        self._out = Pacer(clock, byte_s, self._put_out)
        self._in = Pacer(clock, byte_s, self._taken_in)
        self._full = False
        asyncio.get_running_loop().add_reader(self._fd, self._readable)

    def write(self, data: bytes) -> None:
        """At line speed."""
        self._out.put(data)

    def drop(self) -> None:
        """What is on the line is lost; a serial line has no other way to break."""
        self._out.clear()
        self._in.clear()

    async def close(self) -> None:
        """Take the line away."""
        asyncio.get_running_loop().remove_reader(self._fd)
        await self._out.close()
        await self._in.close()
        os.close(self._fd)
        os.close(self._client_fd)

    def _readable(self) -> None:
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._fd, READ_SIZE)
            if XON in data or XOFF in data:
                self._out.paused = data.rfind(XOFF) > data.rfind(XON)
                self._out.wake()
                data = data.translate(None, bytes((XON, XOFF)))
            self._in.put(data)
            self._flow_control()

    def _taken_in(self, data: bytes) -> None:
        self.session.heard(data)
        self._flow_control()

    def _flow_control(self) -> None:
        waiting = len(self._in.waiting)
        if not self._full and waiting > HIGH_WATER:
            self._full = True
            self._put_out(bytes((XOFF,)))
        elif self._full and waiting < LOW_WATER:
            self._full = False
            self._put_out(bytes((XON,)))

    def _put_out(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):  # a full terminal loses bytes, as a line without a listener
            os.write(self._fd, data)
