"""The driver against the simulated controller, and against peers that say odd things."""

import asyncio
import statistics
import time
from contextlib import asynccontextmanager

import pytest

import drivers.conversation
import drivers.rcx3
import drivers.robot_motion
from cellctl.assembly.hand import lift_free
from drivers.errors import Collision, DeviceError, Garbled, LinkLost, Mismatch, NoAnswer, Refused
from drivers.robot import LEFTY, RIGHTY, Limits, Mode, Point, Robot
from tests.robot_bench import SerialWire, Wire, address_of, controller_on, robot_on

NEAR = Point(260.0, 20.0, 10.0, 5.0)
FAR = Point(250.0, 200.0, 50.0, 90.0)
SPEED = 4  # for tests that catch the arm in motion
SLOW_PCT = 3  # some 4 s of world time
FRONTS = pytest.mark.parametrize("front", ["tcp", "serial"])


@pytest.fixture
def short_patience(monkeypatch):
    """Deadlines cut short, for tests that wait for them to pass."""
    for name, patience_s in (("SLACK_S", 0.1), ("STAND_S", 0.3), ("SETTLE_S", 0.05)):
        monkeypatch.setattr(drivers.robot_motion, name, patience_s)
    for name in ("ANSWER_S", "STOP_S"):
        monkeypatch.setattr(drivers.conversation, name, 0.3)
    monkeypatch.setattr(drivers.rcx3.Rcx3, "greeting_s", 0.1)


async def begun(bench, task):
    """Until the arm is well under way."""
    async with asyncio.timeout(2):
        while bench.stands():
            assert not task.done(), task.result()
            await asyncio.sleep(0.002)
    await asyncio.sleep(0.05)


# -- verbs ---------------------------------------------------------------------------------------------------


@FRONTS
async def test_a_move_ends_with_the_arm_at_its_target(front):
    async with robot_on(front, speed=20) as (bench, robot):
        assert await robot.move(FAR, speed_pct=100) == pytest.approx(FAR, abs=0.0005)
        assert bench.stands()
        assert bench.position() == pytest.approx(FAR, abs=0.001)
        assert await robot.move(NEAR, speed_pct=50, straight=True) == pytest.approx(NEAR, abs=0.0005)
        assert bench.position() == pytest.approx(NEAR, abs=0.001)
        assert await robot.here() == pytest.approx(NEAR, abs=0.0005)


async def test_the_elbow_changes_sides_only_when_it_is_told_to():
    async with robot_on(speed=20) as (_, robot):
        assert (await robot.posture()).hand == RIGHTY
        assert await robot.move(NEAR, speed_pct=100, hand=LEFTY) == pytest.approx(NEAR, abs=0.0005)
        assert (await robot.posture()).hand == LEFTY
        higher = NEAR._replace(z_mm=NEAR.z_mm - 5)
        await lift_free(robot, higher.z_mm)  # straight up as the arm stands, without a swing of the elbow
        assert await robot.posture() == (pytest.approx(higher, abs=0.0005), LEFTY)
        await robot.move(higher, speed_pct=100)
        assert (await robot.posture()).hand == RIGHTY


async def test_power_on_is_idempotent_and_the_status_tells_it():
    async with robot_on(speed=20, on=False) as (bench, robot):
        assert not (await robot.status()).motor_on
        await robot.power_on()
        await robot.power_on()
        assert (await robot.status()).ready
        assert bench.arm.powered


async def test_a_robot_without_power_is_refused_before_anything_is_sent():
    async with robot_on(speed=20, on=False) as (bench, robot):
        with pytest.raises(Refused, match="motor power is off") as refused:
            await robot.move(NEAR, speed_pct=50)
        assert refused.value.code == "not ready"
        assert bench.position().x_mm == pytest.approx(250)


