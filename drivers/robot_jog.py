"""What a person at a terminal does: jogs that run only while somebody holds on, single steps, origin, power off."""

import asyncio
from collections.abc import Callable
from functools import partial

from drivers.controller import Controller
from drivers.errors import NoAnswer
from drivers.rcx import AXES, Point, Position
from drivers.reach import SIDES, Limits
from drivers.robot_motion import TOLERANCE_DEG, TOLERANCE_MM, Motions

HOLD_EVERY_S = 0.05  # the controller itself stops a jog 0.2 s after it last heard that it is held
LONGEST_JOG_S = 60.0
INCH_S = 5.0
ORIGIN_S = 60.0
MARGIN = 5.0  # mm or degrees that are left to our own limits


class Pendant:
    """Jogs and steps are along the tool's axes 1, 2, 3 = x, y, z in mm, or about z, 4, in degrees, at manual speed."""

    def __init__(self, controller: Controller, limits: Limits, motions: Motions) -> None:
        self._controller = controller
        self._limits = limits
        self._motions = motions

    async def jog(self, axis: int, sign: int, *, held: Callable[[], bool]) -> Point:
        """Move while `held()` says so, at most a minute and never past our limits; returns where the arm stands.

        `held` is asked every 50 ms. Nothing that this process does, or no longer does, can keep the arm moving.
        Raises Refused, NoAnswer, Disturbed, LinkLost, Garbled, ValueError. When cancelled the arm stands.
        """
        _check_axis(axis)
        if sign not in (-1, 1):
            raise ValueError(f"a jog's sign is 1 or -1, not {sign}")
        async with self._controller.turn:
            start = await self._motions.be_ready()
            self._check(_beyond(start.point, axis, sign * MARGIN), start)
            lines = self._controller.dialect.jog(axis, sign)
            keep_on = partial(self._keep_on, axis=axis, sign=sign, held=held)
            return await self._motions.by_hand(lines, LONGEST_JOG_S, keep_on)

    async def inch(self, axis: int, by: float) -> Point:
        """One step of at most 10 mm or degrees, to a place inside our limits; returns where the arm stands.

        Raises Refused, NoAnswer, Disturbed, LinkLost, Garbled, ValueError. When cancelled the arm stands.
        """
        _check_axis(axis)
        lines = self._controller.dialect.inch(axis, by)
        async with self._controller.turn:
            start = await self._motions.be_ready()
            wanted = _beyond(start.point, axis, round(by, 3))
            self._check(wanted, start)
            there = await self._motions.by_hand(lines, INCH_S, _until_done)
            off = [abs(a - b) for a, b in zip(there, wanted, strict=True)]
            if max(off[:3]) > TOLERANCE_MM or off[3] > TOLERANCE_DEG:
                self._motions.unfinished = True
                raise NoAnswer(self._controller.device, f"{lines.operation} ended, but the arm stands at {there}")
            return there

    async def find_origin(self) -> None:
        """Origin return (absolute reset), only when the origin is incomplete. Axes may move, slowly.

        Raises Refused, NoAnswer, LinkLost, Garbled. When cancelled the arm stands.
        """
        controller = self._controller
        async with controller.turn:
            if (await controller.status()).origin_done:
                return
            controller.position = None
            command = controller.dialect.origin_return
            await controller.operate(command, within_s=ORIGIN_S)
            if not (await controller.status()).origin_done:
                raise NoAnswer(controller.device, f"{command} ended, but the origin is incomplete")

    async def power_off(self) -> None:
        """Servo and motor power off, brakes on. Raises Refused, NoAnswer, LinkLost, Garbled."""
        async with self._controller.turn:
            if (await self._controller.status()).motor_on:
                await self._controller.power(on=False)

    def _check(self, place: Point, start: Position) -> None:
        objection = self._limits.objection(place, hand=start.hand)
        if objection:
            raise self._motions.refused("limits", f"{objection} (elbow {SIDES[start.hand]})")

    async def _keep_on(self, moving: "asyncio.Future[None]", *, axis: int, sign: int, held: Callable[[], bool]) -> None:
        talk, stopped = self._controller.talk, False
        while not moving.done():
            stopped = stopped or not held() or await self._at_edge(axis, sign)
            (talk.stop if stopped else talk.hold)()
            await asyncio.wait((moving,), timeout=HOLD_EVERY_S)

    async def _at_edge(self, axis: int, sign: int) -> bool:
        """Whether our limits are near; a controller that answers nothing in motion has its own limits alone."""
        before = self._controller.position
        if before is None or not self._controller.dialect.grammar.answers_in_motion:
            return False
        now = await self._controller.where()
        stride = abs(now.point[axis - 1] - before.point[axis - 1])  # since it was last looked at
        return self._limits.objection(_beyond(now.point, axis, sign * (MARGIN + 2 * stride)), hand=now.hand) != ""


async def _until_done(moving: "asyncio.Future[None]") -> None:
    await asyncio.wait((moving,))


def _beyond(point: Point, axis: int, by: float) -> Point:
    return Point(*(value + (by if k == axis else 0.0) for k, value in enumerate(point, 1)))


def _check_axis(axis: int) -> None:
    if not 1 <= axis <= AXES:
        raise ValueError(f"axis {axis} is none: there are 1, 2, 3 (x, y, z) and 4 (r)")
