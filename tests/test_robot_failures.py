"""Failures of the robot and its line, each provoked: found within its bound, answered rightly, and seen in the log.

The numbers are those of the catalogue of failures: R1 lost link, R2 lost END, R3 refusals, R4 alarm in motion,
R5 emergency stop, R6 servo and mode, R7 reboot, R8 wrong place, R9 two masters, R10 noise, R11 settings, R12 collision.
"""

import asyncio
import time
from contextlib import asynccontextmanager

import pytest

import drivers.controller
import drivers.conversation
import drivers.rcx2
import drivers.robot_motion
from drivers.errors import Collision, DeviceError, Disturbed, Garbled, LinkLost, NoAnswer, Refused
from drivers.reach import Limits
from drivers.robot import LEFTY, Point, Robot
from tests import robot_log
from tests.robot_bench import Wire, address_of, controller_on, robot_on
from tests.robot_log import moves_heard

NEAR, FAR = Point(260.0, 20.0, 10.0, 5.0), Point(250.0, 200.0, 50.0, 90.0)
DIALECTS = pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
SLOW_PCT = 3  # some 4 s of world time
LOADED = 4  # the machine that tests run on may be this busy


@pytest.fixture(autouse=True)
def brisk(monkeypatch):
    monkeypatch.setattr(drivers.conversation, "SILENCE_S", 0.03)
    monkeypatch.setattr(drivers.rcx2.Rcx2, "greeting_s", 0.02)
    monkeypatch.setattr(drivers.controller, "FRESH_S", 5.0)  # so that injected refusals meet what they are meant for


@asynccontextmanager
async def robot_in(dialect, *, speed=4, **settings):
    """A robot whose log is checked at the end, whatever happened to it."""
    async with robot_on(speed=speed, dialect=dialect, **settings) as (bench, robot):
        yield bench, robot
    robot_log.check(bench.controller.log, dialect=dialect)


async def under_way(bench, robot, **wish):
    move = asyncio.create_task(robot.move(**{"to": FAR, "speed_pct": SLOW_PCT, **wish}))
    async with asyncio.timeout(3):
        while bench.stands():
            assert not move.done(), move.result()
            await asyncio.sleep(0.001)
    return move


async def recovered(bench, robot):
    """As a person would: open anew, reset, power on, and the arm goes where it is sent."""
    await robot.open()
    assert bench.stands()
    assert await robot.here() == pytest.approx(bench.position(), abs=0.01)
    await robot.reset_alarm()
    await robot.power_on()
    assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)


# -- R1: the link ---------------------------------------------------------------------------------------------


@DIALECTS
@pytest.mark.parametrize("on_disconnect", ["stop", "continue"])
async def test_r1_a_link_that_breaks_in_motion_is_lost_at_once_and_nothing_more_is_sent(dialect, on_disconnect):
    async with robot_in(dialect, on_disconnect=on_disconnect, lost_link_refusal=True) as (bench, robot):
        move = await under_way(bench, robot)
        bench.inject("robot", "link_drop")
        began = time.monotonic()
        with pytest.raises(LinkLost):
            await move
        assert time.monotonic() - began < 0.05 * LOADED
        assert robot.unfinished
        for verb in (robot.here, robot.power_on, robot.halt, lambda: robot.move(NEAR, speed_pct=50)):
            with pytest.raises(LinkLost):
                await verb()
        assert len(moves_heard(bench.controller.log)) == 1
        await recovered(bench, robot)


async def test_r1_a_link_that_falls_silent_in_motion_is_found_long_before_the_moves_deadline():
    async with robot_in("rcx3", speed=1) as (bench, robot):
        move = await under_way(bench, robot)
        await asyncio.sleep(0.05)
        bench.inject("robot", "stall", by_s=3.0)
        began = time.monotonic()
        with pytest.raises((LinkLost, NoAnswer)):
            await move
        assert time.monotonic() - began < 0.1 + 0.3 + 0.2 * LOADED
        assert not robot.is_open


async def test_r1_an_unplugged_adapter_is_a_lost_link_and_comes_back():
    async with robot_on("serial", speed=4) as (bench, robot):
        move = await under_way(bench, robot)
        bench.inject("robot", "unplug", for_s=0.4)
        with pytest.raises((LinkLost, NoAnswer)):
            await move
        with pytest.raises(DeviceError):
            await robot.here()


