"""Every verb of the driver on both generations of controllers, over their networks and their serial lines."""

import asyncio
import time

import pytest

import drivers.conversation
import drivers.rcx2
from drivers.errors import Disturbed, LinkLost, Mismatch, NoAnswer, Refused
from drivers.rcx import Mode, Pulses
from drivers.rcx_points import StoredPoint
from drivers.reach import Limits, PulseLimits
from drivers.robot import LEFTY, RIGHTY, Arch, Leg, Point, Ramps, Robot
from tests.robot_bench import address_of, controller_on, robot_on

NEAR = Point(260.0, 20.0, 10.0, 5.0)
FAR = Point(250.0, 200.0, 50.0, 90.0)
LINES = pytest.mark.parametrize(
    "line",
    [
        {"front": "tcp", "dialect": "rcx3"},
        {"front": "serial", "dialect": "rcx3"},
        {"front": "tcp", "dialect": "rcx2"},
        {"front": "tcp", "dialect": "rcx2", "telnet": True, "echo": True, "errors": "ng"},
        {"front": "serial", "dialect": "rcx2", "language": "japanese"},
    ],
    ids=["rcx3", "rcx3 serial", "rcx2", "rcx2 telnet", "rcx2 serial"],
)
DIALECTS = pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
PULSES = PulseLimits(
    (2912.711, 2912.711, 1638.4, 682.6667),
    Pulses(-407779, -419430, 0, -245760),
    Pulses(407779, 419430, 245760, 245760),
)


@pytest.fixture(autouse=True)
def brisk(monkeypatch):
    """Waits for what may still come are as short as a fast world's lines."""
    monkeypatch.setattr(drivers.conversation, "SILENCE_S", 0.03)
    monkeypatch.setattr(drivers.rcx2.Rcx2, "greeting_s", 0.02)


def said(bench, start):
    """What the controller heard that begins so."""
    return [entry.line for entry in bench.controller.log.of("heard") if entry.line.startswith(start)]


# -- motion --------------------------------------------------------------------------------------------------


@LINES
async def test_moves_end_at_their_targets_with_the_elbow_where_it_shall_be(line):
    async with robot_on(speed=20, **line) as (bench, robot):
        assert await robot.move(FAR, speed_pct=100) == pytest.approx(FAR, abs=0.0005)
        assert await robot.move(NEAR, speed_pct=60, straight=True, ramps=Ramps(80, 70)) == pytest.approx(
            NEAR, abs=0.0005
        )
        assert await robot.move(FAR, speed_pct=100, hand=LEFTY) == pytest.approx(FAR, abs=0.0005)
        assert bench.position() == pytest.approx(FAR, abs=0.001)
        assert (await robot.posture()).hand == LEFTY
        assert await robot.move(NEAR, speed_pct=100, hand=LEFTY, arch=Arch(0)) == pytest.approx(NEAR, abs=0.0005)
        await robot.move(NEAR, speed_pct=100)
        assert (await robot.posture()).hand == RIGHTY
    assert bench.controller.log.of("refused", "halted") == []


@DIALECTS
async def test_a_way_is_gone_without_stops_and_its_end_is_exact(dialect):
    legs = [Leg(Point(260, y, 0, 0), 100, straight=True) for y in (40, 80, 120)]
    async with robot_on(speed=5, dialect=dialect) as (bench, robot):
        await robot.move(Point(260, 0, 0, 0), speed_pct=100)
        assert await robot.move_through(legs) == pytest.approx(legs[-1].to, abs=0.0005)
        assert bench.position() == pytest.approx(legs[-1].to, abs=0.001)
    assert len(said(bench, "@MOVE")) == 4
    assert sum("CONT" in move for move in said(bench, "@MOVE")) == 2


@DIALECTS
async def test_an_arch_goes_over_what_lies_between(dialect):
    start, end = Point(300, -100, 60, 0), Point(300, 100, 60, 0)
    arch = Arch(20, 5, 5) if dialect == "rcx3" else Arch(20)
    async with robot_on(speed=2, dialect=dialect) as (bench, robot):
        await robot.move(start, speed_pct=100)
        move = asyncio.create_task(robot.move(end, speed_pct=30, arch=arch))
        seen = []
        while not move.done():
            await asyncio.sleep(0.002)
            seen.append(bench.position())
        await move
    across = [place for place in seen if abs(place.y_mm) < 90]
    assert len(across) > 10
    assert all(place.z_mm < 30 for place in across)


