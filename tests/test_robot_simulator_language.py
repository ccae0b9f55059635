"""The robot language: what programs compute, where they go, and how wrong ones are refused."""

import asyncio
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.robot.codes import BY_RCX2, Code, Refusal
from simulators.robot.language.expressions import expression
from simulators.robot.language.program import compiled, parse_source
from simulators.robot.language.tokens import tokens_of, upper
from simulators.robot.language.values import PointData, point_data
from simulators.robot.options import Options
from simulators.robot.rcx2 import Rcx2
from simulators.robot.rcx3 import Rcx3
from tests.robot_bench import wire_on

RCX2, RCX3 = Rcx2(Options()), Rcx3(Options())


class Names:
    """A scope with some names in it."""

    def variable(self, name, indices):
        return {"A%": 3, "B!": 2.5, "T$": "abc"}.get(name, 0)

    def point(self, number):
        return PointData((float(number), 1.0, 2.0, 3.0, 0.0, 0.0), in_pulses=number > 100)

    def port(self, port):
        return 5 if not port.bits else 1

    def setting(self, name, index):
        return 100 if index is None else index


def value(text):
    return expression(upper(text))(Names())


def refused(do, *arguments):
    with pytest.raises(Refusal) as refusal:
        do(*arguments)
    return refusal.value


# -- expressions ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("1+2*3", 7),
        ("(1+2)*3", 9),
        ("-2^2", -4),
        ("2^3^2", 512),
        ("7 mod 3", 1),
        ("-7 MOD 3", -1),
        ("7/2", 3.5),
        ("1<2", -1),
        ("1=>2", 0),
        ("3><3", 0),
        ("not 0", -1),
        ("1=1 and 2=2", -1),
        ("5 AND 3 OR 8", 9),
        ("6 XOR 3", 5),
        ("&HFF", 255),
        ("&B101", 5),
        ("&HFFFFFFFF", -1),
        ("A%*B!", 7.5),
        ('"ab"+"c"=T$', -1),
        ("abs(-4)+int(2.9)", 6),
        ("sqr(16)", 4),
        ("raddeg(degrad(30))", pytest.approx(30)),
        ("LOC1(P5)", 5.0),
        ("LOC1(P[A%+2])", 5.0),
        ("LOC2(P5+P6)", 2.0),
        ("DI2()", 5),
        ("DI(20)", 1),
        ("DO2(3,0)", 1),
        ("ACCEL(2)", 2),
        ("ASPEED", 100),
        ("P5", PointData((5.0, 1.0, 2.0, 3.0, 0.0, 0.0), False)),
    ],
)
def test_an_expression_has_its_value(text, result):
    assert value(text) == result


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("1/0", Code.DIVISION_BY_ZERO),
        ("1 MOD 0", Code.DIVISION_BY_ZERO),
        ("1+", Code.SYNTAX),
        ("(1", Code.SYNTAX),
        ("5x", Code.DATA),
        ("1 2", Code.DATA),
        ('1+"a"', Code.TYPE_MISMATCH),
        ("P5=P6", Code.TYPE_MISMATCH),
        ("P5+P105", Code.COORDINATE_TYPE),
        ("SQR(-1)", Code.FUNCTION_CALL),
        ("SIN()", Code.FUNCTION_CALL),
        ("(-8)^0.5", Code.FUNCTION_CALL),
        ("10^400", Code.OUT_OF_RANGE),
        ("DI2(8)", Code.BIT_NUMBER),
        ("DI(28)", Code.BIT_NUMBER),
        ("DI()", Code.SYNTAX),
        ("1234567890123", Code.NUMBER),
        ("(" * 60 + "1" + ")" * 60, Code.STACK_OVERFLOW),
        ("-" * 60 + "1", Code.STACK_OVERFLOW),
    ],
)
def test_a_wrong_expression_is_refused_with_its_code(text, code):
    assert refused(value, text).code is code


