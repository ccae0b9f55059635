"""Everything that can go wrong with a robot or its line can be made to, and the log shows what truly happened."""

import asyncio
import time
from contextlib import asynccontextmanager
from itertools import pairwise

import pytest

from simulators.cell import robot_wiring
from simulators.parts import BaseDrawing, BatteryDrawing
from simulators.product import Product
from simulators.robot import Bench, RobotController, Wiring
from simulators.robot.codes import Code
from simulators.world import World
from tests.robot_bench import Wire, controller_on, serial_wire_on, wire_on

FAR = "@MOVE P,250.0 200.0 0.0 0.0 0.0 0.0,S=10"
NEAR = "@MOVE P,260.0 10.0 20.0 30.0 0.0 0.0"
DOWN = "@MOVE L,250.0 0.0 100.0 0.0 0.0 0.0,VEL=500"


async def stood(bench, within_s=3.0):
    async with asyncio.timeout(within_s):
        while not bench.stands():
            await asyncio.sleep(0.002)


async def under_way(bench, share=0.2):
    """Until this share of 200 mm is done."""
    async with asyncio.timeout(3):
        while bench.position().y_mm < 200 * share:
            await asyncio.sleep(0.001)


def witness(bench, *kinds):
    return bench.controller.log.of(*kinds)


# -- R1, R2: the link and the end of a move ------------------------------------------------------------------


@pytest.mark.parametrize("on_disconnect", ["stop", "continue"])
async def test_r1_a_link_that_drops_in_motion_stops_the_arm_or_not_and_keeps_clients_away(on_disconnect):
    async with wire_on(speed=2, on_disconnect=on_disconnect, lost_link_refusal=True) as (bench, wire):
        assert await wire.ask(FAR) == ["RUN"]
        await under_way(bench)
        bench.inject("robot", "link_drop", for_s=0.4)
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await wire.lines(1)
        early = await Wire.to(bench.controller, greeting=False)
        assert await early.reader.read() == b""
        early.close()
        await stood(bench)
        await asyncio.sleep(0.25)
        again = await Wire.to(bench.controller)
        assert await again.ask("@?MODE") == ["NG=14.400"], "the first command after a lost link"
        assert await again.ask("@?MODE", 2) == ["2", "OK"]
        again.close()
    arrived = bench.position().y_mm == pytest.approx(200)
    assert arrived == (on_disconnect == "continue")
    assert bool(witness(bench, "halted")) != arrived


async def test_r1_a_stalled_line_passes_nothing_in_either_direction_and_then_everything():
    async with wire_on(speed=4) as (bench, wire):
        assert await wire.ask("@MOVE P,250.0 200.0 0.0 0.0 0.0 0.0,S=2") == ["RUN"]
        bench.inject("robot", "stall", by_s=1.0)
        wire.send(b"@?MODE\r\n\x03")
        assert await wire.silent(0.2)
        assert sorted(await wire.lines(3)) == ["2", "NG=1.8", "OK"]


async def test_r1_a_serial_adapter_that_is_pulled_out_comes_back_under_its_link(tmp_path):
    link = tmp_path / "robot"
    async with serial_wire_on(speed=4, serial_link=link) as (bench, wire):
        assert await wire.ask("@?MODE", 2) == ["2", "OK"]
        bench.inject("robot", "unplug", for_s=0.4)
        assert not link.exists()
        with pytest.raises(OSError, match="Input/output error"):
            wire.send("@?MODE\r\n")
        async with asyncio.timeout(1):
            while not link.exists():
                await asyncio.sleep(0.01)
        again = type(wire)(link)
        assert await again.ask("@?MODE", 2) == ["2", "OK"]
        again.close()
        with pytest.raises(ValueError, match="no fault 'vanish'"):
            bench.inject("robot", "vanish")
    assert not link.is_symlink()


