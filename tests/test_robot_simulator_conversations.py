"""Recorded conversations of other people's clients, answered as a real controller answered them.

Each client reads in its own way, some of them carelessly; what they need is part of what a controller is.
"""

import asyncio
import re

import pytest

from simulators.arm import ToolPose
from tests.robot_bench import Wire, controller_on, serial_wire_on, wire_on

FIELDS = rb"-?\d+\.\d{3} -?\d+\.\d{3} -?\d+\.\d{3} -?\d+\.\d{3} 0\.000 0\.000 1 0 0\r\nOK\r\n"
START = ToolPose(300.0, 0.0, 10.0, 0.0)
GREETING = "Welcome to RCX340\r\n\r\n"


class Segments:
    """A client that takes what one read gives it for a whole answer, as many do."""

    def __init__(self, reader, writer):
        self.reader, self.writer = reader, writer

    @classmethod
    async def to(cls, controller):
        return cls(*await asyncio.open_connection("127.0.0.1", controller.port))

    async def read(self, size=1024, within_s=2.0):
        async with asyncio.timeout(within_s):
            return await self.reader.read(size)

    async def ask(self, command, size=1024):
        self.writer.write(command if isinstance(command, bytes) else f"@{command}\r\n".encode())
        return await self.read(size)

    def close(self):
        self.writer.close()


async def said(wire, conversation):
    """Play it: what is sent, then exactly the bytes that must come."""
    for sent, answered in conversation:
        wire.send(sent)
        async with asyncio.timeout(3):
            assert await wire.reader.readexactly(len(answered)) == answered.encode(), sent


async def test_a_supervisor_that_moves_and_jogs_an_rcx340():
    async with controller_on(speed=4, start=START) as (bench, controller):
        wire = await Wire.to(controller, greeting=False)
        await said(
            wire,
            [
                ("", GREETING),
                ("@?MODE\r\n", "2\r\nOK\r\n"),
                ("@ALMRST\r\n", "RUN\r\nEND\r\n"),
                ("@SERVO ON\r\n", "RUN\r\nEND\r\n"),
                ("@?SERVO\r\n", "1 1,1,1,1\r\nOK\r\n"),
                ("@?ORIGIN\r\n", "1 1,1,1,1\r\nOK\r\n"),
                ("@?ALM\r\n", "0.0\r\nOK\r\n"),
                ("@?DO0()\r\n", "6\r\nOK\r\n"),
                ("@?WHRXY\r\n", "300.000 0.000 10.000 0.000 0.000 0.000 1 0 0\r\nOK\r\n"),
                ("@RIGHTY\r\n", "OK\r\n"),
                ("@TOLE 80\r\n", "OK\r\n"),
                ("@WEIGHTG 1000\r\n", "OK\r\n"),
                ("@CHANGE H1\r\n", "OK\r\n"),
                ("@MOVE L,300.0 60.0 10.0 5.0 0.0 0.0,S=2,ACC=100,DEC=100,CONT\r\n", "RUN\r\n"),
            ],
        )
        received = b""
        for _ in range(4):  # it polls while the arm moves
            wire.send("@?WHRXY\r\n")
            await asyncio.sleep(0.02)
            received += await wire.reader.read(1000)
        assert re.fullmatch(FIELDS * 4, received), received
        while not received.endswith(b"END\r\n"):
            received = await wire.reader.read(1000)
        await asyncio.sleep(0.3)  # with CONT the end comes before the arm stands
        await said(
            wire,
            [
                ("@?WHRXY\r\n", "300.000 60.000 10.000 5.000 0.000 0.000 1 0 0\r\nOK\r\n"),
                ("@IDIST 1000\r\n", "OK\r\n"),
                ("@INCHXY 1+\r\n", "RUN\r\nEND\r\n"),
                ("@STOP\r\n", "OK\r\n"),
                ("@JOGXY 1-\r\n", "RUN\r\n"),
            ],
        )
        for _ in range(5):
            wire.send(b"\x16\r\n")
            await asyncio.sleep(0.03)
        assert not bench.stands()
        await said(wire, [("\x03\r\n", "END\r\n")])
        assert bench.stands()
        wire.close()


