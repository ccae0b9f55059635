"""The simulated controller, judged by its wire and by the arm."""

import asyncio
import os
import time
from dataclasses import replace

import pytest

from simulators.robot.codes import Code
from simulators.robot.modes import Mode
from simulators.robot.refusals import Kind, Situation, refusal
from tests.robot_bench import Wire, controller_on, serial_wire_on, wire_on

HERE = "250.000 0.000 0.000 0.000 0.000 0.000 1 0 0"


# -- framing and greeting ------------------------------------------------------------------------------------


async def test_the_greeting_comes_in_two_writes():
    async with controller_on() as (_, controller):
        wire = await Wire.to(controller, greeting=False)
        first = await wire.reader.read(100)
        second = await wire.reader.read(100)
        wire.close()

    assert (first, second) == (b"Welcome to RCX340\r\n", b"\r\n")


async def test_a_second_client_is_taken_and_dropped():
    async with controller_on() as (_, controller):
        first = await Wire.to(controller)
        second = await Wire.to(controller, greeting=False)
        assert await second.reader.read() == b""
        assert await first.ask("@?MODE", 2) == ["2", "OK"]
        first.close()
        second.close()


async def test_after_a_client_has_gone_another_may_come():
    async with controller_on() as (_, controller):
        (await Wire.to(controller)).close()
        await asyncio.sleep(0.02)
        wire = await Wire.to(controller)
        assert await wire.ask("@?MODE", 2) == ["2", "OK"]
        wire.close()


@pytest.mark.parametrize(
    "line",
    ["@?MODE\r\n", "@?MODE\r", "@?mode\n", "@ ?MODE \r\n", "@? MODE\r\n", "@ ? MODE\r\n", "\0\r\n\r\n@?MO\0DE\r\n\0\0"],
)
async def test_every_way_to_write_a_query_is_understood(line):
    async with wire_on(on=False) as (_, wire):
        wire.send(line)
        assert await wire.lines(2) == ["2", "OK"]


async def test_telnet_negotiation_is_ignored():
    async with wire_on(on=False) as (_, wire):
        wire.send(b"\xff\xfd\x01\xff\xfb\x03@?MODE\r\n")
        assert await wire.lines(2) == ["2", "OK"]


async def test_an_at_sign_alone_and_stray_control_bytes_say_nothing():
    async with wire_on(on=False) as (_, wire):
        wire.send(b"@ \x03 \r\n\x16\r\n\x03\r\n")
        assert await wire.ask("@?MODE", 2) == ["2", "OK"]


async def test_pipelined_queries_are_answered_in_order():
    async with wire_on(speed=10, on=False) as (_, wire):
        wire.send("@?MODE\r\n@?EMG\r\n@?ALM\r\n@?MOTOR\r\n@?SERVO\r\n@?ORIGIN\r\n@?WHRXY\r\n")
        assert await wire.lines(14) == [
            *("2", "OK", "0", "OK", "0.0", "OK", "0", "OK"),
            *("0 0,0,0,0", "OK", "1 1,1,1,1", "OK", HERE, "OK"),
        ]


async def test_a_client_that_sends_faster_than_it_is_answered_waits():
    async with wire_on(speed=5, on=False) as (_, wire):
        wire.send("@?MODE\r\n" * 300)
        assert await wire.lines(600) == ["2", "OK"] * 300


async def test_without_flow_control_too_many_waiting_lines_overflow():
    async with serial_wire_on(speed=20, baud=115200, flow="none") as (bench, wire):
        bench.inject("robot", "stall", by_s=4.0)
        wire.send("@?MODE\r\n" * 80)
        replies = await wire.lines(2 * 64 + 1)
        assert replies == ["2", "OK"] * 64 + ["NG=14.211"]