@DIALECTS
@pytest.mark.parametrize(
    ("wish", "complaint"),
    [
        ({"to": Point(390, 150, 0, 0)}, "reach"),
        ({"to": Point(250, 0, 0, 0), "straight": True}, "lefty to righty: move point to point"),
        ({"to": Point(250, 0, 30, 0), "arch": Arch(0)}, "an arch cannot change the elbow"),
        ({"to": Point(399.6, 0, 0, 0), "straight": True, "hand": LEFTY}, "reach"),
        ({"to": Point(0, -200, 0, 0), "straight": True, "hand": LEFTY}, "from the column"),
        ({"to": Point(250, 0, 30, 0), "arch": Arch(31), "hand": LEFTY}, "top at z 31.000"),
        ({"to": Point(250, 0, 30, 0), "ramps": Ramps(0, 100)}, "acceleration 0 %"),
        ({"to": Point(250, 0, 30, 0), "speed_pct": 101}, "speed 101 %"),
    ],
)
async def test_what_the_arm_cannot_do_is_refused_before_anything_is_sent(dialect, wish, complaint):
    async with robot_on(speed=50, dialect=dialect) as (bench, robot):
        await robot.move(Point(0, 250, 40, 0), speed_pct=100, hand=LEFTY)
        before = len(said(bench, "@"))
        with pytest.raises(Refused, match=complaint) as refused:
            await robot.move(**{"speed_pct": 50, **wish})
        assert refused.value.code in ("limits", "speed")
        assert said(bench, "@")[before:] == []
        assert bench.stands()


async def test_a_way_of_which_one_leg_is_out_of_bounds_is_not_begun():
    async with robot_on(speed=50) as (bench, robot):
        legs = [Leg(NEAR, 50), Leg(Point(500, 0, 0, 0), 50), Leg(FAR, 50)]
        with pytest.raises(Refused, match="reach 500"):
            await robot.move_through(legs)
        assert said(bench, "@MOVE") == []
        with pytest.raises(ValueError, match="at least one leg"):
            await robot.move_through([])


# -- by hand -------------------------------------------------------------------------------------------------


@LINES
async def test_a_jog_runs_while_it_is_held_and_a_step_is_exact(line):
    async with robot_on(speed=4, **line) as (bench, robot):
        began = time.monotonic()
        there = await robot.pendant.jog(2, 1, held=lambda: time.monotonic() < began + 0.2)
        assert bench.stands()
        assert there.y_mm > 1
        assert bench.position() == pytest.approx(there, abs=0.01)
        assert await robot.pendant.inch(3, 2.5) == pytest.approx(there._replace(z_mm=there.z_mm + 2.5), abs=0.02)
        assert await robot.pendant.inch(1, -0.25) == pytest.approx(bench.position(), abs=0.01)
        assert not robot.unfinished


@DIALECTS
async def test_a_jog_that_this_process_no_longer_holds_is_stopped_by_the_controller(dialect, monkeypatch):
    async with robot_on(speed=2, dialect=dialect) as (bench, robot):
        monkeypatch.setattr(drivers.conversation.Conversation, "hold", lambda self: None)
        there = await robot.pendant.jog(2, 1, held=lambda: True)
        assert bench.stands()
        assert 1 < there.y_mm < 120


async def test_a_jog_ends_inside_our_own_limits_and_cannot_begin_outside_them():
    async with robot_on(speed=1) as (bench, robot):
        there = await robot.pendant.jog(3, 1, held=lambda: True)
        assert 90 < there.z_mm < 145
        assert bench.stands()
        await robot.move(there._replace(z_mm=148), speed_pct=100)
        with pytest.raises(Refused, match="z 153"):
            await robot.pendant.jog(3, 1, held=lambda: True)
        with pytest.raises(Refused, match=r"z 150\.500"):
            await robot.pendant.inch(3, 2.5)
        assert bench.position().z_mm == pytest.approx(148, abs=0.001)


@pytest.mark.parametrize(("axis", "sign"), [(0, 1), (5, 1), (1, 0), (1, 2)])
async def test_an_axis_that_there_is_not_cannot_be_jogged(axis, sign):
    async with robot_on(speed=20) as (_, robot):
        with pytest.raises(ValueError, match=r"axis|sign"):
            await robot.pendant.jog(axis, sign, held=lambda: True)


# -- power and state -----------------------------------------------------------------------------------------


@LINES
async def test_power_goes_off_and_on_and_an_emergency_stop_is_recovered_from(line):
    async with robot_on(speed=20, **line) as (bench, robot):
        await robot.pendant.power_off()
        assert not bench.arm.powered
        assert not (await robot.status()).servo_on
        await robot.power_on()
        bench.safety(estop_pressed=True)
        status = await robot.status()
        assert status.emergency_stop
        assert "emergency stop" in status.why_not_ready
        with pytest.raises(Refused, match="emergency stop"):
            await robot.reset_alarm()
        bench.safety(estop_pressed=False)
        await robot.reset_alarm()
        await robot.power_on()
        assert (await robot.status()).ready
        assert await robot.move(NEAR, speed_pct=100) == pytest.approx(NEAR, abs=0.0005)


