"""Short variants of `make bench-vision`: the same pictures and judges, few of them."""

from collections import Counter

import numpy as np
import pytest

from cellctl.vision import NotFound
from tests.benchmarks.vision import paper
from tests.benchmarks.vision.contest import HOLE, OFFSET, OURS, Contest
from tests.benchmarks.vision.table import contest_table
from tests.benchmarks.vision.trials import calibrated
from tests.hostile_shown import error_of, is_wrong
from tests.vision_hostile import KINDS, hostile
from tests.vision_regimes import NUISANCE

pytestmark = pytest.mark.usefixtures("one_thread")


def test_with_nuisances_it_stays_near_the_bound_and_far_ahead_of_the_papers_method() -> None:
    contest = Contest({"paper": paper.circle}, {"paper": paper.line})
    contest.run(NUISANCE, range(2), seed=9)
    table = contest_table(contest)

    assert contest.refusals == []
    for quantity, rows in table.items():
        assert rows[OURS]["ratio to the bound"] < 4.0, quantity
    for quantity in (HOLE, OFFSET):
        assert table[quantity]["paper"]["ratio to ours"] > 10.0, quantity


def test_errors_are_as_large_as_the_measurements_say() -> None:
    result = calibrated(12)  # one pack: no further processes

    assert result["good pictures refused"] == 0.0
    assert 0.3 < result["by regime"]["all"]["Mahalanobis"]["variance of error over sigma"] < 2.0


@pytest.mark.parametrize("make", KINDS, ids=lambda make: make.__name__)
def test_a_wrong_pose_is_never_accepted(make) -> None:
    said: Counter[str] = Counter()
    shown = make(np.random.default_rng(40))
    try:
        said["wrong" if is_wrong(error_of(shown)) else "right"] += 1
    except NotFound as refusal:
        said[refusal.check] += 1

    assert not said["wrong"]
    assert shown.there or not said["right"]


@pytest.mark.parametrize(
    "number",
    [245, 802, 1484, 7709, 9411],
    ids=["nothing but shade", "strip along the edge", "grid of blocks", "strip inside edge 2", "strip inside edge 1"],
)
def test_hostile_pictures_that_once_came_through_are_refused(number: int) -> None:
    with pytest.raises(NotFound):
        error_of(hostile(np.random.default_rng([5, number])))