# -- refusals ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("?MODE", "14.222"),
        ("\xe9\xff\xf1x", "14.222"),
        ("@" + "X" * 255, "14.220"),
        ("@FROBNICATE", "5.252"),
        ("@?FROBNICATE", "5.252"),
        ("@123", "5.252"),
        ("@MOVE X,P1", "5.201"),
        ("@MOVE P", "5.201"),
        ("@MOVE P,1.0 2.0 x 4.0 0.0 0.0", "5.202"),
        ("@MOVE P,1.0 2.0 3.0", "4.212"),
        ("@MOVE P,250.0 0.0 0.0 0.0 0.0 0.0,Q=5", "5.238"),
        ("@MOVE P,250.0 0.0 0.0 0.0 0.0 0.0,S=101", "4.208"),
        ("@MOVE P,250.0 0.0 0.0 0.0 0.0 0.0,S=0", "4.208"),
        ("@MOVE P,P77", "6.204"),
        ("@MOVE P,P30000", "4.201"),
        ("@?P77", "6.204"),
        ("@MOVE P,500.0 0.0 0.0 0.0 0.0 0.0", "2.301"),
        ("@MOVE P,300.0 0.0 151.0 0.0 0.0 0.0", "2.334"),
        ("@MOVE L,0.0 -250.0 0.0 0.0 0.0 0.0 2", "2.319"),
        ("@DRIVE(5,1.0)", "4.205"),
        ("@DRIVE 1,1.0", "5.201"),
        ("@DRIVE(3,151.0)", "2.334"),
        ("@JOGXY X+", "5.207"),
        ("@INCHXY 5+", "4.205"),
        ("@ASPEED 0", "4.208"),
        ("@ASPEED fast", "5.202"),
        ("@ACCEL(5)=50", "4.205"),
        ("@RIGHTY 1", "5.251"),
        ("@DO0(1)=1", "4.211"),
        ("@DO2(8)=1", "5.204"),
        ("@DO2()=256", "4.208"),
        ("@MOVE[2] P,P1", "4.204"),
        ("@RUN", "3.208"),
        ("@LOAD <A>,T1", "3.203"),
        ("@MOTOR MAYBE", "5.201"),
    ],
)
async def test_a_refusal_names_its_code_and_moves_nothing(line, code):
    async with wire_on(speed=50) as (bench, wire):
        assert await wire.ask(line) == [f"NG={code}"]
        assert await wire.ask("@?MODE", 2) == ["2", "OK"]
        assert bench.stands()
        assert bench.position() == pytest.approx((250, 0, 0, 0), abs=1e-9)


MOVE = "@MOVE P,260.0 10.0 20.0 30.0 0.0 0.0"


async def test_refusals_come_in_the_order_emergency_alarm_interlock_mode_motor():
    async with wire_on(speed=50, on=False) as (bench, wire):
        assert await wire.ask(MOVE) == ["NG=6.300"]
        bench.inject("robot", "mode", value=0)
        assert await wire.ask(MOVE) == ["NG=0.20"]
        bench.inject("robot", "mode", value=1)
        bench.safety(guard_open=True)
        assert await wire.ask(MOVE) == ["NG=0.21"]
        bench.inject("robot", "mode", value=2)
        assert await wire.ask(MOVE) == ["NG=12.400"]
        bench.inject("robot", "alarm", code="17.910")
        assert await wire.ask(MOVE) == ["NG=6.399"]
        bench.safety(estop_pressed=True)
        assert await wire.ask(MOVE) == ["NG=12.600"]
        assert await wire.ask("@MOVE Q,P1") == ["NG=5.201"]


EVERYTHING_WRONG = Situation(
    emergency=True,
    alarm=Code.MOTOR_OVERLOAD,
    mode=Mode.MANUAL,
    modes_that_move=(Mode.AUTO,),
    interlocked=True,
    arm_locked=True,
    moving=True,
    operating=True,
    running=True,
    motor=False,
    servo=False,
    origin=False,
)
MENDED = (
    ("12.600", {"emergency": False}),
    ("6.399", {"alarm": None}),
    ("0.20", {"mode": Mode.AUTO}),
    ("12.400", {"interlocked": False}),
    ("12.401", {"arm_locked": False}),
    ("6.282", {"moving": False}),
    ("6.280", {"operating": False}),
    ("6.281", {"running": False}),
    ("6.300", {"motor": True}),
    ("6.301", {"servo": True}),
    ("6.302", {"origin": True}),
)