async def test_r2_an_end_can_be_lost_late_or_between_data_and_ok():
    async with wire_on(speed=20) as (bench, wire):
        bench.inject("robot", "lost_end")
        assert await wire.ask(NEAR) == ["RUN"]
        assert await wire.silent(0.1)
        assert bench.stands()
        bench.inject("robot", "late_end", by_s=2.0)
        began = time.monotonic()
        assert await wire.ask(FAR, 2) == ["RUN", "END"]
        assert time.monotonic() - began >= 0.1
        bench.inject("robot", "interleave")
        assert await wire.ask(NEAR) == ["RUN"]
        await stood(bench)
        await asyncio.sleep(0.02)
        assert await wire.ask("@?MODE", 3) == ["2", "END", "OK"]
        bench.inject("robot", "interleave", on=False)
        bench.inject("robot", "late_run", by_s=1.0)
        wire.send(f"{FAR}\r\n@?MODE\r\n")
        assert await wire.lines(4) == ["2", "OK", "RUN", "END"]


async def test_r3_any_refusal_can_be_had():
    async with wire_on(speed=20) as (bench, wire):
        bench.inject("robot", "ng", code="0.5", count=3)
        for _ in range(3):
            assert await wire.ask(NEAR) == ["NG=0.5"]
        assert await wire.ask(NEAR, 2) == ["RUN", "END"]
        with pytest.raises(ValueError, match=r"no code '99\.9'"):
            bench.inject("robot", "ng", code="99.9")
    assert [entry.code for entry in witness(bench, "refused")] == [Code.BUSY] * 3
    assert len(witness(bench, "moves")) == 1


# -- R4 .. R8, R11, R12: the robot ---------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [2, 50])
async def test_r4_an_alarm_comes_exactly_where_it_shall_on_the_way(speed):
    async with wire_on(speed=speed) as (bench, wire):
        bench.inject("robot", "alarm", code="17.800", at=0.5)
        assert await wire.ask(FAR, 2) == ["RUN", "NG=17.800"]
        assert bench.stands()
        assert not bench.arm.powered
        assert await wire.ask("@?ALM", 2) == ["17.800", "OK"]
        assert await wire.ask("@?DO0()", 2) == ["10", "OK"]
        assert await wire.ask(NEAR) == ["NG=6.399"]
        assert await wire.ask("@ALMRST", 2) == ["RUN", "END"]
    assert bench.position().y_mm == pytest.approx(100, abs=8), "half way, and the way to brake"


async def test_r4_a_serious_alarm_needs_the_power_off_and_on():
    async with wire_on(speed=20) as (bench, wire):
        bench.inject("robot", "alarm")
        assert await wire.ask("@?ALM", 2) == ["17.910", "OK"]
        assert await wire.ask("@ALMRST") == ["NG=17.910"]
        bench.inject("robot", "reboot", for_s=0.2)
        await asyncio.sleep(0.05)
        again = await Wire.to(bench.controller)
        assert await again.ask("@?ALM", 2) == ["0.0", "OK"]
        again.close()


@pytest.mark.parametrize("pressed_s", [10.0, 0.02])
async def test_r5_an_emergency_stop_even_a_short_one_takes_the_power_and_latches(pressed_s):
    async with wire_on(speed=1) as (bench, wire):
        assert await wire.ask(FAR) == ["RUN"]
        await under_way(bench)
        at_s = bench.clock.now()
        bench.inject("safety", "estop")
        if pressed_s < 1:
            await asyncio.sleep(pressed_s)
            bench.inject("safety", "estop", on=False)
        assert await wire.lines(1) == ["NG=12.600"]
        assert bench.stands()
        assert not bench.arm.powered
        assert await wire.ask("@MOTOR ON") == ["NG=12.600" if pressed_s > 1 else "NG=6.399"]
        bench.inject("safety", "estop", on=False)
        assert await wire.ask("@ALMRST", 2) == ["RUN", "END"]
        assert await wire.ask(NEAR) == ["NG=6.300"], "nothing moves before a person has switched on again"
        await wire.power_on()
        assert await wire.ask("@?ORIGIN", 2) == ["1 1,1,1,1", "OK"]
    (halted,) = witness(bench, "halted")
    assert halted.stands_s - at_s < 0.05
    after = bench.controller.log.of("moves", since=halted.number)
    assert not after, "no motion after the emergency stop"