@settings(deadline=None)
@given(st.integers(-9999, 9999), st.integers(-9999, 9999), st.sampled_from("+-*"))
def test_whole_numbers_are_computed_as_such(a, b, sign):
    assert value(f"({a}){sign}({b})") == {"+": a + b, "-": a - b, "*": a * b}[sign]


@settings(deadline=None)
@given(st.lists(st.floats(-999, 999), min_size=6, max_size=6), st.sampled_from([0, 1, 2]))
def test_points_are_read_as_they_are_printed(numbers, hand):
    point = point_data(" ".join(f"{n:.3f}" for n in numbers) + f" {hand}")
    assert point_data(RCX3.point(point)) == point
    assert not point.in_pulses
    assert point.values == pytest.approx(numbers, abs=0.00051)
    again = point_data(RCX2.point(point))
    assert again.values == pytest.approx(numbers, abs=0.0056)


@settings(deadline=None)
@given(st.lists(st.integers(-999999, 999999), min_size=6, max_size=6))
def test_whole_numbers_are_pulses_in_both_generations(pulses):
    point = point_data(" ".join(map(str, pulses)))
    assert point.in_pulses
    assert point_data(RCX3.point(point)).values == point_data(RCX2.point(point)).values == point.values


def test_quotes_keep_small_letters_and_comments_are_nothing():
    assert upper('print "aB" c') == 'PRINT "aB" C'
    assert [token.text for token in tokens_of("A=1 'and so on")] == ["A", "=", "1"]


def test_every_code_is_told_apart_in_both_lists():
    assert len({code.rcx3 for code in Code}) == len(Code)
    for code in Code:
        assert RCX3.failure(code) == f"NG={code.rcx3}"
        assert RCX2.failure(code).startswith(f"{code.rcx2}:")
        assert RCX3.code_of(code.rcx3) is code
        group, number = map(int, code.rcx3.split("."))
        if group in (3, 4, 5) and number < 264:
            assert code.rcx2 == f"{group}.{number - 200}", "the rule that links the generations"
    assert BY_RCX2["5.52"] is Code.NO_SUCH_COMMAND


def test_the_older_generation_can_speak_katakana_or_codes():
    japanese = Rcx2(Options(language="japanese")).failure(Code.UNDEFINED_IDENTIFIER)
    assert japanese.startswith("5.30:")
    assert all(0xA1 <= ord(letter) <= 0xDF or letter in " " for letter in japanese[5:])
    assert Rcx2(Options(errors="ng")).failure(Code.NO_POINT) == "NG=6.4"
    assert Rcx3(Options(padded_codes=True)).failure(Code.NO_POINT) == "NG=06.204"


