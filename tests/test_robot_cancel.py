"""Cancelling a verb at any of its awaits leaves the arm standing and the driver usable."""

import asyncio
import contextlib

import pytest

import drivers.conversation
import drivers.rcx2
from drivers.errors import DeviceError
from drivers.rcx_points import StoredPoint
from drivers.robot import Leg, Point
from tests.robot_bench import robot_on

NEAR, FAR = Point(260.0, 20.0, 10.0, 5.0), Point(250.0, 200.0, 50.0, 90.0)
SPEED = 10
MOST_AWAITS = 400
POINT = StoredPoint((1.0, 2.0, 3.0, 4.0, 0.0, 0.0), in_pulses=False)

VERBS = {
    "move": lambda robot: robot.move(FAR, speed_pct=25),
    "line": lambda robot: robot.move(NEAR._replace(y_mm=80.0), speed_pct=25, straight=True),
    "way": lambda robot: robot.move_through([Leg(NEAR._replace(y_mm=y), 40) for y in (30.0, 60.0, 90.0)]),
    "jog": lambda robot: robot.pendant.jog(2, 1, held=lambda: True),
    "inch": lambda robot: robot.pendant.inch(2, 5.0),
    "power": lambda robot: robot.power_on(),
    "points": lambda robot: robot.points.write_all({1: POINT, 2: POINT}),
    "open": lambda robot: robot.open(),
}


@pytest.fixture(autouse=True)
def brisk(monkeypatch):
    monkeypatch.setattr(drivers.conversation, "SILENCE_S", 0.02)
    monkeypatch.setattr(drivers.rcx2.Rcx2, "greeting_s", 0.02)


class CancelledAt:
    """A coroutine that is cancelled at its n-th await, exactly there. `reached` tells whether it came so far."""

    def __init__(self, work, at):
        self.work, self.at, self.reached = work, at, False

    def __await__(self):
        steps, error, awaits = self.work.__await__(), None, 0
        while True:
            try:
                future = steps.throw(error) if error is not None else steps.send(None)
            except StopIteration as end:
                return end.value
            error = None
            if awaits == self.at:
                self.reached = asyncio.current_task().cancel()
            awaits += 1
            try:
                yield future
            except BaseException as raised:
                error = raised


async def stands_still(bench):
    before = bench.position()
    await asyncio.sleep(0.03)
    return bench.stands() and bench.position() == before


async def usable(robot):
    """As the cell would use it after an abort."""
    if not robot.is_open:
        await robot.open()
    await robot.here()
    await robot.power_on()
    assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
@pytest.mark.parametrize("verb", VERBS)
async def test_a_verb_cancelled_at_any_await_leaves_the_arm_standing(dialect, verb):
    async with robot_on(speed=SPEED, dialect=dialect) as (bench, robot):
        for at in awaits_tried(verb):
            await usable(robot)
            cancelled = CancelledAt(VERBS[verb](robot), at)
            with contextlib.suppress(asyncio.CancelledError, DeviceError):
                await asyncio.wait_for(asyncio.ensure_future(as_coroutine(cancelled)), 10)
            assert await stands_still(bench), f"cancelled at await {at}"
            if not cancelled.reached:
                assert at > 1
                break
        await usable(robot)


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
async def test_a_move_cancelled_after_any_number_of_turns_of_the_loop_leaves_the_arm_standing(dialect):
    async with robot_on(speed=SPEED, dialect=dialect) as (bench, robot):
        for turns in (*range(0, 24, 2), 30, 50, 80, 120):
            await usable(robot)
            move = asyncio.create_task(robot.move(FAR, speed_pct=25))
            for _ in range(turns):
                await asyncio.sleep(0)
            move.cancel()
            await asyncio.wait((move,))
            assert move.cancelled()
            assert await stands_still(bench), f"cancelled after {turns} turns"


def awaits_tried(verb):
    """All of them, but of those that look every few milliseconds, or are many, only some of the later ones."""
    return [*range(12), *range(12, MOST_AWAITS, 7)] if verb in ("jog", "open") else range(MOST_AWAITS)


async def as_coroutine(awaitable):
    return await awaitable