@pytest.mark.parametrize(
    ("fault", "params", "code", "mode"),
    [
        ("servo_off", {}, "6.301", "2"),
        ("motor_off", {}, "22.600", "2"),
        ("mode", {"value": 1}, "1.10", "1"),
        ("mode", {"value": "MANUAL"}, "12.500", "0"),
        ("mode", {"value": -1}, "12.500", "-1"),
    ],
)
async def test_r6_somebody_takes_the_servos_or_the_mode_away(fault, params, code, mode):
    async with wire_on(speed=2) as (bench, wire):
        assert await wire.ask(FAR) == ["RUN"]
        await under_way(bench)
        bench.inject("robot", fault, **params)
        assert await wire.lines(1) == [f"NG={code}"]
        assert bench.stands()
        assert await wire.ask("@?MODE", 2) == [mode, "OK"]
        (answer,) = await wire.ask(NEAR)
        assert answer in ("NG=6.300", "NG=0.21", "NG=0.20")


async def test_r7_a_controller_that_restarts_has_lost_what_no_battery_keeps():
    async with wire_on(speed=10) as (bench, wire):
        for command in ("@P1=250.0 0.0 1.0 0.0 0.0 0.0", "@ASPEED 30", "@DO2(1)=1", "@CHANGE H1"):
            assert await wire.ask(command) == ["OK"]
        assert await wire.ask(FAR) == ["RUN"]
        bench.inject("robot", "reboot", for_s=1.0, origin=False, points=False)
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await wire.lines(1)
        assert bench.stands() or not bench.arm.powered
        during = await Wire.to(bench.controller, greeting=False)
        assert await during.reader.read() == b""
        during.close()
        await asyncio.sleep(0.15)
        again = await Wire.to(bench.controller)
        assert await again.ask("@?ORIGIN", 2) == ["0 0,0,0,0", "OK"]
        assert await again.ask("@?MOTOR", 2) == ["0", "OK"]
        assert await again.ask("@?ASPEED", 2) == ["100", "OK"]
        assert await again.ask("@?DO2()", 2) == ["0", "OK"]
        assert await again.ask("@?P1") == ["NG=6.204"]
        assert await again.ask("@?HAND", 2) == ["OFF", "OK"]
        assert await again.ask("@MOTOR ON", 2) == ["RUN", "END"]
        assert await again.ask(NEAR) == ["NG=6.302"]
        assert await again.ask("@ORIGIN", 2) == ["RUN", "END"]
        assert await again.ask(NEAR, 2) == ["RUN", "END"]
        again.close()


async def test_r8_the_tool_can_be_elsewhere_than_the_encoders_say():
    async with wire_on(speed=20) as (bench, wire):
        bench.arm.repeatability_mm = bench.arm.repeatability_deg = 0.0
        bench.inject("robot", "offset", dx_mm=0.5, dr_deg=0.2)
        assert await wire.ask(NEAR, 2) == ["RUN", "END"]
        assert (await wire.ask("@?WHRXY", 2))[0].startswith("260.000 10.000 20.000 30.000")
        assert bench.arm.tool_at(bench.clock.now()) == pytest.approx((260.5, 10, 20, 30.2), abs=1e-6)
        bench.inject("robot", "hand_flip")
        assert await wire.ask("@MOVE P,260.0 20.0 20.0 30.0 0.0 0.0 1", 2) == ["RUN", "END"]
        assert (await wire.ask("@?WHRXY", 2))[0].split()[6] == "2"