def test_a_move_is_refused_for_one_reason_after_the_other_until_nothing_is_wrong():
    now = EVERYTHING_WRONG
    assert refusal(Kind.MOTION, replace(now, mode=Mode.HELD, emergency=False, alarm=None)) is Code.CONTROL_RIGHT
    for code, mended in MENDED:
        assert refusal(Kind.MOTION, now).rcx3 == code
        now = replace(now, **mended)
    assert all(refusal(kind, now) is None for kind in Kind)
    assert refusal(Kind.OUTPUT, EVERYTHING_WRONG) is None, "outputs can always be set"
    assert refusal(Kind.POWER_OFF, replace(now, running=True)) is None
    assert refusal(Kind.JOG, replace(now, mode=Mode.MANUAL, origin=False)) is None


async def test_one_servo_does_not_move_all_axes():
    async with wire_on(speed=50, on=False) as (_, wire):
        assert await wire.ask("@SERVO ON(1)", 2) == ["RUN", "END"]
        assert await wire.ask("@?SERVO", 2) == ["0 1,0,0,0", "OK"]
        assert await wire.ask("@?MOTOR", 2) == ["1", "OK"]
        assert await wire.ask(MOVE) == ["NG=6.301"]
        assert await wire.ask("@DRIVE (1,-40.0),S=50", 2) == ["RUN", "END"]


# -- motion --------------------------------------------------------------------------------------------------


async def test_a_recorded_conversation_of_another_client_is_answered_byte_for_byte():
    async with wire_on(speed=20, on=False) as (_, wire):
        for sent, answered in [
            ("@?MODE", "2\r\nOK\r\n"),
            ("@ALMRST", "RUN\r\nEND\r\n"),
            ("@SERVO ON", "RUN\r\nEND\r\n"),
            ("@?SERVO", "1 1,1,1,1\r\nOK\r\n"),
            ("@?ORIGIN", "1 1,1,1,1\r\nOK\r\n"),
            ("@?ALM", "0.0\r\nOK\r\n"),
            ("@?DO0()", "6\r\nOK\r\n"),
            ("@?WHRXY", f"{HERE}\r\nOK\r\n"),
            ("@RIGHTY", "OK\r\n"),
            ("@TOLE 80", "OK\r\n"),
            ("@WEIGHTG 1000", "OK\r\n"),
            ("@CHANGE H1", "OK\r\n"),
            ("@MOVE L,300.0 0.0 10.0 5.0 0.0 0.0,S=20,ACC=100,DEC=100,CONT", "RUN\r\n"),
            ("", "END\r\n"),
            ("@?WHRXY", "300.000 0.000 10.000 5.000 0.000 0.000 1 0 0\r\nOK\r\n"),
            ("@IDIST 1000", "OK\r\n"),
            ("@INCHXY 1+", "RUN\r\nEND\r\n"),
            ("@?WHRXY", "301.000 0.000 10.000 5.000 0.000 0.000 1 0 0\r\nOK\r\n"),
            ("@STOP", "OK\r\n"),
        ]:
            wire.send(f"{sent}\r\n")
            async with asyncio.timeout(2):
                assert await wire.reader.readexactly(len(answered)) == answered.encode()
        assert await wire.silent()


async def test_run_and_end_never_come_as_one():
    async with wire_on() as (_, wire):
        wire.send("@MOVE P,250.0 0.0 0.001 0.0 0.0 0.0\r\n")
        assert await wire.reader.read(100) == b"RUN\r\n"
        assert await wire.reader.read(100) == b"END\r\n"


async def test_end_comes_when_the_arm_arrives():
    async with wire_on(speed=10) as (bench, wire):
        wire.send("@MOVE P,250.0 200.0 0.0 0.0 0.0 0.0 1,S=30\r\n")
        assert await wire.lines(1) == ["RUN"]
        assert not bench.stands()
        assert await wire.lines(1) == ["END"]
        assert bench.stands()
        assert bench.position() == pytest.approx((250, 200, 0, 0), abs=1e-9)


