import contextlib
import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cellctl.geometry import Px
from cellctl.vision import (
    Edge,
    ExpectedCircle,
    ExpectedEdge,
    Limits,
    NotFound,
    Search,
    find_base,
    find_battery,
)
from simulators.parts import BaseDrawing
from simulators.place import Place
from simulators.render import Polygon, Scene, render
from tests.vision_scenes import (
    BASE_SEARCH,
    BATTERY_SEARCH,
    UM_PER_PX,
    Camera,
    View,
    base_view,
    battery_view,
    clutter,
    line_error,
    some_camera,
    some_place,
)

# Three pictures' worth of sigmas with texture: 0.025 um each for hole and line, 0.3 mdeg, 0.08 um for the corner.
HOLE_UM, LINE_UM, ANGLE_DEG, CORNER_UM, CORNER_ANGLE_DEG = 0.15, 0.15, 0.002, 0.6, 0.006


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)


def refusal(view: View, find: str = "base") -> str:
    with pytest.raises(NotFound) as caught:
        view.base() if find == "base" else view.battery()
    assert caught.value.detail in str(caught.value)
    return caught.value.check


# -- truth --------------------------------------------------------------------------------------------------


def test_a_base_is_measured_to_a_tenth_of_a_micrometre_however_the_camera_is_mounted() -> None:
    rng = np.random.default_rng(1)
    for _ in range(25):
        view = base_view(rng, some_camera(rng), some_place(rng))
        seen = view.base()
        offset, turn = line_error(seen.edge, *view.truth[1:])

        assert math.dist(seen.circle.centre, view.truth[0]) * UM_PER_PX < HOLE_UM
        assert abs(offset) * UM_PER_PX < LINE_UM
        assert abs(turn) < ANGLE_DEG
        assert seen.hole_to_edge_px == pytest.approx(6.0 * view.optics.px_per_mm, abs=0.03)


def test_a_battery_corner_is_measured_to_half_a_micrometre_within_the_whole_search() -> None:
    rng = np.random.default_rng(2)
    for x_mm in (-2.5, 0.3, 2.5):
        for y_mm in (-2.5, 2.5):
            corner = (int(rng.choice([-1, 1])), int(rng.choice([-1, 1])))
            camera = Camera(float(rng.choice([-1.5, 0.0, 1.0, 180.0])), "up", blur_px=float(rng.uniform(0.8, 1.5)))
            view = battery_view(rng, camera, Place(x_mm, y_mm, float(rng.uniform(-1.9, 1.9))), corner)
            check_battery(view)


def test_a_battery_is_found_by_a_camera_mounted_at_any_angle() -> None:
    rng = np.random.default_rng(3)
    for _ in range(14):
        check_battery(battery_view(rng, some_camera(rng), some_place(rng, 0.6), (1, -1)))


def check_battery(view: View) -> None:
    seen = view.battery()
    corner, end_1, end_2 = view.truth

    assert math.dist(seen.corner, corner) * UM_PER_PX < CORNER_UM
    assert abs(line_error(seen.edge_1, corner, end_1)[1]) < CORNER_ANGLE_DEG
    assert abs(line_error(seen.edge_2, corner, end_2)[1]) < CORNER_ANGLE_DEG
    assert abs(seen.squareness_deg) < 2 * CORNER_ANGLE_DEG


def test_the_found_edge_runs_as_the_expected_one() -> None:
    for turn_deg in (0.0, 90.0, 180.0, 270.0):
        view = base_view(np.random.default_rng(4), Camera(turn_deg))
        held = battery_view(np.random.default_rng(4), Camera(turn_deg))
        found = [view.base().edge, held.battery().edge_1, held.battery().edge_2]

        for seen, expected in zip(found, [view.features[1], *held.features], strict=True):
            runs = [math.atan2(e.end.v - e.start.v, e.end.u - e.start.u) for e in (seen, expected)]
            assert math.cos(runs[0] - runs[1]) > 0.9999