# -- programs that are wrong ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lines", "code", "line"),
    [
        (["GOTO *NOWHERE"], Code.UNDEFINED_LABEL, 1),
        (["*A:", "*A:"], Code.DUPLICATE_LABEL, 2),
        (["IF A=1 THEN", "B=1"], Code.IF_WITHOUT_ENDIF, 1),
        (["ENDIF"], Code.ENDIF_WITHOUT_IF, 1),
        (["A=1", "ELSE"], Code.ELSE_WITHOUT_IF, 2),
        (["FOR I=1 TO 3"], Code.FOR_WITHOUT_NEXT, 1),
        (["NEXT"], Code.NEXT_WITHOUT_FOR, 1),
        (["WHILE 1"], Code.WHILE_WITHOUT_WEND, 1),
        (["WEND"], Code.WEND_WITHOUT_WHILE, 1),
        (["SELECT CASE A", "CASE 1"], Code.SELECT_WITHOUT_END_SELECT, 1),
        (["SUB *S"], Code.SUB_WITHOUT_END_SUB, 1),
        (["END SUB"], Code.END_SUB_WITHOUT_SUB, 1),
        (["SUB *S", "END SUB", "SUB *S", "END SUB"], Code.DUPLICATE_LABEL, 3),
        (["A=1", "CALL *S"], Code.UNDEFINED_IDENTIFIER, 2),
        (["CALL *S(1)", "HALT", "SUB *S", "END SUB"], Code.COMMAND_LINE, 1),
        (["ON ERROR GOTO *E"], Code.UNDEFINED_LABEL, 1),
        (["ON A% GOTO *E"], Code.SYNTAX, 1),
        (["CALL S"], Code.SYNTAX, 1),
        (["SUB *S(A%"], Code.SYNTAX, 1),
        (["INPUT A%+1"], Code.SYNTAX, 1),
        (["CASE 1"], Code.CASE_WITHOUT_SELECT, 1),
        (["END SELECT"], Code.END_SELECT_WITHOUT_SELECT, 1),
        (["EXIT FOR"], Code.EXIT_FOR_WITHOUT_FOR, 1),
        (["FOR I=1 TO 3", "WHILE 1", "NEXT", "WEND"], Code.NEXT_WITHOUT_FOR, 3),
        (["A=1", "FROBNICATE"], Code.NO_SUCH_COMMAND, 2),
        (["MOVE X,P1"], Code.SYNTAX, 1),
        (["MOVE P,P1,Q=5"], Code.OPTION, 1),
        (["A="], Code.SYNTAX, 1),
        (["IF A=1 THEN GOTO *X"], Code.UNDEFINED_LABEL, 1),
        (["WAIT"], Code.SYNTAX, 1),
    ],
)
def test_a_program_that_cannot_run_is_refused_with_its_line(lines, code, line):
    refusal = refused(compiled, parse_source("X", lines), RCX3.words)
    assert (refusal.code, refusal.line) == (code, line)


@pytest.mark.parametrize("name", ["", "A B", "Ä", "X" * 33])
def test_a_program_needs_a_name(name):
    assert refused(parse_source, None, [f"NAME={name}"]).code is Code.PROGRAM_NAME


# -- programs that run ---------------------------------------------------------------------------------------


async def begun(wire, lines):
    """Upload and run."""
    for line in ("@WRITE <T>", "NAME=T", *lines, "", "@LOAD <T>,T1", "@RUN"):
        wire.send(f"{line}\r\n")
    assert await wire.lines(4) == ["READY", "OK", "OK", "OK"]


async def ran(wire, bench, lines, within_s=10.0):
    """Upload and run to the end; returns what it printed."""
    await begun(wire, lines)
    async with asyncio.timeout(within_s):
        while bench.controller.machine.running():
            await asyncio.sleep(0.005)
    return [value for entry in bench.controller.log.of("print") for value in entry.values]