async def test_a_plotter_that_draws_with_an_rcx240_over_a_serial_line():
    async with serial_wire_on(
        speed=20, dialect="rcx2", origin_at_start=False, start=ToolPose(250.0, 50.0, 10.0, 0.0)
    ) as (bench, wire):
        assert await wire.ask("@?ORIGIN") == ["INCOMPLETE"]
        assert await wire.ask("@ABSRST") == ["OK"]
        wire.send("@P0=250.00 60.00 10.00 0.0 0.0 0.0\r\n@P1=250.00 80.00 10.00 0.0 0.0 0.0\r\n")  # no waiting
        assert await wire.lines(2) == ["OK", "OK"]
        began_s = bench.clock.now()
        assert await wire.ask("@MOVE L,P0,P1,S=15") == ["OK"]
        assert bench.clock.now() - began_s > 0.15
        assert bench.stands()
        assert bench.position() == pytest.approx((250, 80, 10, 0), abs=1e-9)


async def test_the_plotters_burst_of_points_is_held_back_by_the_line_and_answered_one_by_one():
    async with serial_wire_on(speed=40, baud=38400, dialect="rcx2") as (bench, wire):
        points = [f"@P{k}={250 + k / 10:.2f} 50.00 10.00 0.0 0.0 0.0\r\n" for k in range(63)]
        moves = [f"@MOVE L,{','.join(f'P{k}' for k in range(n, n + 7))},S=100\r\n" for n in range(0, 63, 7)]
        assert await wire.ask("@MOVE P,P0") == ["6.4:Point does not exist"]
        wire.send(points[0])
        assert await wire.lines(1) == ["OK"]
        assert await wire.ask("@MOVE P,P0") == ["OK"]
        for line in points[1:] + moves:
            wire.send(line)
        assert await wire.lines(62 + 9, within_s=20) == ["OK"] * 71
        assert bench.position().x_mm == pytest.approx(256.2)


async def test_a_client_that_takes_each_read_for_one_reply():
    """It reads once per reply, and throws away what has come in before it sends again."""
    async with controller_on(speed=10) as (bench, controller):
        client = await Segments.to(controller)
        assert b"Welcome to RCX340" in await client.read()
        await client.read()
        assert await client.ask("STOP") == b"OK\r\n"
        assert await client.ask("ALMRST") == b"RUN\r\n"
        assert await client.read() == b"END\r\n"
        servo = (await client.ask("?SERVO")).decode()
        assert servo.count(",") >= 3
        assert len(servo.strip()) >= 9
        for axis in range(1, 5):
            assert await client.ask(f"SERVO ON({axis})") == b"RUN\r\n"
            assert await client.read() == b"END\r\n"
        assert await client.ask("ASPEED 100") == b"OK\r\n"
        assert await client.ask("DRIVE (1,0.0),S=1") == b"RUN\r\n"
        assert await client.read(within_s=20) == b"END\r\n"
        assert await client.ask("MOVE P,300.00 100.00 50.00 30.00 0.0 0.0 1,S=50.00") == b"RUN\r\n"
        assert await client.read() == b"END\r\n"
        assert (await client.ask("?WHRXY")).split()[:4] == [b"300.000", b"100.000", b"50.000", b"30.000"]
        assert bench.stands()
        client.close()


POLLED = ("?SERVO", "?WHRXY", "?DI2()", "?DI3()", "?DO2()", "?SO0()", "?SO1()")


