"""Playing cellctl to a PLC, step by step, to see whether it keeps the contract; and how a finding is told."""

import asyncio
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from drivers.plc_probe import PlcProbe
from drivers.plc_registers import READ_ADDRESS, WRITE_COUNT
from drivers.plc_tags import CELL_TAGS, PLC_TAGS, shown

STEP_S = 0.02
HEARTBEAT, SESSION, SEQUENCE, COMMAND, ARGUMENT, OUTPUTS = 0, 1, 3, 4, 5, 6
Picture = Mapping[int, int]  # by the contract's addresses
Holds = Callable[[Picture], bool]


class Found(NamedTuple):
    """What came of one point; None = it could not be tried."""

    passed: bool | None
    came: str
    remedy: str = ""
    sent: str = ""


class Point(NamedTuple):
    """One sentence of the contract, and how it is tried."""

    title: str
    attempt: Callable[["Player"], Awaitable[Found]]


class Seen(NamedTuple):
    """The picture in which something held, or the last one; and after how long."""

    held: bool
    picture: Picture
    after_s: float


@dataclass
class Player:
    """A client that writes exactly what it is told. `words` are registers 0..15."""

    probe: PlcProbe
    words: dict[int, int] = field(default_factory=lambda: dict.fromkeys(range(WRITE_COUNT), 0))

    async def look(self) -> Picture:
        """Registers 100..131; nothing is written."""
        return dict(enumerate(await self.probe.picture(), READ_ADDRESS))

    async def beat(self) -> Picture:
        """One exchange, as cellctl makes one per scan."""
        self.words[HEARTBEAT] = (self.words[HEARTBEAT] + 1) & 0xFFFF
        return dict(enumerate(await self.probe.exchange(list(self.words.values())), READ_ADDRESS))

    async def play(self, holds: Holds, within_s: float) -> Seen:
        """Exchange until this holds."""
        return await _until(self.beat, holds, within_s)

    async def stay_silent(self, holds: Holds, within_s: float) -> Seen:
        """Write nothing until this holds."""
        return await _until(self.look, holds, within_s)

    async def command(self, command: int, argument: int = 0, within_s: float = 1.0) -> Seen:
        """A new command, until the PLC calls it finished."""
        number = self.words[SEQUENCE] % 0xFFFF + 1
        self.words.update({SEQUENCE: number, COMMAND: command, ARGUMENT: argument})
        return await self.play(lambda now: now[107] == now[108] == number, within_s)

    def sent(self, *addresses: int) -> str:
        """What was written last to these registers."""
        return shown(CELL_TAGS, self.words, addresses)


async def _until(step: Callable[[], Awaitable[Picture]], holds: Holds, within_s: float) -> Seen:
    began_s = time.monotonic()
    while True:
        picture = await step()
        after_s = time.monotonic() - began_s
        if holds(picture) or after_s > within_s:
            return Seen(holds(picture), picture, after_s)
        await asyncio.sleep(STEP_S)


def came(picture: Picture, *addresses: int) -> str:
    """What these registers of the PLC showed."""
    return shown(PLC_TAGS, picture, addresses)
