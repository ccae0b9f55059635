"""The PLC benchmarks in short: they run, and their rows say what they promise."""

from tests.benchmarks import bench_plc, bench_reaction


def test_the_cost_of_the_driver_is_measured_beside_others() -> None:
    with bench_plc.serving(bench_plc._plc) as port:
        exchange = bench_plc.exchanges(port, 100, None)
        driver = bench_plc.run(bench_plc.scan_cost(port, 0.3))
        pymodbus = bench_plc.run(bench_plc.pymodbus_cost(port, 0.3))
        nothing = bench_plc.run(bench_plc.idle_cost(0.3))
        late_ms = bench_plc.run(bench_plc.lateness(port, 0.2))

    assert set(exchange) == {"driver", "pymodbus"}
    for row in exchange.values():
        assert 10 < row["p50_us"] <= row["p99_us"] <= row["max_us"] < 1e6
    assert 0 < nothing["cpu_pct"] < driver["cpu_pct"] < 100
    assert nothing["us_each"] < pymodbus["us_each"]
    assert len(late_ms) == 20
    assert min(late_ms) > -1


def test_the_cell_stops_the_arm_because_of_the_bit_alone() -> None:
    row = bench_reaction.measure(3, with_vision=False, speed=20.0)

    assert row["events"] == 3
    assert 0 < row["aborting"]["p50_ms"] < 1000
    assert 0 < row["last_byte"]["p50_ms"] < 1000
    assert row["last_motion"]["max_ms"] <= row["last_byte"]["max_ms"]
