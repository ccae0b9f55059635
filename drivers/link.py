"""A line link to a controller: text lines over TCP or a serial port, with single control bytes out of turn.

A link that has failed or was poisoned delivers nothing more, not even what it had received: after a time-out nobody
knows which answer belongs to which question. It is opened again, which starts with an empty slate.
"""

import asyncio
import socket
import termios
from collections import deque
from typing import Protocol

from drivers.errors import DeviceError, Garbled, LinkLost, NoAnswer
from drivers.link_address import SerialAddress, TcpAddress, parse_address
from drivers.link_lines import LONGEST_LINE, LineSplitter
from drivers.link_serial import SerialWire, reason

MOST_LINES = 16_384  # received and not yet read; a whole segment of a point file
MOST_UNSENT = 4096  # bytes
CONNECT_S = 2.0
CLOSE_S = 0.5
DRAIN_S = 2.0  # in which a line must be taken
LOOK_AGAIN_S = 0.005
KEEP_ALIVE_S, KEEP_ALIVE_PROBES = 5, 3  # a dead peer is noticed in 15 s even when nothing is asked


class Wire(Protocol):
    """What carries the bytes: a TCP transport or a serial port."""

    def write(self, data: bytes, /) -> None:
        """Send, as soon as possible; never blocks."""

    def get_write_buffer_size(self) -> int:
        """Bytes that the other side has not taken yet."""

    def close(self) -> None:
        """Let go, after sending what waits."""

    def abort(self) -> None:
        """Let go at once."""


class LineLink:
    """One link, opened and closed as often as needed. `device` names it in errors."""

    def __init__(self, address: str, *, device: str) -> None:
        self.device = device
        self.address = address
        self._parsed = parse_address(address)
        self._wire: Wire | None = None
        self._receiver: _Receiver | None = None

    @property
    def is_serial(self) -> bool:
        """Whether it is a serial port, which keeps the bytes of earlier conversations."""
        return isinstance(self._parsed, SerialAddress)

    @property
    def is_open(self) -> bool:
        """Whether lines can be sent and received."""
        return self._receiver is not None and self._receiver.failure is None

    async def open(self) -> None:
        """Connect; raises LinkLost. A link that is open is closed first."""
        await self.close()
        receiver = _Receiver(self.device, telnet=not self.is_serial)
        try:
            async with asyncio.timeout(CONNECT_S):
                self._wire = await _connect(self._parsed, receiver)
        except TimeoutError:
            raise LinkLost(self.device, f"no connection to {self.address} within {CONNECT_S:g} s") from None
        except (OSError, termios.error) as error:  # serial.SerialException is an OSError
            why = reason(error, self._parsed.path) if isinstance(self._parsed, SerialAddress) else str(error)
            raise LinkLost(self.device, f"no connection to {self.address}: {why}") from error
        self._receiver = receiver

    async def close(self) -> None:
        """Hang up; returns when the port is free. May be called at any time, also twice."""
        wire, receiver = self._wire, self._receiver
        self._wire = self._receiver = None
        if wire is None or receiver is None:
            return
        receiver.fail(LinkLost(self.device, "the link was closed"))
        wire.close()
        try:
            async with asyncio.timeout(CLOSE_S):
                await receiver.gone.wait()
        except TimeoutError:
            pass
        finally:
            wire.abort()

    def poison(self, because: str) -> None:
        """Trust nothing on this link any more: drop it and what it has received."""
        if self._receiver is not None:
            self._receiver.fail(LinkLost(self.device, because))
        if self._wire is not None:
            self._wire.abort()

    def send(self, line: str) -> None:
        """Send one line; raises LinkLost, or NoAnswer when the other side takes nothing."""
        self._write(line.encode("latin-1") + b"\r\n")

    def tell(self, control: bytes) -> None:
        """Send control bytes now, out of turn; raises as `send`."""
        self._write(control)

    async def drained(self) -> None:
        """Until the other side has taken most of what was sent; raises LinkLost, or NoAnswer when it does not."""
        deadline_s = asyncio.get_running_loop().time() + DRAIN_S
        while self._wire is not None and self.is_open and self._wire.get_write_buffer_size() > MOST_UNSENT // 2:
            if asyncio.get_running_loop().time() > deadline_s:
                raise self._stuck()
            await asyncio.sleep(LOOK_AGAIN_S)

    async def line(self) -> str:
        """The next line received; raises LinkLost or Garbled once the link has failed."""
        if self._receiver is None:
            raise LinkLost(self.device, f"{self.address} is not open")
        return await self._receiver.line()

    def _write(self, data: bytes) -> None:
        if self._receiver is None or self._wire is None:
            raise LinkLost(self.device, f"{self.address} is not open")
        if self._receiver.failure is not None:
            raise self._receiver.failure
        if self._wire.get_write_buffer_size() > MOST_UNSENT:
            raise self._stuck()
        self._wire.write(data)

    def _stuck(self) -> NoAnswer:
        self.poison("it takes no bytes")
        return NoAnswer(self.device, "it does not take what is sent")


class _Receiver(asyncio.Protocol):
    """Collects lines until the link fails."""

    def __init__(self, device: str, *, telnet: bool) -> None:
        self.failure: DeviceError | None = None
        self.gone = asyncio.Event()
        self._device = device
        self._splitter = LineSplitter(telnet=telnet)
        self._lines: deque[str] = deque()
        self._news = asyncio.Event()
        self._wire: Wire | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._wire = transport
        if (sock := transport.get_extra_info("socket")) is not None:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, KEEP_ALIVE_S)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, KEEP_ALIVE_S)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, KEEP_ALIVE_PROBES - 1)

    def data_received(self, data: bytes) -> None:
        if self.failure is not None:
            return
        lines, refusals = self._splitter.feed(data)
        if refusals and self._wire is not None:
            self._wire.write(refusals)
        if self._splitter.overlong:
            self.fail(Garbled(self._device, f"{LONGEST_LINE} bytes without a line end"))
        elif len(self._lines) + len(lines) > MOST_LINES:
            self.fail(Garbled(self._device, f"more than {MOST_LINES} lines that nobody asked for"))
        else:
            self._lines.extend(lines)
            self._news.set()

    def connection_lost(self, exc: Exception | None) -> None:
        self.fail(LinkLost(self._device, f"the link broke: {exc or 'the other side hung up'}"))
        self.gone.set()

    def fail(self, failure: DeviceError) -> None:
        """Remember the first failure; nothing is delivered any more."""
        self.failure = self.failure or failure
        self._lines.clear()
        self._news.set()

    async def line(self) -> str:
        while not self._lines:
            if self.failure is not None:
                raise self.failure
            self._news.clear()
            await self._news.wait()
        return self._lines.popleft()


async def _connect(address: TcpAddress | SerialAddress, receiver: _Receiver) -> Wire:
    loop = asyncio.get_running_loop()
    if isinstance(address, TcpAddress):
        transport, _ = await loop.create_connection(lambda: receiver, address.host, address.port)
        return transport
    return SerialWire(address, receiver)