@pytest.mark.parametrize(
    ("lines", "printed"),
    [
        (["FOR I%=1 TO 3", "PRINT I%", "NEXT I%"], [1, 2, 3]),
        (["FOR I%=3 TO 1 STEP -1", "PRINT I%", "IF I%=2 THEN", "EXIT FOR", "ENDIF", "NEXT", "PRINT 9"], [3, 2, 9]),
        (["FOR I%=5 TO 1", "PRINT I%", "NEXT"], []),
        (["FOR I%=1 TO 9", "PRINT I%", "IF I%=2 THEN EXIT FOR", "NEXT", "PRINT 7"], [1, 2, 7]),
        (["A%=0", "WHILE A%<3", "A%=A%+1", "PRINT A%", "WEND"], [1, 2, 3]),
        (["A%=2", "IF A%=1 THEN", "PRINT 1", "ELSEIF A%=2 THEN", "PRINT 2", "ELSE", "PRINT 3", "ENDIF"], [2]),
        (["A%=9", "IF A%=1 THEN", "PRINT 1", "ELSEIF A%=2 THEN", "PRINT 2", "ELSE", "PRINT 3", "END IF"], [3]),
        (["A%=1", "IF A%=1 THEN PRINT 1:PRINT 2 ELSE PRINT 3"], [1, 2]),
        (["IF 0 THEN *E", "PRINT 1", "GOTO *F", "*E: PRINT 2", "*F:", "PRINT 3"], [1, 3]),
        (["GOSUB *S", "PRINT 2", "HALT", "*S:", "PRINT 1", "RETURN"], [1, 2]),
        (["SELECT CASE 2+1", "CASE 1,2", "PRINT 1", "CASE 3", "PRINT 3", "CASE ELSE", "PRINT 9", "END SELECT"], [3]),
        (["SELECT CASE 7", "CASE 1", "PRINT 1", "CASE ELSE", "PRINT 9", "END SELECT"], [9]),
        (["DIM A%(3)", "FOR I%=0 TO 3", "A%(I%)=I%*I%", "NEXT", "PRINT A%(3)"], [9]),
        (
            ["P1=100.0 200.0 0.0 0.0 0.0 0.0", "P2=P1+P1", "PRINT LOC1(P2)", "LOC1(P2)=5.5", "PRINT LOC1(P2)"],
            [200.0, 5.5],
        ),
        (["SGI1=7", "ASGI0=8", "PRINT SGI1+ASGI0", 'T$="x"', 'PRINT T$+"y"'], [15, "xy"]),
        (["DO2()=&B101", "PRINT DO2(2,0)", "SET DO2(1)", "RESET DO(20)", "PRINT DO2()"], [3, 6]),
        (["REM one: two 'three", "PRINT 1 'comment"], [1]),
        (["WAIT DI(20)=1,50", "PRINT TIMEOUT"], [1]),
        (["CALL *S(2,3)", "PRINT A%", "HALT", "SUB *S(A%,B%)", "A%=A%*B%", "PRINT A%", "END SUB"], [6, 0]),
        (["N%=1", "CALL *S", "PRINT N%", "HALT", "SUB *S", "SHARED N%", "N%=5", "EXIT SUB", "N%=9", "END SUB"], [5]),
        (
            ["CALL *F(3)", "HALT", "SUB *F(N%)", "IF N%=0 THEN EXIT SUB", "CALL *F(N%-1)", "PRINT N%", "END SUB"],
            [1, 2, 3],
        ),
        (
            [
                "CALL *S",
                "HALT",
                "SUB *S",
                "FOR I%=1 TO 2",
                "GOSUB *G",
                "NEXT",
                "EXIT SUB",
                "*G: PRINT I%",
                "RETURN:END SUB",
            ],
            [1, 2],
        ),
        (["ON ERROR GOTO *E", "PRINT 1/0", "PRINT 2", "HALT", "*E:", "PRINT ERR,ERL", "RESUME NEXT"], [393419, 2, 2]),
        (["ON ERROR GOTO *E", "A%=0", "PRINT 6/A%", "HALT", "*E: A%=3", "RESUME"], [2.0]),
        (["ON ERROR GOTO *E", "PRINT LOC1(P9)", "HALT", "*E:", "RESUME *F", "*F:", "PRINT 4"], [4]),
    ],
)
async def test_a_program_does_what_it_says(lines, printed):
    async with wire_on(speed=100, on=False) as (bench, wire):
        assert await ran(wire, bench, lines) == printed
        assert (await wire.ask("@?TSKMON T1", 2))[0] == "T,0,S,32"


PICK_AND_PLACE = """\
NAME=PICK
ASPEED 100
P1=250.000 100.000 0.000 0.000 0.000 0.000
P2=250.000 100.000 60.000 0.000 0.000 0.000
P3=300.000 -80.000 0.000 45.000 0.000 0.000
P4=300.000 -80.000 55.000 45.000 0.000 0.000
RESET DO(20)
FOR N%=1 TO 2
  MOVE P,P1,S=80
  MOVE L,P2,VEL=200
  WAIT ARM
  DO(20)=1
  DELAY 100
  IF DI(20)<>1 THEN *MISSED
  MOVE P,P1
  MOVE P,P3,CONT
  MOVE L,P4,S=30
  WAIT ARM
  RESET DO(20)
  WAIT DI(20)=0,500
  MOVE P,P3,A3=0.0{10.0,10.0}
  ASGI0=N%
NEXT N%
HALT
*MISSED:
ASGI1=1
DRIVE (3,0.0)
HALT
""".splitlines()


