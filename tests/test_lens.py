"""Lenses from points: both models against truth, what is left out, what is refused. Truth is projected by OpenCV."""

import math
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cellctl.calibration.board import DotBoard
from cellctl.calibration.errors import LensRefused
from cellctl.calibration.lens.boards import Chessboard
from cellctl.calibration.lens.model import LensModel, Views
from cellctl.calibration.lens.pinhole import Pinhole
from cellctl.calibration.lens.quality import common_residual, uncertainty
from cellctl.calibration.lens.report import assumed, lens_text
from cellctl.calibration.lens.report_picture import lens_picture
from cellctl.calibration.lens.sightings import Sighting, views_of
from cellctl.calibration.lens.solve import LensResult, calibrate_lens
from cellctl.calibration.lens.telecentric import Telecentric
from tests.lens_scenes import Camera, some_places

BOARD = Chessboard(9, 7, 10.0)
CAMERA = Camera((1500.0, 1501.5, 650.0, 470.0), (-0.2, 0.1, 0.001, -0.0005, 0.02), (1280, 960))
DOTS = DotBoard()
FIVE_MP = (2592, 1944)


def seen(rng: np.random.Generator, count: int = 12, *, camera: Camera = CAMERA, tilt_deg=28.0, noise_px=0.1) -> Views:
    """A chessboard in so many pictures."""
    places = some_places(rng, camera, BOARD, count, tilt_deg)
    points = np.array([camera.see(place, BOARD.points_mm) for place in places])
    points += rng.normal(0, noise_px, points.shape)
    return Views(BOARD.points_mm, points, np.ones(points.shape[:2], bool), camera.picture_px)


def telecentric(
    rng: np.random.Generator, count: int = 10, *, tilt_deg=(3.0, 15.0), lens=(136.0, 0.0, 0.0, -2e-9, 1330.0, 940.0)
) -> Views:
    """A dot plate before a camera that looks down: turned in space, then seen by parallel projection."""
    scale, e, g, k1, *centre = lens
    points = []
    for _ in range(count):
        side, tilt = rng.uniform(0, 2 * np.pi), math.radians(rng.uniform(*tilt_deg))
        turn = cv2.Rodrigues(np.array([math.cos(side), math.sin(side), 0.0]) * tilt)[0]
        turn = turn @ cv2.Rodrigues(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))[0]
        board = (DOTS.points_mm - DOTS.centre_mm) * (1.0, -1.0)
        flat = np.column_stack([board, np.zeros(len(board))]) @ turn[:2].T @ np.array([[1 + e, g], [g, 1 - e]]) * scale
        flat += (1295.5 + rng.uniform(-300, 300), 971.5 + rng.uniform(-150, 150))
        away = flat - centre
        points.append(flat + away * k1 * (away**2).sum(1, keepdims=True))
    seen_px = np.array(points) + rng.normal(0, 0.03, (count, len(DOTS.points_mm), 2))
    return Views(DOTS.points_mm, seen_px, np.ones(seen_px.shape[:2], bool), FIVE_MP)


def names(views: Views) -> list[str]:
    return [f"{index}.png" for index in range(len(views.seen))]


def calibrated(lens, views: Views) -> LensResult:
    return calibrate_lens(lens, views, names(views))


@cache
def good() -> LensResult:
    return calibrated("pinhole", seen(np.random.default_rng(1)))


# -- the models --------------------------------------------------------------------------------------------------------


def slopes(model: LensModel, shared: np.ndarray, own: np.ndarray, board: np.ndarray, steps: np.ndarray):
    """Derivatives of `see` by differences, (n, m, 2, S + P) for one picture each."""
    x = np.concatenate([shared, own[0]])

    def see(values: np.ndarray) -> np.ndarray:
        return model.see(values[: len(shared)], values[None, len(shared) :], board)

    ways = np.diag(steps)
    return np.stack([(see(x + way) - see(x - way)) / (2 * way.sum()) for way in ways], axis=-1)


def test_the_pinhole_model_is_opencvs_and_its_derivatives_are_right():
    rng = np.random.default_rng(3)
    place = some_places(rng, CAMERA, BOARD, 1)
    assert (
        np.abs(Pinhole().see(CAMERA.truth, place, BOARD.points_mm)[0] - CAMERA.see(place[0], BOARD.points_mm)).max()
        < 1e-8
    )
    by_shared, by_own = Pinhole().jacobian(CAMERA.truth, place, BOARD.points_mm)
    expected = slopes(Pinhole(), CAMERA.truth, place, BOARD.points_mm, np.array([1e-3] * 4 + [1e-5] * 8 + [1e-3] * 3))
    found = np.concatenate([by_shared, by_own], axis=-1)
    assert np.abs(found - expected).max(axis=(0, 1, 2)) == pytest.approx(0, abs=1e-5 * np.abs(found).max())


