"""The SCARA: verbs over its RCX340 controller.

A verb says what shall be, so it may be repeated. Success of a move is its END *and* the position read back *and* the
elbow on the right side. A motion is never repeated here. After LinkLost, NoAnswer or Garbled the link is down and
`open` begins afresh: it stops whatever an earlier conversation left running and reads everything anew.
"""

import asyncio
import contextlib
import math
from collections.abc import Callable
from typing import TypeVar

from drivers import rcx
from drivers.conversation import Conversation, refusal, uncancelled
from drivers.errors import DeviceError, LinkLost, Mismatch, NoAnswer, Refused
from drivers.rcx import LEFTY, RIGHTY, Point, Position, RobotStatus
from drivers.reach import Limits

__all__ = ["LEFTY", "RIGHTY", "Limits", "Point", "Robot", "RobotStatus"]

T = TypeVar("T")

TOLERANCE_MM = TOLERANCE_DEG = 0.02
SETTLE_S = 0.5  # END may come while the arm still creeps inside the controller's tolerance
STAND_S = 5.0
LOOK_AGAIN_S = 0.005
POWER_S = 10.0
AUTOMATIC_SPEED_PCT = 100  # each move says its own share of it
# Deadlines: full speeds that even a heavily loaded arm keeps, time to start and stop, and the controller's slack.
SURE_MM_PER_S, SURE_LINE_MM_PER_S, SURE_Z_MM_PER_S, SURE_DEG_PER_S = 600.0, 300.0, 300.0, 200.0
RAMPS_S, SLACK_S = 1.0, 2.0
ELBOW_SWING_DEG = 360.0  # an elbow that changes sides: both arms, and the tool which turns back
LONGEST_TEXT = 200
OPEN_PAUSES_S = (0.05, 0.1, 0.2, 0.4, 0.0)  # the controller may not have noticed that its last client left