async def test_a_client_with_ten_byte_buffers_polls_all_the_while():
    """RUN and END must each be all that a read of ten bytes gives; END may come inside the answer to a poll."""
    async with controller_on(speed=2) as (bench, controller):
        client = await Segments.to(controller)
        greeting = await client.read(100)
        assert (greeting, await client.read(100)) == (b"Welcome to RCX340\r\n", b"\r\n")
        assert await client.ask("MOTOR ON", 10) == b"RUN\r\n"
        assert await client.read(10) == b"END\r\n"
        assert await client.ask("ALMRST", 10) == b"RUN\r\n"
        assert await client.read(10) == b"END\r\n"
        assert await client.ask("MOVE P,250.000 150.000 20.000 0.000 0 0 1", 10) == b"RUN\r\n"
        ended = False
        while not ended:
            for query in POLLED:
                answer, reads = await client.ask(query, 100), 1
                while b"OK" not in answer:
                    answer, reads = answer + await client.read(100), reads + 1
                assert reads <= 3
                ended = ended or b"END" in answer
        assert bench.position() == pytest.approx((250, 150, 20, 0), abs=1e-6)
        for setting in ("IDIST 5000", "ACCEL 50", "DECEL 50", "MSPEED 30", "ASPEED 100", "TCHXY 5", "DO2(1)=1"):
            assert await client.ask(setting, 20) == b"OK\r\n"
        assert await client.ask("LOC1(P5)=200.000", 20) == b"OK\r\n"
        assert await client.ask("?LOC1(P5)", 20) == b"200.000\r\nOK\r\n"
        assert await client.ask("INCHXY 2-", 10) == b"RUN\r\n"
        assert await client.read(10) == b"END\r\n"
        assert await client.ask("JOGXY 1+", 10) == b"RUN\r\n"
        for _ in range(3):
            client.writer.write(b"\x16")
            await client.ask("?WHRXY", 100)
        assert await client.ask(b"\x03", 10) == b"END\r\n"
        for command in ("STOP ", "RESET "):
            assert await client.ask(command, 10) == b"OK\r\n"
        assert await client.ask("RUN", 20) == b"NG=3.208\r\n"  # there is no program
        client.close()


async def test_a_client_of_an_rcx240_over_the_network_that_wants_exactly_ok():
    async with controller_on(speed=10, dialect="rcx2") as (bench, controller):
        client = await Segments.to(controller)
        for command in ("STOP", "MANUAL", "EMGRST", "SERVO ON(1)", "SERVO ON(2)", "ACCEL(1)=50.00", "DECEL(1)=50.00"):
            assert await client.ask(command) == b"OK\r\n", command
        assert await client.ask("DRIVE(1,10.00),S=50.00") == b"OK\r\n"
        assert await client.ask("DRIVE(1,20.00),(2,45.00),S=80.00") == b"OK\r\n"
        assert await client.ask("DRIVEI(1,-5.00),S=80.00") == b"OK\r\n"
        assert bench.stands()
        answer = (await client.ask("?WHRXY")).decode()
        assert "[POS]" in answer
        tokens = [token for token in answer.split(" ") if token]
        assert float(tokens[1]) == pytest.approx(bench.position().x_mm, abs=0.005)
        for command in ("STOP", "MANUAL", "EMGRST", "AUTO", "RESET"):
            assert await client.ask(command) == b"OK\r\n", command
        client.close()


async def test_fixed_columns_of_the_older_position_line():
    async with serial_wire_on(speed=20, dialect="rcx2", start=ToolPose(120.25, -310.5, 7.0, -33.25)) as (_, wire):
        (line,) = await wire.ask("@?WHRXY ")
        assert line == "[POS]  120.25 -310.50    7.00  -33.25    0.00    0.00"
        (pulses,) = await wire.ask("@?WHERE")
        assert re.fullmatch(r"\[POS\]( +-?\d+){6}", pulses)
        assert len(pulses) == 5 + 6 * 8