async def test_queries_are_answered_in_motion_and_settings_are_not():
    async with wire_on() as (bench, wire):
        assert await wire.ask("@MOVE P,250.0 200.0 0.0 0.0 0.0 0.0,S=20") == ["RUN"]
        seen = [(await wire.ask("@?WHRXY", 2))[0] for _ in range(5)]
        assert len(set(seen)) == 5
        for refused in ("@DECEL 50", "@ASPEED 10", MOVE, "@MOTOR OFF", "@P1=1.0 2.0 3.0 4.0 0.0 0.0"):
            assert await wire.ask(refused) == ["NG=6.282"]
        assert await wire.ask("@DO2(3)=1") == ["OK"]
        assert not bench.stands()
        assert await wire.lines(1) == ["END"]
        assert await wire.ask("@DECEL 50") == ["OK"]


async def test_control_c_stops_a_move_even_inside_a_line():
    async with wire_on() as (bench, wire):
        assert await wire.ask("@MOVE P,250.0 200.0 0.0 0.0 0.0 0.0,S=10") == ["RUN"]
        await asyncio.sleep(0.1)
        wire.send(b"@?MO\x03DE\r\n")
        assert sorted(await wire.lines(3)) == ["2", "NG=1.8", "OK"]
        assert bench.stands()
        assert 0 < bench.position().y_mm < 199


async def test_the_speeds_multiply():
    async with wire_on(speed=20) as (bench, wire):
        assert await wire.ask("@MOVE P,250.0 200.0 0.0 0.0 0.0 0.0", 2) == ["RUN", "END"]
        assert await wire.ask("@ASPEED 50") == ["OK"]
        assert await wire.ask("@MOVE P,250.0 0.0 0.0 0.0 0.0 0.0,S=20", 2) == ["RUN", "END"]
    quick_s, slow_s = (entry.ends_s - entry.at_s for entry in bench.controller.log.of("moves"))
    assert quick_s < 0.3
    assert slow_s > 0.8


async def test_a_jog_runs_while_the_key_is_held_and_stops_by_control_c():
    async with wire_on() as (bench, wire):
        assert await wire.ask("@JOGXY 2+") == ["RUN"]
        for _ in range(8):
            await asyncio.sleep(0.05)
            wire.send(b"\x16\r\n")
        assert not bench.stands()
        wire.send(b"\x03\r\n")
        assert await wire.lines(1) == ["END"]
        assert bench.stands()
        assert bench.position().y_mm > 20
        assert bench.position().x_mm == pytest.approx(250)


async def test_a_jog_stops_when_the_key_is_let_go():
    async with wire_on(speed=5) as (bench, wire):
        began_s = bench.clock.now()
        assert await wire.ask("@JOG 1-", 2) == ["RUN", "END"]
        assert 0.2 <= bench.clock.now() - began_s < 0.6
        assert bench.stands()


async def test_a_jog_ends_at_the_edge_of_the_range():
    async with wire_on(speed=5) as (bench, wire):
        assert await wire.ask("@JOGXY 3+") == ["RUN"]
        for _ in range(25):
            wire.send(b"\x16")
            await asyncio.sleep(0.01)
        assert await wire.lines(1) == ["END"]
        assert bench.position().z_mm == pytest.approx(150, abs=5)


async def test_points_are_kept_and_moved_to():
    async with wire_on(speed=50) as (bench, wire):
        assert await wire.ask("@P5 = 260.5 20.25 30.0 40.0 0.0 0.0") == ["OK"]
        assert await wire.ask("@?P5", 2) == ["260.500 20.250 30.000 40.000 0.000 0.000 0 0 0", "OK"]
        assert await wire.ask("@LOC3(P5)=31.5") == ["OK"]
        assert await wire.ask("@?LOC3(P5)", 2) == ["31.500", "OK"]
        assert await wire.ask("@MOVE P, P5,S=50", 2) == ["RUN", "END"]
        assert bench.position() == pytest.approx((260.5, 20.25, 31.5, 40), abs=1e-9)
        assert await wire.ask("@TCHXY 6") == ["OK"]
        assert await wire.ask("@?P6", 2) == ["260.500 20.250 31.500 40.000 0.000 0.000 1 0 0", "OK"]
        assert await wire.ask("@MOVE P,P5,P6", 2) == ["RUN", "END"]


