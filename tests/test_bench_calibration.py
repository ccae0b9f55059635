"""The calibration benchmark in short: it runs, and its goals hold on a few cells."""

from tests.benchmarks.bench_calibration import OURS, planar, planar_text
from tests.benchmarks.bench_calibration_spatial import simulated, simulated_text


def test_the_planar_goals_hold_and_opencvs_general_solvers_do_not_come_near():
    rows = planar("eye_in_hand", 90, 3, lambda text: None) + planar("arm_2", 0, 3, lambda text: None)
    for row in rows:
        if row["method"] == OURS:
            assert row["held_out_rms_um"] <= 10
            assert row["held_out_worst_um"] <= 30
            assert row["differential_rms_um"] <= 1
        elif row["method"].startswith("OpenCV") and "absolute_ratio" in row:
            assert row["absolute_ratio"] > 5
    assert OURS in planar_text(rows)


def test_the_spatial_table_has_a_row_for_every_method():
    rows = simulated(3, lambda text: None)
    assert len(rows) == 12
    assert "normalised variance" in simulated_text(rows)