async def test_r9_a_second_master_takes_the_control_and_moves_the_arm():
    async with wire_on(speed=5) as (bench, wire):
        before = (await wire.ask("@?WHRXY", 2))[0]
        bench.inject("robot", "second_master", axis=2, mm=12.0)
        await asyncio.sleep(0.02)
        await stood(bench)
        assert await wire.ask("@?MODE", 2) == ["1", "OK"]
        assert (await wire.ask("@?WHRXY", 2))[0] != before
        assert bench.position().y_mm == pytest.approx(12)
        for command in (NEAR, "@ASPEED 10", "@DO2(1)=1", "@MOTOR OFF", "@RESET"):
            assert await wire.ask(command) == ["NG=0.21"], command
    assert len(witness(bench, "pendant moves")) == 1
    assert not witness(bench, "moves")


async def test_r9_two_clients_never_command_at_once_unless_the_controller_lets_them():
    async with controller_on(speed=5) as (_, controller):
        first = await Wire.to(controller)
        second = await Wire.to(controller, greeting=False)
        assert await second.reader.read() == b""
        for wire in (first, second):
            wire.close()
    joined = controller.log.of("joined", "turned away")
    assert [entry.kind for entry in joined] == ["joined", "turned away"]
    async with controller_on(speed=5, second_client="serve") as (bench, controller):
        one, other = await Wire.to(controller), await Wire.to(controller)
        await one.power_on()
        assert await one.ask("@MOVE P,250.0 200.0 0.0 0.0 0.0 0.0,S=1") == ["RUN"]
        assert await other.ask(NEAR) == ["NG=6.282"]
        other.send(b"\x03")
        assert await other.silent(0.02)
        assert not bench.stands(), "another client's stop is none of this operation's"
        assert await one.lines(1) == ["END"]
        for wire in (one, other):
            wire.close()
    assert {entry.client for entry in controller.log.of("heard")} == {
        entry.client for entry in controller.log.of("joined")
    }


async def test_r10_the_line_can_be_noisy_cut_echoing_or_in_pieces():
    async with wire_on(speed=50) as (bench, wire):
        bench.inject("robot", "cut")
        wire.send("@?MODE\r\n")
        assert await wire.reader.readexactly(5) == b"2OK\r\n"
        bench.inject("robot", "echo")
        assert await wire.ask("@?mode", 3) == ["@?mode", "2", "OK"]
        bench.inject("robot", "echo", on=False)
        bench.inject("robot", "short_position")
        assert len((await wire.ask("@?WHRXY", 2))[0].split()) == 7
        bench.inject("robot", "double")
        assert await wire.ask("@?MODE", 3) == ["2", "2", "OK"]
        bench.inject("robot", "corrupt")
        wrong, right = await wire.ask("@?MODE", 2)
        assert (wrong != "2", right) == (True, "OK")
        bench.inject("robot", "apart")
        wire.send("@?MODE\r\n")
        assert await wire.reader.read(1) == b"2"
        assert await wire.lines(2) == ["", "OK"]
        bench.inject("robot", "garbage", count=2)
        noisy = await wire.ask("@?MODE", 4)
        assert [line for line in noisy if line.isascii()] == ["2", "OK"]


@pytest.mark.parametrize("late_s", [0.3, 0.0])
async def test_r10_a_greeting_may_come_late(late_s):
    async with controller_on() as (bench, controller):
        if late_s:
            bench.inject("robot", "late_greeting", by_s=late_s)
        wire = await Wire.to(controller, greeting=False)
        began = time.monotonic()
        assert await wire.lines(2) == ["Welcome to RCX340", ""]
        assert late_s <= time.monotonic() - began < late_s + 0.2
        wire.close()


