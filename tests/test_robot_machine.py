"""The driver against the simulated controller, in any order of verbs and accidents: what must hold, always holds."""

import asyncio
import contextlib

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule, run_state_machine_as_test

import drivers.conversation
import drivers.rcx2
import drivers.robot_motion
from drivers.errors import DeviceError
from drivers.reach import Limits
from drivers.robot import LEFTY, RIGHTY, Arch, Leg, Point
from tests import robot_log
from tests.robot_bench import robot_on

SPEED = 40
PLACES = st.builds(Point, st.floats(180, 300), st.floats(-150, 150), st.floats(0, 100), st.floats(-90, 90))
SPEEDS = st.integers(10, 100)
HANDS = st.sampled_from([RIGHTY, LEFTY])
SOON_S = st.floats(0, 0.02)
LINE_FAULTS = st.sampled_from(
    [
        ("late_run", {"by_s": 0.5}),
        ("late_end", {"by_s": 1.0}),
        ("lost_end", {}),
        ("ng_instead_of_end", {"code": "17.800"}),
        ("ng", {"code": "6.282"}),
        ("ng", {"code": "0.5", "count": 2}),
        ("garbage", {}),
        ("double", {}),
        ("cut", {}),
        *(("split_bytes", {"on": on}) for on in (True, False)),
        *(("coalesce", {"on": on}) for on in (True, False)),
        *(("interleave", {"on": on}) for on in (True, False)),
        *(("apart", {"on": on}) for on in (True, False)),
    ]
)


class DriverMachine(RuleBasedStateMachine):
    """One bench, one controller, one driver; DIALECT is set below."""

    dialect = "rcx3"

    def __init__(self):
        super().__init__()
        self.loop = asyncio.new_event_loop()
        self.stack = contextlib.AsyncExitStack()
        on = robot_on(speed=SPEED, dialect=self.dialect, latching_alarms=False)
        self.bench, self.robot = self.run(self.stack.enter_async_context(on))
        self.pressed = False

    def run(self, work):
        return self.loop.run_until_complete(work)

    def tried(self, work):
        """What it returned, or None when it failed in one of the ways that it may."""
        try:
            return self.run(work)
        except DeviceError:
            return None

    def teardown(self):
        self.run(self.stack.aclose())
        self.loop.close()
        robot_log.check(self.bench.controller.log, dialect=self.dialect)

    # -- what a cell does ---------------------------------------------------------------------------------

    @rule(to=PLACES, speed_pct=SPEEDS, hand=HANDS, straight=st.booleans())
    def move(self, to, speed_pct, hand, straight):
        there = self.tried(self.robot.move(to, speed_pct=speed_pct, hand=hand, straight=straight))
        if there is not None:
            assert there == pytest.approx(to, abs=0.02)
            assert self.bench.position() == pytest.approx(to, abs=0.02)
            assert Limits().objection(to, hand=hand) == ""
            assert self.bench.arm.joints_at(self.bench.clock.now()).hand == hand
            assert not self.robot.unfinished

    @rule(to=PLACES, top_z_mm=st.floats(0, 60))
    def over_an_arch(self, to, top_z_mm):
        there = self.tried(self.robot.move(to, speed_pct=100, arch=Arch(top_z_mm)))
        assert there is None or self.bench.position() == pytest.approx(to, abs=0.02)

    @rule(places=st.lists(PLACES, min_size=1, max_size=4))
    def along(self, places):
        there = self.tried(self.robot.move_through([Leg(place, 80) for place in places]))
        assert there is None or self.bench.position() == pytest.approx(places[-1], abs=0.02)

    @rule(to=PLACES, after_s=SOON_S)
    def cancel(self, to, after_s):
        async def begin_and_cancel():
            move = asyncio.create_task(self.robot.move(to, speed_pct=20))
            await asyncio.sleep(after_s)
            move.cancel()
            await asyncio.wait((move,))
            with contextlib.suppress(asyncio.CancelledError, DeviceError):
                move.result()

        self.run(begin_and_cancel())

    @rule(to=PLACES, after_s=SOON_S)
    def halt(self, to, after_s):
        async def begin_and_halt():
            move = asyncio.create_task(self.robot.move(to, speed_pct=20))
            await asyncio.sleep(after_s)
            with contextlib.suppress(DeviceError):
                await self.robot.halt()
            with contextlib.suppress(DeviceError):
                await move

        self.run(begin_and_halt())

    @rule()
    def ask(self):
        here = self.tried(self.robot.here())
        assert here is None or here == pytest.approx(self.bench.position(), abs=0.02)

    @rule()
    def recover(self):
        async def as_a_person_would():
            if not self.robot.is_open:
                await self.robot.open()
            await self.robot.reset_alarm()
            await self.robot.power_on()

        self.tried(as_a_person_would())

    # -- what happens to it -------------------------------------------------------------------------------

    @rule(fault=LINE_FAULTS)
    def spoil_the_line(self, fault):
        name, params = fault
        self.bench.inject("robot", name, **params)

    @rule(code=st.sampled_from(["17.800", "17.910", "12.520"]), at=st.none() | st.floats(0.1, 0.9))
    def alarm(self, code, at):
        self.bench.inject("robot", "alarm", code=code, at=at)
        self.run(asyncio.sleep(0.01))

    @rule()
    def lose_the_link(self):
        self.bench.inject("robot", "link_drop")
        self.run(asyncio.sleep(0.02))

    @rule()
    def switch_the_servo_off(self):
        self.bench.inject("robot", "servo_off")
        self.run(asyncio.sleep(0.02))

    @precondition(lambda self: not self.pressed)
    @rule()
    def press_the_emergency_stop(self):
        self.pressed = True
        self.bench.safety(estop_pressed=True)
        self.run(asyncio.sleep(0.01))

    @precondition(lambda self: self.pressed)
    @rule()
    def release_the_emergency_stop(self):
        self.pressed = False
        self.bench.safety(estop_pressed=False)

    # -- what always holds --------------------------------------------------------------------------------

    @invariant()
    def the_arm_stands_when_nobody_waits_for_it(self):
        async def stands():
            async with asyncio.timeout(2):  # an arm needs its way to brake
                while not self.bench.stands():
                    await asyncio.sleep(0.001)

        self.run(stands())


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
def test_in_any_order_of_verbs_and_accidents_what_must_hold_holds(dialect, monkeypatch):
    for name, patience_s in (("ANSWER_S", 0.15), ("STOP_S", 0.3), ("SILENCE_S", 0.02)):
        monkeypatch.setattr(drivers.conversation, name, patience_s)
    for name, patience_s in (("SLACK_S", 0.1), ("SETTLE_S", 0.05), ("STAND_S", 0.3), ("WATCH_EVERY_S", 0.01)):
        monkeypatch.setattr(drivers.robot_motion, name, patience_s)
    monkeypatch.setattr(drivers.rcx2.Rcx2, "greeting_s", 0.02)
    monkeypatch.setattr(DriverMachine, "dialect", dialect)
    run_state_machine_as_test(
        DriverMachine,
        settings=settings(
            max_examples=12,
            stateful_step_count=15,
            deadline=None,
            derandomize=True,
            database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )
