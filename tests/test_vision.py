import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from cellctl.geometry import Px
from cellctl.vision import (
    ExpectedCircle,
    ExpectedEdge,
    Limits,
    Search,
    find_base,
    find_battery,
)
from simulators.parts import BaseDrawing
from simulators.place import Place
from tests.vision_scenes import (
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
pytestmark = pytest.mark.usefixtures("one_thread")


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