@pytest.mark.parametrize(
    ("target", "straight", "complaint"),
    [
        (Point(390, 150, 0, 0), False, r"reach 417\.852 mm is outside"),
        (Point(300, 0, 160, 0), False, r"z 160\.000 mm"),
        (Point(60, -190, 0, 0), True, "mm from the column"),
    ],
)
async def test_a_target_out_of_bounds_is_refused_before_anything_is_sent(target, straight, complaint):
    async with robot_on(speed=20) as (bench, robot):
        await robot.move(Point(0, 200, 0, 0), speed_pct=100)
        with pytest.raises(Refused, match=complaint) as refused:
            await robot.move(target, speed_pct=50, straight=straight)
        assert refused.value.code == "limits"
        assert bench.position() == pytest.approx((0, 200, 0, 0), abs=0.001)


@pytest.mark.parametrize("speed_pct", [0, 101, -5])
async def test_a_speed_out_of_bounds_is_refused(speed_pct):
    async with robot_on(speed=20) as (_, robot):
        with pytest.raises(Refused, match=r"outside 1 \.\. 100 %"):
            await robot.move(NEAR, speed_pct=speed_pct)


@FRONTS
async def test_the_robot_answers_while_it_moves(front):
    async with robot_on(front, speed=SPEED) as (bench, robot):
        move = asyncio.create_task(robot.move(FAR, speed_pct=2 * SLOW_PCT))
        await begun(bench, move)
        seen = []
        while not move.done():
            seen.append(await robot.here())
            assert (await robot.status()).ready
        assert (await move) == pytest.approx(FAR, abs=0.0005)
    assert [point.y_mm for point in seen] == sorted(point.y_mm for point in seen)
    assert len({point.y_mm for point in seen}) > 1


async def test_two_moves_at_once_follow_one_another():
    async with robot_on(speed=20) as (bench, robot):
        await asyncio.gather(robot.move(FAR, speed_pct=50), robot.move(NEAR, speed_pct=50))
        assert bench.position() == pytest.approx(NEAR, abs=0.001)


async def test_a_command_costs_little_time_of_our_own():
    async with robot_on(speed=100) as (_, robot):
        took_s = []
        for _ in range(100):
            began = time.thread_time()
            await robot.here()
            took_s.append(time.thread_time() - began)
    assert statistics.median(took_s) < 0.003  # both sides of the wire; 0.3 ms on a quiet machine


# -- stopping ------------------------------------------------------------------------------------------------


@FRONTS
async def test_a_cancelled_move_leaves_the_arm_standing(front):
    async with robot_on(front, speed=SPEED) as (bench, robot):
        move = asyncio.create_task(robot.move(FAR, speed_pct=SLOW_PCT))
        await begun(bench, move)
        move.cancel()
        with pytest.raises(asyncio.CancelledError):
            await move
        assert bench.stands()
        stopped = bench.position()
        assert 0 < stopped.y_mm < 199
        assert await robot.here() == pytest.approx(stopped, abs=0.001)
        assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)


async def test_a_move_cancelled_again_and_again_still_leaves_the_arm_standing():
    async with robot_on(speed=SPEED) as (bench, robot):
        move = asyncio.create_task(robot.move(FAR, speed_pct=SLOW_PCT))
        await begun(bench, move)
        while not move.done():
            move.cancel()
            await asyncio.sleep(0.001)
        assert move.cancelled()
        assert bench.stands()
        assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)


@pytest.mark.parametrize("after_turns", [1, 2, 3, 5, 8, 13])
async def test_a_move_cancelled_before_it_began_does_not_begin_later(after_turns):
    async with robot_on(speed=SPEED) as (bench, robot):
        move = asyncio.create_task(robot.move(FAR, speed_pct=SLOW_PCT))
        for _ in range(after_turns):
            await asyncio.sleep(0)
        move.cancel()
        with pytest.raises(asyncio.CancelledError):
            await move
        stopped = bench.position()
        await asyncio.sleep(0.05)
        assert bench.stands()
        assert bench.position() == stopped
        assert robot.is_open


async def test_halt_stops_the_move_under_way():
    async with robot_on(speed=SPEED) as (bench, robot):
        move = asyncio.create_task(robot.move(FAR, speed_pct=SLOW_PCT))
        await begun(bench, move)
        await robot.halt()
        with pytest.raises(Refused, match="stop executed") as refused:
            await move
        assert refused.value.code == "1.8"
        assert bench.stands()


