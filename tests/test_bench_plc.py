"""The PLC benchmarks in short: they run, and their rows say what they promise."""

from tests.benchmarks import bench_plc, bench_reaction


def test_the_cost_of_the_driver_is_measured_beside_others_and_no_bad_answer_is_taken() -> None:
    result = bench_plc.measure(100, 0.3, 60)

    assert set(result["exchange"]) == {"driver", "pymodbus"}
    for row in result["exchange"].values():
        assert 10 < row["p50_us"] <= row["p99_us"] <= row["max_us"] < 1e6
    driver, bare, nothing = (row["cpu_pct"] for row in result["scan"].values())
    assert 0 < nothing < driver < 100
    assert 0 < bare < 100
    assert result["scan"]["driver, words decoded and watched"]["scans_per_s"] > 20
    assert set(result["late"]) == {"no vision", "5 MP vision without a pause"}
    assert result["storm"]["taken"]["right"] > 20
    assert "wrong" not in result["storm"]["taken"]


def test_the_cell_stops_the_arm_because_of_the_bit_alone() -> None:
    row = bench_reaction.measure(3, with_vision=False, speed=20.0)

    assert row["events"] == 3
    assert 0 < row["aborting"]["p50_ms"] < 1000
    assert 0 < row["last_byte"]["p50_ms"] < 1000
    assert row["last_motion"]["max_ms"] <= row["last_byte"]["max_ms"]
