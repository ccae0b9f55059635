"""A line link to a controller: text lines over TCP or a serial port, with single control bytes out of turn.

    tcp://HOST:PORT                                            serial:/dev/ttyS0?baud=9600&parity=odd&flow=xonxoff

A link that has failed or was poisoned delivers nothing more, not even what it had received: after a time-out nobody
knows which answer belongs to which question. It is opened again, which starts with an empty slate.
"""

import asyncio
import contextlib
import os
import socket
import termios
from collections import deque
from typing import NamedTuple, Protocol
from urllib.parse import parse_qsl, urlsplit

import serial

from drivers.errors import DeviceError, Garbled, LinkLost, NoAnswer

LONGEST_LINE = 512
MOST_LINES = 256  # received and not yet read
MOST_UNSENT = 4096  # bytes
CONNECT_S = 2.0
CLOSE_S = 0.5
READ_SIZE = 4096
BAUDS = (4800, 9600, 19200, 38400, 57600, 115200)
PARITIES = {"none": serial.PARITY_NONE, "odd": serial.PARITY_ODD, "even": serial.PARITY_EVEN}
PSEUDO_TERMINALS = range(136, 144)  # device major numbers
FLOWS = ("none", "xonxoff", "rtscts")

IAC, DONT, DO, WONT, WILL, SUBNEGOTIATION, SUBNEGOTIATION_END = 255, 254, 253, 252, 251, 250, 240


class TcpAddress(NamedTuple):
    """Where a controller listens."""

    host: str
    port: int


class SerialAddress(NamedTuple):
    """A serial port and its settings; 8 data bits, 1 stop bit."""

    path: str
    baud: int
    parity: str
    flow: str


def parse_address(text: str) -> TcpAddress | SerialAddress:
    """Read a link address; raises ValueError with the value and the remedy."""
    if text.startswith("tcp://"):
        return _tcp_address(text)
    if text.startswith("serial:"):
        return _serial_address(text)
    raise ValueError(f"{text!r} is no link address: write tcp://HOST:PORT or serial:/dev/ttyS0?baud=9600")


def _tcp_address(text: str) -> TcpAddress:
    parts = urlsplit(text)
    try:
        port = parts.port
    except ValueError:
        port = None
    rest = (parts.path, parts.query, parts.fragment, parts.username)
    if not parts.hostname or not port or any(rest):
        raise ValueError(f"{text!r} needs a host and a port from 1 to 65535: write tcp://192.168.0.2:23")
    return TcpAddress(parts.hostname, port)


def _serial_address(text: str) -> SerialAddress:
    path, _, query = text.removeprefix("serial:").partition("?")
    if not path.startswith("/"):
        raise ValueError(f"{text!r} needs the whole path of a port: write serial:/dev/ttyS0?baud=9600")
    given = {"baud": "9600", "parity": "odd", "flow": "xonxoff"}
    for key, value in parse_qsl(query, keep_blank_values=True):
        if key not in given:
            raise ValueError(f"{text!r} has the unknown setting {key!r}: there are baud, parity, flow")
        given[key] = value
    choices = {"baud": tuple(map(str, BAUDS)), "parity": tuple(PARITIES), "flow": FLOWS}
    for key, allowed in choices.items():
        if given[key] not in allowed:
            raise ValueError(f"{text!r}: {key} is {given[key]!r}, choose one of {', '.join(allowed)}")
    return SerialAddress(path, int(given["baud"]), given["parity"], given["flow"])


