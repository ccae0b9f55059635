"""Broken input at both controllers: nothing breaks, every line gets at most its reply, and pieces change nothing."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.robot.codes import Refusal
from simulators.robot.framing import ETX, SYN, Framer, Negotiation
from simulators.robot.language.program import compiled, parse_source
from simulators.robot.language.statements import statement
from simulators.robot.options import Options
from simulators.robot.rcx2 import Rcx2
from simulators.robot.rcx3 import Rcx3
from tests.benchmarks.fuzz_robot import fuzzed
from tests.robot_bench import wire_on

DIALECTS = (Rcx2(Options()), Rcx3(Options()))


def refused(do, *arguments):
    try:
        do(*arguments)
    except Refusal as refusal:
        return refusal.code is not None
    return False


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
async def test_thousands_of_broken_inputs_break_nothing(dialect):
    result = await fuzzed(dialect, 3000, seed=1)
    assert result["crashes"] == []
    assert result["replies"] > 1500
    assert len(result["refused_by_group"]) >= 4


@settings(deadline=None)
@given(st.text(st.characters(max_codepoint=255), max_size=80))
def test_any_text_is_a_command_a_question_or_refused(text):
    for dialect in DIALECTS:
        refused(dialect.command, text)
        refused(dialect.command, f"@{text}")
        refused(statement, text.upper(), dialect.words)


@settings(deadline=None)
@given(st.lists(st.text(st.characters(max_codepoint=127), max_size=40), max_size=8))
def test_any_text_is_a_program_or_refused(lines):
    for dialect in DIALECTS:
        refused(lambda lines=lines, dialect=dialect: compiled(parse_source("X", lines), dialect.words))


@settings(deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=10))
def test_framing_does_not_depend_on_the_pieces(pieces):
    one, other = Framer(), Framer()

    assert [event for piece in pieces for event in one.feed(piece)] == other.feed(b"".join(pieces))


@pytest.mark.parametrize(
    ("data", "events"),
    [
        (b"@?M\x03OD\x16E\r\n", [ETX, SYN, "@?MODE"]),
        (b"a\rb\nc\r\nd\r\n\r\n", ["a", "b", "c", "d", ""]),
        (b"x\0y\r\n\0\0", ["xy"]),
        (b"\xff\xfd\x01@?EMG\r", [Negotiation(0xFD, 1), "@?EMG"]),
        (b"\xff\xfa\x18\x00VT100\xff\xf0@\r", ["@"]),
        (b"\xff\xf4\r", [ETX, ""]),
        (b"\xff\xffa\r", ["\xffa"]),
        (b"\xff1\r", ["1"]),
        (b"a\x1ab\r", ["a\x1a", "b"]),
        (b"x" * 1000 + b"\r", ["x" * 300]),
    ],
)
def test_bytes_become_lines_and_controls(data, events):
    assert Framer().feed(data) == events


async def test_every_noisy_line_gets_one_answer_and_the_controller_lives_on():
    rng = random.Random(5)
    async with wire_on(speed=100, on=False) as (_, wire):
        for _ in range(200):
            line = "@" + "".join(
                chr(rng.choice([*range(33, 127), *range(0xA1, 0xDF)])) for _ in range(rng.randrange(1, 90))
            )
            (answer,) = await wire.ask(line)
            assert answer.startswith("NG=") or answer == "OK"
        assert await wire.ask("@?MODE", 2) == ["2", "OK"]
