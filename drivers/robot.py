"""The SCARA: verbs over its RCX controller, of either generation.

A verb says what shall be, so it may be repeated. Success of a move is its END *and* the position read back *and* the
elbow on the right side. A motion is never repeated here. After LinkLost, NoAnswer or Garbled the link is down and
`open` begins afresh: it stops whatever an earlier conversation left running and reads everything anew.
"""

import asyncio
import contextlib
from collections.abc import Sequence
from typing import NamedTuple

from drivers import rcx
from drivers.controller import Controller
from drivers.errors import LinkLost, Refused
from drivers.motion import YK400XG, Dynamics
from drivers.rcx import LEFTY, RIGHTY, Arch, Mode, Motion, Point, Position, Ramps, RobotStatus, parse_failure
from drivers.rcx2 import Rcx2
from drivers.rcx3 import Rcx3
from drivers.rcx_dialect import Dialect
from drivers.reach import Limits
from drivers.robot_files import Files, Points, Programs
from drivers.robot_jog import Pendant
from drivers.robot_motion import HEAVY_KG, Motions
from drivers.robot_ports import Ports
from drivers.robot_setup import Setup

__all__ = ["LEFTY", "RIGHTY", "Arch", "Identity", "Leg", "Limits", "Mode", "Point", "Ramps", "Robot", "RobotStatus"]

DIALECTS: dict[str, Dialect] = {"rcx3": Rcx3(), "rcx2": Rcx2()}
FULL = Ramps()
ALARM_RESET_S = 10.0
LONGEST_TEXT = 200
OPEN_PAUSES_S = (0.05, 0.1, 0.2, 0.4, 0.0)  # the controller may not have noticed that its last client left


class Leg(NamedTuple):
    """One stretch of a way."""

    to: Point
    speed_pct: int
    straight: bool = False


class Identity(NamedTuple):
    """What the controller tells of itself; "" for what it does not. The protocol knows no serial number."""

    version: str
    configuration: str

    def __str__(self) -> str:
        return ", ".join(told for told in self if told) or "does not say"


