"""Whom the delivered PLC program serves, whether that client lives, and what follows for safety."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.plc_bench import (
    BRING,
    EMERGENCY,
    FAULT,
    NOT_YOUR_SESSION,
    OK,
    READY,
    RELEASE_GOOD,
    RELEASE_REJECT,
    RESET,
    RUNNING,
    SILENT,
    STARTING,
    Bench,
    live,
)

# -- who is served, and whether it lives ---------------------------------------------------------------------------


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(1, 130), min_size=1, max_size=6))
def test_enable_falls_500_ms_after_the_last_heartbeat_and_the_session_ends_after_1_s(gaps: list[int]) -> None:
    bench = live()
    for gap in gaps:
        bench.beat(2)
        assert bench.station.robot_enable
        assert (bench[102], bench[103]) == (77, READY)
        for scans in range(1, gap + 1):
            bench.scan()
            assert bench.station.robot_enable is (scans <= 50)
            assert bench[102] == (77 if scans <= 100 else 0)
            assert bench[103] == (READY if scans <= 50 else SILENT)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(st.sampled_from([11, 22, 33]), st.integers(1, 120), st.integers(0, 3)), max_size=10))
def test_the_first_live_session_is_served_and_others_only_after_it_was_silent_for_1_s(turns) -> None:  # type: ignore[no-untyped-def]
    bench = Bench()
    bench.scan(3)
    served, silent, heartbeat = 0, 0, 0
    for session, scans, command in turns:
        for _ in range(scans):
            heartbeat = (heartbeat + 1) & 0xFFFF
            bench.registers.update({0: heartbeat, 1: session, 3: session, 4: command, 6: session & 0xFF})
            silent = 0 if session == served else silent + 1
            served = session if served == 0 or silent > 100 else served
            silent = 0 if session == served else silent
            bench.scan()
            assert bench[102] == served
            assert bench[107] == session
            assert bench[109] == NOT_YOUR_SESSION  # each number was written before its session was served
            assert bench.station.lights[1] is bool(served & 4)
    assert bench.station.belt_starts == 0


def test_what_stands_in_the_registers_at_power_on_is_no_sign_of_life() -> None:
    bench = Bench()
    bench.registers.update({0: 5, 1: 77, 3: 4, 4: BRING, 6: 1})
    bench.scan(200)
    assert (bench[102], bench[103], bench.station.belt_starts) == (0, SILENT, 0)
    assert not bench.station.robot_enable
    assert not bench.station.suction.valve


def test_a_power_cycle_keeps_clamp_and_vacuum_and_counts_the_boot() -> None:
    bench = live()
    bench.command(BRING)
    bench.beat(5, w6=0b101)
    bench.program.halt()
    assert not bench.station.robot_enable
    assert not bench.station.lights[1]
    bench.registers.update(dict.fromkeys(bench.registers, 0))
    bench.program.restart()
    bench.scan(50)
    assert (bench[117], bench[102], bench[107], bench[110]) == (2, 0, 0, 0)
    assert bench.station.suction.valve
    assert bench.station.carrier_clamped()
    assert not bench.station.lights[1]


def test_the_plc_is_starting_for_20_ms_and_takes_no_command() -> None:
    bench = Bench()
    bench.scan()
    bench.beat()
    assert (bench[102], bench[103]) == (77, STARTING)
    for _ in range(3):  # more cycles of the same moment
        bench.registers.update({0: bench[0] + 1, 3: 1, 4: BRING})
        bench.program.scan(bench.station.now_s, bench.station.now_s)
    assert (bench[103], bench[107], bench.station.belt_starts) == (STARTING, 0, 0)
    bench.scan()
    assert (bench[103], bench[107], bench.station.belt_starts) == (RUNNING, 1, 1)


# -- safety --------------------------------------------------------------------------------------------------------

facts = st.tuples(st.booleans(), st.booleans(), st.booleans())


@settings(max_examples=30, deadline=None)
@given(st.lists(facts, min_size=1, max_size=30))
def test_every_fall_of_a_safety_fact_is_latched_until_the_latches_are_reset(history) -> None:  # type: ignore[no-untyped-def]
    bench = live()
    before, lost = 0b1111, 0
    for estop_pressed, guard_open, air_ok in history:
        bench.station.estop_pressed, bench.station.guard_open, bench.station.air_ok = estop_pressed, guard_open, air_ok
        bench.beat()
        enable = not estop_pressed and not guard_open
        now = (not estop_pressed) | (not guard_open) << 1 | air_ok << 2 | enable << 3
        lost |= before & ~now
        before = now
        assert (bench[104], bench[106]) == (now, lost)
        assert bench.station.robot_enable is enable
        assert (bench[103] == EMERGENCY) is estop_pressed
    assert bench.command(RESET) == OK
    assert bench[106] == 0


@pytest.mark.parametrize(
    ("lose", "begin"),
    [
        ("estop_pressed", BRING),
        ("estop_pressed", RELEASE_GOOD),
        ("guard_open", BRING),
        ("guard_open", RELEASE_REJECT),
        ("silence", BRING),
    ],
)
def test_lost_safety_or_a_silent_client_stops_the_belt_and_ends_the_command_as_a_fault(lose: str, begin: int) -> None:
    bench = live()
    if begin != BRING:
        bench.command(BRING)
    number = bench[107] + 1
    bench.beat(5, w3=number, w4=begin, w5=bench.station.carrier)
    assert bench.station.conveyor._driven
    if lose == "silence":
        bench.scan(52)
    else:
        setattr(bench.station, lose, True)
        bench.scan()
    assert not bench.station.conveyor._driven
    assert [bench[at] for at in (107, 108, 109)] == [number, number, FAULT]