# -- R2: END --------------------------------------------------------------------------------------------------


@DIALECTS
async def test_r2_a_late_end_is_waited_for_and_a_lost_one_never_leads_to_a_second_motion(dialect, monkeypatch):
    monkeypatch.setattr(drivers.robot_motion, "SLACK_S", 0.3)
    async with robot_in(dialect, speed=20) as (bench, robot):
        bench.inject("robot", "late_end", by_s=2.0)
        assert await robot.move(FAR, speed_pct=100) == pytest.approx(FAR, abs=0.0005)
        bench.inject("robot", "lost_end")
        with pytest.raises(NoAnswer, match=r"no (END|OK) after @MOVE"):
            await robot.move(NEAR, speed_pct=100)
        assert len(moves_heard(bench.controller.log)) == 2
        await recovered(bench, robot)


# -- R3: refusals ---------------------------------------------------------------------------------------------


@DIALECTS
@pytest.mark.parametrize("code", ["5.201", "6.282", "2.334", "6.301", "14.211"])
async def test_r3_a_refusal_is_typed_moves_nothing_and_is_not_repeated(dialect, code):
    async with robot_in(dialect, speed=20) as (bench, robot):
        await robot.move(NEAR, speed_pct=100)
        await robot.posture()
        controller = bench.controller
        bench.inject("robot", "ng", code=code)
        with pytest.raises(Refused) as refused:
            await robot.move(FAR, speed_pct=50)
        wanted = controller.log.of("refused")[-1].code
        assert refused.value.code == (wanted.rcx3 if dialect == "rcx3" else wanted.rcx2)
        assert "see the controller's manual" not in str(refused.value) or dialect == "rcx2"
        assert bench.position() == pytest.approx(NEAR, abs=0.001)
        assert await robot.move(FAR, speed_pct=100) == pytest.approx(FAR, abs=0.0005)


@pytest.mark.parametrize("code", ["0.5", "0.8"])
async def test_r3_a_busy_controller_is_asked_again_three_times_and_no_more(code, monkeypatch):
    monkeypatch.setattr(drivers.robot_motion, "WATCH_EVERY_S", 5.0)  # its questions would be refused, too
    async with robot_in("rcx3", speed=20) as (bench, robot):
        await robot.here()
        bench.inject("robot", "ng", code=code, count=3)
        assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)
        assert len(moves_heard(bench.controller.log)) == 4
        bench.inject("robot", "ng", code=code, count=4)
        with pytest.raises(Refused):
            await robot.move(FAR, speed_pct=100)
        assert len(moves_heard(bench.controller.log)) == 8
        assert bench.position() == pytest.approx(NEAR, abs=0.001)


# -- R4, R12: alarms and collisions ---------------------------------------------------------------------------


@DIALECTS
async def test_r4_an_alarm_on_the_way_ends_the_move_and_keeps_the_outputs(dialect):
    async with robot_in(dialect, latching_alarms=False) as (bench, robot):
        await robot.ports.switch("DO", 2, 0, True)
        bench.inject("robot", "alarm", code="17.800", at=0.3)
        with pytest.raises(Collision, match="overload"):
            await robot.move(FAR, speed_pct=20)
        assert robot.unfinished
        assert bench.stands()
        assert 0 < bench.position().y_mm < 199
        assert "overload" in (await robot.status()).why_not_ready
        with pytest.raises(Refused):
            await robot.move(NEAR, speed_pct=50)
        assert len(moves_heard(bench.controller.log)) == 1
        assert await robot.ports.bit("DO", 2, 0) is True, "what hangs on the cup must not fall"
        await robot.reset_alarm()
        await robot.power_on()
        assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)


async def test_r4_an_alarm_that_only_a_restart_clears_says_so():
    async with robot_in("rcx3", speed=20) as (bench, robot):
        bench.inject("robot", "alarm", code="17.910")
        with pytest.raises(Collision, match=r"17\.910"):
            await robot.reset_alarm()