class Robot:
    """One controller on `tcp://HOST:PORT` or `serial:/dev/...?baud=9600&parity=odd&flow=xonxoff`.

    `payload_kg` is what the controller is told that the arm carries; None leaves that to its parameters. What the arm
    can do, `dynamics`, gives each move its deadline.
    """

    def __init__(
        self,
        address: str,
        *,
        limits: Limits,
        dialect: str = "rcx3",
        device: str = "robot",
        hand: int = RIGHTY,
        payload_kg: float | None = None,
        dynamics: Dynamics = YK400XG,
    ) -> None:
        if dialect not in DIALECTS:
            raise ValueError(f"{dialect!r} is no generation of controllers: choose one of {', '.join(DIALECTS)}")
        self.limits = limits
        self.device = device
        self.dialect = DIALECTS[dialect]
        self._hand = hand
        self._controller = Controller(address, self.dialect, device=device)
        self._setup = Setup(self._controller, limits, payload_kg)
        loaded = dynamics.at_payload(HEAVY_KG if payload_kg is None else payload_kg)
        self._motions = Motions(self._controller, limits, loaded, self._setup.do)
        self.pendant = Pendant(self._controller, limits, self._motions)
        self.ports = Ports(self._controller)
        self.files = Files(self._controller)
        self.points = Points(self._controller)
        self.programs = Programs(self._controller)

    @property
    def unfinished(self) -> bool:
        """Whether a motion is under way, or the last one did not reach its target."""
        return self._motions.unfinished

    @property
    def is_open(self) -> bool:
        """Whether the link stands; a verb on one that does not raises LinkLost."""
        return self._controller.talk.is_open

    async def open(self) -> None:
        """Connect, stop what runs, wait until the arm stands, read status and position, set up the controller.

        Raises LinkLost, NoAnswer, Garbled, Refused, Mismatch. Moves nothing.
        """
        async with self._controller.turn:
            self._forget()
            try:
                await self._greet()
                await self._resynchronise()
                await self._setup.check_place(await self._motions.stand())
                if (await self._controller.status()).mode is Mode.AUTOMATIC:
                    await self._setup.do()
            except BaseException:
                await self._controller.talk.close()
                raise

    async def close(self) -> None:
        """Stop what moves and hang up. May be called at any time, also twice."""
        self._forget()
        await self._controller.talk.close()

    # -- asking ------------------------------------------------------------------------------------------

    async def status(self) -> RobotStatus:
        """Ask the controller how it is; the newer generation answers also while the arm moves."""
        return await self._controller.status()

    async def here(self) -> Point:
        """Where the arm is; the newer generation answers also while it moves."""
        return (await self._controller.where()).point

    async def posture(self) -> Position:
        """Where the arm is and on which side its elbow (`hand`); the newer generation answers also while it moves."""
        return await self._controller.where()

    async def identity(self) -> Identity:
        """What the controller tells of itself, for records: version and robot."""
        told = {}
        for what in ("VER", "CONFIG"):
            with contextlib.suppress(Refused):  # firmware that does not know the question
                lines = await self._controller.talk.ask(rcx.query(what))
                told[what] = ", ".join(_printable(line) for line in lines)
        return Identity(told.get("VER", ""), told.get("CONFIG", ""))

    # -- power -------------------------------------------------------------------------------------------

    async def power_on(self) -> None:
        """Motor power and servo on, everything set up. Raises Refused, NoAnswer, LinkLost, Garbled, Mismatch."""
        async with self._controller.turn:
            self._setup.done = False  # a person may have changed the speed meanwhile
            status = await self._controller.status()
            if not (status.motor_on and status.servo_on):
                await self._controller.power(on=True)
            if status.mode is Mode.AUTOMATIC:
                await self._setup.do()

    async def reset_alarm(self) -> None:
        """Clear an alarm whose cause is gone. Raises Refused with the alarm's code while it stands."""
        async with self._controller.turn:
            if not (await self._controller.status()).alarm:
                return
            await self._controller.operate(self.dialect.alarm_reset, within_s=ALARM_RESET_S)
            status = await self._controller.status()
            if status.alarm:
                raise self._controller.talk.refusal(
                    parse_failure(status.alarm), f"the alarm stands: {status.why_not_ready}"
                )

    # -- motion ------------------------------------------------------------------------------------------

    async def move(
        self,
        to: Point,
        *,
        speed_pct: int,
        straight: bool = False,
        hand: int | None = None,
        ramps: Ramps = FULL,
        arch: Arch | None = None,
    ) -> Point:
        """Move point to point (on a line, over an arch) and return the position read back, within 0.02 mm and 0.02 deg.

        The elbow goes to the side of `hand` (RIGHTY, LEFTY), which only a motion point to point can change.
        A target outside `limits` or a robot that is not ready raises Refused before anything is sent; else Refused
        (the controller's code), NoAnswer (deadline, or not at the target), Disturbed, LinkLost, Garbled. When
        cancelled it stops the arm, waits until it stands, and lets the cancellation go on.
        """
        async with self._controller.turn:
            return await self._motions.run([Motion(to, hand or self._hand, speed_pct, straight, ramps, arch)])

    async def move_through(self, legs: Sequence[Leg], *, hand: int | None = None) -> Point:
        """Move along these without a stop between them; only the end is exact, and only it is read back.

        Each leg but the last may be left before its end is quite reached. Raises as `move`, and ValueError for no legs.
        """
        if not legs:
            raise ValueError("a way has at least one leg")
        motions = [Motion(leg.to, hand or self._hand, leg.speed_pct, leg.straight, blends=True) for leg in legs[:-1]]
        end = legs[-1]
        async with self._controller.turn:
            return await self._motions.run([*motions, Motion(end.to, hand or self._hand, end.speed_pct, end.straight)])

    async def halt(self) -> None:
        """Stop the arm at once, out of turn. The move under way raises Refused. Raises LinkLost."""
        self._controller.talk.stop()

    # -- details -----------------------------------------------------------------------------------------

    async def _greet(self) -> None:
        talk = self._controller.talk
        for pause_s in OPEN_PAUSES_S:
            await talk.open()
            await talk.quiet()
            if talk.is_open:
                return
            await asyncio.sleep(pause_s)
        raise LinkLost(self.device, "it hangs up at once: does another client hold the connection?")

    async def _resynchronise(self) -> None:
        """Stop what runs, then ask until question and answer belong together."""
        talk, first = self._controller.talk, self.dialect.first_query
        talk.stop()
        await talk.quiet()
        for setting in () if talk.is_serial else self.dialect.before_talk:
            with contextlib.suppress(Refused):
                await self._controller.set(setting)
        with contextlib.suppress(Refused):  # a first command may earn "communication disconnected", once
            await talk.learn(rcx.query(first))
        await self._controller.value(first, str)

    def _forget(self) -> None:
        self._controller.forget()
        self._setup.done = False


def _printable(line: str) -> str:
    """A line of text as it may go into a record."""
    letters = line.strip()[:LONGEST_TEXT]
    return "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in letters)