@pytest.mark.parametrize("mirrored", [True, False])
def test_the_derivatives_of_the_telecentric_model_are_right(mirrored):
    model = Telecentric(mirrored=mirrored)
    shared = np.array([136.0, 0.001, -0.0005, -3e-9, 1e-16, 1e-22, 1300.0, 960.0])
    own = np.array([[0.7, 0.2, -0.1, 1100.0, 900.0]])
    steps = np.array([1e-3, 1e-6, 1e-6, 1e-11, 1e-18, 1e-24, 1e-2, 1e-2, 1e-6, 1e-6, 1e-6, 1e-2, 1e-2])
    found = np.concatenate(model.jacobian(shared, own, DOTS.points_mm), axis=-1)
    expected = slopes(model, shared, own, DOTS.points_mm, steps)
    largest = np.abs(found).max(axis=(0, 1, 2))
    assert (np.abs(found - expected).max(axis=(0, 1, 2)) / largest).max() < 1e-5


# -- against truth -----------------------------------------------------------------------------------------------------


def normalised(found: LensResult, truth: np.ndarray) -> float:
    """Squared error in sigmas, per parameter: 1 on average when the covariance is right."""
    error, sd = found.fit.shared - truth, found.sd
    correlation = found.covariance / np.outer(sd, sd)
    return float((error / sd) @ np.linalg.solve(correlation, error / sd)) / len(truth)


def test_the_errors_of_a_pinhole_lens_are_as_large_as_its_covariance_says():
    found = [calibrated("pinhole", seen(np.random.default_rng(seed), 8)) for seed in range(10)]
    squares = [normalised(one, CAMERA.truth) for one in found]
    assert 0.7 < np.mean(squares) < 1.35  # 90 degrees of freedom
    assert np.mean([one.fit.adjustment.sd_px for one in found]) == pytest.approx(0.1, rel=0.03)
    assert all(0.9 < one.hold_out_px / one.fit.rms_px < 1.5 for one in found)


def test_the_errors_of_a_telecentric_lens_are_as_large_as_its_covariance_says():
    squares = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        e, g, k1 = rng.normal(0, 1e-4), rng.normal(0, 1e-4), rng.normal(0, 3e-9)
        u, v = rng.normal((1295.5, 971.5), 60)
        found = calibrated("telecentric", telecentric(rng, lens=(136.0, e, g, k1, u, v)))
        squares.append(normalised(found, np.array([136.0, e, g, k1, 0.0, 0.0, u, v])))
    assert 0.5 < np.mean(squares) < 1.3  # 64 degrees of freedom; k2 and k3 are truly 0, as taken for granted


@given(st.integers(0, 10**6), st.floats(0.7, 3.0), st.floats(-0.25, 0.1), st.floats(-0.1, 0.1))
@settings(max_examples=6, deadline=None)
def test_any_ordinary_lens_is_found_without_noise(seed, focal, k1, k2):
    rng = np.random.default_rng(seed)
    camera = Camera((focal * 1280, focal * 1290, 650.0, 470.0), (k1, k2, 0.001, -0.0005, 0.0), (1280, 960))
    found = calibrated("pinhole", seen(rng, 6, camera=camera, noise_px=1e-4))
    assert found.fit.shared[:4] == pytest.approx(camera.truth[:4], rel=3e-4)
    assert found.fit.rms_px < 2e-4


def test_pictures_taken_squarely_do_for_a_telecentric_lens():
    found = calibrated("telecentric", telecentric(np.random.default_rng(5), 6, tilt_deg=(0.0, 0.0)))
    assert found.fit.shared[0] == pytest.approx(136.0, abs=0.005)
    assert found.fit.shared[3] == pytest.approx(-2e-9, abs=2e-10)


def test_one_picture_does_for_a_telecentric_lens_and_the_report_says_what_it_does_not_show():
    found = calibrated("telecentric", telecentric(np.random.default_rng(6), 1, tilt_deg=(0.0, 0.5)))
    assert found.fit.shared[0] == pytest.approx(136.0, rel=5e-4)
    assert found.sd[0] == pytest.approx(136.0 * 2e-4, rel=0.2)  # what is taken for granted of the sensor's tilt
    assert found.hold_out_px is None
    assert found.fold_sd is None
    assert {"squeeze_e", "squeeze_g"} <= set(assumed(found))
    assert "taken for granted: squeeze_e, squeeze_g" in lens_text(found)


