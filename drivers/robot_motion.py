"""How the arm is moved: what is checked before, the deadline, what is watched meanwhile, what is read afterwards."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine, Sequence

from drivers.controller import Controller
from drivers.conversation import STOP_S, uncancelled
from drivers.errors import DeviceError, Disturbed, LinkLost, NoAnswer, Refused
from drivers.motion import Dynamics, duration_s
from drivers.rcx import Motion, Point, Position, parse_failure
from drivers.rcx_dialect import Lines
from drivers.reach import SIDES, Limits

TOLERANCE_MM = TOLERANCE_DEG = 0.02
SETTLE_S = 0.5  # END may come while the arm still creeps inside the controller's tolerance
STAND_S = 5.0
LOOK_AGAIN_S = 0.005
WATCH_EVERY_S = 0.1
WATCH_ANSWER_S = 0.3
MOVED_MM = MOVED_DEG = 0.05  # since the arm was last asked: somebody else has moved it
DEADLINE_FACTOR = 1.5
SLACK_S = 2.0
HEAVY_KG = 5.0  # when nobody has said what the arm carries, its deadlines are those of a full load
Meanwhile = Callable[["asyncio.Future[None]"], Awaitable[None]]


class Motions:
    """Motions of one controller; whoever calls holds its turn. `prepare` sets the controller up where it is not."""

    def __init__(
        self, controller: Controller, limits: Limits, dynamics: Dynamics, prepare: Callable[[], Awaitable[None]]
    ) -> None:
        self._controller = controller
        self._dynamics = dynamics
        self._limits = limits
        self._prepare = prepare
        self.unfinished = False

    def refused(self, code: str, why: str) -> Refused:
        """What is not even sent."""
        return Refused(self._controller.device, code, why)

    def check(self, motion: Motion, start: Position | None) -> None:
        """Raises Refused for what our own model of the arm does not allow; `start` None: not known yet."""
        percents = (("speed", motion.speed_pct), ("acceleration", motion.ramps.accel_pct))
        for name, percent in (*percents, ("deceleration", motion.ramps.decel_pct)):
            if not 1 <= percent <= 100:
                raise self.refused("speed", f"{name} {percent} % is outside 1 .. 100 %")
        objection = self._limits.objection(motion.to, hand=motion.hand)
        if not objection and start is not None and motion.straight:
            objection = self._limits.objection_to_line(start, motion.to, hand=motion.hand)
        if not objection and start is not None and motion.arch is not None:
            objection = self._limits.objection_to_arch(start, motion.to, motion.arch, hand=motion.hand)
        if objection:
            raise self.refused("limits", objection)

    async def run(self, motions: Sequence[Motion]) -> Point:
        """Do these, one after the other, and return the position read back at the end of the last.

        Raises Refused, NoAnswer, Disturbed, LinkLost, Garbled. When cancelled the arm stands.
        """
        for motion in motions:
            self.check(motion, None)
        start = await self.be_ready()
        said = []
        for motion in motions:
            self.check(motion, start)
            said.append(self._say(motion))
            start = Position(motion.to, motion.hand)
        return await self._carried_out(self._go(motions, said))

    async def be_ready(self) -> Position:
        """Where the arm stands, ready to move; raises Refused, and Disturbed when it is not where it was left."""
        controller = self._controller
        status = await controller.recent_status()
        if not status.ready:
            raise controller.talk.refusal(parse_failure(status.alarm), status.why_not_ready)
        await self._prepare()
        left = controller.position
        if left is not None and controller.position_is_fresh:
            return left
        now = await controller.where()
        if left is not None and not self.unfinished and not _near(now, left, MOVED_MM, MOVED_DEG):
            raise Disturbed(
                controller.device,
                f"the arm was left at {left.point}, {SIDES[left.hand]}, and stands at {now.point}, {SIDES[now.hand]}: "
                "somebody else has moved it",
            )
        return now

    async def stand(self) -> Position:
        """Wait until two readings of the position agree; raises NoAnswer, LinkLost, Garbled."""
        deadline_s = _now_s() + STAND_S
        before = await self._controller.where()
        while True:
            await asyncio.sleep(LOOK_AGAIN_S)
            now = await self._controller.where()
            if now == before:
                return now
            if _now_s() > deadline_s:
                raise NoAnswer(self._controller.device, f"the arm does not come to rest, it is at {now.point}")
            before = now

    async def by_hand(self, lines: Lines, within_s: float, meanwhile: Meanwhile) -> Point:
        """A jog or an inch; the arm stands where it says afterwards."""

        async def go() -> Point:
            talk = self._controller.talk
            for setting in lines.settings:
                await talk.set(setting)
            try:
                await _beside(talk.operate(lines.operation, within_s=within_s), meanwhile)
            except Refused as refused:
                if not self._is_stop(refused):  # some firmware reports a jog that was stopped as a failure
                    raise
            return (await self.stand()).point

        return await self._carried_out(go())

    def _is_stop(self, refused: Refused) -> bool:
        code = parse_failure(refused.code)
        return code is not None and self._controller.dialect.is_event(code)

    # -- on the way --------------------------------------------------------------------------------------

    async def _carried_out(self, going: Awaitable[Point]) -> Point:
        self.unfinished = True
        try:
            there = await going
        except asyncio.CancelledError:
            self._controller.doubt()
            await uncancelled(self._stand_or_hang_up())
            raise
        except DeviceError:
            self._controller.doubt()  # whatever it was, ask again before the next motion
            raise
        self.unfinished = False
        return there

    def _say(self, motion: Motion) -> Lines:
        try:
            return self._controller.dialect.move(motion)
        except ValueError as error:
            raise self.refused("limits", str(error)) from error

    async def _go(self, motions: Sequence[Motion], said: Sequence[Lines]) -> Point:
        talk = self._controller.talk
        for setting in said[0].settings:
            await talk.set(setting)
        before = self._controller.position
        for motion, lines in zip(motions, said, strict=True):
            within_s = self._longest_s(before, motion)
            await _beside(talk.operate(lines.operation, within_s=within_s), self._watch)
            before = Position(motion.to, motion.hand)
        return await self._arrived(said[-1].operation, motions[-1])

    async def _watch(self, moving: "asyncio.Future[None]") -> None:
        """Look at the controller now and then while it moves: a silent link and a lost mode are not found by END."""
        answers = self._controller.dialect.grammar.answers_in_motion
        while not moving.done():
            await asyncio.wait((moving,), timeout=WATCH_EVERY_S if answers else None)
            if not moving.done():
                await self._look(moving)

    async def _look(self, moving: "asyncio.Future[None]") -> None:
        try:
            status = await self._controller.glance(within_s=WATCH_ANSWER_S, ended=moving.done)
        except LinkLost:
            await asyncio.wait((moving,), timeout=STOP_S)  # it knows better why
            raise
        except Refused as refused:
            if self._controller.dialect.is_busy(refused.code):
                return
            raise
        if status is not None and not status.ready:
            raise self._controller.talk.refusal(parse_failure(status.alarm), status.why_not_ready)

    def _longest_s(self, start: Position | None, motion: Motion) -> float:
        """The time after which the move has failed: half as long again as predicted, and the controller's slack."""
        predicted_s = duration_s(start or Position(motion.to, motion.hand), motion, self._limits, self._dynamics)
        return predicted_s * DEADLINE_FACTOR + SLACK_S

    async def _arrived(self, line: str, motion: Motion) -> Point:
        wanted = Position(motion.to, motion.hand)
        deadline_s = _now_s() + SETTLE_S
        while True:
            position = await self._controller.where()
            if _near(position, wanted, TOLERANCE_MM, TOLERANCE_DEG):
                return position.point
            if _now_s() > deadline_s:
                detail = f"{line} ended, but the arm stands at {position.point}, hand {SIDES[position.hand]}"
                raise NoAnswer(self._controller.device, detail)
            await asyncio.sleep(LOOK_AGAIN_S)

    async def _stand_or_hang_up(self) -> None:
        try:
            await self.stand()
        except DeviceError:
            with contextlib.suppress(DeviceError):
                await self._controller.talk.close()


async def _beside(operation: Coroutine[None, None, None], meanwhile: Meanwhile) -> None:
    """An operation and what is done until it ends. When that fails, or this is cancelled, the operation is stopped."""
    moving = asyncio.create_task(operation)
    try:
        await meanwhile(moving)
    finally:
        if not moving.done():
            moving.cancel()  # which stops the arm
            await uncancelled(_ended(moving))
        elif not moving.cancelled():
            moving.result()  # its own failure comes first


async def _ended(moving: "asyncio.Future[None]") -> None:
    await asyncio.wait((moving,))
    if not moving.cancelled():
        moving.exception()


def _near(position: Position, wanted: Position, within_mm: float, within_deg: float) -> bool:
    """A side of the elbow that the controller does not say is taken as right."""
    there, there_wanted = position.point, wanted.point
    return (
        all(abs(a - b) <= within_mm for a, b in zip(there[:3], there_wanted[:3], strict=True))
        and abs(there.r_deg - there_wanted.r_deg) <= within_deg
        and position.hand in (wanted.hand, 0)
    )


def _now_s() -> float:
    return asyncio.get_running_loop().time()