class LineSplitter:
    """Bytes to lines, pure. NUL and CR are dropped, LF ends a line, telnet negotiation is swallowed and refused."""

    def __init__(self, *, telnet: bool) -> None:
        self.overlong = False  # a line passed LONGEST_LINE; nothing after it can be trusted
        self._telnet = telnet
        self._begun = bytearray()
        self._negotiation = bytearray()

    def feed(self, data: bytes) -> tuple[list[str], bytes]:
        """The whole lines that these bytes complete, and the bytes to send back at once."""
        refusals = b""
        if self._telnet and (self._negotiation or IAC in data):
            data, refusals = self._without_negotiation(data)
        *ended, begun = data.translate(None, b"\0\r").split(b"\n")
        lines = []
        for piece in ended:
            lines.append(bytes(self._begun + piece))
            self._begun.clear()
        self._begun += begun
        self.overlong = self.overlong or any(len(line) > LONGEST_LINE for line in (*lines, self._begun))
        del self._begun[LONGEST_LINE + 1 :]
        return [line.decode("latin-1") for line in lines], refusals

    def _without_negotiation(self, data: bytes) -> tuple[bytes, bytes]:
        plain, refusals = bytearray(), bytearray()
        for byte in data:
            if not self._negotiation and byte != IAC:
                plain.append(byte)
                continue
            self._negotiation.append(byte)
            if self._negotiation_ended():
                refusals += _refusal(self._negotiation)
                plain += _not_telnet(self._negotiation)
                self._negotiation.clear()
        return bytes(plain), bytes(refusals)

    def _negotiation_ended(self) -> bool:
        told = self._negotiation
        if len(told) == 1:
            return False
        if told[1] == SUBNEGOTIATION:
            del told[2:-2]  # its content is nothing to us
            return len(told) == 4 and told[2:] == bytes((IAC, SUBNEGOTIATION_END))
        return len(told) == 3 or told[1] not in (WILL, WONT, DO, DONT)


def _not_telnet(told: bytearray) -> bytes:
    """A stray FFh takes no letter and no line end with it."""
    return bytes(told[1:]) if told[1] < SUBNEGOTIATION_END else b""


def _refusal(told: bytearray) -> bytes:
    answer = {WILL: DONT, DO: WONT}.get(told[1])
    return bytes((IAC, answer, told[2])) if answer is not None else b""


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
            raise LinkLost(self.device, f"no connection to {self.address}: {error}") from error
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
            self.poison("it takes no bytes")
            raise NoAnswer(self.device, f"it has not taken {MOST_UNSENT} bytes that were sent")
        self._wire.write(data)


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


def _has_no_parity(path: str) -> bool:
    """A pseudo terminal (a line carried over a network, for instance) refuses parity when opened again."""
    return os.major(os.stat(path).st_rdev) in PSEUDO_TERMINALS


class SerialWire:
    """A serial port on the running loop; reads and writes never block. Raises SerialException."""

    def __init__(self, address: SerialAddress, receiver: asyncio.Protocol) -> None:
        self._receiver = receiver
        self._unsent = bytearray()
        self._loop = asyncio.get_running_loop()
        self._port: serial.Serial | None = serial.Serial(
            address.path,
            address.baud,
            parity=PARITIES["none" if _has_no_parity(address.path) else address.parity],
            xonxoff=address.flow == "xonxoff",
            rtscts=address.flow == "rtscts",
            exclusive=True,
            timeout=0,
        )
        self._port.reset_input_buffer()
        self._fd = self._port.fileno()
        self._loop.add_reader(self._fd, self._readable)

    def write(self, data: bytes) -> None:
        """Send now what the port takes, the rest when it can."""
        if self._port is None:
            return
        # A control byte does not wait behind a line that flow control holds back.
        self._unsent[:] = data + self._unsent if len(data) == 1 else self._unsent + data
        self._writable()

    def get_write_buffer_size(self) -> int:
        """Bytes that the port has not taken."""
        return len(self._unsent)

    def close(self) -> None:
        """Let go; a serial line has nobody to say good-bye to."""
        self._drop(None)

    def abort(self) -> None:
        """The same."""
        self._drop(None)

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(error)
            return
        if data:
            self._receiver.data_received(data)
        else:
            self._drop(None)

    def _writable(self) -> None:
        try:
            sent = os.write(self._fd, self._unsent)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._drop(error)
            return
        del self._unsent[:sent]
        if self._unsent:
            self._loop.add_writer(self._fd, self._writable)
        else:
            self._loop.remove_writer(self._fd)

    def _drop(self, why: Exception | None) -> None:
        if self._port is None:
            return
        self._loop.remove_reader(self._fd)
        self._loop.remove_writer(self._fd)
        with contextlib.suppress(termios.error):  # else closing waits for what flow control holds back
            self._port.reset_output_buffer()
        self._port.close()
        self._port = None
        self._receiver.connection_lost(why)