async def test_a_cancelled_question_takes_its_answer_with_it():
    async with robot_on(speed=SPEED) as (_, robot):
        for _ in range(10):
            question = asyncio.create_task(robot.here())
            await asyncio.sleep(0.001)
            question.cancel()
            await asyncio.wait((question,))
            assert (await robot.status()).ready


# -- safety --------------------------------------------------------------------------------------------------


@FRONTS
async def test_an_emergency_stop_in_motion_is_told_and_recovered_from(front):
    async with robot_on(front, speed=SPEED) as (bench, robot):
        move = asyncio.create_task(robot.move(FAR, speed_pct=SLOW_PCT))
        await begun(bench, move)
        bench.safety(estop_pressed=True)
        with pytest.raises(Refused, match="emergency stop") as refused:
            await move
        assert refused.value.code == "12.600"
        assert bench.stands()
        assert "emergency stop is pressed" in (await robot.status()).why_not_ready
        with pytest.raises(Refused, match=r"12\.600"):
            await robot.reset_alarm()
        with pytest.raises(Refused, match="emergency stop is pressed"):
            await robot.move(NEAR, speed_pct=50)

        bench.safety(estop_pressed=False)
        with pytest.raises(Refused, match="not allowed during an alarm"):
            await robot.power_on()
        await robot.reset_alarm()
        await robot.power_on()
        assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)


async def test_an_open_guard_refuses_motion():
    async with robot_on(speed=20) as (bench, robot):
        bench.safety(guard_open=True)
        with pytest.raises(Refused, match="interlock") as refused:
            await robot.move(NEAR, speed_pct=50)
        assert refused.value.code == "12.400"
        bench.safety(guard_open=False)
        await robot.move(NEAR, speed_pct=50)


async def test_an_alarm_in_motion_is_told_with_its_meaning():
    async with robot_on(speed=SPEED, latching_alarms=False) as (bench, robot):
        move = asyncio.create_task(robot.move(FAR, speed_pct=SLOW_PCT))
        await begun(bench, move)
        bench.inject("robot", "alarm", code="17.910")
        with pytest.raises(Collision, match="a collision perhaps") as refused:
            await move
        assert refused.value.code == "17.910"
        assert robot.unfinished
        assert (await robot.status()).alarm == "17.910"
        await robot.reset_alarm()
        assert (await robot.status()).alarm == ""


async def test_a_robot_in_emergency_stop_can_be_opened_and_asked():
    async with controller_on(speed=20) as (bench, controller):
        bench.safety(estop_pressed=True)
        robot = Robot(address_of(controller), limits=Limits())
        await robot.open()
        status = await robot.status()
        assert status.emergency_stop
        assert status.alarm == "12.600"
        await robot.close()


async def test_a_pendant_that_holds_control_is_named_and_later_the_robot_is_set_up():
    async with controller_on(speed=20) as (bench, controller):
        bench.inject("robot", "mode", value=1)
        robot = Robot(address_of(controller), limits=Limits())
        await robot.open()
        with pytest.raises(Refused, match="select automatic on the pendant"):
            await robot.move(NEAR, speed_pct=50)
        bench.inject("robot", "mode", value=2)
        await robot.power_on()
        assert await robot.move(NEAR, speed_pct=50) == pytest.approx(NEAR, abs=0.0005)
        await robot.close()


# -- a bad line ----------------------------------------------------------------------------------------------


@FRONTS
@pytest.mark.parametrize("fault", ["split_bytes", "coalesce", "padded_codes", "almrst_ok"])
async def test_odd_but_legal_replies_change_nothing(front, fault):
    async with robot_on(front, speed=20) as (bench, robot):
        bench.inject("robot", fault)
        for target in (NEAR, FAR):
            assert await robot.move(target, speed_pct=100) == pytest.approx(target, abs=0.0005)
        bench.inject("robot", "alarm", code="17.800")
        await robot.reset_alarm()
        await robot.power_on()
        assert await robot.move(NEAR, speed_pct=100, straight=True) == pytest.approx(NEAR, abs=0.0005)
        assert bench.position() == pytest.approx(NEAR, abs=0.001)