class Robot:
    """One controller on `tcp://HOST:PORT` or `serial:/dev/...?baud=9600&parity=odd&flow=xonxoff`."""

    def __init__(self, address: str, *, limits: Limits, device: str = "robot", hand: int = RIGHTY) -> None:
        self.limits = limits
        self.device = device
        self._hand = hand
        self._talk = Conversation(address, device=device)
        self._turn = asyncio.Lock()
        self._status: RobotStatus | None = None
        self._position: Position | None = None
        self._prepared = False
        self._unfinished = False

    @property
    def unfinished(self) -> bool:
        """Whether a motion is under way, or the last one did not reach its target."""
        return self._unfinished

    @property
    def is_open(self) -> bool:
        """Whether the link stands; a verb on one that does not raises LinkLost."""
        return self._talk.is_open

    async def open(self) -> None:
        """Connect, stop what runs, wait until the arm stands, read status and position, set up the controller.

        Raises LinkLost, NoAnswer, Garbled, Refused, Mismatch. Moves nothing.
        """
        async with self._turn:
            self._forget()
            try:
                await self._greet()
                await self._resynchronise()
                await self._stand()
                await self._read_status()
                await self._prepare()
            except BaseException:
                await self._talk.close()
                raise

    async def close(self) -> None:
        """Hang up. May be called at any time, also twice."""
        self._forget()
        await self._talk.close()

    async def status(self) -> RobotStatus:
        """Ask the controller how it is, also while the arm moves."""
        return await self._read_status()

    async def here(self) -> Point:
        """Where the arm is, also while it moves."""
        return (await self._read_position()).point

    async def posture(self) -> Position:
        """Where the arm is and on which side its elbow (`hand`), also while it moves."""
        return await self._read_position()

    async def identity(self) -> str:
        """What the controller tells of itself, for records: version and robot. The protocol knows no serial number."""
        told = []
        for what in ("VER", "CONFIG"):
            with contextlib.suppress(Refused):  # firmware that does not know the question
                told += [_printable(line) for line in await self._talk.ask(rcx.query(what))]
        return ", ".join(told) or "does not say"

    async def power_on(self) -> None:
        """Motor power and servo on. Raises Refused, NoAnswer, LinkLost, Garbled."""
        async with self._turn:
            status = await self._read_status()
            if status.motor_on and status.servo_on:
                return
            await self._operate("MOTOR ON", within_s=POWER_S)
            status = await self._read_status()
            if not (status.motor_on and status.servo_on):
                raise NoAnswer(self.device, f"MOTOR ON had no effect: {status.why_not_ready}")

    async def reset_alarm(self) -> None:
        """Clear an alarm whose cause is gone. Raises Refused with the alarm's code while it stands."""
        async with self._turn:
            if not (await self._read_status()).alarm:
                return
            await self._operate("ALMRST", within_s=POWER_S)
            status = await self._read_status()
            if status.alarm:
                raise refusal(self.device, status.alarm, f"the alarm stands: {status.why_not_ready}")

    async def move(self, to: Point, *, speed_pct: int, straight: bool = False, hand: int | None = None) -> Point:
        """Move point to point (or on a line) and return the position read back, within 0.02 mm and 0.02 deg.

        The elbow goes to the side of `hand` (RIGHTY, LEFTY), which only a motion point to point can change.
        A target outside `limits` or a robot that is not ready raises Refused before anything is sent; else Refused
        (the controller's code), NoAnswer (deadline, or not at the target), LinkLost, Garbled. When cancelled it
        stops the arm, waits until it stands, and lets the cancellation go on.
        """
        async with self._turn:
            hand = hand or self._hand
            self._check_target(to, speed_pct, straight, hand)
            await self._be_ready()
            line = rcx.move(to, hand=hand, speed_pct=speed_pct, straight=straight)
            self._unfinished = True
            try:
                await self._talk.operate(line, within_s=self._longest_s(to, speed_pct, straight, hand))
                there = await self._arrived(line, to, hand)
            except asyncio.CancelledError:
                self._status = None
                await uncancelled(self._stand_or_hang_up())
                raise
            except DeviceError:
                self._status = None  # whatever it was, ask again before the next motion
                raise
            self._unfinished = False
            return there

    async def halt(self) -> None:
        """Stop the arm at once, out of turn. The move under way raises Refused. Raises LinkLost."""
        self._talk.stop()

    # -- opening -----------------------------------------------------------------------------------------

    async def _greet(self) -> None:
        for pause_s in OPEN_PAUSES_S:
            await self._talk.open()
            await self._talk.quiet()
            if self._talk.is_open:
                return
            await asyncio.sleep(pause_s)
        raise LinkLost(self.device, "it hangs up at once: does another client hold the connection?")

    async def _resynchronise(self) -> None:
        """Stop what runs, then ask until question and answer belong together."""
        self._talk.stop()
        await self._talk.quiet()
        with contextlib.suppress(Refused):  # a first command may earn "communication disconnected", once
            await self._talk.ask(rcx.query("MODE"))
        await self._value("MODE", rcx.parse_integer)

    async def _prepare(self) -> None:
        """Robot coordinates of the bare flange, full automatic speed. Only possible with the control right."""
        if self._prepared or self._status is None or self._status.mode != rcx.AUTO_RELEASED:
            return
        for setting in ("CHANGE OFF", "SHIFT OFF", f"ASPEED {AUTOMATIC_SPEED_PCT}"):
            await self._set(setting)
        speed_pct = await self._value("ASPEED", rcx.parse_integer)
        if speed_pct != AUTOMATIC_SPEED_PCT:
            raise Mismatch(self.device, f"automatic speed is {speed_pct} %, not {AUTOMATIC_SPEED_PCT} %")
        self._prepared = True

    # -- moving ------------------------------------------------------------------------------------------

    def _check_target(self, to: Point, speed_pct: int, straight: bool, hand: int) -> None:
        if not 1 <= speed_pct <= 100:
            raise Refused(self.device, "speed", f"speed {speed_pct} % is outside 1 .. 100 %")
        objection = self.limits.objection(to, hand=hand)
        if not objection and straight and self._position is not None:
            objection = self.limits.objection_to_line(self._position.point, to)
        if objection:
            raise Refused(self.device, "limits", objection)

    async def _be_ready(self) -> None:
        if self._status is None or not self._status.ready:
            status = await self._read_status()
            if not status.ready:
                raise refusal(self.device, status.alarm or "not ready", status.why_not_ready)
        await self._prepare()
        if self._position is None:
            await self._read_position()

    def _longest_s(self, to: Point, speed_pct: int, straight: bool, hand: int) -> float:
        """The time after which the move has failed: distance over a speed that is surely reached, ramps, slack."""
        start = self._position.point if self._position is not None else to
        across_mm = math.dist(start[:2], to[:2])
        swing_deg = 0.0 if self._position is None or self._position.hand == hand else ELBOW_SWING_DEG
        full_s = max(
            across_mm / (SURE_LINE_MM_PER_S if straight else SURE_MM_PER_S),
            abs(to.z_mm - start.z_mm) / SURE_Z_MM_PER_S,
            # the tool's axis also turns back what the arms turn it by
            (abs(to.r_deg - start.r_deg) + across_mm + swing_deg) / SURE_DEG_PER_S,
        )
        return full_s * (100 / speed_pct) + RAMPS_S + SLACK_S

    async def _arrived(self, line: str, to: Point, hand: int) -> Point:
        deadline_s = asyncio.get_running_loop().time() + SETTLE_S
        while True:
            position = await self._read_position()
            if _at(position, to, hand):
                return position.point
            if asyncio.get_running_loop().time() > deadline_s:
                side = {RIGHTY: "righty", LEFTY: "lefty"}.get(position.hand, "unknown")
                raise NoAnswer(self.device, f"{line} ended, but the arm stands at {position.point}, hand {side}")
            await asyncio.sleep(LOOK_AGAIN_S)

    async def _stand_or_hang_up(self) -> None:
        try:
            await self._stand()
        except DeviceError:
            with contextlib.suppress(DeviceError):
                await self._talk.close()

    async def _stand(self) -> None:
        """Wait until two readings of the position agree."""
        deadline_s = asyncio.get_running_loop().time() + STAND_S
        before = await self._read_position()
        while True:
            await asyncio.sleep(LOOK_AGAIN_S)
            now = await self._read_position()
            if now == before:
                return
            if asyncio.get_running_loop().time() > deadline_s:
                raise NoAnswer(self.device, f"the arm does not come to rest, it is at {now.point}")
            before = now

    # -- asking ------------------------------------------------------------------------------------------

    async def _read_status(self) -> RobotStatus:
        answers = [await self._value(what, str) for what in rcx.STATUS_QUERIES]
        status = rcx.parse_status(tuple(answers))
        if status is None:
            raise self._talk.garbled("the status queries", answers)
        self._status = status
        return status

    async def _read_position(self) -> Position:
        self._position = await self._value("WHRXY", rcx.parse_position)
        return self._position

    async def _value(self, what: str, parse: Callable[[str], T | None]) -> T:
        line = rcx.query(what)
        answer = await self._talk.ask(line)
        value = parse(answer[0]) if len(answer) == 1 else None
        if value is None:
            raise self._talk.garbled(line, answer)
        return value

    async def _set(self, setting: str) -> None:
        line = rcx.command(setting)
        if answer := await self._talk.ask(line):
            raise self._talk.garbled(line, answer)

    async def _operate(self, text: str, *, within_s: float) -> None:
        self._status = None
        await self._talk.operate(rcx.command(text), within_s=within_s)

    def _forget(self) -> None:
        self._status = self._position = None
        self._prepared = False


def _printable(line: str) -> str:
    """A line of text as it may go into a record."""
    letters = line.strip()[:LONGEST_TEXT]
    return "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in letters)


def _at(position: Position, to: Point, hand: int) -> bool:
    there = position.point
    return (
        all(abs(a - b) <= TOLERANCE_MM for a, b in zip(there[:3], to[:3], strict=True))
        and abs(there.r_deg - to.r_deg) <= TOLERANCE_DEG
        and position.hand == hand
    )