@DIALECTS
async def test_r12_what_blocks_z_is_a_collision_and_the_move_is_not_repeated(dialect):
    async with robot_in(dialect, speed=10, latching_alarms=False) as (bench, robot):
        await robot.move(NEAR, speed_pct=100)
        bench.inject("robot", "block_z", at_mm=30.0)
        with pytest.raises(Collision):
            await robot.move(NEAR._replace(z_mm=60), speed_pct=20)
        assert (await robot.here()).z_mm == pytest.approx(30, abs=1.0)
        assert len(moves_heard(bench.controller.log)) == 2
        bench.inject("robot", "block_z", at_mm=None)
        await recovered(bench, robot)


# -- R5: emergency stop ---------------------------------------------------------------------------------------


@DIALECTS
@pytest.mark.parametrize("pulse", [False, True])
async def test_r5_an_emergency_stop_is_told_within_50_ms_and_nothing_moves_until_it_is_reset(dialect, pulse):
    took_s = []
    for _ in range(3):
        async with robot_in(dialect, speed=1) as (bench, robot):
            move = await under_way(bench, robot)
            await asyncio.sleep(0.03)
            began = time.monotonic()
            bench.safety(estop_pressed=True)
            if pulse:
                await asyncio.sleep(0.02)
                bench.safety(estop_pressed=False)
            with pytest.raises(Refused, match="emergency stop"):
                await move
            took_s.append(time.monotonic() - began)
            with pytest.raises(Refused):
                await robot.move(NEAR, speed_pct=50)
            assert len(moves_heard(bench.controller.log)) == 1
            bench.safety(estop_pressed=False)
            await robot.reset_alarm()
            await robot.power_on()
    assert min(took_s) < 0.050


# -- R6: servo and mode ---------------------------------------------------------------------------------------


@DIALECTS
@pytest.mark.parametrize("fault", [("servo_off", {}), ("motor_off", {}), ("mode", {"value": 0}), ("arm_locked", {})])
async def test_r6_what_a_person_takes_away_stops_the_arm_and_is_named(dialect, fault):
    name, params = fault
    async with robot_in(dialect) as (bench, robot):
        if name == "arm_locked":
            bench.inject("robot", name)
            with pytest.raises(Refused, match="arm locked"):
                await robot.move(FAR, speed_pct=50)
            return
        move = await under_way(bench, robot)
        bench.inject("robot", name, **params)
        began = time.monotonic()
        with pytest.raises(Refused):
            await move
        assert time.monotonic() - began < 0.1 * LOADED
        assert bench.stands()
        with pytest.raises(Refused, match=r"servo|motor|mode"):
            await robot.move(NEAR, speed_pct=50)
        assert len(moves_heard(bench.controller.log)) == 1


# -- R7: reboot -----------------------------------------------------------------------------------------------


@DIALECTS
@pytest.mark.parametrize("origin", [True, False])
async def test_r7_after_a_reboot_nothing_moves_before_everything_was_asked_anew(dialect, origin):
    async with robot_in(dialect, speed=10) as (bench, robot):
        move = await under_way(bench, robot, speed_pct=2)
        bench.inject("robot", "reboot", for_s=0.5, origin=origin, points=False)
        with pytest.raises(DeviceError):
            await move
        await robot.open()
        status = await robot.status()
        assert status.origin_done is origin
        await robot.power_on()
        if not origin:
            with pytest.raises(Refused, match="origin is incomplete"):
                await robot.move(NEAR, speed_pct=50)
            await robot.pendant.find_origin()
        assert await robot.points.all() == {}
        assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)


# -- R8: wrong place ------------------------------------------------------------------------------------------


@DIALECTS
async def test_r8_an_elbow_on_the_wrong_side_is_no_success(dialect, monkeypatch):
    monkeypatch.setattr(drivers.robot_motion, "SETTLE_S", 0.05)
    async with robot_in(dialect, speed=20) as (bench, robot):
        bench.inject("robot", "hand_flip")
        with pytest.raises(NoAnswer, match="hand lefty"):
            await robot.move(NEAR, speed_pct=50)
        assert robot.unfinished
        bench.inject("robot", "hand_flip", on=False)
        assert (await robot.posture()).hand == LEFTY


# -- R9: two masters ------------------------------------------------------------------------------------------


