"""Inputs and outputs of the delivered PLC program: debounced, counted, scaled, and each in its place."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.plc_bench import (
    BRING,
    RESET,
    STOP,
    live,
)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.integers(1, 6)), max_size=30))
def test_a_level_of_the_switch_counts_when_it_has_stood_for_20_ms(levels: list[tuple[bool, int]]) -> None:
    bench = live()
    state, raw_before, scans = False, False, 0
    for raw, for_scans in levels:
        bench.station.seen_by_switch = raw
        for _ in range(for_scans):
            scans = scans + 1 if raw == raw_before and raw != state else 0
            raw_before = raw
            if raw != state and scans >= 2:
                state, scans = raw, 0
            bench.beat()
            assert bench[105] & 1 == state


def test_buttons_are_debounced_and_counted_modulo_256() -> None:
    bench = live()
    for name, times in (("start", 300), ("stop", 2), ("reset", 3)):
        for _ in range(times):
            bench.buttons = {name}
            bench.beat(1)
            bench.buttons = set()
            bench.beat(1)  # a bounce, too short to count
            bench.buttons = {name}
            bench.beat(4)
            bench.buttons = set()
            bench.beat(4)
    assert bench[118] == 2 << 8 | 300 % 256
    assert bench[119] == 3
    bench.buttons = {"stop"}
    bench.beat(4)
    assert bench[105] & 0xE0 == 0x40


@settings(max_examples=50, deadline=None)
@given(st.floats(-110.0, 20.0))
def test_the_vacuum_is_told_in_tenths_of_a_kpa(kpa: float) -> None:
    bench = live()
    bench.station.pressure_kpa = kpa
    bench.beat()
    told = bench[115] - ((bench[115] & 0x8000) << 1)
    assert told == pytest.approx(kpa * 10, abs=0.52)


def test_each_sensor_has_its_bit() -> None:
    bench = live()
    station = bench.station
    assert bench[105] == 0
    station.battery = True
    bench.beat()
    assert bench[105] == 0b01000
    station.pressure_kpa = -60.0
    bench.beat()
    assert bench[105] == 0b01010
    bench.beat(40, w3=1, w4=BRING)
    assert bench[105] == 0b11010
    bench.beat(200)
    assert bench[105] == 0b01111


def test_vacuum_reached_has_a_hysteresis_from_40_to_35_kpa() -> None:
    bench = live()
    seen = []
    for kpa in (-30.0, -39.0, -41.0, -36.0, -34.0, -39.0):
        bench.station.pressure_kpa = kpa
        bench.beat()
        seen.append(bool(bench[105] & 2))
    assert seen == [False, False, True, True, False, False]


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 0xFF))
def test_each_output_bit_reaches_its_actuator(bits: int) -> None:
    bench = live()
    bench.beat(2, w6=bits)
    station = bench.station
    seen = (station.suction.valve, station.suction.blow, station.lights[1], station.lights[2], *station.tower)
    assert seen == tuple(bool(bits >> at & 1) for at in range(8))


def test_reserved_registers_stay_0_and_the_heartbeat_moves_with_each_cycle() -> None:
    bench = live()
    for command in (BRING, RESET, STOP):
        bench.command(command)
        before = bench[100]
        bench.beat()
        assert bench[100] == before + 1
        assert bench[101] == 0x0100
        assert [bench[at] for at in range(120, 132)] == [0] * 12
        assert bench[116] == 100
