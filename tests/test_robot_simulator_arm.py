"""The simulated controller's arm where it does not simply go and stand: it sinks, and it is done before it stands."""

import asyncio

import pytest

from drivers.robot import Point
from tests.robot_bench import robot_on, wire_on

THERE = "@MOVE P,300.0 100.0 40.0 0.0 0.0 0.0"
THERE_EXACTLY = (300, 100, 40, 0)


async def stood(bench):
    async with asyncio.timeout(5):
        while not bench.stands():
            await asyncio.sleep(0.002)
    return bench.position()


# -- gravity -------------------------------------------------------------------------------------------------


async def test_the_third_axis_sinks_to_its_end_while_its_brake_is_released():
    async with wire_on(speed=50) as (bench, wire):
        assert await wire.ask("@SERVO FREE(3)", 2) == ["RUN", "END"]
        assert (await stood(bench)).z_mm == pytest.approx(150)
        assert (await wire.ask("@?WHRXY", 2))[0].split()[2] == "150.000"


async def test_a_servo_that_comes_on_again_catches_the_sinking_axis():
    async with wire_on(speed=5, free_z_mm_per_s=20.0) as (bench, wire):
        assert await wire.ask("@SERVO FREE", 2) == ["RUN", "END"]
        await asyncio.sleep(0.05)
        assert await wire.ask("@SERVO ON", 2) == ["RUN", "END"]
        caught = (await stood(bench)).z_mm
        assert 1 < caught < 149
        assert await wire.ask(THERE, 2) == ["RUN", "END"]
        assert bench.position() == pytest.approx(THERE_EXACTLY)


@pytest.mark.parametrize("off", ["@SERVO OFF", "@MOTOR OFF"])
async def test_a_brake_that_takes_its_time_lets_the_axis_sag_a_little(off):
    async with wire_on(speed=20, brake_sag_mm=0.3) as (bench, wire):
        assert await wire.ask(THERE, 2) == ["RUN", "END"]
        assert await wire.ask(off, 2) == ["RUN", "END"]
        assert await stood(bench) == pytest.approx((300, 100, 40.3, 0))


async def test_an_emergency_stop_on_the_way_stops_the_arm_and_then_lets_it_sag():
    async with wire_on(speed=2, brake_sag_mm=0.3) as (bench, wire):
        assert await wire.ask(f"{THERE},S=5") == ["RUN"]
        await asyncio.sleep(0.05)
        bench.safety(estop_pressed=True)
        assert await wire.lines(1) == ["NG=12.600"]
        stood_at = bench.controller.log.of("halted")[-1].at
        stands_at = await stood(bench)
        assert [b - a for a, b in zip(stood_at, stands_at, strict=True)] == pytest.approx([0, 0, 0.3, 0], abs=1e-6)


async def test_a_brake_that_holds_at_once_keeps_the_axis_where_it_is():
    async with wire_on(speed=50) as (bench, wire):
        assert await wire.ask(THERE, 2) == ["RUN", "END"]
        assert await wire.ask("@SERVO OFF", 2) == ["RUN", "END"]
        assert await stood(bench) == pytest.approx(THERE_EXACTLY)


# -- done before it stands -----------------------------------------------------------------------------------


async def early_s(bench, wire, setting):
    """By how much a motion's END came before its arrival, in world seconds."""
    assert await wire.ask(setting) == ["OK"]
    assert await wire.ask(f"{THERE},S=10", 2) == ["RUN", "END"]
    return bench.controller.log.of("moves")[-1].ends_s - bench.controller.log.of("said")[-1].at_s


async def test_end_comes_when_every_axis_is_within_its_setting():
    async with wire_on(ends_at="outpos") as (bench, wire):
        far = await early_s(bench, wire, "@OUTPOS 40000")
        await wire.ask("@MOVE P,250.0 0.0 0.0 0.0 0.0 0.0", 2)
        near = await early_s(bench, wire, "@OUTPOS 10000")
        assert far > near > 0
    async with wire_on(ends_at="tolerance") as (bench, wire):
        assert await early_s(bench, wire, "@TOLE 10000") > 0
    async with wire_on() as (bench, wire):
        assert await early_s(bench, wire, "@OUTPOS 20000") <= 0


async def test_an_rcx240_takes_its_outpos_for_it():
    async with wire_on(dialect="rcx2", ends_at="outpos") as (bench, wire):
        assert await wire.ask("@OUTPOS 20000") == ["OK"]
        assert await wire.ask(f"{THERE},S=50") == ["OK"]
        assert bench.controller.log.of("moves")[-1].ends_s > bench.controller.log.of("said")[-1].at_s


async def test_what_comes_after_an_early_end_begins_when_the_arm_stands():
    async with wire_on(ends_at="outpos") as (bench, wire):
        assert await wire.ask("@OUTPOS 100000") == ["OK"]
        assert await wire.ask(f"{THERE},S=20", 2) == ["RUN", "END"]
        assert not bench.stands()
        assert await wire.ask("@ASPEED 90") == ["OK"]
        assert await wire.ask("@MOVE P,250.0 0.0 0.0 0.0 0.0 0.0", 2) == ["RUN", "END"]
        first, second = bench.controller.log.of("moves")
        assert second.begins == pytest.approx(THERE_EXACTLY)
        assert second.ends_s > first.ends_s
        assert await stood(bench) == pytest.approx((250, 0, 0, 0), abs=1e-6)


async def test_a_stop_before_the_next_motion_has_begun_leaves_it_undone():
    async with wire_on(ends_at="outpos") as (bench, wire):
        assert await wire.ask("@OUTPOS 1000000") == ["OK"]
        assert await wire.ask(f"{THERE},S=5", 2) == ["RUN", "END"]
        assert await wire.ask("@MOVE P,250.0 0.0 0.0 0.0 0.0 0.0") == ["RUN"]
        wire.send("\x03")
        assert await wire.lines(1) == ["NG=1.8"]
        assert (await stood(bench)).y_mm < 99


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
async def test_the_driver_takes_an_early_end_for_no_arrival(dialect):
    async with robot_on(speed=5, dialect=dialect, ends_at="outpos") as (bench, robot):
        for place in (Point(300.0, 100.0, 40.0, 0.0), Point(260.0, -50.0, 20.0, 30.0)):
            there = await robot.move(place, speed_pct=50)
            assert there == pytest.approx(place, abs=0.02)
            assert bench.position() == pytest.approx(place, abs=0.02)
