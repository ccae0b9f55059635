"""The driver's PLC behind a wire that can go wrong, and what truly was on that wire and in the PLC."""

import asyncio
import struct
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from drivers.errors import DeviceError
from drivers.plc import Plc
from drivers.plc_registers import PlcImage
from simulators.modbus import Exchange
from simulators.modbus_frames import HEADER_SIZE
from simulators.plc import PlcServer
from tests.fault_proxy import FaultProxy, proxied
from tests.plc_belt import Belt, powered, running
from tests.wire_trouble import Trouble, modbus_frames

READY_S = 10.0  # also when this computer is busy


class Written(NamedTuple):
    """Registers 0..15 as one request carried them."""

    heartbeat: int
    session: int
    machine_state: int
    sequence: int
    command: int
    argument: int
    outputs: int


def written(pdu: bytes) -> Written | None:
    """What a request writes, None when it writes nothing."""
    if pdu[0] not in (16, 23):
        return None
    return Written._make(struct.unpack_from(">7H", pdu, 6 if pdu[0] == 16 else 10))


def words_sent(proxy: FaultProxy, since_s: float) -> list[Written]:
    """What was on the wire to the PLC since then."""
    sent = [written(p.message[HEADER_SIZE:]) for p in proxy.record if p.direction == "up" and p.at_s > since_s]
    return [words for words in sent if words is not None]


def commands_sent(proxy: FaultProxy, since_s: float) -> set[int]:
    """Commands among it."""
    return {words.command for words in words_sent(proxy, since_s) if words.command}


@dataclass
class WiredCell:
    """World, PLC, wire and driver."""

    world: Belt
    server: PlcServer
    proxy: FaultProxy
    plc: Plc
    executed: list[Exchange] = field(default_factory=list)  # by the server, in its order
    late_s: float = 0.0  # the longest that this busy computer has kept a timer waiting

    def commands_executed(self) -> list[tuple[int, int]]:
        """(sequence, command) as the PLC met each for the first time."""
        found = [written(each.request) for each in self.executed]
        return list(dict.fromkeys((w.sequence, w.command) for w in found if w is not None and w.command))

    def truth_age_s(self, image: PlcImage, at_s: float) -> float:
        """How long before `at_s` the PLC answered with exactly this picture; fails when it never did."""
        for exchange in reversed(self.executed):
            words = exchange.answer[2:] if exchange.answer else b""
            if words == struct.pack(">32H", *image.words):
                return at_s - exchange.at_s
        raise AssertionError(f"the PLC never answered {image}")

    @contextmanager
    def at_the_next_command(self, do: Callable[[], object]) -> Iterator[None]:
        """When the PLC has executed the next new command, and before its answer is on the wire; fails if none came."""
        known, done = set(self.commands_executed()), list[bool]()

        def listen(exchange: Exchange) -> None:
            self.executed.append(exchange)
            found = written(exchange.request)
            if found and found.command and (found.sequence, found.command) not in known and not done:
                done.append(True)
                do()

        self.server.modbus.listener = listen
        yield
        self.server.modbus.listener = self.executed.append
        assert done, "no new command came"

    async def watch_lateness(self) -> None:
        """Bounds are those of a computer that has time for us."""
        while True:
            began_s = time.monotonic()
            await asyncio.sleep(0.01)
            self.late_s = max(self.late_s, time.monotonic() - began_s - 0.01)

    async def trouble_within(self, within_s: float) -> tuple[float, DeviceError]:
        """Wait until the driver's picture is worthless: after how many seconds, and why."""
        began_s = time.monotonic()
        async with asyncio.timeout(within_s):
            while True:
                try:
                    _ = self.plc.image
                except DeviceError as error:
                    return time.monotonic() - began_s, error
                await asyncio.sleep(0.001)


@asynccontextmanager
async def wired(speed: float = 20.0, *, seed: int = 1, **options: Any) -> AsyncIterator[WiredCell]:
    """A running cell whose Modbus frames go through a fault proxy; options are the driver's."""
    async with (
        powered(speed) as (belt, server),
        proxied(server.port, messages=modbus_frames, seed=seed) as proxy,
        running(Plc("127.0.0.1", proxy.port, **options)) as plc,
    ):
        cell = WiredCell(belt, server, proxy, plc)
        server.modbus.listener = cell.executed.append
        await plc.ready(within_s=READY_S)
        lateness = asyncio.create_task(cell.watch_lateness())
        try:
            yield cell
        finally:
            lateness.cancel()


Provoke = Callable[[WiredCell], object]


def down(**trouble: float) -> Provoke:
    """Answers that go wrong."""

    def provoke(c: WiredCell) -> None:
        c.proxy.down = Trouble(**trouble)  # type: ignore[arg-type]

    return provoke


async def together(cases: Iterable[tuple[str, Awaitable[None]]]) -> None:
    """All at once; what fails is named."""

    async def named(name: str, case: Awaitable[None]) -> None:
        try:
            await case
        except Exception as error:
            error.add_note(f"in case: {name}")
            wrong.append(error)

    wrong = list[Exception]()
    async with asyncio.TaskGroup() as group:
        for name, case in cases:
            group.create_task(named(name, case))
    if wrong:
        raise ExceptionGroup("some cases", wrong)