@DIALECTS
async def test_r9_a_second_client_gets_nothing_and_disturbs_nothing(dialect):
    async with robot_in(dialect, speed=10) as (bench, robot):
        move = await under_way(bench, robot, speed_pct=2)
        other = await Wire.to(bench.controller, greeting=False)
        other.send("@MOVE P,300.0 0.0 0.0 0.0 0.0 0.0\r\n\x03")
        assert await other.reader.read() == b""
        other.close()
        rival = Robot(address_of(bench.controller), limits=Limits(), dialect=dialect)
        with pytest.raises(LinkLost, match="another client"):
            await rival.open()
        assert await move == pytest.approx(FAR, abs=0.0005)
        assert len(moves_heard(bench.controller.log)) == 1


async def test_r9_a_serial_port_belongs_to_one_program():
    async with robot_on("serial", speed=10) as (bench, robot):
        rival = Robot(address_of(bench.controller, "serial"), limits=Limits())
        with pytest.raises(LinkLost, match="is in use by another program"):
            await rival.open()
        assert (await robot.status()).ready


@DIALECTS
async def test_r9_a_pendant_that_takes_over_in_motion_stops_ours_for_good(dialect):
    async with robot_in(dialect) as (bench, robot):
        move = await under_way(bench, robot)
        bench.inject("robot", "second_master", axis=3, mm=8.0)
        with pytest.raises(Refused):
            await move
        with pytest.raises((Refused, Disturbed)):
            await robot.move(NEAR, speed_pct=50)
        assert len(moves_heard(bench.controller.log)) == 1


# -- R10: noise -----------------------------------------------------------------------------------------------


@DIALECTS
@pytest.mark.parametrize("fault", ["garbage", "cut", "double", "corrupt"])
async def test_r10_spoilt_replies_give_an_error_or_the_truth(dialect, fault, monkeypatch):
    monkeypatch.setattr(drivers.conversation, "ANSWER_S", 0.2)
    async with robot_in(dialect, speed=20) as (bench, robot):
        wrong = 0
        for k in range(5):
            bench.inject("robot", fault, count=1)
            try:
                for _ in range(k % 4):
                    here = await robot.here()
                    wrong += here != pytest.approx(bench.position(), abs=0.01)
            except (Garbled, NoAnswer, Refused, LinkLost):
                pass
            if not robot.is_open:
                with_patience(monkeypatch)
                await robot.open()
                monkeypatch.setattr(drivers.conversation, "ANSWER_S", 0.2)
        assert wrong == 0 or fault == "corrupt"  # one bit of one digit cannot be seen by any client
        assert wrong <= 3


def with_patience(monkeypatch):
    monkeypatch.setattr(drivers.conversation, "ANSWER_S", 1.0)


async def test_r10_an_echo_is_no_answer():
    async with robot_in("rcx2", speed=20) as (bench, robot):
        bench.inject("robot", "echo")
        assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)
        assert (await robot.status()).ready


async def test_r10_japanese_errors_are_read_by_their_codes():
    async with robot_in("rcx2", speed=20, language="japanese") as (bench, robot):
        bench.safety(estop_pressed=True)
        with pytest.raises(Refused, match="emergency stop"):
            await robot.move(NEAR, speed_pct=50)


# -- a client that dies ---------------------------------------------------------------------------------------


@DIALECTS
async def test_after_a_client_has_died_in_motion_the_next_one_knows_where_the_arm_is_before_it_moves(dialect):
    async with controller_on(4, dialect=dialect, on_disconnect="continue", servo_at_start=True) as (bench, controller):
        dead = await Wire.to(controller, greeting=dialect == "rcx3")
        dead.send("@DO2(0)=1\r\n@MOVE P,250.0 200.0 50.0 90.0 0.0 0.0,S=3\r\n")
        while bench.stands():
            await asyncio.sleep(0.002)
        dead.writer.transport.abort()
        robot = Robot(address_of(controller), limits=Limits(), dialect=dialect)
        await robot.open()
        assert bench.stands()
        assert await robot.here() == pytest.approx(bench.position(), abs=0.01)
        assert await robot.ports.bit("DO", 2, 0) is True
        await robot.move(NEAR, speed_pct=100)
        await robot.close()
        since = controller.log.of("joined")[-1].number
        heard = [entry.line for entry in controller.log.of("heard", since=since)]
        first = next(k for k, line in enumerate(heard) if line.startswith("@MOVE"))
        assert sum(line.startswith("@?WHRXY") for line in heard[:first]) >= 2