@DIALECTS
async def test_an_origin_that_is_lost_is_named_and_found_again(dialect):
    async with robot_on(speed=20, dialect=dialect) as (bench, robot):
        bench.inject("robot", "lose_origin")
        assert not (await robot.status()).origin_done
        with pytest.raises(Refused, match="origin is incomplete"):
            await robot.move(NEAR, speed_pct=50)
        await robot.pendant.find_origin()
        await robot.pendant.find_origin()
        assert len(said(bench, "@ORIGIN") + said(bench, "@ABSRST")) == 1
        assert await robot.move(NEAR, speed_pct=50) == pytest.approx(NEAR, abs=0.0005)


@DIALECTS
async def test_the_mode_that_a_person_chooses_is_told(dialect):
    async with robot_on(speed=20, dialect=dialect) as (bench, robot):
        bench.inject("robot", "mode", value="MANUAL" if dialect == "rcx2" else 0)
        assert (await robot.status()).mode is Mode.MANUAL
        with pytest.raises(Refused, match="the mode is manual: select automatic"):
            await robot.move(NEAR, speed_pct=50)


@DIALECTS
async def test_tool_work_frame_speed_and_payload_are_set_and_read_back(dialect):
    async with controller_on(50, dialect=dialect) as (bench, controller):
        machine = controller.machine
        machine.settings.put("ASPEED", 30)
        machine.frames.hand, machine.frames.shift = "H1", "S2"
        robot = Robot(address_of(controller), limits=Limits(), dialect=dialect, payload_kg=1.5)
        await robot.open()
        await robot.power_on()
        assert (machine.frames.hand, machine.frames.shift) == ("OFF", "OFF")
        assert machine.settings.number("ASPEED") == 100
        assert machine.settings.payload_kg() == (1.5 if dialect == "rcx3" else 2)
        bench.inject("robot", "speed", pct=40)
        await robot.power_on()  # as each Reset does
        assert machine.settings.number("ASPEED") == 100
        await robot.close()


@DIALECTS
async def test_a_tool_that_shifts_positions_is_found_by_the_axes_pulses(dialect):
    async with controller_on(50, dialect=dialect) as (_, controller):
        machine = controller.machine
        machine.tables.set_entry("H", 1, (0.0, 20.0, 0.0), tool_on_r=True)
        machine.frames.hand = "H1"
        robot = Robot(address_of(controller), limits=Limits(pulses=PULSES), dialect=dialect)
        with pytest.raises(Mismatch, match="its axes stand at x=250"):
            await robot.open()
        machine.frames.hand = "OFF"
        await robot.open()
        await robot.close()


# -- memory and ports ----------------------------------------------------------------------------------------


@LINES
async def test_points_are_written_and_read_one_by_one_and_all_together(line):
    points = {
        5: StoredPoint((250.5, -20.25, 30.0, 40.0, 0.0, 0.0), in_pulses=False),
        70: StoredPoint((1000, -2000, 3000, 4000, 0, 0), in_pulses=True),
        123: StoredPoint((1.0, 2.0, 3.0, 4.0, 0.0, 0.0), in_pulses=False, hand=LEFTY),
    }
    async with robot_on(speed=50, **line) as (_, robot):
        assert await robot.points.all() == {}
        assert await robot.points.one(5) is None
        await robot.points.write(5, points[5])
        assert await robot.points.one(5) == points[5]
        await robot.points.write_all({number: points[number] for number in (70, 123)})
        found = await robot.points.all()
        assert {n: p._replace(hand=0) for n, p in found.items()} == {n: p._replace(hand=0) for n, p in points.items()}
        assert (await robot.files.read("PNT"))[0].startswith("P5=")
        with pytest.raises(ValueError, match="outside P0"):
            await robot.points.one(30000)


async def test_a_point_table_of_thousands_comes_whole():
    points = {number: StoredPoint((number / 8, 1.0, 2.0, 3.0, 0.0, 0.0), in_pulses=False) for number in range(700)}
    async with robot_on(speed=100) as (_, robot):
        await robot.points.write_all(points)
        assert await robot.points.all() == points


@LINES
async def test_a_program_is_stored_loaded_run_and_stopped(line):
    lines = ["*A:", "DELAY 100", "DO2(5)=1", "GOTO *A", "END"]
    async with robot_on(speed=20, **line) as (_, robot):
        await robot.programs.write("SPIN", lines)
        assert await robot.programs.names() == ["SPIN"]
        assert await robot.programs.read("SPIN") == ["NAME=SPIN", *lines]
        await robot.programs.load("SPIN")
        assert not await robot.programs.running()
        await robot.programs.run()
        assert await robot.programs.running()
        while not await robot.ports.bit("DO", 2, 5):
            await asyncio.sleep(0.005)
        with pytest.raises(Refused, match="program"):
            await robot.move(NEAR, speed_pct=50)
        await robot.programs.stop()
        await robot.programs.reset()
        assert not await robot.programs.running()
        assert await robot.move(NEAR, speed_pct=50) == pytest.approx(NEAR, abs=0.0005)


