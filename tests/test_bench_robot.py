"""The robot driver's benchmark in short: it runs, and its rows say what it promises."""

import asyncio

import pytest

from drivers.rcx2 import Rcx2
from drivers.rcx3 import Rcx3
from tests.benchmarks.bench_robot import line_ms, measure, parsed_per_s, table, unit_times


def test_a_question_takes_the_driver_little_longer_than_a_bare_client():
    (row,) = measure("rcx3", questions=20, moves=2, wanted=["tcp"])
    assert 2 <= row["bare_p50_ms"] <= row["bare_p99_ms"]
    assert 2 <= row["driver_p50_ms"] <= row["driver_p99_ms"]
    assert 0 < row["cpu_per_move_ms"] < 100
    unit = asyncio.run(unit_times())
    assert unit["worst_stretch_off_percent"] < 5
    assert unit["ratio"] < 0.9
    result = {"round_trips": [row], "lines_parsed_per_s": {"rcx3": 1e5}, "unit": unit}
    assert len(table(result).splitlines()) == 5


def test_every_line_of_both_generations_is_parsed():
    assert parsed_per_s(Rcx3(), 200) > 1000
    assert parsed_per_s(Rcx2(), 200) > 1000


def test_a_byte_takes_eleven_bits_on_the_serial_line():
    assert line_ms("rcx3") == pytest.approx(42 * 11 / 9600 * 1000)  # @?WHERE and 33 bytes of an answer