async def test_end_between_data_and_ok_is_end():
    async with robot_on(speed=SPEED) as (bench, robot):
        bench.inject("robot", "interleave")
        move = asyncio.create_task(robot.move(NEAR, speed_pct=SLOW_PCT))
        await begun(bench, move)
        while not move.done():
            point = await robot.here()
        assert (await move) == pytest.approx(NEAR, abs=0.0005)
        assert point == pytest.approx(NEAR, abs=0.0005)


async def test_a_late_run_is_waited_for():
    async with robot_on(speed=SPEED) as (bench, robot):
        bench.inject("robot", "late_run", by_s=0.4)
        assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)


@pytest.mark.usefixtures("short_patience")
async def test_a_run_that_does_not_come_stops_the_arm_and_the_motion_is_not_repeated():
    async with robot_on(speed=SPEED) as (bench, robot):
        bench.inject("robot", "late_run", by_s=60.0)
        with pytest.raises(NoAnswer, match="no RUN after @MOVE"):
            await robot.move(FAR, speed_pct=SLOW_PCT)
        assert bench.stands()
        assert bench.position().y_mm < 190
        assert not robot.is_open


@pytest.mark.usefixtures("short_patience")
async def test_a_lost_end_is_no_answer_and_the_next_open_finds_the_arm():
    async with robot_on(speed=20) as (bench, robot):
        bench.inject("robot", "lost_end")
        with pytest.raises(NoAnswer, match="no END after @MOVE"):
            await robot.move(NEAR, speed_pct=100)
        with pytest.raises(LinkLost):
            await robot.here()
        await robot.open()
        assert await robot.here() == pytest.approx(NEAR, abs=0.0005)
        assert await robot.move(FAR, speed_pct=100) == pytest.approx(FAR, abs=0.0005)


async def test_ng_instead_of_end_is_a_refusal():
    async with robot_on(speed=20) as (bench, robot):
        bench.inject("robot", "ng_instead_of_end", code="17.800")
        with pytest.raises(Refused, match="motor overload"):
            await robot.move(NEAR, speed_pct=100)
        assert await robot.move(FAR, speed_pct=100) == pytest.approx(FAR, abs=0.0005)


async def test_a_motion_is_unfinished_until_the_arm_is_at_its_target():
    async with robot_on(speed=SPEED) as (bench, robot):
        assert not robot.unfinished
        move = asyncio.create_task(robot.move(FAR, speed_pct=SLOW_PCT))
        await begun(bench, move)
        assert robot.unfinished
        await robot.halt()
        with pytest.raises(Refused):
            await move
        assert robot.unfinished
        await robot.move(NEAR, speed_pct=100)
        assert not robot.unfinished


@FRONTS
async def test_the_controller_tells_what_it_is_and_a_question_it_does_not_know_is_left_out(front):
    async with robot_on(front, speed=20) as (bench, robot):
        told = await robot.identity()
        assert "YK400XG" in told.configuration.upper()
        bench.inject("robot", "ng", code="5.252", count=2)
        assert str(await robot.identity()) == "does not say"
        assert await robot.here() == pytest.approx((250, 0, 0, 0))


@FRONTS
async def test_garbage_is_never_taken_for_a_value(front):
    async with robot_on(front, speed=20) as (bench, robot):
        bench.inject("robot", "garbage")
        with pytest.raises(Garbled, match="@\\?WHRXY was answered by"):
            await robot.here()
        assert not robot.is_open
        await robot.open()
        assert await robot.here() == pytest.approx((250, 0, 0, 0))


async def test_a_link_that_breaks_in_motion_is_lost_and_reopening_reads_everything():
    async with robot_on(speed=SPEED) as (bench, robot):
        move = asyncio.create_task(robot.move(FAR, speed_pct=SLOW_PCT))
        await begun(bench, move)
        bench.inject("robot", "link_drop")
        with pytest.raises(LinkLost):
            await move
        for verb in (robot.here, robot.status, robot.power_on, robot.halt):
            with pytest.raises(LinkLost):
                await verb()
        await robot.open()
        assert bench.stands()
        assert await robot.here() == pytest.approx(bench.position(), abs=0.001)
        assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)