async def test_a_task_tells_what_it_does():
    async with robot_on(speed=20) as (_, robot):
        await robot.programs.write("SPIN", ["*A:", "DELAY 100", "GOTO *A"])
        await robot.programs.load("SPIN", task=2)
        task = await robot.programs.task(2)
        assert (task.program, task.state) == ("SPIN", "S")


@DIALECTS
@pytest.mark.parametrize(
    ("name", "content", "complaint"),
    [
        ("A B", ["END"], "'A B' is no program name"),
        ("A", ["END", ""], "line 2, '', is no line"),
        ("A", ["X" * 80], "line 1"),
        ("A", ["\x03"], "line 1"),
    ],
)
async def test_a_file_that_the_controller_could_not_take_as_it_is_is_not_sent(dialect, name, content, complaint):
    async with robot_on(speed=50, dialect=dialect) as (bench, robot):
        with pytest.raises(ValueError, match=complaint):
            await robot.programs.write(name, content)
        assert said(bench, "@WRITE") == []


@DIALECTS
async def test_a_file_with_a_wrong_line_is_refused_and_the_conversation_goes_on(dialect):
    async with robot_on(speed=50, dialect=dialect) as (_, robot):
        with pytest.raises(Refused):
            await robot.files.write("PNT", ["P1=1.0 2.0 3.0 4.0 0.0 0.0", "S1=1.0 2.0 3.0 4.0"])
        assert await robot.points.all() == {}
        with pytest.raises(Refused):
            await robot.programs.read("NOBODY")
        assert (await robot.status()).ready


@DIALECTS
async def test_outputs_are_written_by_bit_and_byte_and_read_back(dialect):
    async with robot_on(speed=50, dialect=dialect) as (bench, robot):
        await robot.ports.write("DO", 2, 5)
        await robot.ports.switch("DO", 2, 3, True)
        await robot.ports.switch("DO", 2, 0, False)
        assert await robot.ports.read("DO", 2) == 12
        assert await robot.ports.bit("DO", 2, 3) is True
        bench.inject("robot", "input", port=2, bit=1, on=True)
        assert await robot.ports.read("DI", 2) == 2
        for wrong in (
            robot.ports.write("DO", 1, 0),
            robot.ports.switch("DO", 2, 8, True),
            robot.ports.write("DO", 2, 256),
        ):
            with pytest.raises(ValueError, match="is outside"):
                await wrong


# -- leaving and disturbance ---------------------------------------------------------------------------------


async def test_leaving_the_older_network_says_good_bye_and_stops_nothing():
    async with robot_on(speed=20, dialect="rcx2") as (bench, robot):
        await robot.move(NEAR, speed_pct=100)
        await robot.close()
        left = bench.controller.log.of("left")
        assert [entry.logged_out for entry in left] == [True]
        await robot.open()
        assert (await robot.status()).alarm == ""


@DIALECTS
async def test_closing_in_motion_stops_the_arm(dialect):
    async with robot_on(speed=4, on_disconnect="continue", dialect=dialect) as (bench, robot):
        move = asyncio.create_task(robot.move(FAR, speed_pct=3))
        async with asyncio.timeout(3):
            while bench.stands():
                await asyncio.sleep(0.002)
        await robot.close()
        with pytest.raises((LinkLost, Refused)):
            await move
        async with asyncio.timeout(3):
            while not bench.stands():
                await asyncio.sleep(0.002)
        assert bench.position().y_mm < 199


@DIALECTS
async def test_an_arm_that_somebody_else_has_moved_is_not_sent_on(dialect):
    async with robot_on(speed=20, dialect=dialect) as (bench, robot):
        await robot.move(NEAR, speed_pct=100)
        bench.inject("robot", "second_master", axis=1, mm=5.0)
        await asyncio.sleep(0.6)
        bench.inject("robot", "mode", value=2)
        with pytest.raises(Disturbed, match="somebody else has moved it"):
            await robot.move(FAR, speed_pct=100)
        assert bench.stands()
        assert bench.position().x_mm == pytest.approx(265, abs=0.01)
        await robot.here()  # whoever asks knows
        assert await robot.move(FAR, speed_pct=100) == pytest.approx(FAR, abs=0.0005)


async def test_an_output_that_does_not_follow_is_told(monkeypatch):
    async with robot_on(speed=50) as (bench, robot):
        monkeypatch.setattr(bench.controller.machine.ports, "write", lambda ref, value: None)
        with pytest.raises(NoAnswer, match=r"DO2\(3\) was set to 1 and is 0"):
            await robot.ports.switch("DO", 2, 3, True)