@pytest.mark.parametrize("corrected", [True, False])
def test_dots_seen_askew_are_used_where_their_centres_are(corrected):
    """The middle of each dot by brute force: the centre of gravity of its outline's polygon as OpenCV projects it."""
    board = DotBoard(9, 7, 10.0, 6.0, 8.0)
    rng = np.random.default_rng(2)
    camera = Camera((1500.0, 1500.0, 640.0, 480.0), (-0.1, 0.05, 0.0, 0.0, 0.0), (1280, 960))
    angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    sizes = np.full(63, 3.0)
    sizes[0] = 4.0
    sightings = []
    for place in some_places(rng, camera, board, 8, tilt_deg=40):
        outlines = board.points_mm[:, None] + sizes[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
        rims = [camera.see(place, rim).astype(np.float32) - 600 for rim in outlines]
        moments = [cv2.moments(rim) for rim in rims]
        middles = np.array([[m["m10"] / m["m00"], m["m01"] / m["m00"]] for m in moments]) + 600
        sightings.append(Sighting(middles, np.ones(63, bool)))
    views = views_of(sightings, board, camera.picture_px)
    found = calibrated("pinhole", views if corrected else views._replace(diameters_mm=None))
    error = np.abs(found.fit.shared - camera.truth)[:4].max()
    assert (error < 0.02) == corrected


# -- what is left out --------------------------------------------------------------------------------------------------


def test_two_wrong_points_are_left_out_and_their_pictures_stay():
    views = seen(np.random.default_rng(7))
    views.points_px[2, 5] += 30
    views.points_px[7, 50] -= (4, 6)
    found = calibrated("pinhole", views)
    assert np.argwhere(~found.fit.used).tolist() == [[2, 5], [7, 50]]
    assert normalised(found, CAMERA.truth) < 3
    assert "2 points far off left out" in lens_text(found)


def test_a_blurred_picture_is_left_out_by_name():
    rng = np.random.default_rng(8)
    views = seen(rng)
    views.points_px[3] += rng.normal(0, 2, (63, 2))
    found = calibrated("pinhole", views)
    assert [out.name for out in found.out] == ["3.png"]
    assert "px is usual here" in found.out[0].reason


def test_a_picture_whose_points_are_in_another_order_is_left_out_by_name():
    rng = np.random.default_rng(9)
    views = seen(rng)
    views.points_px[4] = views.points_px[4][rng.permutation(63)]
    found = calibrated("pinhole", views)
    assert [out.name for out in found.out] == ["4.png"]
    assert "beside a flat board's" in found.out[0].reason


def test_a_picture_of_another_zoom_is_left_out_though_it_fits_quite_well():
    views, zoomed = seen(np.random.default_rng(0)), CAMERA._replace(intrinsics=(1600.0, 1601.6, 650.0, 470.0))
    views.points_px[5] = seen(np.random.default_rng(100), 1, camera=zoomed).points_px[0]
    found = calibrated("pinhole", views)
    assert [out.name for out in found.out] == ["5.png"]
    assert normalised(found, CAMERA.truth) < 3


def test_the_same_picture_twice_counts_once():
    views = seen(np.random.default_rng(10))
    views.points_px[6] = views.points_px[1]
    found = calibrated("pinhole", views)
    assert [tuple(out) for out in found.out] == [("6.png", "shows exactly what 1.png shows")]


def test_a_bent_board_shows_as_what_all_pictures_share():
    rng = np.random.default_rng(11)
    views = seen(rng)
    before = common_residual(good())
    bent = Chessboard(9, 7, 10.0).points_mm + rng.normal(0, 0.05, (63, 2))
    places = some_places(rng, CAMERA, BOARD, 12, 28.0)
    views = views._replace(points_px=np.array([CAMERA.see(place, bent) for place in places]))
    common, chance = common_residual(calibrated("pinhole", views))
    assert common > 2.5 * chance
    assert before[0] < 1.5 * before[1]


# -- what is refused ---------------------------------------------------------------------------------------------------


def parallel(rng: np.random.Generator) -> Views:
    views = seen(rng, 8, tilt_deg=0.0)
    return views


def one_corner(rng: np.random.Generator) -> Views:
    far = CAMERA._replace(intrinsics=(300.0, 300.0, 640.0, 480.0))
    places = some_places(rng, CAMERA, BOARD, 6)
    points = np.array([far.see(place, BOARD.points_mm) for place in places]) / 2 + 20
    return Views(BOARD.points_mm, points, np.ones((6, 63), bool), (1280, 960))


def of_two_zooms(rng: np.random.Generator) -> Views:
    views = seen(rng, 8)
    other = seen(rng, 4, camera=CAMERA._replace(intrinsics=(2200.0, 2200.0, 650.0, 470.0)))
    views.points_px[4:] = other.points_px
    return views


@pytest.mark.parametrize(
    ("lens", "views", "says"),
    [
        ("pinhole", lambda rng: seen(rng, 2), "2 usable pictures, a pinhole lens needs 3"),
        ("pinhole", parallel, "parallel: all 8 boards are parallel"),
        ("pinhole", one_corner, "coverage: the board was seen over"),
        ("pinhole", of_two_zooms, "pictures disagree"),
        ("pinhole", lambda rng: telecentric(rng, 10), "focal length: not observable: .* no perspective"),
        ("pinhole", lambda rng: telecentric(rng, 10, tilt_deg=(10, 35)), "focal length: not observable"),
        ("telecentric", seen, "this lens is pinhole"),
    ],
)
def test_pictures_that_do_not_tell_are_refused_with_what_is_missing(lens, views, says):
    with pytest.raises(LensRefused, match=says):
        calibrated(lens, views(np.random.default_rng(12)))


def test_a_lens_far_away_whose_perspective_hardly_shows_is_refused():
    far = Camera((60000.0, 60000.0, 640.0, 480.0), (0.0, 0.0, 0.0, 0.0, 0.0), (1280, 960))
    with pytest.raises(LensRefused, match="focal length"):
        calibrated("pinhole", seen(np.random.default_rng(13), camera=far, tilt_deg=10))


@given(
    st.integers(0, 10**6),
    st.sampled_from(["pinhole", "telecentric"]),
    st.sampled_from(["noise", "one line", "far", "same"]),
)
@example(0, "pinhole", "one point")
@example(0, "telecentric", "one point")
@settings(max_examples=16, deadline=None)
def test_points_of_nothing_are_refused_with_a_sentence(seed, lens, kind):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 900, (4, 63, 2))
    if kind == "one line":
        points[..., 1] = 2 * points[..., 0] + rng.normal(0, 1, (4, 63))
    elif kind == "far":
        points = 1e9 * points
    elif kind == "same":
        points = np.repeat(BOARD.points_mm[None] * 10, 4, axis=0) + rng.normal(0, 1e-3, (4, 63, 2))
    elif kind == "one point":
        points[:] = 500.0
    views = Views(BOARD.points_mm, points, np.ones((4, 63), bool), (1280, 960))
    try:
        found = calibrated(lens, views)
    except LensRefused as refused:
        assert len(refused.detail) > 20  # noqa: PT017
    else:
        assert (lens, kind) == ("telecentric", "same")
        assert found.fit.rms_px < 0.01