def test_with_lens_distortion_it_finds_the_outline_that_is_in_the_picture() -> None:
    rng = np.random.default_rng(5)
    view = base_view(rng, Camera(3.0, k1=3.5e-10), Place(0.7, -0.6, 1.0))
    seen, place = view.base(), Place(0.7, -0.6, 1.0)
    phi = np.linspace(0.0, 2.0 * math.pi, 360, endpoint=False)
    rim = view.optics.px_from_mm(np.array([place.point(3.0 * math.cos(t), 3.0 * math.sin(t)) for t in phi]))
    edge = view.optics.px_from_mm(np.array([place.point(x, 6.0) for x in np.linspace(-7.0, 7.0, 100)]))
    slope, height = np.polyfit(edge[:, 0], edge[:, 1], 1)
    start, end = (Px(float(u), float(slope * u + height)) for u in edge[[0, -1], 0])
    offset, turn = line_error(seen.edge, start, end)

    assert math.dist(seen.circle.centre, fitted_centre(rim)) * UM_PER_PX < HOLE_UM
    assert math.dist(view.truth[0], fitted_centre(rim)) > 0.03  # the distortion does shift a hole's outline
    assert abs(offset) * UM_PER_PX < LINE_UM
    assert abs(turn) < ANGLE_DEG


def fitted_centre(rim: np.ndarray) -> np.ndarray:
    """Centre of the circle of least squares through points."""
    middle = rim.mean(axis=0)
    away = rim - middle
    design = np.column_stack([2.0 * away, np.ones(len(rim))])
    return middle + np.linalg.lstsq(design, np.sum(away * away, axis=1), rcond=None)[0][:2]


def test_dirt_scratches_and_blots_move_nothing_by_a_micrometre() -> None:
    rng = np.random.default_rng(6)
    for _ in range(6):
        camera, place = some_camera(rng), some_place(rng)
        base = base_view(rng, camera, place, over=clutter(rng, camera.aimed((0.0, 2.0))))
        battery = battery_view(rng, Camera(looks="up"), place, (1, 1), over=clutter(rng, camera.aimed((22.0, 39.0))))

        assert math.dist(base.base().circle.centre, base.truth[0]) * UM_PER_PX < 0.3
        assert abs(line_error(base.base().edge, *base.truth[1:])[0]) * UM_PER_PX < 0.5
        assert math.dist(battery.battery().corner, battery.truth[0]) * UM_PER_PX < 1.0


def test_the_groove_the_chamfer_and_the_inner_ring_are_not_taken_for_the_features() -> None:
    drawing = BaseDrawing(hole_radius_mm=3.0)
    rng = np.random.default_rng(7)
    for x_mm in (-1.4, 1.4):
        for y_mm in (-1.4, 1.4):
            view = base_view(rng, Camera(), Place(x_mm, y_mm, 1.9), drawing)
            seen = view.base()

            assert seen.circle.radius_px == pytest.approx(3.0 * view.optics.px_per_mm, abs=0.05)
            assert abs(line_error(seen.edge, *view.truth[1:])[0]) < 0.05


# -- own uncertainty ----------------------------------------------------------------------------------------


def test_the_predicted_uncertainty_is_honest() -> None:
    rng = np.random.default_rng(8)
    scores: dict[str, list[float]] = {name: [] for name in ("hole", "line", "angle", "corner", "corner angle")}
    for _ in range(30):
        view = base_view(rng, some_camera(rng), some_place(rng))
        seen = view.base()
        offset, turn = line_error(seen.edge, *view.truth[1:])
        scores["hole"] += [(a - b) / seen.circle.sd_px for a, b in zip(seen.circle.centre, view.truth[0], strict=True)]
        scores["line"].append(offset / seen.edge.offset_sd_px)
        scores["angle"].append(turn / seen.edge.angle_sd_deg)
    for _ in range(30):
        view = battery_view(
            rng, replace(some_camera(rng), turn_deg=float(rng.uniform(-5, 5))), some_place(rng), (-1, 1)
        )
        held = view.battery()
        scores["corner"] += [(a - b) / held.corner_sd_px for a, b in zip(held.corner, view.truth[0], strict=True)]
        for edge, end in ((held.edge_1, view.truth[1]), (held.edge_2, view.truth[2])):
            scores["corner angle"].append(line_error(edge, view.truth[0], end)[1] / edge.angle_sd_deg)

    for name, score in scores.items():
        assert 0.5 < float(np.sqrt(np.mean(np.square(score)))) < 2.0, name