async def test_a_pick_and_place_program_runs_with_its_vacuum():
    async with wire_on(speed=20) as (bench, wire):
        machine = bench.controller.machine
        held = []

        async def cup():
            while True:
                on = machine.ports._bytes.get(("DO", 2), 0) & 1
                bench.inject("robot", "input", port=2, bit=0, on=bool(on))
                if (on and len(held) % 2 == 0) or (not on and len(held) % 2 == 1):
                    held.append(bench.position())
                await asyncio.sleep(0.001)

        gripping = asyncio.create_task(cup())
        await ran(wire, bench, PICK_AND_PLACE[1:], within_s=20)
        gripping.cancel()
        assert await wire.ask("@?ASGI0", 2) == ["2", "OK"]
        assert await wire.ask("@?ASGI1", 2) == ["0", "OK"]
    assert len(held) == 4
    for place, expected in zip(held, [(250, 100, 60, 0), (300, -80, 55, 45)] * 2, strict=True):
        assert place == pytest.approx(expected, abs=0.01)


async def test_without_a_part_the_program_goes_to_its_label():
    async with wire_on(speed=50) as (bench, wire):
        await ran(wire, bench, PICK_AND_PLACE[1:], within_s=20)
        assert await wire.ask("@?ASGI1", 2) == ["1", "OK"]
        assert bench.position().z_mm == pytest.approx(0, abs=1e-6)


async def test_an_error_in_a_running_program_stops_it_there_and_is_told():
    async with wire_on(speed=50) as (bench, wire):
        await ran(wire, bench, ["A%=0", "PRINT 1", "PRINT 5/A%", "PRINT 2"])
        assert [value for entry in bench.controller.log.of("print") for value in entry.values] == [1]
        assert (await wire.ask("@?TSKMON T1", 2))[0] == "T,3,S,32"
        assert (await wire.ask("@?MSG", 2))[0].startswith("6.203")
        assert await wire.ask("@?ALM", 2) == ["0.0", "OK"]


@pytest.mark.parametrize(
    ("lines", "code"),
    [
        (["SUB *S", "PRINT 1", "END SUB"], "6.208"),
        (["EXIT SUB"], "6.209"),
        (["RESUME"], "6.201"),
        (["SHARED A%"], "6.201"),
        (["ON ERROR GOTO *E", "PRINT 1/0", "HALT", "*E:", "PRINT 2/0"], "6.203"),
        (["ON ERROR GOTO *E", "ON ERROR GOTO 0", "PRINT 1/0", "*E:", "PRINT 2"], "6.203"),
        (["CALL *S", "HALT", "SUB *S", "CALL *S", "END SUB"], "5.212"),
    ],
)
async def test_a_wrong_way_through_a_program_stops_it_with_its_code(lines, code):
    async with wire_on(speed=100, on=False) as (bench, wire):
        await ran(wire, bench, lines)
        assert (await wire.ask("@?MSG", 2))[0].partition(":")[0] == code


async def test_an_error_number_has_the_group_in_its_upper_byte_on_an_rcx240():
    async with wire_on(speed=100, dialect="rcx2") as (bench, wire):
        for line in ("@WRITE PGM", "NAME=T", "ON ERROR GOTO *E", "PRINT 1/0", "*E: PRINT ERR", "", "@SWI <T>", "@RUN"):
            wire.send(f"{line}\r\n")
        assert await wire.lines(4) == ["READY", "OK", "OK", "OK"]
        while bench.controller.machine.running():
            await asyncio.sleep(0.005)
        assert [entry.values for entry in bench.controller.log.of("print")] == [[6 << 8 | 3]]


ASKS = ['INPUT "how many?",A%,T$', "PRINT A%+1,T$", "INPUT P5", "PRINT LOC2(P5)", "INPUT A%"]


