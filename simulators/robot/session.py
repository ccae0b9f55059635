"""One client: what it has sent and what it is told, over whatever carries the bytes."""

import asyncio
import itertools
from collections.abc import Callable
from typing import Protocol

from simulators.robot.faults import LineFaults
from simulators.robot.framing import Framer, Negotiation

MOST_LINES = 64  # waiting to be worked on; then the carrier is held, or, if that cannot be, lines are lost
FEW_LINES = 16
NUMBERS = itertools.count(1)


class Carrier(Protocol):
    """What carries a session's bytes."""

    @property
    def can_hold(self) -> bool:
        """Whether a client can be made to wait."""

    def write(self, data: bytes) -> None:
        """Bytes to the client."""

    def hold(self, on: bool) -> None:
        """Make the client wait, or let it go on."""

    def hang_up(self) -> None:
        """End the connection in good order, where there is one."""

    def drop(self) -> None:
        """The link breaks."""


class Host(Protocol):
    """What a session needs of the controller."""

    @property
    def faults(self) -> LineFaults:
        """How the line is spoilt at present."""

    def joined(self, session: "Session") -> bool:
        """A client has come; False turns it away."""

    def left(self, session: "Session") -> None:
        """The client has gone."""

    def control(self, session: "Session", byte: int) -> None:
        """A control byte acts at once."""

    def negotiated(self, session: "Session", told: Negotiation) -> None:
        """The client has said something about telnet."""

    def later(self, for_s: float, do: Callable[[], None]) -> None:
        """Do this after so many world seconds."""


class Session:
    """Its lines wait in `lines`; None stands for those that were too many."""

    def __init__(self, host: Host, carrier: Carrier, *, kind: str) -> None:
        self.lines: asyncio.Queue[str | None] = asyncio.Queue()
        self.carrier = carrier
        self.is_network = kind == "network"
        self.name = f"{kind} {next(NUMBERS)}"
        self.echoes = False
        self.logged_out = False
        self._host = host
        self._framer = Framer()
        self._holding = False
        self._held_back = bytearray()
        self._stalled = bytearray()

    def heard(self, data: bytes) -> None:
        """Bytes from the client."""
        if (wait_s := self._host.faults.stalled_s()) > 0:
            if not self._stalled:
                self._host.later(wait_s, self._go_on)
            self._stalled += data
            return
        for event in self._framer.feed(data):
            if isinstance(event, Negotiation):
                self._host.negotiated(self, event)
            elif isinstance(event, int):
                self._host.control(self, event)
            else:
                self._take(event)
        if self.echoes and self._framer.plain:
            self.carrier.write(bytes(self._framer.plain))

    async def next_line(self) -> str | None:
        """The next line to be worked on."""
        line = await self.lines.get()
        if self._holding and self.lines.qsize() <= FEW_LINES:
            self._hold(False)
        return line

    def say(self, *lines: str) -> None:
        """Lines that belong together, in one piece."""
        spoilt = [self._host.faults.spoilt(line) for line in lines]
        for data in spoilt if self._host.faults.apart else [b"".join(spoilt)]:
            self.tell(data)

    def tell(self, data: bytes) -> None:
        """Bytes to the client, as the line's faults let them through."""
        faults = self._host.faults
        wait_s = faults.holding_back_s()
        if not data or faults.mute:
            return
        if wait_s > 0 or self._held_back:
            self._held_back += data
            if len(self._held_back) == len(data):
                self._host.later(wait_s, self._let_go)
        elif faults.split_bytes:
            for k in range(len(data)):
                self.carrier.write(data[k : k + 1])
        else:
            self.carrier.write(data)

    def _go_on(self) -> None:
        data = bytes(self._stalled)
        self._stalled.clear()
        self.heard(data)

    def _let_go(self) -> None:
        data = bytes(self._held_back)
        self._held_back.clear()
        self.carrier.write(data)

    def _take(self, line: str) -> None:
        if self.lines.qsize() < MOST_LINES:
            self.lines.put_nowait(line)
        elif self.carrier.can_hold:
            self.lines.put_nowait(line)
            self._hold(True)
        elif self.lines.qsize() == MOST_LINES:
            self.lines.put_nowait(None)

    def _hold(self, on: bool) -> None:
        if on is not self._holding:
            self._holding = on
            self.carrier.hold(on)