def test_more_noise_and_less_contrast_are_said_to_be_less_certain() -> None:
    good, noisy, faint = (
        base_view(np.random.default_rng(9), camera).base().edge.offset_sd_px
        for camera in (Camera(noise=1.5), Camera(noise=7.0), Camera(exposure=0.4))
    )

    assert good < noisy
    assert good < faint


def test_the_blur_is_reported() -> None:
    for blur_px in (0.8, 1.2, 1.8):
        seen = base_view(np.random.default_rng(10), Camera(blur_px=blur_px)).base()

        assert seen.circle.blur_px == pytest.approx(blur_px, abs=0.11)
        assert seen.edge.blur_px == pytest.approx(blur_px, abs=0.11)


# -- refusals -----------------------------------------------------------------------------------------------


def test_texture_alone_is_refused() -> None:
    square = np.array([[-20.0, -20.0], [20.0, -20.0], [20.0, 20.0], [-20.0, 20.0]])
    base, battery = (v(np.random.default_rng(11)) for v in (base_view, battery_view))
    pixels = render(Scene(120.0, [Polygon(square, 120.0, texture=2.5)]), base.optics, np.random.default_rng(12))

    assert refusal(base._replace(pixels=pixels)) in {"hole", "contrast"}
    assert refusal(battery._replace(pixels=pixels), "battery") in {"edge 1", "contrast"}


def test_a_base_is_no_battery_and_a_battery_is_no_base() -> None:
    rng = np.random.default_rng(13)
    for corner in ((-1, -1), (1, 1)):
        for _ in range(3):
            base, battery = (
                base_view(rng, Camera(), some_place(rng)),
                battery_view(rng, Camera(), some_place(rng), corner),
            )

            assert refusal(battery._replace(pixels=base.pixels), "battery")
            assert refusal(base._replace(pixels=battery.pixels)) in {"hole", "hole inliers", "hole radius"}


def test_an_edge_that_goes_on_past_the_corner_is_refused() -> None:
    view = battery_view(np.random.default_rng(14))
    corner, (edge_1, edge_2) = view.truth[0], view.features
    pixels = view.pixels.copy()
    row = round(corner.v)
    pixels[row : row + 300, : round(corner.u) + 200] = 150

    assert refusal(view._replace(pixels=pixels, features=(edge_1, edge_2)), "battery") == "corner"


@pytest.mark.parametrize("radius_mm", [2.75, 2.88, 3.12, 3.3])
def test_a_hole_of_another_radius_is_refused(radius_mm: float) -> None:
    view = base_view(np.random.default_rng(15), drawing=BaseDrawing(hole_radius_mm=radius_mm))

    assert refusal(view) in {"hole radius", "hole"}


def test_an_edge_at_another_distance_from_the_hole_is_refused() -> None:
    view = base_view(np.random.default_rng(16), drawing=BaseDrawing(edge_distance_mm=6.3))

    assert refusal(view) == "hole to edge"


def test_a_picture_without_light_is_refused() -> None:
    dark = Camera(exposure=0.02)

    assert refusal(base_view(np.random.default_rng(17), dark)) == "light"
    assert refusal(battery_view(np.random.default_rng(17), dark), "battery") == "light"


def test_an_over_exposed_picture_is_refused() -> None:
    bright = Camera(exposure=2.6)

    assert refusal(base_view(np.random.default_rng(18), bright)) == "saturation"
    assert refusal(battery_view(np.random.default_rng(18), bright), "battery") == "saturation"


def test_a_part_that_is_away_is_refused() -> None:
    view, held = base_view(np.random.default_rng(19)), battery_view(np.random.default_rng(19))
    empty = render(Scene(45.0, []), view.optics, np.random.default_rng(20))

    assert refusal(view._replace(pixels=empty)) == "contrast"
    assert refusal(held._replace(pixels=empty), "battery") == "contrast"


def test_a_part_further_away_than_the_search_is_refused() -> None:
    assert refusal(base_view(np.random.default_rng(21), place=Place(3.0, 0.0))).startswith("hole")


def test_the_wrong_polarity_is_refused() -> None:
    view = base_view(np.random.default_rng(22))
    held = battery_view(np.random.default_rng(22))

    assert refusal(view._replace(pixels=255 - view.pixels)).startswith("hole")
    limits = replace(held.limits, min_contrast=40.0)  # above that of the battery's own seam
    assert refusal(held._replace(pixels=255 - held.pixels, limits=limits), "battery")