async def test_a_program_asks_on_the_line_and_is_answered_there():
    async with wire_on(speed=50, on=False, dialogue="line") as (bench, wire):
        await begun(wire, ASKS)
        assert await wire.lines(1) == ["how many?"]
        assert await wire.ask("@?MODE", 2) == ["2", "OK"]
        assert await wire.ask('41, "left"') == ["42 left"]
        assert await wire.ask("1.0 2.5 0.0 0.0 0.0 0.0") == ["2.5"]
        wire.send("many\r\n")
        while bench.controller.machine.running():
            await asyncio.sleep(0.005)
        assert (await wire.ask("@?MSG", 2))[0].startswith("5.202")
        assert await wire.ask("many") == ["NG=14.222"]


async def test_a_program_asks_at_the_pendant_unless_it_is_set_otherwise():
    async with wire_on(speed=50, on=False) as (bench, wire):
        with pytest.raises(ValueError, match="no program asks"):
            bench.inject("robot", "key_in", text="1")
        await begun(wire, ["INPUT A%", "PRINT A%", "INPUT A%"])
        while not bench.controller.machine.dialogue.asks:
            await asyncio.sleep(0.005)
        assert await wire.ask("5") == ["NG=14.222"]
        bench.inject("robot", "key_in", text="5")
        while not bench.controller.machine.dialogue.asks:
            await asyncio.sleep(0.005)
        assert await wire.ask("@STOP") == ["OK"]
        assert [entry.values for entry in bench.controller.log.of("print")] == [[5]]
        assert not bench.controller.machine.dialogue.asks


async def test_a_stopped_program_goes_on_where_it_was_and_a_reset_one_from_the_start():
    async with wire_on(speed=4) as (bench, wire):
        lines = ["MOVE P,P1,S=5", "PRINT 1", "MOVEI P,P2,S=1", "PRINT 2"]
        assert await wire.ask("@P1=250.0 50.0 0.0 0.0 0.0 0.0") == ["OK"]
        assert await wire.ask("@P2=0.0 40.0 0.0 0.0 0.0 0.0") == ["OK"]
        for line in ("@WRITE <T>", "NAME=T", *lines, "", "@LOAD <T>,T1", "@RUN"):
            wire.send(f"{line}\r\n")
        await wire.lines(4)
        while not bench.controller.log.of("print"):
            await asyncio.sleep(0.002)
        while bench.position().y_mm < 60:  # well into the relative motion
            await asyncio.sleep(0.002)
        assert await wire.ask("@STOP") == ["OK"]
        assert bench.stands()
        assert 50 < bench.position().y_mm < 90
        assert (await wire.ask("@?TSKMON T1", 2))[0] == "T,3,S,32"
        assert await wire.ask("@RUN") == ["OK"]
        async with asyncio.timeout(5):
            while bench.controller.machine.running():
                await asyncio.sleep(0.005)
        assert bench.position().y_mm == pytest.approx(90), "the rest of the relative motion, not all of it again"
        assert await wire.ask("@RESET") == ["OK"]
        assert (await wire.ask("@?TSKMON T1", 2))[0] == "T,0,S,32"


async def test_what_is_refused_while_a_program_runs():
    async with wire_on(speed=4) as (_, wire):
        for line in ("@WRITE <T>", "NAME=T", "PRINT 1", "*A:", "DELAY 10", "GOTO *A", "", "@LOAD <T>", "@RUN"):
            wire.send(f"{line}\r\n")
        assert await wire.lines(4) == ["READY", "OK", "OK", "OK"]
        for refused_line in ("@MOVE P,250.0 0.0 1.0 0.0 0.0 0.0", "@LOAD <T>", "@WRITE <T>", "@RESET", "@ASPEED 10"):
            assert await wire.ask(refused_line) == ["NG=6.281"], refused_line
        assert await wire.ask("@ASGI0=3") == ["OK"], "variables are how client and program talk"
        assert await wire.ask("@?DO1()", 2) == ["11", "OK"]
        assert await wire.ask("@STOP") == ["OK"]
        assert await wire.ask("@?DO1()", 2) == ["3", "OK"]
        assert await wire.ask("@RESET") == ["OK"]
        assert await wire.ask("@?DO1()", 2) == ["19", "OK"]