@FRONTS
async def test_opening_stops_what_an_earlier_conversation_left_running(front):
    baud = 9600 if front == "serial" else None
    async with controller_on(SPEED, serial_baud=baud, on_disconnect="continue", servo_at_start=True) as (
        bench,
        controller,
    ):
        other = SerialWire(controller.tty) if baud else await Wire.to(controller)
        assert await other.ask("@MOVE P,250.0 200.0 50.0 90.0 0.0 0.0,S=3") == ["RUN"]
        await asyncio.sleep(0.05)
        other.close()
        assert not bench.stands()
        robot = Robot(address_of(controller, front), limits=Limits())
        await robot.open()
        assert bench.stands()
        assert 0 < bench.position().y_mm < 199
        await robot.close()


@pytest.mark.usefixtures("short_patience")
@FRONTS
async def test_a_mute_controller_is_no_answer_and_comes_back(front):
    async with robot_on(front, speed=20) as (bench, robot):
        bench.inject("robot", "mute")
        with pytest.raises(NoAnswer, match=r"no answer to @\?WHRXY within"):
            await robot.here()
        with pytest.raises(DeviceError):
            await robot.open()
        bench.inject("robot", "mute", on=False)
        await robot.open()
        assert (await robot.status()).ready


async def test_a_controller_that_talks_to_another_client_hangs_up():
    async with controller_on(speed=20) as (_, controller):
        first, second = (Robot(address_of(controller), limits=Limits()) for _ in range(2))
        await first.open()
        with pytest.raises(LinkLost, match="another client"):
            await second.open()
        assert (await first.status()).mode is Mode.AUTOMATIC
        await first.close()
        await second.open()
        await second.close()


def test_a_generation_that_there_is_not_is_refused():
    with pytest.raises(ValueError, match="'rcx4' is no generation of controllers: choose one of rcx3, rcx2"):
        Robot("tcp://127.0.0.1:1", limits=Limits(), dialect="rcx4")


async def test_nobody_there_is_a_lost_link():
    with pytest.raises(LinkLost, match="no connection"):
        await Robot("tcp://127.0.0.1:1", limits=Limits()).open()


async def test_no_task_is_left_behind():
    before = asyncio.all_tasks()
    async with robot_on(speed=20) as (bench, robot):
        move = asyncio.create_task(robot.move(FAR, speed_pct=SLOW_PCT))
        await begun(bench, move)
        move.cancel()
        await asyncio.wait((move,))
        await robot.close()
        await robot.close()
    await asyncio.sleep(0)
    assert asyncio.all_tasks() == before


# -- peers that say odd things -------------------------------------------------------------------------------

ANSWERS = {
    "@?MODE": "2\r\nOK\r\n",
    "@?EMG": "0\r\nOK\r\n",
    "@?ALM": "0.0\r\nOK\r\n",
    "@?MOTOR": "2\r\nOK\r\n",
    "@?SERVO": "1 1,1,1,1\r\nOK\r\n",
    "@?ORIGIN": "1 1,1,1,1\r\nOK\r\n",
    "@?WHRXY": "250.000 0.000 0.000 0.000 0.000 0.000 1 0 0\r\nOK\r\n",
    "@CHANGE OFF": "OK\r\n",
    "@?HAND": "OFF\r\nOK\r\n",
    "@?SHIFT": "NG=5.252\r\n",
    "@SHIFT OFF": "OK\r\n",
    "@ASPEED 100": "OK\r\n",
    "@?ASPEED": "100\r\nOK\r\n",
    "@MOVE": "RUN\r\nEND\r\n",
}


@asynccontextmanager
async def scripted(answers, greeting="Welcome to RCX340\r\n\r\n"):
    """A peer that answers by a table; yields its address, the table, and the lines that it heard."""
    heard = []

    async def serve(reader, writer):
        writer.write(greeting.encode())
        while line := await reader.readline():
            command = line.decode().replace("\x03", "").strip()
            heard.append(command)
            answer = answers.get(command, answers.get(command.split(" ")[0], ""))
            writer.write(answer.encode("latin-1"))
        writer.close()

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
        yield f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}", heard