def test_a_hole_that_is_largely_covered_is_refused() -> None:
    lid = Polygon(np.array([[-4.0, -4.0], [4.0, -4.0], [4.0, 1.0], [-4.0, 1.0]]), 130.0)

    assert refusal(base_view(np.random.default_rng(23), over=[lid])).startswith("hole")


def test_a_battery_that_is_not_square_is_refused() -> None:
    view = battery_view(np.random.default_rng(24))
    one, two = view.features
    skewed = ExpectedEdge(two.start, Px(two.end.u + 0.008 * (two.end.v - two.start.v), two.end.v), two.bright_left)

    assert refusal(view._replace(features=(one, skewed)), "battery") == "squareness"


def test_an_angle_that_is_too_uncertain_is_refused() -> None:
    view = base_view(np.random.default_rng(25))

    assert refusal(view._replace(limits=replace(view.limits, max_angle_sd_deg=1e-5))) == "edge angle"


def test_a_hole_at_the_border_of_the_picture_is_refused() -> None:
    view = base_view(np.random.default_rng(26))
    circle, edge = view.features

    assert refusal(
        view._replace(
            pixels=np.ascontiguousarray(view.pixels[:, 1050:]),
            features=(circle._replace(centre=Px(circle.centre.u - 1050, circle.centre.v)), edge),
        )
    ) in {"view", "hole"}


# -- pictures drawn by hand -----------------------------------------------------------------------------------


def drawn_base(scale: int, mirrored: bool) -> np.ndarray:
    """A 900 x 700 base drawn with OpenCV, 8-fold and then shrunk: bright body below an edge at v = 120, hole in it.

    Seen by a mirrored camera (v = -y) the reference edge is on top; unmirrored, the same part is upside down.
    """
    picture = np.full((700 * scale, 900 * scale), 40, np.uint8)
    picture[120 * scale :] = 130
    cv2.circle(picture, (450 * scale, 400 * scale), 150 * scale, 30, -1)
    small = cv2.GaussianBlur(cv2.resize(picture, (900, 700), interpolation=cv2.INTER_AREA), (0, 0), 1.1)
    return small if mirrored else np.ascontiguousarray(small[::-1])


def test_a_hand_drawn_base_below_a_camera_that_looks_down() -> None:
    hole = ExpectedCircle(Px(440.0, 408.0), 150.0, True)
    edge = ExpectedEdge(Px(120.0, 125.0), Px(780.0, 125.0), bright_left=False)  # walking right, the body is below
    seen = find_base(drawn_base(8, mirrored=True), hole, edge, Search(60.0, 2.0), Limits(hole_to_edge_px=280.5))

    assert seen.circle.centre == pytest.approx((449.56, 399.56), abs=0.06)
    assert seen.circle.radius_px == pytest.approx(150.0, abs=0.1)
    assert seen.edge.start.v == pytest.approx(119.5, abs=0.02)
    assert seen.hole_to_edge_px == pytest.approx(280.0, abs=0.1)


def test_a_hand_drawn_base_seen_unmirrored() -> None:
    hole = ExpectedCircle(Px(440.0, 292.0), 150.0, True)
    edge = ExpectedEdge(Px(120.0, 575.0), Px(780.0, 575.0), bright_left=True)  # walking right, the body is above
    seen = find_base(drawn_base(8, mirrored=False), hole, edge, Search(60.0, 2.0), Limits(hole_to_edge_px=280.5))

    assert seen.circle.centre == pytest.approx((449.56, 299.44), abs=0.06)
    assert seen.edge.start.v == pytest.approx(579.5, abs=0.02)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_hand_drawn_battery_corner(mirrored: bool) -> None:
    """A camera that looks up shows a battery's lower left corner at the upper left (v = +y), mirrored: lower left."""
    picture = np.full((800, 1000), 40, np.uint8)
    picture[200:, 250:] = 150
    picture = cv2.GaussianBlur(picture, (0, 0), 1.1)
    corner, way = Px(249.5, 199.5), 1.0
    if mirrored:
        picture, corner, way = np.ascontiguousarray(picture[::-1]), Px(249.5, 599.5), -1.0
    expected = Px(corner.u + 20.0, corner.v - 15.0)
    edge_1 = ExpectedEdge(expected, Px(expected.u + 600.0, expected.v), bright_left=mirrored)
    edge_2 = ExpectedEdge(expected, Px(expected.u, expected.v + way * 450.0), bright_left=not mirrored)
    seen = find_battery(picture, edge_1, edge_2, Search(60.0, 2.0), Limits(corner_skip_px=100.0))

    assert tuple(seen.corner) == pytest.approx(tuple(corner), abs=0.02)
    assert seen.squareness_deg == pytest.approx(0.0, abs=0.002)


