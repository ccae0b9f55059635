"""A TCP proxy that makes a wire go wrong: between a client and a server of any protocol, deterministic by seed.

`proxy.up` (client to server) and `proxy.down` (server to client) say what happens to the messages of a direction; both
may be changed at any time. What a message is, `messages` says: a piece of the stream as it came, a Modbus TCP frame, a
line. The proxy keeps a record of every message and of what became of it, so tests can ask what truly was on the wire.
"""

import asyncio
import contextlib
import random
import socket
import struct
import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from tests.wire_trouble import Framing, Trouble, as_it_comes, fate

Direction = Literal["up", "down"]
LONGEST_RECORD = 200_000
CALM = Trouble()


class Passed(NamedTuple):
    """One message on the wire; `became` names what was done to it, empty when nothing was."""

    at_s: float  # time.monotonic()
    connection: int
    direction: Direction
    message: bytes
    became: tuple[str, ...]


@dataclass(eq=False)
class FaultProxy:
    """Listens on `port` (known after start) and passes everything on to the server at `host`:`server_port`."""

    server_port: int
    host: str = "127.0.0.1"
    messages: Framing = as_it_comes
    seed: int = 1
    port: int = 0
    up: Trouble = field(default_factory=Trouble)
    down: Trouble = field(default_factory=Trouble)
    haunted: bool = False  # answers still on their way when a connection ended arrive in the next one
    listener: Callable[[Passed], object] = lambda passed: None  # told of each message before its fate is carried out
    record: deque[Passed] = field(default_factory=lambda: deque(maxlen=LONGEST_RECORD))
    counts: Counter[str] = field(default_factory=Counter)  # "down lose" and so on; "connections", "ghosts"
    stalled: set[Direction] = field(default_factory=set)
    dead: bool = False
    ghosts: list[bytes] = field(default_factory=list)
    _wires: set["_Wire"] = field(default_factory=set)
    _server: asyncio.Server | None = None

    async def start(self) -> None:
        """Listen; also again after `refuse`, on the same port."""
        self._server = await asyncio.start_server(self._serve, self.host, self.port)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """End everything that the proxy began."""
        self.refuse()
        tasks = {wire.task for wire in self._wires}
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)

    # -- what happens to connections -------------------------------------------------------------------------------

    def refuse(self) -> None:
        """Nobody listens any more; connections stay. `start` listens again."""
        server, self._server = self._server, None
        if server is not None:
            server.close()

    def reset(self) -> None:
        """RST to both sides of every connection."""
        for wire in list(self._wires):
            wire.end(reset=True)

    def hang_up(self) -> None:
        """FIN to both sides of every connection."""
        for wire in list(self._wires):
            wire.end(reset=False)

    def unplug(self) -> None:
        """Half-open: what is sent vanishes and nobody is told; new connections are taken and stay silent."""
        self.dead = True

    def plug_in(self) -> None:
        """The cable is back: new connections work, what was sent meanwhile is lost, old connections are reset."""
        self.dead = False
        self.reset()

    def stall(self, *directions: Direction) -> None:
        """Messages wait (both directions when none is named) until `go_on`; none is lost."""
        self.stalled |= set(directions or ("up", "down"))

    def go_on(self) -> None:
        """Everything that waited arrives now, in order."""
        self.stalled.clear()
        for wire in self._wires:
            wire.let_through()

    # -- carrying --------------------------------------------------------------------------------------------------

    def next_trouble(self, direction: Direction) -> Trouble:
        """What happens to the message that comes now; counts it."""
        trouble = self.up if direction == "up" else self.down
        if trouble.count is None:
            return trouble
        if trouble.count <= 0:
            return CALM
        trouble.count -= 1
        return trouble

    def note(self, passed: Passed) -> None:
        """Keep the record of one message."""
        self.record.append(passed)
        self.listener(passed)
        for name in passed.became:
            self.counts[f"{passed.direction} {name}"] += 1

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.counts["connections"] += 1
        wire = _Wire(self, self.counts["connections"], writer)
        self._wires.add(wire)
        try:
            await wire.carry(reader)
        except OSError:
            pass  # the server does not listen: the client sees its connection end
        except asyncio.CancelledError:
            pass  # by close(), which waits for this task; the stream's own callback would report it as an error
        finally:
            self._wires.discard(wire)
            wire.end(reset=False)