async def test_a_program_that_goes_round_for_ever_leaves_the_controller_alive():
    async with wire_on(speed=100) as (_, wire):
        for line in ("@WRITE <T>", "NAME=T", "*A: GOTO *A", "", "@LOAD <T>", "@RUN"):
            wire.send(f"{line}\r\n")
        assert await wire.lines(4) == ["READY", "OK", "OK", "OK"]
        for _ in range(20):
            assert await wire.ask("@?MODE", 2) == ["2", "OK"]
        assert await wire.ask("@STOP") == ["OK"]


async def test_tasks_start_one_another_and_share_the_arm():
    async with wire_on(speed=50) as (bench, wire):
        for line in (
            *("@WRITE PGM", "NAME=MAIN", "START <SUB>,T2", "MOVE P,P1,S=20", "PRINT 1", "WAIT SGI1=1", "PRINT 3"),
            *("NAME=SUB", "MOVE P,P2,S=20", "PRINT 2", "SGI1=1", ""),
            *("@P1=260.0 0.0 0.0 0.0 0.0 0.0", "@P2=260.0 50.0 0.0 0.0 0.0 0.0", "@LOAD <MAIN>", "@RUN"),
        ):
            wire.send(f"{line}\r\n")
        assert await wire.lines(6) == ["READY", *["OK"] * 5]
        async with asyncio.timeout(5):
            while bench.controller.machine.running():
                await asyncio.sleep(0.005)
        assert sorted(v for entry in bench.controller.log.of("print") for v in entry.values) == [1, 2, 3]
        assert len(bench.controller.log.of("moves")) == 2


async def test_points_hands_shifts_and_programs_can_be_read_back():
    async with wire_on(speed=20, on=False) as (_, wire):
        for line in (
            *("@WRITE PNT", "P1=1.0 2.0 3.0 4.0 0.0 0.0 2", "P7=1 2 3 4 0 0", "", "@H1=30.0 50.0 10.0 R"),
            *("@S2=10.0 20.0 0.0 90.0", "@WRITE <A>", "PGN=5", "PRINT 1", "", "@PDEF(0)=3,4,1"),
        ):
            wire.send(f"{line}\r\n")
        assert await wire.lines(7) == ["READY", "OK", "OK", "OK", "READY", "OK", "OK"]
        assert await wire.ask("@READ PNT", 4) == [
            "BEGIN",
            "P1=1.000 2.000 3.000 4.000 0.000 0.000 2 0 0",
            "P7=1 2 3 4 0 0 0 0 0",
            "END",
        ]
        assert await wire.ask("@READ <A>", 5) == ["BEGIN", "NAME=A", "PGN=5", "PRINT 1", "END"]
        assert await wire.ask("@READ HND", 3) == ["BEGIN", "H1=30.000 50.000 10.000 R", "END"]
        assert await wire.ask("@READ SFT", 3) == ["BEGIN", "S2=10.000 20.000 0.000 90.000", "END"]
        assert await wire.ask("@READ PLT", 3) == ["BEGIN", "PL(0)=3,4,1", "END"]
        assert await wire.ask("@READ DIR", 3) == ["BEGIN", "1,A,1", "END"]
        assert await wire.ask("@READ <B>") == ["NG=3.203"]


async def test_a_file_with_a_mistake_changes_nothing():
    async with wire_on(speed=20, on=False) as (_, wire):
        for line in ("@WRITE PNT", "P1=1.0 2.0 3.0 4.0 0.0 0.0", "P2=nonsense", ""):
            wire.send(f"{line}\r\n")
        assert await wire.lines(2) == ["READY", "NG=5.202"]
        assert await wire.ask("@?P1") == ["NG=6.204"]
        wire.send("@WRITE PNT\r\nH1=1.0 2.0 3.0 R\r\n\x1a")
        assert await wire.lines(2) == ["READY", "NG=4.202"]
        assert await wire.ask("@WRITE LOG") == ["NG=3.204"]