async def test_pulses_and_millimetres_are_told_apart_by_the_point():
    async with wire_on(speed=50) as (bench, wire):
        pulses, _ = await wire.ask("@?WHERE", 2)
        assert await wire.ask("@MOVE P,260.0 50.0 30.0 40.0 0.0 0.0", 2) == ["RUN", "END"]
        assert await wire.ask(f"@MOVE P,{pulses}", 2) == ["RUN", "END"]
        assert bench.position() == pytest.approx((250, 0, 0, 0), abs=0.01)


async def test_relative_moves_and_single_axes():
    async with wire_on(speed=50) as (bench, wire):
        assert await wire.ask("@MOVEI P,10.0 5.0 2.0 1.0 0.0 0.0", 2) == ["RUN", "END"]
        assert bench.position() == pytest.approx((260, 5, 2, 1), abs=1e-6)
        before = bench.arm.joints_at(bench.clock.now())
        assert await wire.ask("@DRIVEI(3,8.0),(4,-5.0),S=50", 2) == ["RUN", "END"]
        after = bench.arm.joints_at(bench.clock.now())
        assert [b - a for a, b in zip(before, after, strict=True)] == pytest.approx([0, 0, 8, -5], abs=1e-6)


async def test_the_hand_flag_chooses_the_elbow():
    async with wire_on(speed=50) as (_, wire):
        assert await wire.ask("@MOVE P,250.0 0.0 0.0 0.0 0.0 0.0 2", 2) == ["RUN", "END"]
        assert (await wire.ask("@?WHRXY", 2))[0].split()[6] == "2"
        assert await wire.ask("@LEFTY") == ["OK"]
        assert await wire.ask("@MOVE L,260.0 0.0 0.0 0.0 0.0 0.0", 2) == ["RUN", "END"]
        assert await wire.ask("@MOVE L,250.0 0.0 0.0 0.0 0.0 0.0 1") == ["NG=2.320"]


async def test_outputs_are_written_by_byte_and_bit():
    async with wire_on(speed=50, on=False) as (_, wire):
        assert await wire.ask("@DO2()=5") == ["OK"]
        assert await wire.ask("@DO(23)=1") == ["OK"]
        assert await wire.ask("@DO2(0)=0") == ["OK"]
        assert await wire.ask("@?DO2()", 2) == ["12", "OK"]
        assert await wire.ask("@?DO2(3)", 2) == ["1", "OK"]
        assert await wire.ask("@?DI3()", 2) == ["0", "OK"]
        assert await wire.ask("@?SO1()", 2) == ["19", "OK"]
        assert await wire.ask("@ASGI0=-5") == ["OK"]
        assert await wire.ask("@?ASGI0", 2) == ["-5", "OK"]


# -- safety --------------------------------------------------------------------------------------------------


async def test_an_emergency_stop_in_motion_brakes_and_takes_the_power():
    async with wire_on() as (bench, wire):
        assert await wire.ask("@MOVE P,250.0 200.0 0.0 0.0 0.0 0.0,S=10") == ["RUN"]
        await asyncio.sleep(0.1)
        bench.safety(estop_pressed=True)
        assert not bench.stands(), "an arm needs its way to brake"
        assert await wire.lines(1) == ["NG=12.600"]
        assert bench.stands()
        assert not bench.arm.powered
        assert await wire.ask("@?EMG", 2) == ["1", "OK"]
        assert await wire.ask("@?ALM", 2) == ["12.600", "OK"]
        assert await wire.ask("@?DO0()", 2) == ["11", "OK"]
        assert await wire.ask("@ALMRST") == ["NG=12.600"]
        bench.safety(estop_pressed=False)
        assert await wire.ask("@MOTOR ON") == ["NG=6.399"]
        assert await wire.ask("@ALMRST", 2) == ["RUN", "END"]
        assert await wire.ask("@?MOTOR", 2) == ["0", "OK"]
        await wire.power_on()
        assert await wire.ask(MOVE, 2) == ["RUN", "END"]