@asynccontextmanager
async def robot_at(answers, **scene):
    table = ANSWERS | answers
    async with scripted(table, **scene) as (address, heard):
        robot = Robot(address, limits=Limits())
        await robot.open()
        try:
            yield robot, table, heard
        finally:
            await robot.close()
            await asyncio.sleep(0.005)


@pytest.mark.usefixtures("short_patience")
async def test_end_with_the_arm_elsewhere_is_no_success():
    async with robot_at({}) as (robot, _, heard):
        with pytest.raises(NoAnswer, match=r"ended, but the arm stands at x=250\.000"):
            await robot.move(NEAR, speed_pct=50)
        assert sum(line.startswith("@MOVE") for line in heard) == 1


@pytest.mark.usefixtures("short_patience")
async def test_end_with_the_elbow_on_the_other_side_is_no_success():
    position = "260.000 20.000 10.000 5.000 0.000 0.000 2 0 0\r\nOK\r\n"
    async with robot_at({"@?WHRXY": position}) as (robot, _, _):
        with pytest.raises(NoAnswer, match="hand lefty"):
            await robot.move(NEAR, speed_pct=50)


async def test_run_and_end_in_one_segment_with_a_six_field_position_of_another_make():
    async with robot_at({}) as (robot, table, _):
        table["@?WHRXY"] = "260.000 20.000 10.000 5.000 0.000 0.000 1\r\nOK\r\n"
        assert await robot.move(NEAR, speed_pct=50) == NEAR


@pytest.mark.parametrize("greeting", ["", "Welcome to RCX320\r\n\r\n", "\r\nWelcome to RCX340\r\n\r\n\r\n"])
async def test_any_greeting_or_none_is_let_pass(greeting):
    async with robot_at({}, greeting=greeting) as (robot, _, _):
        assert await robot.here() == (250, 0, 0, 0)


async def test_a_first_command_after_reconnecting_may_be_refused_once():
    async with scripted(ANSWERS | {"@?MODE": "NG=14.400\r\n"}) as (address, _):
        robot = Robot(address, limits=Limits())
        with pytest.raises(Refused, match="communication disconnected"):
            await robot.open()
        assert not robot.is_open


async def test_another_automatic_speed_than_the_one_set_is_a_mismatch():
    async with scripted(ANSWERS | {"@?ASPEED": "30\r\nOK\r\n"}) as (address, _):
        with pytest.raises(Mismatch, match="ASPEED 100 was accepted, but ASPEED is 30, not 100"):
            await Robot(address, limits=Limits()).open()


@pytest.mark.parametrize(
    "noise", ["", "250.000 0.000\r\n", "\xff\xfe\r\n", "1\r\n1\r\n", "nan nan nan nan nan nan\r\n"]
)
async def test_an_answer_that_is_no_position_is_garbled(noise):
    async with robot_at({}) as (robot, table, _):
        table["@?WHRXY"] = f"{noise}OK\r\n"
        with pytest.raises(Garbled):
            await robot.here()


async def test_a_failure_nobody_can_read_is_garbled():
    async with robot_at({}) as (robot, table, _):
        table["@?WHRXY"] = "NG=??\r\n"
        with pytest.raises(Garbled, match="NG="):
            await robot.here()


async def test_doubled_answers_give_no_wrong_value():
    """Every answer comes twice; the driver may give up, but never takes one question's answer for another's."""
    table = {command: answer * 2 for command, answer in ANSWERS.items() if command.startswith("@?")}
    wrong = given_up = 0
    async with robot_at({}) as (robot, answers, _):
        answers.update(table)
        for _ in range(60):
            try:
                for _ in range(5):
                    wrong += await robot.here() != (250, 0, 0, 0)
                    wrong += not (await robot.status()).ready
            except DeviceError:
                given_up += 1
                answers.update(ANSWERS)
                await robot.open()
                answers.update(table)
    assert wrong == 0
    assert given_up > 0


async def test_the_late_report_of_a_stop_is_no_answer_to_a_question():
    async with robot_at({"@?WHRXY": f"NG=1.8\r\nEND\r\n{ANSWERS['@?WHRXY']}"}) as (robot, _, _):
        assert await robot.here() == (250, 0, 0, 0)