async def test_a_hand_and_a_shift_move_what_the_positions_mean():
    async with wire_on(speed=50) as (bench, wire):
        assert await wire.ask("@H1=0.0 50.0 10.0 R") == ["OK"]
        assert await wire.ask("@S1=20.0 10.0 5.0 90.0") == ["OK"]
        assert await wire.ask("@CHANGE H1") == ["OK"]
        assert await wire.ask("@?WHRXY", 2) == ["300.000 0.000 10.000 0.000 0.000 0.000 1 0 0", "OK"]
        assert await wire.ask("@MOVE P,300.0 100.0 40.0 90.0 0.0 0.0", 2) == ["RUN", "END"]
        assert bench.position() == pytest.approx((300, 50, 30, 90), abs=1e-6)
        assert await wire.ask("@SHIFT S1") == ["OK"]
        assert (await wire.ask("@?WHRXY", 2))[0] == "90.000 -280.000 35.000 0.000 0.000 0.000 1 0 0"
        assert await wire.ask("@H1=0.0 0.0 0.0 R") == ["NG=6.271"]
        assert await wire.ask("@CHANGE H2") == ["OK"]
        assert await wire.ask("@H3=100 5.0 0.0") == ["OK"]
        assert await wire.ask("@CHANGE H3") == ["NG=2.342"]
        assert await wire.ask("@CHANGE H32") == ["NG=6.255"]


async def test_a_place_on_a_pallet():
    async with wire_on(speed=50) as (bench, wire):
        corners = {3996: (250, 0, 30), 3997: (290, 0, 30), 3998: (250, 60, 30), 3999: (290, 60, 30), 4000: (250, 0, 20)}
        for number, (x, y, z) in corners.items():
            assert await wire.ask(f"@P{number}={x}.0 {y}.0 {z}.0 0.0 0.0 0.0") == ["OK"]
        assert await wire.ask("@PMOVE (0,1)") == ["NG=6.236"]
        assert await wire.ask("@PDEF(0)=3,4,2") == ["OK"]
        assert await wire.ask("@PMOVE (0,8),S=50", 2) == ["RUN", "END"]
        assert bench.position() == pytest.approx((270, 40, 30, 0), abs=1e-6)
        assert await wire.ask("@PMOVE (0,24)", 2) == ["RUN", "END"]
        assert bench.position() == pytest.approx((290, 60, 20, 0), abs=1e-6)
        assert await wire.ask("@PMOVE (0,25)") == ["NG=4.208"]
    ways = [entry.way for entry in bench.controller.log.of("moves")]
    assert ways == ["Arch", "Arch"]


async def test_arcs_go_through_their_middle_and_bad_ones_are_refused():
    async with wire_on(speed=2) as (bench, wire):
        assert await wire.ask("@MOVE P,300.0 0.0 0.0 0.0 0.0 0.0", 2) == ["RUN", "END"]
        assert await wire.ask("@P1=320.0 20.0 0.0 0.0 0.0 0.0") == ["OK"]
        assert await wire.ask("@P2=300.0 40.0 10.0 0.0 0.0 0.0") == ["OK"]
        assert await wire.ask("@MOVE C,P1,P2,S=20") == ["RUN"]
        radii = []
        while not bench.stands():
            x, y, *_ = bench.position()
            radii.append(math.hypot(x - 300, y - 20))
            await asyncio.sleep(0.002)
        assert await wire.lines(1) == ["END"]
        assert radii == pytest.approx([20] * len(radii))
        assert len(radii) > 5
        assert await wire.ask("@MOVE C,P2,P2") == ["NG=2.329"]
        assert await wire.ask("@MOVE C,300.0 30.0 0.0 0.0 0.0 0.0,300.0 20.0 0.0 0.0 0.0 0.0") == ["NG=2.330"]
        assert await wire.ask("@MOVE C,P1") == ["NG=5.201"]
        assert await wire.ask("@MOVE P,P2,A3=20.0") == ["NG=2.314"]
        assert await wire.ask("@MOVE L,P2,A3=0.0") == ["NG=5.238"]
