"""Recorded conversations of real controllers, replayed to the driver byte by byte: what it says, and how it reads."""

import asyncio
from contextlib import asynccontextmanager

import pytest

import drivers.conversation
import drivers.rcx2
import drivers.robot_motion
from drivers.errors import Collision, Refused
from drivers.rcx import Mode
from drivers.reach import Limits
from drivers.robot import Point, Robot

HERE = "300.000 0.000 10.000 0.000 0.000 0.000 1 0 0"
THERE = "310.000 0.000 10.000 5.000 0.000 0.000 1 0 0"
ON_THE_WAY = "304.512 0.000 10.000 2.250 0.000 0.000 1 0 0"
OPENING_3 = [
    ("\x03", []),
    ("@?MODE\r\n", ["2\r\nOK\r\n"]),
    ("@?MODE\r\n", ["2\r\nOK\r\n"]),
    ("@?WHRXY\r\n", [f"{HERE}\r\nOK\r\n"]),
    ("@?WHRXY\r\n", [f"{HERE}\r\nOK\r\n"]),
    ("@?MODE\r\n", ["2\r\nOK\r\n"]),
    ("@?EMG\r\n", ["0\r\nOK\r\n"]),
    ("@?ALM\r\n", ["0.0\r\nOK\r\n"]),
    ("@?MOTOR\r\n", ["2\r\nOK\r\n"]),
    ("@?SERVO\r\n", ["1 1,1,1,1\r\nOK\r\n"]),
    ("@?ORIGIN\r\n", ["1 1,1,1,1\r\nOK\r\n"]),
    ("@CHANGE OFF\r\n", ["OK\r\n"]),
    ("@?HAND\r\n", ["NG=5.252\r\n"]),
    ("@SHIFT OFF\r\n", ["OK\r\n"]),
    ("@?SHIFT\r\n", ["NG=5.252\r\n"]),
    ("@ASPEED 100\r\n", ["OK\r\n"]),
    ("@?ASPEED\r\n", ["100\r\nOK\r\n"]),
]
POS = "[POS]  100.00   50.00   10.00    0.00    0.00    0.00"
OPENING_2 = [
    ("\x03", []),
    ("@ETHER ECHO 0\r\n", ["OK\r\n"]),
    ("@?MOD\r\n", ["AUTO\r\n"]),
    ("@?MOD\r\n", ["AUTO\r\n"]),
    *(("@?WHRXY\r\n", [POS, "\r\n"]), ("@?ARM\r\n", ["RIGHTY\r\n"])) * 2,
    ("@?MOD\r\n", ["AUTO\r\n"]),
    ("@?EMG\r\n", ["OFF\r\n"]),
    ("@?SERVO\r\n", ["ON,99991111\r\n"]),
    ("@?ORIGIN\r\n", ["COMPLETE\r\n"]),
    ("@?DO0()\r\n", ["6\r\n"]),
    ("@CHANGE OFF\r\n", ["OK\r\n"]),
    ("@?HAND\r\n", ["OFF\r\n"]),
    ("@SHIFT OFF\r\n", ["OK\r\n"]),
    ("@?SHIFT\r\n", ["5.30:\xbc\xb7\xcd\xde\xc2\xbc\r\n"]),
    ("@ASPEED 100\r\n", ["OK\r\n"]),
    ("@?SPEED\r\n", ["100,50\r\n"]),
]
STATUS_3 = OPENING_3[5:11]
STATUS_2 = OPENING_2[8:13]


@pytest.fixture(autouse=True)
def deliberate(monkeypatch):
    """Nothing is asked but what the test asks for."""
    monkeypatch.setattr(drivers.robot_motion, "WATCH_EVERY_S", 60.0)
    monkeypatch.setattr(drivers.conversation, "SILENCE_S", 0.03)
    monkeypatch.setattr(drivers.rcx2.Rcx2, "greeting_s", 0.03)