# -- the report --------------------------------------------------------------------------------------------------------


def test_the_report_names_every_figure_and_every_picture():
    text = lens_text(good())
    for word in ("fx_px", "k3", "p2", "sd (pictures)", "hold-out", "coverage", "lens known", *good().names):
        assert word in text


def test_the_lens_is_known_best_where_the_board_was_seen():
    known = uncertainty(good())
    assert known.rms_px < 0.3 * known.worst_px
    assert known.sd_px[5:7, 7:9].max() < known.sd_px[0, 0]


def test_the_uncertainty_is_what_the_errors_are():
    """Directions in which lenses from other noise put points, turned to agree with the truth, against the forecast."""
    found = [calibrated("pinhole", seen(np.random.default_rng(seed), 8)) for seed in range(4)]
    grid = np.stack(np.meshgrid(np.linspace(400, 880, 5), np.linspace(300, 660, 5)), -1).reshape(-1, 2)
    ratios = []
    for one in found:
        known = uncertainty(one)
        truly, free = Pinhole().at_pixels(CAMERA.truth, grid)
        moved = truly @ (one.fit.shared - CAMERA.truth)
        flat = free.reshape(-1, 3)
        left = moved.ravel() - flat @ np.linalg.lstsq(flat, moved.ravel(), rcond=None)[0]
        ratios.append((left**2).sum() / 25 / known.rms_px**2)
    assert 0.1 < np.mean(ratios) < 1.5  # turned to agree in the middle alone, so smaller than over all that was seen


def test_the_picture_shows_four_panels_whatever_was_left_out():
    rng = np.random.default_rng(8)
    views = seen(rng)
    views.points_px[3] += rng.normal(0, 2, (63, 2))
    for result in (good(), calibrated("pinhole", views), calibrated("telecentric", telecentric(rng, 1))):
        drawn = lens_picture(result)
        assert drawn.shape[1] == 1440
        assert all(
            len(np.unique(part)) > 20 for half in np.array_split(drawn, 2) for part in np.array_split(half, 2, 1)
        )
