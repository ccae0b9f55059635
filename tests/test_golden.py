"""What is made of golden assemblies: spreads that are the statistics of the truth, and a table for people."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellctl.geometry import Pose
from cellctl.procedures.golden import Assemblies, Golden, Spread, difference

HERE = Pose(0.0, 0.0, 0.0)


def assemblies(*seats: list[Pose]) -> Assemblies:
    """One list of seats per pair."""
    return Assemblies(tuple(Golden(n, HERE, seat, HERE) for n, pair in enumerate(seats, 1) for seat in pair))


def drawn(rng: np.random.Generator, pairs: int, repeats: int, pair_mm: float, repeat_mm: float) -> Assemblies:
    means = rng.normal(0.0, pair_mm, (pairs, 3))
    each = means[:, None] + rng.normal(0.0, repeat_mm, (pairs, repeats, 3))
    return assemblies(*([Pose(*seat) for seat in pair] for pair in each.tolist()))


def test_the_spreads_are_those_of_the_seatings_and_of_the_pairs():
    rng = np.random.default_rng(1)
    found = [drawn(rng, 4, 6, 0.010, 0.004) for _ in range(300)]
    within = np.sqrt(np.mean([one.repeat_spread.xy_mm**2 for one in found]))
    between = np.sqrt(np.mean([one.pair_spread.xy_mm**2 for one in found if one.pair_spread]))
    assert within == pytest.approx(0.004, rel=0.03)
    assert between == pytest.approx(0.010, rel=0.06)


def test_pairs_that_do_not_differ_are_not_said_to_differ():
    rng = np.random.default_rng(2)
    found = [drawn(rng, 3, 5, 0.0, 0.004).pair_spread for _ in range(200)]
    assert np.sqrt(np.mean([one.xy_mm**2 for one in found if one])) < 0.004 / math.sqrt(5)


def test_one_pair_tells_nothing_about_pairs_and_one_seating_nothing_about_seatings():
    one = assemblies([Pose(1, 2, 3)])
    assert one.mean == pytest.approx(Pose(1, 2, 3))
    assert one.pair_spread is None
    assert one.repeat_spread == Spread(0.0, 0.0, 0.0)
    assert one.table()[-1].endswith("not known, only one was taught")


def test_every_pair_counts_the_same_in_the_mean():
    two = assemblies([Pose(0, 0, 179.0), Pose(0, 0, 179.0)], [Pose(0.010, 0, -179.0), Pose(0.020, 0, -179.0)])
    assert two.mean.x_mm == pytest.approx(0.0075)
    assert abs(two.mean.t_deg) == pytest.approx(180.0)


def test_the_table_has_a_row_per_seating_and_the_figures_in_um():
    rows = assemblies([Pose(0.001, 0, 0), Pose(-0.001, 0, 0)], [Pose(0.005, 0, 0.002), Pose(0.003, 0, 0.002)]).table()
    assert len(rows) == 1 + 4 + 2 + 2
    assert rows[1].split()[:5] == ["1", "1", "-1.0", "+0.0", "-1.0"]
    assert rows[5].split()[:6] == ["within", "a", "pair", "1.4", "0.0", "0.0"]
    assert rows[-1].split()[:5] == ["between", "pairs", "2.6", "0.0", "1.4"]


@given(st.lists(st.tuples(*[st.floats(-1, 1)] * 3), min_size=2, max_size=8))
def test_the_spread_of_one_pair_is_the_standard_deviation(seats: list[tuple[float, float, float]]):
    found = assemblies([Pose(*seat) for seat in seats]).repeat_spread
    assert found == pytest.approx(np.std(seats, axis=0, ddof=1), abs=1e-9)
    off = difference(Pose(*seats[0]), Pose(*seats[1]))
    assert found.within(abs(off.x_mm) + 2.9, 2.9)