@asynccontextmanager
async def controller(dialect, *conversation, greeting=(), **options):
    """A robot opened on a controller that says what was recorded; every byte of the driver must be the expected one."""
    wrong, left = [], list(conversation)

    async def serve(reader, writer):
        for piece in greeting:
            writer.write(piece.encode("latin-1"))
            await asyncio.sleep(0.005)
        while left:
            expected, answers = left[0]
            heard = await reader.read(len(expected))
            if heard.decode("latin-1") != expected:
                wrong.append((heard, expected))
                break
            left.pop(0)
            for piece in answers:
                writer.write(piece.encode("latin-1"))
                await asyncio.sleep(0.002)
        if expected != "LOGOUT\r\n":
            await reader.read(100)
        writer.close()

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
        address = f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        robot = Robot(address, limits=Limits(), dialect=dialect, **options)
        try:
            await robot.open()
            yield robot
        finally:
            await robot.close()
            assert wrong == []
        assert [expected for expected, _ in left] in ([], ["LOGOUT\r\n"])
        await asyncio.sleep(0.005)


WELCOME = ("Welcome to RCX340\r\n", "\r\n")


@pytest.mark.parametrize("greeting", [WELCOME, ("Welcome to RCX340\r\n\r\n",), ("Wel", "come to RCX320\r", "\n\r\n")])
async def test_an_rcx340_is_opened_and_moved_and_its_end_comes_between_data_and_ok(greeting):
    move = "@MOVE P,310.000 0.000 10.000 5.000 0.000 0.000 1,S=20\r\n"
    async with controller(
        "rcx3",
        *OPENING_3,
        (move, ["RUN\r\n"]),
        ("@?WHRXY\r\n", [f"{ON_THE_WAY}\r\n", "OK\r\n"]),
        ("@?WHRXY\r\n", [f"{THERE}\r\n", "END\r\n", "OK\r\n"]),
        ("@?WHRXY\r\n", [f"{THERE}\r\nOK\r\n"]),
        greeting=greeting,
    ) as robot:
        moving = asyncio.create_task(robot.move(Point(310, 0, 10, 5), speed_pct=20))
        await asyncio.sleep(0.02)
        assert (await robot.here()).x_mm == 304.512
        assert (await robot.here()).x_mm == 310
        assert await moving == (310, 0, 10, 5)


@pytest.mark.parametrize(
    "answers", [["RUN\r\n", "END\r\n"], ["RUN\r\nEND\r\n"], ["OK\r\n"], ["RU", "N\r", "\nEND", "\r\n"]]
)
async def test_power_and_alarm_reset_are_understood_as_each_firmware_answers(answers):
    alarm = [*STATUS_3[:2], ("@?ALM\r\n", ["17.800\r\nOK\r\n"]), *STATUS_3[3:]]
    off = [*STATUS_3[:3], ("@?MOTOR\r\n", ["0\r\nOK\r\n"]), ("@?SERVO\r\n", ["0 0,0,0,0\r\nOK\r\n"]), STATUS_3[5]]
    async with controller(
        *("rcx3", *OPENING_3),
        *(*alarm, ("@ALMRST\r\n", answers), *STATUS_3),
        *(*off, ("@MOTOR ON\r\n", answers), *STATUS_3),
        *OPENING_3[11:],
    ) as robot:
        await robot.reset_alarm()
        await robot.power_on()


@pytest.mark.parametrize("failure", ["NG=12.600", "NG=12.600 ", "NG= 12.600"])
async def test_a_move_that_an_emergency_stop_ends_is_told_with_its_code(failure):
    async with controller(
        "rcx3",
        *OPENING_3,
        ("@MOVE L,310.000 0.000 10.000 5.000 0.000 0.000 1,S=20\r\n", ["RUN\r\n", f"{failure}\r\n"]),
    ) as robot:
        with pytest.raises(Refused, match="emergency stop on") as refused:
            await robot.move(Point(310, 0, 10, 5), speed_pct=20, straight=True)
        assert refused.value.code == "12.600"


@pytest.mark.parametrize("failure", ["NG=06.204", "NG=6.204"])
async def test_codes_are_read_padded_or_not(failure):
    async with controller("rcx3", *OPENING_3, ("@?P7\r\n", [f"{failure}\r\n"])) as robot:
        assert await robot.points.one(7) is None


async def test_a_point_line_from_the_field_is_read():
    line = "11.000 -170.916 9.995 32.331 0.000 0.000 1 0 0"
    async with controller("rcx3", *OPENING_3, ("@?P11\r\n", [f"{line}\r\n", "OK\r\n"])) as robot:
        assert (await robot.points.one(11)).values == (11.0, -170.916, 9.995, 32.331, 0.0, 0.0)