async def test_r11_a_changed_speed_shows_and_a_wrong_payload_makes_the_tool_swing():
    async with wire_on(speed=10) as (bench, wire):
        bench.inject("robot", "speed", pct=100)
        assert await wire.ask("@?ASPEED", 2) == ["100", "OK"]
        bench.inject("robot", "speed", pct=7)
        assert await wire.ask("@?ASPEED", 2) == ["7", "OK"]
        bench.inject("robot", "speed", pct=100)
        bench.arm.repeatability_mm = bench.arm.repeatability_deg = 0.0

        async def swing_mm():
            assert await wire.ask("@MOVE P,250.0 0.0 0.0 0.0 0.0 0.0", 2) == ["RUN", "END"]
            assert await wire.ask("@MOVE P,250.0 150.0 0.0 0.0 0.0 0.0", 2) == ["RUN", "END"]
            end_s = bench.arm._motions[-1].plan.end_s
            return max(abs(bench.arm.tool_at(end_s + k / 1000).y_mm - 150) for k in range(200))

        assert await swing_mm() < 1e-6
        bench.inject("robot", "payload", kg=5.0)
        assert await swing_mm() > 0.05
        assert await wire.ask("@WEIGHT 5") == ["OK"]
        assert await swing_mm() < 1e-6, "the controller knows what it carries and is gentler"


@pytest.mark.parametrize("speed", [2, 50])
async def test_r12_an_arm_that_hits_something_stands_there_and_alarms(speed):
    async with wire_on(speed=speed) as (bench, wire):
        bench.inject("robot", "block_z", at_mm=62.5)
        assert await wire.ask(DOWN, 2) == ["RUN", "NG=17.910"]
        assert bench.position().z_mm == pytest.approx(62.5, abs=0.01)
        assert not bench.arm.powered
        assert (await wire.ask("@?WHRXY", 2))[0].split()[2].startswith("62.5")
        bench.inject("robot", "block_z", at_mm=None)


# -- what else the options change ----------------------------------------------------------------------------


@pytest.mark.parametrize(("after_stop", "ending"), [("ng", "NG=1.8"), ("end", "END")])
async def test_how_a_stopped_move_ends_is_an_option(after_stop, ending):
    async with wire_on(speed=2, after_stop=after_stop) as (bench, wire):
        assert await wire.ask(FAR) == ["RUN"]
        await under_way(bench)
        wire.send(b"\x03")
        assert await wire.lines(1) == [ending]
        assert bench.stands()


async def test_other_open_questions_are_options_too():
    settings = {"almrst": "ok", "servo_reply": "ok", "where_fields": 9, "busy": "0.5", "version": "X1", "config": "Y2"}
    async with wire_on(speed=4, greeting="Welcome to RCX320", on=False, **settings) as (_, wire):
        assert await wire.ask("@ALMRST") == ["OK"]
        assert await wire.ask("@SERVO ON") == ["OK"]
        assert await wire.ask("@?MOTOR", 2) == ["2", "OK"]
        assert len((await wire.ask("@?WHERE", 2))[0].split()) == 9
        assert await wire.ask("@?VER", 2) == ["X1", "OK"]
        assert await wire.ask("@?CONFIG", 2) == ["Y2", "OK"]
        assert await wire.ask(FAR) == ["RUN"]
        assert await wire.ask(NEAR) == ["NG=0.5"]
        assert await wire.lines(1) == ["END"]


async def test_pulses_soft_limits_and_outputs_in_an_emergency_are_options():
    settings = {"pulse_scale": 2.0, "soft_limit_margin_deg": 10.0, "outputs_on_emergency": "clear"}
    async with wire_on(speed=20, **settings) as (bench, wire):
        assert await wire.ask("@DRIVE(1,29127),(3,16384)", 2) == ["RUN", "END"]
        joints = bench.arm.joints_at(bench.clock.now())
        assert (joints.j1_deg, joints.z_mm) == pytest.approx((5, 5), abs=0.001)
        assert await wire.ask("@DRIVE(1,135.0)") == ["NG=2.334"]
        assert await wire.ask("@DO3()=7") == ["OK"]
        bench.inject("safety", "estop")
        assert await wire.ask("@?DO3()", 2) == ["0", "OK"]