async def test_a_program_with_its_points_is_written_selected_and_run_on_an_rcx240():
    """It waits for nothing, puts a blank before every line end, and ends its files with a blank line."""
    async with serial_wire_on(speed=40, baud=38400, dialect="rcx2") as (bench, wire):
        for line in (
            *("@SYSTEM ", "@WRITE PGM ", "NAME=DATA", "MOVE P,P1,S=50", "DO(20)=1", "MOVE P,P2", "HALT", " "),
            *("@WRITE PNT ", "P1=300.00 0.00 10.00 0.00 0.00 0.00", "P2=250.00 100.00 0.00 0.00 0.00 0.00", " "),
            *("@AUTO ", "@SWI <DATA> ", "@RUN "),
        ):
            wire.send(f"{line}\r\n")
        assert await wire.lines(8) == ["OK", "READY", "OK", "READY", "OK", "OK", "OK", "OK"]
        async with asyncio.timeout(5):
            while bench.controller.machine.running():
                await asyncio.sleep(0.01)
        assert bench.position() == pytest.approx((250, 100, 0, 0), abs=1e-6)
        assert await wire.ask("@?DO2()") == ["1"]


UPLOAD = (
    "@WRITE <TRAJ_PG>",
    "NAME=TRAJ_PG",
    "PGN=1",
    "P100=300.000000 50.000000 20.000000 30.000000 0.0 0.0",
    "P101=250.000000 120.000000 20.000000 0.000000 0.0 0.0",
    "P102=-29127 131072 16384 0 0 0",
    "MOVE P,P100,S=10.000000,A3=0.000000{0.000000,0.000000}",
    "WAIT ARM",
    "MOVE L,P101,VEL=200.000000,CONT",
    "MOVE P,P102,S=50",
    "WAIT ARM",
    "END",
    "",
    "@LOAD <TRAJ_PG>,T1",
    "@RUN T1",
)


async def test_trajectories_are_uploaded_and_watched_while_ten_questions_come_every_tenth_of_a_second():
    async with wire_on(speed=5) as (bench, wire):
        for _ in range(2):  # the second time over the program that is loaded
            for line in UPLOAD:
                wire.send(f"{line}\r\n")
            assert await wire.lines(4) == ["READY", "OK", "OK", "OK"]
            states = []
            while states[-1:] != ["S"]:
                for query in (
                    "?WHERE",
                    "?WHRXY",
                    "?ALM",
                    "?MSPEED",
                    "?ORIGIN",
                    "?MOTOR",
                    "?MODE",
                    "?EMG",
                    "?TSKMON T1",
                ):
                    wire.send(f"@{query}\r\n")
                replies = await wire.lines(18)
                assert replies[1::2] == ["OK"] * 9
                assert len(replies[0].split()) == 6
                assert len(replies[2].split()) == 9
                states.append(replies[16].split(",")[2])
                await asyncio.sleep(0.02)
            assert states[0] == "R"
            pulses = (await wire.ask("@?WHERE", 2))[0].split()[:4]
            assert pulses == ["-29127", "131072", "16384", "0"]
        assert bench.stands()


async def test_a_state_query_before_any_program_is_loaded_names_a_stopped_task():
    async with wire_on(speed=20) as (_, wire):
        assert await wire.ask("@? TSKMON T1", 2) == ["0,0,S,32", "OK"]


