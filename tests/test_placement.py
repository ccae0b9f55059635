"""The predicted placement error is the one that a Monte Carlo of the same errors gives."""

import math
import time
import timeit

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.geometry import Mm, Pose
from cellctl.placement import Errors, WorstCorner, beside, learn, predict, shares, straight_fit
from simulators.parts import BaseDrawing, base

CORNERS = [Mm(-26.5, -42.5), Mm(26.5, -42.5), Mm(26.5, 42.5), Mm(-26.5, 42.5)]
STOP = np.diag([0.0033, 0.0033, math.radians(0.0013)])


def stop(name: str, at: Mm) -> Errors:
    """A robot stop whose tool is at a point of the battery."""
    return Errors((name,) * 3, STOP).seen_from(Pose(at.x_mm, at.y_mm, 0.0))


def misplaced_mm(columns: np.ndarray, draws: np.ndarray) -> np.ndarray:
    """The worst corner of each draw, by moving the corners exactly."""
    worst = np.zeros(draws.shape[1])
    for motion, number in zip((columns @ draws).T, range(draws.shape[1]), strict=True):
        moved = Pose(motion[0], motion[1], math.degrees(motion[2]))
        worst[number] = max(math.dist(moved.point(*corner), corner) for corner in CORNERS)
    return worst


@pytest.mark.parametrize("turning", [0.0, 1.0, 8.0])
def test_mean_and_quantiles_of_the_worst_of_four_corners_are_those_of_a_monte_carlo(turning: float) -> None:
    angle = Errors(("edge",), np.array([[0.0], [0.0], [turning * 1e-4]]))
    errors = stop("at the seat", Mm(0, 0)).and_of(stop("over the base", Mm(-18.0, 62.0))).and_of(angle)
    worst = WorstCorner(errors, CORNERS)
    drawn = misplaced_mm(errors.columns, np.random.default_rng(3).standard_normal((len(errors.names), 20_000)))
    assert worst.mean_mm == pytest.approx(float(drawn.mean()), rel=0.01)
    for probability, rel in ((0.5, 0.015), (0.9, 0.015), (0.99, 0.03)):
        quantile_mm = worst.quantile_mm(probability)
        assert quantile_mm == pytest.approx(float(np.quantile(drawn, probability)), rel=rel)
        assert worst.within(quantile_mm) == pytest.approx(probability, abs=2e-3)


def test_the_worst_of_four_corners_is_worse_than_the_single_corner_that_errs_most() -> None:
    """For one corner alone, moved alike in x and y, 99 of 100 lie within 3.035 sigma."""
    errors = stop("at the seat", Mm(0, 0))
    single_mm = 3.035 * math.hypot(0.0033, math.radians(0.0013) * math.hypot(26.5, 42.5) / math.sqrt(2))
    assert predict(errors, CORNERS, 0.04).p99_mm > 1.005 * single_mm


@given(st.lists(st.floats(-0.05, 0.05), min_size=9, max_size=9))
@settings(max_examples=40, deadline=None)
def test_whatever_errs_the_quantiles_are_finite_and_in_order(numbers: list[float]) -> None:
    columns = np.array(numbers).reshape(3, 3) * np.array([[1.0], [1.0], [0.02]])
    worst = WorstCorner(Errors(("a", "b", "c"), columns), CORNERS)
    p50, p99 = worst.quantile_mm(0.5), worst.quantile_mm(0.99)
    assert 0.0 <= p50 <= p99 < 1.0
    assert math.isfinite(worst.mean_mm)


def test_the_sentence_names_expectation_limit_and_largest_share() -> None:
    predicted = predict(stop("small", Mm(0, 0)).scaled({}, 0.1).and_of(stop("R axis", Mm(0, 0))), CORNERS, 0.04)
    assert predicted.good
    assert predicted.largest == "R axis"
    assert predicted.sentence == "expected 5 um, p99 11 um of 40 um, largest share: R axis (99%)"
    assert sum(predicted.shares.values()) == pytest.approx(1.0)