class _Wire:
    """One connection of a client and the one to the server that belongs to it."""

    def __init__(self, proxy: FaultProxy, number: int, client: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self.task = task
        self._proxy, self._number = proxy, number
        self._writers = [client]
        self._ways: list[_Way] = []

    async def carry(self, from_client: asyncio.StreamReader) -> None:
        """Until one side hangs up."""
        from_server, to_server = await asyncio.open_connection(self._proxy.host, self._proxy.server_port)
        up = _Way(self._proxy, self._number, "up", to_server)
        down = _Way(self._proxy, self._number, "down", self._writers[0])
        self._writers.append(to_server)
        self._ways = [up, down]
        down.haunt()
        carrying = [asyncio.create_task(up.carry(from_client)), asyncio.create_task(down.carry(from_server))]
        try:
            await asyncio.wait(carrying, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in carrying:
                task.cancel()
            await asyncio.wait(carrying)

    def let_through(self) -> None:
        """The stall is over."""
        for way in self._ways:
            way.let_through()

    def end(self, *, reset: bool) -> None:
        """Close both sides; with RST when so asked."""
        for way in self._ways:
            way.forget()
        for writer in self._writers:
            sock = writer.get_extra_info("socket")
            if reset and sock is not None and not writer.is_closing():
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                writer.transport.abort()
            writer.close()


class _Way:
    """One direction of one connection."""

    def __init__(self, proxy: FaultProxy, number: int, direction: Direction, to: asyncio.StreamWriter) -> None:
        self._proxy, self._number, self._direction, self._to = proxy, number, direction, to
        self._chance = random.Random(f"{proxy.seed} {direction} {number}")
        self._before = b""  # the last message
        self._timers: dict[asyncio.TimerHandle, bytearray] = {}  # and what each will write
        self._merging: bytearray | None = None
        self._held: deque[bytes] = deque()  # by a stall
        self._due_s = 0.0

    async def carry(self, reader: asyncio.StreamReader) -> None:
        """Pass on what comes until the sender hangs up, and then what is still on its way."""
        rest = b""
        with contextlib.suppress(ConnectionError):
            while received := await reader.read(65536):
                messages, rest = self._proxy.messages(rest + received)
                for message in messages:
                    self._pass(message)
        if rest:
            self._pass(rest)
        while self._timers or self._held or self._proxy.dead:
            await asyncio.sleep(0.002)

    def haunt(self) -> None:
        """What an earlier connection did not deliver comes first."""
        ghosts, self._proxy.ghosts[:] = list(self._proxy.ghosts), []
        self._proxy.counts["ghosts"] += len(ghosts)
        for ghost in ghosts:
            self._write(ghost)

    def forget(self) -> None:
        """Nothing more arrives on this way."""
        if self._proxy.haunted and self._direction == "down":
            self._proxy.ghosts += [*map(bytes, self._timers.values()), *self._held]
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
        self._held.clear()

    def let_through(self) -> None:
        """The stall is over."""
        while self._held:
            self._write(self._held.popleft())

    def _pass(self, message: bytes) -> None:
        """What becomes of one message."""
        trouble = self._proxy.next_trouble(self._direction)
        drawn = fate(trouble, message, self._before, self._chance)
        self._before = message
        became = ("dead",) if self._proxy.dead else drawn.names
        self._proxy.note(Passed(time.monotonic(), self._number, self._direction, message, became))
        if self._proxy.dead:
            return
        for arriving in drawn.arrives:
            if "late" in drawn.names:
                self._at(time.monotonic() + drawn.wait_s, arriving)
            elif trouble.merge_s:
                self._merge(trouble.merge_s, arriving)
            else:
                self._in_order(drawn.wait_s, arriving, trouble)

    def _merge(self, within_s: float, message: bytes) -> None:
        if self._merging is not None:
            self._merging += message
            return
        self._merging = bytearray(message)
        self._at(time.monotonic() + within_s, self._merging)

    def _in_order(self, wait_s: float, message: bytes, trouble: Trouble) -> None:
        """Whole or in pieces, and never before what was sent earlier."""
        size = trouble.split_bytes or max(len(message), 1)
        for start in range(0, len(message), size):
            now_s = time.monotonic()
            self._due_s = max(now_s + wait_s, self._due_s)
            piece = message[start : start + size]
            if self._due_s <= now_s and not self._timers:
                self._write(piece)
            else:
                self._at(self._due_s, piece)
            self._due_s += trouble.split_gap_s if size < len(message) else 1e-6

    def _at(self, at_s: float, data: bytes | bytearray) -> None:
        def now() -> None:
            written = self._timers.pop(timer)
            if written is self._merging:
                self._merging = None
            self._write(bytes(written))

        timer = asyncio.get_running_loop().call_later(at_s - time.monotonic(), now)
        self._timers[timer] = data if isinstance(data, bytearray) else bytearray(data)

    def _write(self, data: bytes) -> None:
        if self._direction in self._proxy.stalled:
            self._held.append(data)
        elif not self._proxy.dead and not self._to.is_closing():
            self._to.write(data)


@asynccontextmanager
async def proxied(
    server_port: int, *, host: str = "127.0.0.1", messages: Framing = as_it_comes, seed: int = 1
) -> AsyncIterator[FaultProxy]:
    """A running proxy before a server."""
    proxy = FaultProxy(server_port, host, messages, seed)
    await proxy.start()
    try:
        yield proxy
    finally:
        await proxy.close()