# -- junk -----------------------------------------------------------------------------------------------------

JUNK = hnp.arrays(
    dtype=st.sampled_from([np.uint8, np.uint16, np.float32, np.bool_]),
    shape=hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=9),
)


@settings(max_examples=60, deadline=None)
@given(junk=JUNK, repeat=st.integers(1, 60), u=st.floats(-500, 900), v=st.floats(-500, 900), radius=st.floats(-10, 300))
def test_junk_is_refused_in_words(junk: np.ndarray, repeat: int, u: float, v: float, radius: float) -> None:
    pixels = np.repeat(np.repeat(junk, repeat, axis=0), repeat, axis=1) if junk.ndim > 1 else junk
    circle = ExpectedCircle(Px(u, v), radius, True)
    edges = ExpectedEdge(Px(u, v), Px(u + 300.0, v), True), ExpectedEdge(Px(u, v), Px(u, v + 300.0), False)
    limits = Limits(corner_skip_px=20.0, min_contrast=5.0, min_inliers=0.0, max_residual_px=99.0)

    for find, features in ((find_base, (circle, edges[0])), (find_battery, edges)):
        with contextlib.suppress(NotFound, ValueError):  # anything else is a fault
            find(pixels, *features, Search(50.0, 3.0), limits)


@pytest.mark.parametrize(
    "junk", [None, 3, "picture", [[1, 2], [3, 4]], np.zeros((100, 100)), np.zeros((20, 200), np.uint8)]
)
def test_what_is_no_picture_is_a_value_error(junk: object) -> None:
    view, held = base_view(np.random.default_rng(27)), battery_view(np.random.default_rng(27))
    for finding in (view, held):
        with pytest.raises(ValueError, match="a picture must be"):
            finding._replace(pixels=junk).base() if finding is view else finding._replace(pixels=junk).battery()


@pytest.mark.parametrize(
    ("circle", "edge", "search"),
    [
        (ExpectedCircle(Px(math.nan, 0.0), 400.0, True), None, BASE_SEARCH),
        (ExpectedCircle(Px(900.0, 900.0), 0.0, True), None, BASE_SEARCH),
        (None, ExpectedEdge(Px(5.0, 5.0), Px(5.0, 5.0), True), BASE_SEARCH),
        (None, None, Search(-1.0, 2.0)),
        (None, None, Search(100.0, math.inf)),
    ],
)
def test_a_senseless_expectation_is_a_value_error(
    circle: ExpectedCircle | None, edge: ExpectedEdge | None, search: Search
) -> None:
    view = base_view(np.random.default_rng(28))
    features = (circle or view.features[0], edge or view.features[1])

    with pytest.raises(ValueError, match=r"expected|search|direction"):
        view._replace(features=features, search=search).base()


def test_two_expected_edges_must_make_a_corner() -> None:
    edge = ExpectedEdge(Px(0.0, 0.0), Px(500.0, 0.0), True)
    for other in (
        edge,
        ExpectedEdge(Px(1.0, 0.0), Px(1.0, 500.0), False),
        ExpectedEdge(Px(0.0, 0.0), Px(0.0, 9.0), True),
    ):
        with pytest.raises(ValueError, match="corner"):
            find_battery(np.zeros((600, 600), np.uint8), edge, other, BATTERY_SEARCH, Limits())


def test_measuring_changes_neither_the_picture_nor_its_own_answer() -> None:
    view = base_view(np.random.default_rng(29))
    before = view.pixels.copy()
    view.pixels.flags.writeable = False
    first, second = view.base(), view.base()

    assert first == second
    assert isinstance(first.edge, Edge)
    assert np.array_equal(view.pixels, before)