async def test_a_program_goes_up_as_clients_in_the_field_send_it():
    lines = ["PGN=1", "P100=300.000 0.000 10.000 0.000 0.000 0.000 1 0 0", "MOVE P,P100,S=10", "WAIT ARM", "END"]
    async with controller(
        "rcx3",
        *OPENING_3,
        ("@WRITE <TRAJ_PG>\r\n", ["READY\r\n"]),
        ("NAME=TRAJ_PG\r\n" + "".join(f"{line}\r\n" for line in lines) + "\r\n", ["OK\r\n"]),
        ("@LOAD <TRAJ_PG>,T1\r\n", ["OK\r\n"]),
        ("@RUN\r\n", ["OK\r\n"]),
        ("@?TSKMON T1\r\n", ["TRAJ_PG,3,R,32\r\nOK\r\n"]),
        ("@STOP\r\n", ["OK\r\n"]),
        ("@READ <TRAJ_PG>\r\n", ["BEGIN\r\nNAME=TRAJ_PG\r\nMOVE P,P1\r\nEND\r\n", "END\r\n"]),
    ) as robot:
        await robot.programs.write("TRAJ_PG", lines)
        await robot.programs.load("TRAJ_PG")
        await robot.programs.run()
        assert (await robot.programs.task()).state == "R"
        await robot.programs.stop()
        assert await robot.programs.read("TRAJ_PG") == ["NAME=TRAJ_PG", "MOVE P,P1", "END"]


async def test_an_rcx222_is_moved_by_axes_that_answer_once_at_the_end():
    """Body and line end in two writes, as the first replies of a real one came."""
    end = "[POS]  110.00   50.00   10.00    0.00    0.00    0.00"
    async with controller(
        "rcx2",
        *OPENING_2,
        ("@RIGHTY\r\n", ["OK\r\n"]),
        ("@MOVE P,150.00 50.00 10.00 0.00 0.00 0.00,S=15\r\n", ["", "", "O", "K\r\n"]),
        *(("@?WHRXY\r\n", [end.replace("110.00", "150.00"), "\r\n"]), ("@?ARM\r\n", ["RIGHTY\r\n"])),
        ("LOGOUT\r\n", []),
    ) as robot:
        assert await robot.move(Point(150, 50, 10, 0), speed_pct=15) == (150, 50, 10, 0)


async def test_an_rcx240_that_follows_its_data_by_ok_is_understood_as_well():
    opening = [(sent, [*answers, "OK\r\n"] if "?" in sent else answers) for sent, answers in OPENING_2]
    opening = [(sent, [a for a in answers if sent != "@?SHIFT\r\n" or a != "OK\r\n"]) for sent, answers in opening]
    async with controller("rcx2", *opening, *[(s, [*a, "OK\r\n"]) for s, a in STATUS_2], ("LOGOUT\r\n", [])) as robot:
        status = await robot.status()
        assert (status.mode, status.ready) == (Mode.AUTOMATIC, True)


@pytest.mark.parametrize(
    ("failure", "kind", "words"),
    [
        ("2.1:Over soft limit", Refused, "soft limit over"),
        ("NG=2.1", Refused, "soft limit over"),
        ("12.1:\xcb\xbc\xde\xae\xb3\xc3\xb2\xbc", Refused, "emergency stop on"),
        ("17.4:Motor overload", Collision, "motor overload"),
        ("99.99:?", Refused, "unknown group, see the controller's manual"),
    ],
)
async def test_an_rcx240s_failures_are_read_in_any_language(failure, kind, words):
    async with controller(
        "rcx2",
        *OPENING_2,
        ("@RIGHTY\r\n", ["OK\r\n"]),
        ("@MOVE P,150.00 50.00 10.00 0.00 0.00 0.00,S=15\r\n", [f"{failure}\r\n"]),
        ("LOGOUT\r\n", []),
    ) as robot:
        with pytest.raises(kind, match=words):
            await robot.move(Point(150, 50, 10, 0), speed_pct=15)


async def test_a_telnet_board_that_negotiates_and_echoes_is_answered_and_seen_through():
    """FF FB 01 and FF FB 03 are refused; until then each line comes back before its answer."""
    echoed = [(sent, [sent, *answers]) if sent.startswith("@") else (sent, answers) for sent, answers in OPENING_2]
    async with controller(
        "rcx2",
        ("\xff\xfe\x01\xff\xfe\x03", []),
        *echoed,
        ("LOGOUT\r\n", []),
        greeting=("\xff\xfb\x01\xff\xfb\x03",),
    ) as robot:
        assert robot.is_open