async def test_axes_are_braked_on_or_free():
    async with wire_on(speed=20) as (_, wire):
        assert await wire.ask("@SERVO FREE(4)", 2) == ["RUN", "END"]
        assert await wire.ask("@?SERVO", 2) == ["0 1,1,1,2", "OK"]
        assert await wire.ask("@SERVO OFF(3)", 2) == ["RUN", "END"]
        assert await wire.ask("@?SERVO", 2) == ["0 1,1,0,2", "OK"]
        assert await wire.ask(NEAR) == ["NG=6.301"]
        assert await wire.ask("@DRIVE(1,-40.0)", 2) == ["RUN", "END"]
        assert await wire.ask("@MOTOR OFF", 2) == ["RUN", "END"]
        assert await wire.ask("@?SERVO", 2) == ["0 0,0,0,0", "OK"]
        assert await wire.ask("@MOTOR PWR", 2) == ["RUN", "END"]
        assert await wire.ask("@?MOTOR", 2) == ["1", "OK"]


async def test_a_motion_that_watches_an_input_stops_on_it():
    async with wire_on(speed=4) as (bench, wire):
        assert await wire.ask(f"{FAR},STOPON DI(20)=1") == ["RUN"]
        await under_way(bench)
        bench.inject("robot", "input", port=2, bit=0)
        assert await wire.lines(1) == ["END"]
        assert bench.stands()
        assert bench.position().y_mm < 150


async def test_moves_that_blend_end_early_and_save_time():
    async with wire_on(speed=1) as (bench, wire):
        assert await wire.ask("@CONTPLS 60000") == ["OK"]
        corner = "@MOVE P,300.0 50.0 0.0 0.0 0.0 0.0,S=20"
        assert await wire.ask(f"{corner},CONT", 2) == ["RUN", "END"]
        assert not bench.stands()
        assert await wire.ask("@ASPEED 50") == ["NG=6.282"], "the arm still moves"
        assert await wire.ask("@MOVE P,250.0 150.0 0.0 0.0 0.0 0.0,S=50", 2) == ["RUN", "END"]
        assert bench.position() == pytest.approx((250, 150, 0, 0), abs=1e-6)
        first, second = bench.controller.log.of("moves")
        assert first.ends_s > second.at_s, "the second began before the first had ended"


# -- the older generation ------------------------------------------------------------------------------------


async def test_an_rcx240_says_nothing_until_a_move_has_ended_and_then_answers_in_order():
    async with wire_on(speed=4, dialect="rcx2") as (bench, wire):
        wire.send(f"{FAR}\r\n@?MOD\r\n@?WHRXY\r\n")
        await under_way(bench)
        assert await wire.silent(0.05)
        assert await wire.lines(3) == ["OK", "AUTO", "[POS]  250.00  200.00    0.00    0.00    0.00    0.00"]
        wire.send(f"{NEAR},S=5\r\n@?MOD\r\n")
        await asyncio.sleep(0.1)
        wire.send(b"\x03")
        assert await wire.lines(2) == ["0.7:Stop executed", "AUTO"]
        assert bench.stands()


async def test_an_rcx240_may_refuse_what_comes_while_it_moves():
    async with wire_on(speed=4, dialect="rcx2", when_moving="refuse") as (bench, wire):
        wire.send(f"{FAR}\r\n")
        await under_way(bench)
        assert await wire.ask("@?MOD") == ["14.23:Illegal command while operating"]
        assert await wire.lines(1) == ["OK"]
        assert await wire.ask("@?MOD") == ["AUTO"]


