"""The delivered PLC program, executed as it is and judged by what conveyor, clamp, cup and robot enable truly do."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.conveyor import Fault
from tests.benchmarks.bench_plc_program import soak
from tests.plc_bench import (
    BRING,
    FAULT,
    IN_FAULT,
    NOT_YOUR_SESSION,
    OK,
    READY,
    RELEASE_GOOD,
    RELEASE_REJECT,
    RESET,
    RUNNING,
    SCAN_S,
    STOP,
    TIMED_OUT,
    UNKNOWN,
    WRONG_STATE,
    Wire,
    live,
)

# -- the sequence --------------------------------------------------------------------------------------------------


def test_carriers_come_one_by_one_and_go_where_they_are_told() -> None:
    bench = live()
    for number in range(1, 5):
        assert bench.command(BRING) == OK
        assert (bench[110], bench[113], bench.station.came) == (number, 500 + number, number)
        assert bench.station.carrier_clamped()
        assert not bench.station.conveyor_moving()
        assert bench.command(RELEASE_GOOD if number % 2 else RELEASE_REJECT, 500 + number) == OK
    assert bench.station.left == [(501, True), (502, False), (503, True), (504, False)]


def test_an_arrival_counts_only_when_the_carrier_is_clamped_and_the_belt_at_rest() -> None:
    bench = live()
    bench.beat(w3=1, w4=BRING)
    before = 0
    while bench[108] != 1:
        bench.beat()
        if bench[110] != before:
            before = bench[110]
            assert bench.station.carrier_clamped()
            assert not bench.station.conveyor_moving()
    assert before == 1


def test_the_age_of_an_arrival_is_told_in_ms_in_two_words() -> None:
    bench = live()
    assert (bench[111], bench[112]) == (0, 0)
    bench.command(BRING)
    age_ms = bench[111] << 16 | bench[112]
    bench.station.now_s += 70.0 - SCAN_S
    bench.beat()
    assert (bench[111] << 16 | bench[112]) - age_ms == pytest.approx(70_000, abs=20)
    assert bench[111] == 1
    assert bench.command(RELEASE_GOOD, 501) == bench.command(BRING) == OK
    assert (bench[111], bench[112]) == (0, 0)


def test_an_empty_line_is_a_bring_that_timed_out_after_8_s_and_no_fault() -> None:
    bench = live()
    bench.station.conveyor.inject("stuck")
    began_s = bench.station.now_s
    assert bench.command(BRING) == TIMED_OUT
    assert bench.station.now_s - began_s == pytest.approx(8.0, abs=0.1)
    assert (bench[103], bench[114]) == (READY, 0)
    assert not bench.station.conveyor._driven


@pytest.mark.parametrize(
    ("fault", "begin", "result", "number", "after_s"),
    [
        ("blocked", BRING, FAULT, 3, 0.5),
        ("blocked", RELEASE_GOOD, FAULT, 3, 0.5),
        ("creeps", BRING, TIMED_OUT, 2, 1.84),  # it comes within 0.8 s, and the clamp has 1 s
    ],
)
def test_a_belt_that_fails_ends_the_command_and_is_a_fault_until_it_is_reset(
    fault: Fault, begin: int, result: int, number: int, after_s: float
) -> None:
    bench = live()
    if begin == RELEASE_GOOD:
        bench.command(BRING)
    bench.station.conveyor.inject(fault)
    began_s = bench.station.now_s
    assert bench.command(begin, 501) == result
    assert bench.station.now_s - began_s == pytest.approx(after_s, abs=0.05)
    assert (bench[103], bench[114]) == (IN_FAULT, number)
    assert bench.command(BRING) == WRONG_STATE
    bench.station.conveyor.inject(fault, on=False)
    assert bench[114] == number
    assert bench.command(RESET) == OK
    bench.beat()
    assert (bench[103], bench[114]) == (READY, 0)


def test_a_belt_that_does_not_stop_is_a_fault_within_a_second() -> None:
    bench = live()
    bench.station.conveyor.inject("creeps")
    bench.beat(99)
    assert bench[114] == 0
    bench.beat(3)
    assert bench[114] == 4


def test_a_clamp_that_does_not_close_is_fault_2(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = live()
    monkeypatch.setattr(bench.station.conveyor, "clamp", lambda on: None)
    assert bench.command(BRING) == TIMED_OUT
    assert (bench[103], bench[114], bench[110]) == (IN_FAULT, 2, 0)


def test_a_carrier_that_does_not_leave_the_beam_is_fault_1(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = live()
    bench.command(BRING)
    monkeypatch.setattr(bench.station.conveyor, "release", lambda: None)
    began_s = bench.station.now_s
    assert bench.command(RELEASE_GOOD, 501) == TIMED_OUT
    assert bench.station.now_s - began_s == pytest.approx(4.0, abs=0.05)
    assert (bench[103], bench[114]) == (IN_FAULT, 1)
    assert bench.station.left == []


@pytest.mark.parametrize(
    ("command", "argument", "clamped", "result"),
    [
        (BRING, 0, True, WRONG_STATE),
        (RELEASE_GOOD, 99, True, WRONG_STATE),
        (RELEASE_REJECT, 0, False, WRONG_STATE),
        (RELEASE_GOOD, 501, False, WRONG_STATE),
        (0, 0, True, UNKNOWN),
        (6, 0, False, UNKNOWN),
        (65_535, 0, False, UNKNOWN),
        (STOP, 0, True, OK),
        (RESET, 0, True, OK),
    ],
)
def test_what_cannot_be_done_now_is_answered_and_moves_nothing(
    command: int, argument: int, clamped: bool, result: int
) -> None:
    bench = live()
    if clamped:
        bench.command(BRING)
    starts = bench.station.belt_starts
    assert bench.command(command, argument) == result
    bench.beat(20)
    assert bench.station.belt_starts == starts
    assert bench.station.carrier_clamped() is clamped


def test_stop_conveyor_ends_a_bring_at_once() -> None:
    bench = live()
    bench.beat(20, w3=1, w4=BRING)
    assert bench[103] == RUNNING
    bench.beat(w3=2, w4=STOP)
    assert [bench[at] for at in (107, 108, 109)] == [2, 2, OK]
    assert not bench.station.conveyor._driven


def test_another_command_waits_until_the_one_before_is_finished() -> None:
    bench = live()
    bench.beat(10, w3=1, w4=BRING)
    bench.beat(10, w3=2, w4=RELEASE_GOOD, w5=501)
    assert (bench[107], bench[108]) == (1, 0)
    bench.beat(300)
    assert [bench[at] for at in (107, 108, 109)] == [2, 2, OK]
    assert bench.station.left == [(501, True)]


# -- exactly once --------------------------------------------------------------------------------------------------

traffic = st.lists(st.sampled_from(["lose", "repeat", "late"]), max_size=12)
commands = st.sampled_from([BRING, RELEASE_GOOD, RELEASE_REJECT, STOP, RESET, 9])


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(commands, traffic), max_size=8), st.integers(0, 0xFFFF), st.integers())
def test_every_command_is_executed_once_whatever_is_lost_repeated_or_late(
    given_commands: list[tuple[int, list[str]]], first: int, seed: int
) -> None:
    bench = live()
    bench.beat(w3=first)
    wire = Wire(bench, random.Random(seed))
    for command, ways in given_commands:
        wire.command(command, ways)


def test_the_long_run_through_a_bad_wire_in_short() -> None:
    figures = soak(60)
    assert figures["commands"] == 60
    assert min(figures["arrivals"], figures["releases"], figures["disturbed_packets"]) > 5


def test_a_late_packet_changes_no_output() -> None:
    bench = live()
    bench.beat(3, w6=0)
    late = dict(bench.frame)
    bench.beat(30, w6=1)
    assert bench.station.suction.valve
    bench.registers.update(late)
    bench.scan()
    assert bench.station.suction.valve
    bench.beat(w6=0)
    assert not bench.station.suction.valve


@pytest.mark.parametrize(("number", "heartbeat"), [(0xFFFC, 0xFFF0), (0xFFFF, 0xFF40)])
def test_numbers_and_heartbeats_wrap_around(number: int, heartbeat: int) -> None:
    bench = live()
    bench.frame[0] = heartbeat  # far from the one before: the session has to begin anew
    bench.scan(120)
    bench.beat(3, w1=78, w3=number)
    assert [bench[at] for at in (102, 107, 109)] == [78, number, NOT_YOUR_SESSION]
    for _ in range(3):
        assert bench.command(BRING) == OK
        assert bench.command(RELEASE_GOOD, bench.station.carrier) == OK
    assert bench[110] == len(bench.station.left) == 3
    assert bench[0] < heartbeat
    assert bench[107] < number