def test_beyond_the_limit_it_is_a_no_go() -> None:
    assert not predict(stop("at the seat", Mm(0, 0)).scaled({}, 5.0), CORNERS, 0.04).good


def test_an_angle_acts_at_its_lever() -> None:
    turned = Errors(("angle",), np.array([[0.0], [0.0], [1e-4]])).seen_from(Pose(*CORNERS[0], 30.0))
    assert WorstCorner(turned, CORNERS).quantile_mm(0.99) == pytest.approx(2.576e-4 * math.hypot(53.0, 85.0), rel=0.003)


def test_no_error_at_all_is_no_error() -> None:
    nothing = predict(Errors.none(3), CORNERS, 0.04)
    assert (nothing.expected_mm, nothing.p99_mm, nothing.largest) == (0.0, 0.0, "none")


def test_what_two_measurements_have_in_common_cancels() -> None:
    common = Errors.of("lens", np.eye(3))
    assert np.allclose(common.and_of(common.mapped(-np.eye(3))).covariance, 2 * np.eye(3))
    both = beside(common, common.scaled({}, 0.5)).mapped([[1, 0, 0, -1, 0, 0]])
    assert both.covariance[0, 0] == pytest.approx(1.25)


def test_covariances_of_very_different_units_keep_their_smallest_variances() -> None:
    covariance = np.diag([25.0, 1e-20])
    assert Errors.of("map", covariance).covariance == pytest.approx(covariance, rel=1e-9)


def test_learning_from_a_second_look_gives_the_best_weighted_mean() -> None:
    """Two independent looks at the same place, the second twice as sure: weights 1/5 and 4/5."""
    both = beside(Errors.of("first", [[4.0]]), Errors.of("second", [[1.0]]))
    learnt = learn(both.mapped([[1, 0]]), both.mapped([[-1, 1]]), np.array([1.0]))
    assert learnt.left.covariance[0, 0] == pytest.approx(0.8)
    assert learnt.error[0] == pytest.approx(-0.8)  # the first look said 0, the second 1; the best is 0.8


def test_form_error_turns_a_fitted_edge_as_the_simulated_parts_do() -> None:
    """Straight lines through the wavy edges that the simulator makes, against the closed form."""
    found = []
    for seed in range(400):
        outline = base(BaseDrawing(form_sd_mm=0.002, form_seed=seed))[0]
        points = outline.points[np.abs(outline.points[:, 1] - 6.0) < 0.05]
        x, y = points[np.abs(points[:, 0]) <= 7.0].T
        found.append(np.polyfit(x, y - 6.0, 1)[::-1])
    offset, slope = np.std(found, axis=0)
    model = np.sqrt(np.diag(straight_fit(14.0, 0.002, 3.0)))
    assert offset == pytest.approx(model[0], rel=0.12)
    assert slope == pytest.approx(model[1], rel=0.12)


def test_a_prediction_takes_a_fraction_of_a_millisecond_of_the_processor() -> None:
    errors = stop("a", Mm(0, 0)).and_of(stop("b", Mm(-18.0, 62.0)))
    taken_s = timeit.repeat(lambda: predict(errors, CORNERS, 0.04), timer=time.process_time, number=100, repeat=5)
    assert min(taken_s) / 100 < 0.002  # 0.25 ms on a quiet machine


def test_shares_are_those_of_the_corner_that_varies_most() -> None:
    turn = Errors(("turn",), np.array([[0.0], [0.0], [1e-4]])).seen_from(Pose(*CORNERS[0], 0.0))
    shift = Errors(("shift",), np.array([[0.01], [0.0], [0.0]]))
    parts = shares(turn.and_of(shift), CORNERS)
    far = 53.0**2 + 85.0**2
    assert parts["turn"] == pytest.approx(far * 1e-8 / (far * 1e-8 + 1e-4))