@pytest.mark.parametrize("good_bye", [True, False])
async def test_an_rcx240s_network_board_stops_the_robot_when_a_client_leaves_without_a_word(good_bye):
    async with wire_on(speed=2, dialect="rcx2") as (bench, wire):
        wire.send("@WRITE <T>\r\nNAME=T\r\nMOVE P,P1,S=10\r\n\r\n@P1=250.0 200.0 0.0 0.0 0.0 0.0\r\n")
        assert await wire.lines(3) == ["READY", "OK", "OK"]
        assert await wire.ask("@SWI <T>") == ["OK"]
        assert await wire.ask("@RUN") == ["OK"]
        await under_way(bench)
        if good_bye:
            wire.send("LOGOUT\r\n")
            assert await wire.reader.read() == b""
        wire.close()
        await asyncio.sleep(0.05)
        await stood(bench)
    assert (bench.position().y_mm == pytest.approx(200)) == good_bye
    assert (Code.COMMUNICATION in [entry.code for entry in witness(bench, "report")]) != good_bye


async def test_the_boards_own_words_and_its_echo():
    async with wire_on(speed=20, dialect="rcx2", telnet=True) as (_, wire):
        assert await wire.reader.readexactly(6) == b"\xff\xfb\x01\xff\xfb\x03"
        assert await wire.ask("VER", 2) == ["VER", "Version_1.01"]
        assert await wire.ask("@?ETHER ECHO", 3) == ["@?ETHER ECHO", "1", "OK"]
        assert await wire.ask("@ETHER ECHO 0", 2) == ["@ETHER ECHO 0", "OK"]
        assert await wire.ask("@?MOD") == ["AUTO"]
        wire.send(b"\xff\xfd\x01@?MOD\r\n")  # DO ECHO
        assert await wire.lines(2) == ["@?MOD", "AUTO"]
        wire.send(b"\xff\xfe\x01\xff\xfd\x18\xff\xfb\x1f@?MOD\r\n")  # DONT ECHO, DO TERMINAL-TYPE, WILL NAWS
        assert await wire.reader.readexactly(6) == b"\xff\xfc\x18\xff\xfe\x1f"
        assert await wire.lines(1) == ["AUTO"]
        wire.send(b"\xff\xf4bye\r\n")  # interrupt process, and a good-bye
        assert await wire.reader.read() == b""


async def test_a_client_that_says_nothing_for_long_is_hung_up_on():
    async with wire_on(speed=100, dialect="rcx2", silence_min=0.5) as (bench, wire):
        for _ in range(3):
            await asyncio.sleep(0.2)
            assert await wire.ask("@?MOD") == ["AUTO"]
        began_s = bench.clock.now()
        async with asyncio.timeout(2):
            assert await wire.reader.read() == b""
        assert 25 < bench.clock.now() - began_s < 45


async def test_settings_and_modes_of_the_older_generation():
    async with wire_on(speed=50, dialect="rcx2") as (bench, wire):
        assert await wire.ask("@MANUAL") == ["OK"]
        assert await wire.ask("@MOVE P,260.0 0.0 0.0 0.0 0.0 0.0") == ["OK"], "in manual mode, too"
        assert await wire.ask("@SYSTEM") == ["OK"]
        assert await wire.ask(NEAR) == ["14.25:Illegal command in this mode"]
        assert await wire.ask("@AUTO") == ["OK"]
        assert await wire.ask("@UNIT 1") == ["OK"]
        assert await wire.ask("@IDIST 5000") == ["OK"]
        assert await wire.ask("@INCH Y+") == ["OK"]
        assert bench.position() == pytest.approx((260, 5, 0, 0), abs=1e-6)
        assert await wire.ask("@UNIT 0") == ["OK"]
        assert await wire.ask("@INCH Z+") == ["OK"]
        assert bench.position().z_mm == pytest.approx(5000 / 1638.4)
        assert await wire.ask("@INCH 1+") == ["5.7:Illegal axis name"]
        assert await wire.ask("@INCH A+") == ["4.5:Undefined axis number"]
        assert await wire.ask("@MOVE P,260.0 0.0 20.0 0.0 0.0 0.0,Z=0.00") == ["OK"]
        assert await wire.ask("@MOVE P,260.0 0.0 20.0 0.0 0.0 0.0,A3=0.0") == ["5.38:Illegal option"]
        bench.inject("robot", "alarm", code="17.4")
        assert await wire.ask(NEAR) == ["17.4:Motor overload"], "an older controller answers by its alarm"
        assert await wire.ask("@EMGRST") == ["OK"]
        assert await wire.ask("@SERVO ON") == ["OK"]
        bench.inject("safety", "estop")
        assert await wire.ask("@?EMG") == ["ON"]
        assert await wire.ask(NEAR) == ["12.1:Emergency stop on"]
        assert await wire.ask("@EMGRST") == ["12.1:Emergency stop on"]


