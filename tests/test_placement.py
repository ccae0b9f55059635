"""The predicted placement error is the one that a Monte Carlo of the same errors gives."""

import math

import numpy as np
import pytest

from cellctl.geometry import Mm, Pose
from cellctl.placement import Source, predict

CORNERS = [Mm(-26.5, -42.5), Mm(26.5, -42.5), Mm(26.5, 42.5), Mm(-26.5, 42.5)]
SOURCES = [
    Source("hole", 0.0033, 0.0013, Mm(-18.0, 62.0)),
    Source("corner", 0.0033, 0.0013, CORNERS[0]),
    Source("seat", 0.0033, 0.0013, Mm(0.0, 0.0)),
]


def misplaced_mm(rng: np.random.Generator, corner: Mm) -> float:
    """How far one corner comes to lie from its place, every error drawn once and composed exactly."""
    motion = Pose(0.0, 0.0, 0.0)
    for source in SOURCES:
        dx, dy, dt = rng.normal(0.0, (source.sd_mm, source.sd_mm, source.sd_deg))
        centre = source.centre
        turn = Pose(centre.x_mm + dx, centre.y_mm + dy, dt) @ Pose(-centre.x_mm, -centre.y_mm, 0.0)
        motion = turn @ motion
    there = motion.point(*corner)
    return math.hypot(there.x_mm - corner.x_mm, there.y_mm - corner.y_mm)


def test_expected_and_p99_are_those_of_a_monte_carlo() -> None:
    predicted = predict(SOURCES, CORNERS)
    rng = np.random.default_rng(3)
    drawn = [np.array([misplaced_mm(rng, corner) for _ in range(3000)]) for corner in CORNERS]
    worst = max(drawn, key=lambda errors: float((errors**2).mean()))
    assert predicted.expected_mm == pytest.approx(math.sqrt(float((worst**2).mean())), rel=0.04)
    assert predicted.p99_mm == pytest.approx(float(np.quantile(worst, 0.99)), rel=0.08)


def test_the_largest_source_is_named_with_its_share() -> None:
    predicted = predict([Source("small", 0.001, 0.0, Mm(0, 0)), Source("big", 0.003, 0.0, Mm(0, 0))], CORNERS)
    assert predicted.largest == "big"
    assert predicted.share == pytest.approx(0.9)
    assert "largest share: big (90%)" in predicted.sentence


def test_an_angle_acts_at_its_lever() -> None:
    predicted = predict([Source("angle", 0.0, 0.01, CORNERS[0])], CORNERS)
    assert predicted.expected_mm == pytest.approx(math.radians(0.01) * math.hypot(53.0, 85.0))


def test_no_error_at_all_is_no_error() -> None:
    assert predict([Source("none", 0.0, 0.0, Mm(0, 0))], CORNERS)[:2] == (0.0, 0.0)
