import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators import parts
from simulators.place import Place
from simulators.render import Light, Optics, Polygon, Ring, Scene, Stroke, disk, placed, render
from tests.vision_scenes import PLAIN

Inside = Callable[[np.ndarray, np.ndarray], np.ndarray]

DARK, BRIGHT = 20.0, 220.0
FINE = 10  # samples per pixel and axis of the brute-force picture
RECTANGLE = np.array([[-1.5, -1.0], [1.7, -1.0], [1.7, 1.2], [-1.5, 1.2]])
ATTITUDES = [(11.0, "up"), (45.0, "down"), (203.0, "down")]


def small_camera(turn_deg: float, looks: str) -> Optics:
    """Tilted by some percent and strongly distorted, so that a mistake in either shows in a small picture."""
    plain = Optics.aimed((0.1, -0.05), looks=looks, turn_deg=turn_deg, px_per_mm=16.0, width=88, height=72)
    tilt = np.array([[1.0, 0.02], [0.0, 0.97]])
    return replace(plain, matrix=plain.matrix @ tilt, k1=3e-7, noise=0.0, black=0.0, light=PLAIN)


def brute_force(inside: Inside, optics: Optics) -> np.ndarray:
    """Coverage per pixel: many samples, blurred, then averaged over each pixel."""
    rim = 8
    u, v = ((np.arange((n + 2 * rim) * FINE) + 0.5) / FINE - 0.5 - rim for n in (optics.width, optics.height))
    mm = optics.mm_from_px(np.stack(np.meshgrid(u, v), axis=-1))
    fine = inside(mm[..., 0], mm[..., 1]).astype(np.float32)
    fine = cv2.GaussianBlur(fine, (0, 0), optics.blur_px * FINE, borderType=cv2.BORDER_REPLICATE)
    pixels = fine.reshape(len(v) // FINE, FINE, len(u) // FINE, FINE).mean(axis=(1, 3))
    return pixels[rim:-rim, rim:-rim]


def coverage(shape, optics: Optics) -> np.ndarray:
    picture = render(Scene(DARK, [shape]), optics, np.random.default_rng(0))
    return (picture - DARK) / (BRIGHT - DARK)


def in_disk(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.hypot(x - 0.2, y - 0.1) < 1.93


def in_ring(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return in_disk(x, y) & (np.hypot(x - 0.2, y - 0.1) > 1.0)


def in_rectangle(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (x > -1.5) & (x < 1.7) & (y > -1.0) & (y < 1.2)


def in_rounded(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    dx, dy = (np.maximum(np.maximum(low - p, p - high), 0.0) for p, low, high in ((x, -0.7, 0.9), (y, -0.2, 0.4)))
    return np.hypot(dx, dy) < 0.8


def in_notch(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return in_rectangle(x, y) & ~((x > 0.2) & (y > 0.3))


SHAPES = {
    "disk": (disk((0.2, 0.1), 1.93, BRIGHT), in_disk),
    "ring": (Ring((0.2, 0.1), 1.0, 1.93, BRIGHT), in_ring),
    "rectangle": (Polygon(RECTANGLE, BRIGHT), in_rectangle),
    "rectangle the other way round": (Polygon(RECTANGLE[::-1], BRIGHT), in_rectangle),
    "rounded": (Polygon(RECTANGLE, BRIGHT, radius_mm=0.8), in_rounded),
    "hollow corner": (
        Polygon(np.array([[-1.5, -1], [1.7, -1], [1.7, 0.3], [0.2, 0.3], [0.2, 1.2], [-1.5, 1.2]]), BRIGHT),
        in_notch,
    ),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_looks_as_brute_force_says(name: str) -> None:
    shape, inside = SHAPES[name]
    for turn_deg, looks in ATTITUDES:
        optics = small_camera(turn_deg, looks)
        wrong = coverage(shape, optics) - brute_force(inside, optics)

        assert np.abs(wrong).max() < 0.03, (turn_deg, looks)


def test_an_edge_lies_within_five_thousandths_of_a_pixel() -> None:
    for turn_deg in (3.3, 31.0, 46.0, 93.1):  # never along the samples of the brute-force picture
        optics = small_camera(turn_deg, "down")
        edge = Polygon(np.array([[-20.0, -20.0], [20.0, -20.0], [20.0, 0.0137], [-20.0, 0.0137]]), BRIGHT)
        truth = brute_force(lambda x, y: y < 0.0137, optics)
        wrong = coverage(edge, optics) - truth
        length = np.abs(np.diff(truth, axis=0))[:, 10:-10].sum(), np.abs(np.diff(truth, axis=1))[10:-10].sum()

        assert abs(wrong.sum()) / max(length) < 0.005, turn_deg


def test_a_circle_lies_within_five_thousandths_of_a_pixel() -> None:
    for turn_deg, looks in ATTITUDES:
        optics = small_camera(turn_deg, looks)
        wrong = coverage(disk((0.2, 0.1), 1.93, BRIGHT), optics) - brute_force(in_disk, optics)
        centre, radius = optics.px_from_mm(np.array([0.2, 0.1])), 1.93 * optics.px_per_mm
        v, u = np.mgrid[: optics.height, : optics.width]
        phi = np.arctan2(v - centre[1], u - centre[0])
        shift = [float((wrong * f).sum()) / (math.pi * radius) for f in (np.cos(phi), np.sin(phi))]
        growth = float(wrong.sum()) / (2.0 * math.pi * radius)

        assert np.abs([*shift, growth]).max() < 0.005, (turn_deg, looks)


def test_a_stroke_has_its_width_and_place() -> None:
    optics = replace(small_camera(20.0, "up"), matrix=Optics.aimed((0, 0), looks="up", px_per_mm=16.0).matrix, k1=0.0)
    line = Stroke(np.array([[-10.0, 0.2], [10.0, 0.5]]), 0.2, BRIGHT)
    slope = math.atan2(0.3, 20.0)
    truth = brute_force(lambda x, y: np.abs((y - 0.35) * math.cos(slope) - x * math.sin(slope)) < 0.1, optics)

    assert np.abs(coverage(line, optics) - truth).max() < 0.03


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-3.5e-10, 3.5e-10))
def test_pixels_and_millimetres_are_exact_inverses(u: float, v: float, k1: float) -> None:
    optics = replace(Optics.aimed((300.0, -120.0), looks="up", turn_deg=2.0), k1=k1)
    there = optics.px_from_mm(optics.mm_from_px(np.array([u, v])))

    assert there == pytest.approx([u, v], abs=1e-6)


def test_directions_are_the_derivative_of_the_map() -> None:
    optics = replace(Optics.aimed((10.0, 20.0), looks="down", turn_deg=33.0), k1=3e-10)
    points = np.array([[3.0, 16.0], [17.0, 23.0]])
    way = np.array([[0.6, 0.8], [1.0, 0.0]])
    px, direction = optics.traced(points, way)
    step = (optics.px_from_mm(points + 1e-4 * way) - optics.px_from_mm(points - 1e-4 * way)) / 2e-4

    assert px == pytest.approx(optics.px_from_mm(points))
    assert direction == pytest.approx(step, rel=1e-6)


def test_camera_1_is_mirrored_and_camera_2_is_not() -> None:
    origin = np.array([[5.0, 7.0], [6.0, 7.0], [5.0, 8.0]])
    down, up = (Optics.aimed((5.0, 7.0), looks=looks).px_from_mm(origin) for looks in ("down", "up"))

    assert np.sign(down[1] - down[0]).tolist() == [1.0, 0.0]
    assert np.sign(down[2] - down[0]).tolist() == [0.0, -1.0]
    assert np.sign(up[2] - up[0]).tolist() == [0.0, 1.0]


def test_no_light_gives_a_dark_noisy_picture() -> None:
    picture = render(parts.scene((parts.base(parts.BaseDrawing()), Place(0, 0))), camera(), generator(), exposure=0.0)

    assert picture.mean() == pytest.approx(6.0, abs=0.3)
    assert 2.0 < picture.std() < 3.0


def camera(**changes: object) -> Optics:
    return replace(Optics.aimed((0.0, 2.0), looks="down", width=640, height=480), **changes)


def generator() -> np.random.Generator:
    return np.random.default_rng(1)


def test_exposure_scales_the_light() -> None:
    plain = camera(light=PLAIN, noise=0.0)
    full, half = (render(Scene(100.0, []), plain, generator(), exposure=e) for e in (1.0, 0.5))

    assert (int(full[0, 0]), int(half[0, 0])) == (106, 56)


def test_over_exposed_parts_saturate() -> None:
    picture = render(Scene(100.0, []), camera(), generator(), exposure=4.0)

    assert picture.min() == 255


def test_noise_has_the_asked_for_strength_and_changes_from_picture_to_picture() -> None:
    rng = generator()
    one, other = (render(Scene(100.0, []), camera(light=PLAIN, noise=4.0), rng) for _ in range(2))

    assert one.std() == pytest.approx(4.0, rel=0.02)
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] == pytest.approx(0.0, abs=0.02)


def test_light_falls_off_as_asked() -> None:
    picture = render(Scene(200.0, []), camera(noise=0.0, light=Light(0.05, 0.0, 0.0)), generator())

    assert picture[:, -1].mean() - picture[:, 0].mean() == pytest.approx(20.0, abs=0.6)


def test_texture_stays_inside_its_polygon() -> None:
    square = Polygon(np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, 3.0], [-1.0, 3.0]]), 100.0, texture=2.0)
    picture = render(Scene(50.0, [square]), camera(noise=0.0, light=PLAIN), generator())

    assert picture[200:280, 280:360].std() == pytest.approx(2.0, rel=0.25)
    assert picture[:20].std() == 0.0


def test_later_shapes_cover_earlier_ones_and_shapes_out_of_view_do_nothing() -> None:
    plain = camera(noise=0.0, light=PLAIN, black=0.0)
    shapes = [disk((0.0, 2.0), 1.0, 200.0), disk((0.0, 2.0), 0.5, 80.0), disk((500.0, 2.0), 3.0, 255.0)]
    picture = render(Scene(50.0, shapes), plain, generator())

    assert (picture[240, 320], picture[240, 320 + 100], picture[0, 0]) == (80, 200, 50)


def test_a_stroke_that_is_an_area_is_refused() -> None:
    with pytest.raises(ValueError, match="too wide"):
        render(Scene(50.0, [Stroke(np.array([[-1.0, 2.0], [1.0, 2.0]]), 0.5, 200.0)]), camera(), generator())


def test_two_threads_render_what_one_renders() -> None:
    scene = parts.scene((parts.base(parts.BaseDrawing()), Place(0.1, 0.2, 0.3)))

    def picture(seed: int) -> np.ndarray:
        return render(scene, camera(), np.random.default_rng(seed))

    with ThreadPoolExecutor(2) as pool:
        together = list(pool.map(picture, range(8)))

    for seed, seen in enumerate(together):
        assert np.array_equal(seen, picture(seed))


def test_the_hole_of_a_base_has_the_drawn_radius() -> None:
    optics = camera(noise=0.0, light=PLAIN, width=1000, height=1000, offset_px=np.array([500.0, 500.0]))
    picture = render(parts.scene((parts.base(parts.BaseDrawing(hole_radius_mm=2.5)), Place(0, 0))), optics, generator())
    dark = (picture < 88).sum() - (picture[:, 880:] < 88).sum() - (picture[:, :120] < 88).sum()

    assert math.sqrt(dark / math.pi) / optics.px_per_mm == pytest.approx(2.5, abs=0.005)


def test_a_base_has_its_edge_and_its_seat_where_the_drawing_says() -> None:
    drawing = parts.BaseDrawing(seat_x_mm=12.0, seat_y_mm=-30.0, seat_width_mm=20.0, seat_height_mm=10.0)
    optics = replace(Optics.aimed((12.0, -12.0), looks="up", px_per_mm=20.0, width=900, height=900), noise=0.0)
    picture = render(parts.scene((parts.base(drawing), Place(0, 0))), optics, generator()).astype(float)
    u, v = (round(x) for x in optics.px_from_mm(np.array([12.0, -30.0])))
    across = np.flatnonzero(np.abs(np.diff(picture[v, u - 260 : u + 260])) > 8) + u - 260
    edge = np.flatnonzero(np.abs(np.diff(picture[:, u])) > 20)[-1]

    assert np.ptp(across) / 20.0 == pytest.approx(20.0, abs=0.15)
    assert optics.mm_from_px(np.array([u, edge + 0.5]))[1] == pytest.approx(6.0, abs=0.05)


def test_a_dot_plate_has_its_dots_where_it_says_and_the_first_is_larger() -> None:
    optics = replace(Optics.aimed((4.8, 3.6), looks="down", turn_deg=5.0, px_per_mm=60.0, width=960, height=720))
    plate = parts.PlateDrawing()
    picture = render(Scene(60.0, placed(parts.dot_plate(), Place(0.1, 0.05))), optics, generator())
    count, _, stats, _ = cv2.connectedComponentsWithStats((picture < 118).astype(np.uint8))
    dots = [i for i in range(1, count) if 400 < stats[i, cv2.CC_STAT_AREA] < 4000]
    expected = optics.px_from_mm(plate.dots() + np.array([0.1, 0.05]))
    largest = max(dots, key=lambda i: stats[i, cv2.CC_STAT_AREA])
    box = stats[largest, [cv2.CC_STAT_LEFT, cv2.CC_STAT_TOP, cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]

    assert len(dots) == 63
    assert box[:2] + box[2:] / 2 - 0.5 == pytest.approx(expected[0], abs=0.6)


def test_form_error_bends_an_edge_but_leaves_its_corners() -> None:
    straight, wavy = (parts.battery(parts.BatteryDrawing(form_sd_mm=sd, form_seed=3))[0].points for sd in (0.0, 0.01))
    lower = wavy[(wavy[:, 1] < -42.0) & (np.abs(wavy[:, 0]) < 24.0)]

    assert 0.004 < lower[:, 1].std() < 0.02
    assert {tuple(p) for p in straight} <= {tuple(p) for p in wavy}
