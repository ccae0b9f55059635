import numpy as np
import pytest

from cellctl.geometry import Px
from cellctl.vision import ExpectedCircle, ExpectedEdge
from cellctl.vision.annotate import EXPECTED, FOUND, annotate
from simulators.place import Place
from tests.vision_scenes import base_view, battery_view


def coloured(drawn: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Places (v, u) whose colour is nearly this one."""
    return np.argwhere(np.abs(drawn.astype(int) - colour).max(axis=2) < 30)


def test_a_base_is_drawn_at_half_size_where_it_was_found() -> None:
    view = base_view(np.random.default_rng(1), place=Place(0.8, -0.5, 1.0))
    seen = view.base()
    drawn = annotate(view.pixels, seen, view.features, "unit 17 base")
    places = coloured(drawn, FOUND)
    centre = (np.array(seen.circle.centre) + 0.5) / 2 - 0.5
    away = np.hypot(places[:, 1] - centre[0], places[:, 0] - centre[1])
    on_circle = np.abs(away - seen.circle.radius_px / 2) < 2.0

    assert drawn.shape == (972, 1296, 3)
    assert drawn.dtype == np.uint8
    assert on_circle.sum() > 1000
    assert places[on_circle].mean(axis=0)[::-1] == pytest.approx(centre, abs=1.0)
    assert len(coloured(drawn, EXPECTED)) > 500


def test_a_battery_has_both_edges_and_its_corner_drawn() -> None:
    view = battery_view(np.random.default_rng(2))
    seen = view.battery()
    drawn = annotate(view.pixels, seen, view.features, "")
    places = coloured(drawn, FOUND)
    corner = (np.array(seen.corner) + 0.5) / 2 - 0.5

    assert (np.abs(places[:, 0] - corner[1]) < 3).sum() > 400
    assert (np.abs(places[:, 1] - corner[0]) < 3).sum() > 250


def test_a_refusal_shows_what_was_expected_and_says_why() -> None:
    view = base_view(np.random.default_rng(3))
    plain, told = (
        annotate(view.pixels, None, view.features, text) for text in ("", "no base: hole radius 380 px " * 9)
    )

    assert len(coloured(plain, FOUND)) == 0
    assert len(coloured(plain, EXPECTED)) > 500
    assert np.array_equal(plain[:600], told[:600])
    assert told[850:].max() == 255
    assert not np.array_equal(plain[850:], told[850:])


def test_features_outside_the_picture_and_odd_captions_do_no_harm() -> None:
    far = (ExpectedCircle(Px(1e9, float("nan")), 50.0, True), ExpectedEdge(Px(-1e12, 0.0), Px(float("inf"), 5.0), True))
    drawn = annotate(np.full((101, 203), 80, np.uint8), None, far, "Bild 3 µm → gut\n\n" + "x" * 500)

    assert drawn.shape == (50, 101, 3)


def test_what_is_no_picture_is_refused() -> None:
    with pytest.raises(ValueError, match="a picture must be"):
        annotate(np.zeros((100, 100, 3), np.uint8), None, (), "")