@pytest.mark.parametrize(
    ("sent", "answered"),
    [
        (b"@ ?WHERE \r", rb"-?\d+( -?\d+){5}\r\nOK\r\n"),
        (b"@ ?WHRXY \r", FIELDS),
        (b"@ ?MSPEED \r", rb"20\r\nOK\r\n"),
        (b"@ ?IDIST \r", rb"1000\r\nOK\r\n"),
        (b"@ ?ACCEL(1) \r", rb"100\r\nOK\r\n"),
        (b"@ ?ASGI0 \r", rb"0\r\nOK\r\n"),
        (b"@ ?MOTOR \r", rb"2\r\nOK\r\n"),
        (b"@ ?EMG \r", rb"0\r\nOK\r\n"),
        (b"@ ?ALM \r", rb"0\.0\r\nOK\r\n"),
        (b"@ ?DI2() \r", rb"0\r\nOK\r\n"),
        (b"@ ?DI2(3) \r", rb"0\r\nOK\r\n"),
        (b"@ MSPEED 50 \r", rb"OK\r\n"),
        (b"@ JOG 1+ \r", rb"RUN\r\n"),
        (b"@ INCHXY 3+ \r", rb"RUN\r\n"),
        (b"@ABSRST \r", rb"NG=5\.252\r\n"),  # a word of the older generation
        (b"@? WHERE\r\n", rb"-?\d+( -?\d+){5}\r\nOK\r\n"),
        (b"@? ARMCND\r\n", rb"1\r\nOK\r\n"),
        (b"@ARMSEL 2\r\n", rb"OK\r\n"),
        (b"@MOTOR FREE\r\n", rb"RUN\r\n"),
        (b"@TORQUE (1)=20\r\n", rb"OK\r\n"),
        (b"@P501=300.000 0.000 10.000 0.000 0.0 0.0 1 0 0\r\n", rb"OK\r\n"),
        (b"@P0=300.0 0.0 10.000 0 0 0\r\n", rb"OK\r\n"),
        (b"@MOVE P,300.0 0.0 0 0.0 0 0, S=50\r\n", rb"RUN\r\n"),
    ],
)
async def test_what_other_clients_of_an_rcx340_send(sent, answered):
    async with wire_on(speed=20) as (_, wire):
        wire.send(sent)
        async with asyncio.timeout(1):
            received = await wire.reader.readuntil(b"OK\r\n" if b"OK" in answered else b"\r\n")
        assert re.fullmatch(answered, received), received


@pytest.mark.parametrize(
    ("sent", "answered"),
    [
        ("@? WHERE", r"\[POS\]( +-?\d+){6}"),
        ("@? ABSRST", "COMPLETE"),
        ("@? SERVO", "ON,99991111"),
        ("@? EMG", "OFF"),
        ("@? MOD", "AUTO"),
        ("@? ARM", "RIGHTY"),
        ("@?SPEED", "100,20"),
        ("@?UNIT", "PULSE"),
        ("@PROGRAM", "OK"),
        ("@WAIT ARM", "OK"),
        ("@ARMTYP 0,0", "OK"),
        ("@TEACH 12", "OK"),
        ("@DO2()=3", "OK"),
        ("@?DO2()", "0"),
        ("@SERVO FREE", "OK"),
        ("@JOG R-", "OK"),
        ("@MOTOR ON", r"5\.52:.*"),  # a word of the newer generation
        ("@FOO", r"5\.52:.*"),
        ("FOO", r"14\.22:.*"),
        ("@" + "X" * 80, r"14\.20:.*"),
        ("@MOVE P,P77", r"6\.4:.*"),
    ],
)
async def test_what_other_clients_of_an_rcx240_send(sent, answered):
    async with wire_on(speed=20, dialect="rcx2") as (_, wire):
        (received,) = await wire.ask(sent)
        assert re.fullmatch(answered, received), received
        assert await wire.silent(), "one line answers everything"


async def test_a_client_that_writes_one_point_and_pads_its_packets_with_nul():
    async with wire_on(speed=20, dialect="rcx2") as (_, wire):
        wire.send(b"@?WHRXY\r\n".ljust(16, b"\0"))
        assert (await wire.lines(1))[0].startswith("[POS]")
        wire.send("@WRITE P8\r\nP8=300.5 1.5 2.5 3.5 0 0\r\n")
        assert await wire.lines(2) == ["READY", "OK"]
        assert await wire.ask("@READ P8", 2) == ["P8=  300.50    1.50    2.50    3.50    0.00    0.00", "END"]
