"""One RCX controller, asked and told in values: what its verbs share, whoever they belong to."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Sequence
from typing import TypeVar

from drivers import rcx
from drivers.conversation import ANSWER_S, Conversation
from drivers.errors import NoAnswer, Refused
from drivers.rcx import Position, Pulses, RobotStatus
from drivers.rcx_dialect import Dialect

T = TypeVar("T")

POWER_S = 10.0
FRESH_S = 0.5  # what was read longer ago is read again before a motion


class Controller:
    """`turn` is held by whoever moves the arm or exchanges files: one at a time.

    What it said last about its state and the arm's place is kept for FRESH_S; everything else is asked.
    """

    def __init__(self, address: str, dialect: Dialect, *, device: str) -> None:
        self.device = device
        self.dialect = dialect
        self.talk = Conversation(address, dialect, device=device)
        self.turn = asyncio.Lock()
        self.position: Position | None = None
        self._position_at_s = self._status_at_s = -FRESH_S
        self._status: RobotStatus | None = None

    def forget(self) -> None:
        """Nothing is known of it any more."""
        self.position = None
        self.doubt()

    def doubt(self) -> None:
        """Something has happened: state and place are asked again before the next motion."""
        self._status = None
        self._position_at_s = -FRESH_S

    async def value(self, what: str, parse: Callable[[str], T | None], *, within_s: float = ANSWER_S) -> T:
        """Ask; raises Refused, NoAnswer, LinkLost, Garbled."""
        line = rcx.query(what)
        answer = await self.talk.ask(line, within_s=within_s)
        value = parse(answer[0]) if len(answer) == 1 else None
        if value is None:
            raise self.talk.garbled(line, answer)
        return value

    async def set(self, setting: str) -> None:
        """Tell; raises as `value`."""
        await self.talk.set(rcx.command(setting))

    async def operate(self, text: str, *, within_s: float) -> None:
        """Do; raises as `value`."""
        self.doubt()
        await self.talk.operate(rcx.command(text), within_s=within_s)

    async def status(self) -> RobotStatus:
        """Its state, asked now."""
        return self._understood([answer async for answer in self._state(ANSWER_S)])

    async def glance(self, *, within_s: float, ended: Callable[[], bool]) -> RobotStatus | None:
        """Its state, each answer within so many seconds; None when meanwhile what is watched has ended."""
        answers = []
        async for answer in self._state(within_s):
            answers.append(answer)
            if ended():
                return None
        return self._understood(answers)

    async def _state(self, within_s: float) -> AsyncIterator[str]:
        answers = []
        for what in self.dialect.status_queries:
            answers.append(await self.value(what, str, within_s=within_s))
            yield answers[-1]
        for what in self.dialect.more_queries(answers):
            for answer in await self.talk.ask(rcx.query(what), codes_are_data=True):
                yield answer

    def _understood(self, answers: Sequence[str]) -> RobotStatus:
        status = self.dialect.status(answers)
        if status is None:
            raise self.talk.garbled("the status queries", answers)
        self._status, self._status_at_s = status, _now_s()
        return status

    async def recent_status(self) -> RobotStatus:
        """Its state, not older than FRESH_S."""
        if self._status is None or not self._status.ready or _now_s() - self._status_at_s > FRESH_S:
            return await self.status()
        return self._status

    async def where(self) -> Position:
        """Where the arm is, asked now, with the side of its elbow also where a position does not say it."""
        position = await self.value("WHRXY", rcx.parse_position)
        if position.hand == 0:
            with contextlib.suppress(Refused):  # firmware that does not say it
                position = position._replace(hand=await self.value(self.dialect.hand_query, rcx.parse_hand))
        self.position, self._position_at_s = position, _now_s()
        return position

    async def pulses(self) -> Pulses:
        """The axes, asked now."""
        return await self.value("WHERE", rcx.parse_pulses)

    async def power(self, *, on: bool) -> None:
        """Motor power and servos; raises NoAnswer when it had no effect, and as `value`."""
        self.position = None  # without servos the arm may sink
        command = self.dialect.power_on if on else self.dialect.power_off
        await self.operate(command, within_s=POWER_S)
        status = await self.status()
        if (status.motor_on and status.servo_on) is not on:
            raise NoAnswer(self.device, f"{command} had no effect: {status.why_not_ready or 'the servo is on'}")

    @property
    def position_is_fresh(self) -> bool:
        """Whether the arm's place was read a moment ago."""
        return self.position is not None and _now_s() - self._position_at_s < FRESH_S

    async def fetch(self, name: str) -> list[str]:
        """READ a file; raises as `value`."""
        async with self.turn:
            return await self.talk.fetch(rcx.command(f"READ {name}"))

    async def store(self, name: str, lines: Sequence[str]) -> None:
        """WRITE a file; raises as `value`."""
        async with self.turn:
            await self.talk.store(rcx.command(f"WRITE {name}"), lines)


def _now_s() -> float:
    return asyncio.get_running_loop().time()