async def test_a_serial_line_holds_a_client_that_sends_too_fast():
    async with serial_wire_on(speed=1, dialect="rcx2") as (_, wire):
        for _ in range(100):
            wire.send("@?MOD\r\n")
        assert await wire.lines(100, within_s=10) == ["AUTO"] * 100
        assert wire.holds


async def test_the_log_pairs_every_answer_with_its_question():
    async with wire_on(speed=20) as (bench, wire):
        for query in ("@?MODE", "@?EMG", "@?MODE", "@ASPEED 50"):
            await wire.ask(query, 1 if "ASPEED" in query else 2)
    entries = [entry for entry in witness(bench, "heard", "said") if entry.line not in ("RUN", "END", "@MOTOR ON", "")]
    lines = [entry.line for entry in entries if not entry.line.startswith("Welcome")]
    assert lines == ["@?MODE", "2", "OK", "@?EMG", "0", "OK", "@?MODE", "2", "OK", "@ASPEED 50", "OK"]
    assert all(a.number < b.number and a.at_s <= b.at_s for a, b in pairwise(bench.controller.log.entries))


@asynccontextmanager
async def wired(world, wiring):
    """A controller with something on its inputs and outputs."""
    controller = RobotController(world, wiring=wiring)
    await controller.start()
    wire = await Wire.to(controller)
    try:
        yield wire
    finally:
        wire.close()
        await controller.close()


async def test_a_sensor_and_an_actuator_can_be_wired_to_the_controllers_inputs_and_outputs():
    valve, vacuum = [], [False]
    wiring = Wiring(inputs={(2, 3): lambda: vacuum[0]}, outputs={(2, 1): valve.append})
    async with wired(Bench(speed=20), wiring) as wire:
        assert await wire.ask("@DO2(1)=1") == ["OK"]
        assert await wire.ask("@DO2()=3") == ["OK"]
        assert await wire.ask("@?DI2()", 2) == ["0", "OK"]
        vacuum[0] = True
        assert await wire.ask("@?DI(23)", 2) == ["1", "OK"]
        assert await wire.ask("@DO2(1)=0") == ["OK"]
    assert valve == [True, False]


async def test_in_the_cell_the_robots_own_valve_and_switch_hold_a_battery_whatever_the_plcs_valve_does():
    world = World(7, Product(BaseDrawing(), BatteryDrawing()), speed=50)
    world.robot_enable = True
    world.lay_reference_battery()
    table, z_mm = world.layout.table, world.layout.heights.table_mm
    async with wired(world, robot_wiring(world)) as wire:
        await wire.power_on()
        place = f"{table.x_mm:.3f} {table.y_mm:.3f} {z_mm:.3f} 0.0 0.0 0.0"
        assert await wire.ask(f"@MOVE P,{place}", 2) == ["RUN", "END"]
        assert await wire.ask("@DO(20)=1") == ["OK"]
        world.valve(False)
        await asyncio.sleep(0.02)
        assert await wire.ask("@?DI(20)", 2) == ["1", "OK"]
        assert world.held is not None
        assert await wire.ask("@DO(20)=0") == ["OK"]
        await asyncio.sleep(0.02)
        assert await wire.ask("@?DI(20)", 2) == ["0", "OK"]
        assert world.held is None