@pytest.mark.parametrize("fact", [{"guard_open": True}, {"robot_enable": False}])
async def test_the_interlock_stops_the_arm_and_keeps_the_power(fact):
    async with wire_on() as (bench, wire):
        assert await wire.ask("@MOVE P,250.0 200.0 0.0 0.0 0.0 0.0,S=10") == ["RUN"]
        await asyncio.sleep(0.05)
        bench.safety(**fact)
        assert await wire.lines(1) == ["NG=12.400"]
        assert bench.stands()
        assert await wire.ask("@?MOTOR", 2) == ["2", "OK"]
        assert await wire.ask(MOVE) == ["NG=12.400"]
        bench.safety(guard_open=False, robot_enable=True)
        assert await wire.ask(MOVE, 2) == ["RUN", "END"]


@pytest.mark.parametrize("on_disconnect", ["stop", "continue"])
async def test_a_client_that_leaves_stops_the_arm_or_not_as_set(on_disconnect):
    async with wire_on(speed=10, on_disconnect=on_disconnect) as (bench, wire):
        assert await wire.ask("@MOVE P,250.0 200.0 0.0 0.0 0.0 0.0,S=2") == ["RUN"]
        while bench.position().y_mm < 20:
            await asyncio.sleep(0.002)
        wire.close()
        await asyncio.sleep(0.05)
        while not bench.stands():
            await asyncio.sleep(0.005)
        assert (bench.position().y_mm == pytest.approx(200)) == (on_disconnect == "continue")


# -- faults and the serial line ------------------------------------------------------------------------------


async def test_a_fault_that_does_not_exist_is_refused():
    async with wire_on(speed=50, on=False) as (bench, _):
        with pytest.raises(ValueError, match="no fault 'explode'"):
            bench.inject("robot", "explode")


async def test_faults_of_the_line_show_on_the_line():
    async with wire_on(speed=50) as (bench, wire):
        bench.inject("robot", "padded_codes")
        assert await wire.ask("@?P1") == ["NG=06.204"]
        bench.inject("robot", "almrst_ok")
        assert await wire.ask("@ALMRST") == ["OK"]
        bench.inject("robot", "ng_instead_of_end", code="17.800")
        assert await wire.ask(MOVE, 2) == ["RUN", "NG=17.800"]
        bench.inject("robot", "lost_end")
        assert await wire.ask(MOVE) == ["RUN"]
        assert await wire.silent()
        bench.inject("robot", "garbage")
        noise, *rest = await wire.ask("@?MODE", 3)
        assert rest == ["2", "OK"]
        assert len(noise) == 12
        bench.inject("robot", "split_bytes")
        assert await wire.ask("@?MODE", 2) == ["2", "OK"]
        bench.inject("robot", "split_bytes", on=False)
        bench.inject("robot", "coalesce")
        wire.send("@?MODE\r\n@?EMG\r\n")
        assert await wire.reader.read(100) == b"2\r\nOK\r\n0\r\nOK\r\n"
        bench.inject("robot", "mute")
        wire.send("@?MODE\r\n")
        assert await wire.silent()


async def test_a_serial_line_answers_at_its_baud_rate():
    async with controller_on(port=None, serial_baud=9600) as (_, controller):
        fd = os.open(controller.tty, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        began = time.monotonic()
        os.write(fd, b"@?WHRXY\r\n")
        data, pieces = b"", 0
        while not data.endswith(b"OK\r\n"):
            await asyncio.sleep(0.002)
            try:
                data += os.read(fd, 100)
                pieces += 1
            except BlockingIOError:
                assert time.monotonic() - began < 2
        took_s = time.monotonic() - began
        os.close(fd)

    assert data == f"{HERE}\r\nOK\r\n".encode()
    least_s = (9 + len(data)) * 11 / 9600
    assert least_s <= took_s < least_s + 0.1
    assert pieces > 5
