"""How a battery lies in its seat, out of one picture: found to a fraction of a micrometre, or refused by name."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.assembly import seating
from cellctl.calibration.plane_map import PlaneMap
from cellctl.geometry import Offset, Pose, Px
from cellctl.recipe import Recipe, load_recipe
from cellctl.vision import ExpectedEdge, Limits, NotFound, Search
from cellctl.vision.gap import ExpectedGap, find_gap
from simulators.parts import BODY, FOIL, SLIT, BaseDrawing, BatteryDrawing, assembly, base, battery
from simulators.place import Place
from simulators.render import Light, Optics, Polygon, Scene, placed, render
from tests.benchmarks import bench_gap
from tests.gap_scenes import PLAIN_CAMERA, GapView, Lie, dirt, gap_view, some_camera_1, some_lie, some_stop
from tests.vision_scenes import HERE, Camera, textured

BASE = BaseDrawing()
UM = 1000.0
RECIPE: Recipe = load_recipe(Path(__file__).parent.parent / "recipes", "x85")
CORNERS = {(-1, -1): "lower_left", (1, -1): "lower_right", (-1, 1): "upper_left", (1, 1): "upper_right"}


def errors_um(view: GapView) -> np.ndarray:
    """Of the battery's corner against the seat's, in the picture's axes."""
    seen = view.found()
    apart = np.subtract(seen.battery_corner, seen.seat_corner) - np.subtract(view.truth[1], view.truth[0])
    return apart / view.optics.px_per_mm * UM


def test_clean_gaps_are_found_to_a_tenth_of_a_micrometre_in_every_corner_and_attitude() -> None:
    rng = np.random.default_rng(1)
    errors = []
    for corner in CORNERS:
        for _ in range(3):
            errors.append(errors_um(gap_view(rng, some_camera_1(rng), some_lie(rng, corner), some_stop(rng))))
    assert np.std(errors) < 0.25
    assert np.abs(errors).max() < 0.8


@pytest.mark.parametrize(("gap_mm", "within_um"), [(0.02, 4.0), (0.03, 2.0), (0.05, 0.7), (0.2, 0.7)])
def test_narrow_and_wide_gaps_are_found_though_their_edges_blur_into_each_other(
    gap_mm: float, within_um: float
) -> None:
    rng = np.random.default_rng(2)
    for _ in range(3):
        lie = Lie(dx_mm=gap_mm - 0.1, dy_mm=gap_mm - 0.1)
        assert np.abs(errors_um(gap_view(rng, some_camera_1(rng), lie, some_stop(rng)))).max() < within_um


def test_dirty_gaps_are_found_within_four_micrometres_or_refused() -> None:
    rng = np.random.default_rng(3)
    errors, refused = [], 0
    for _ in range(12):
        view = gap_view(rng, some_camera_1(rng), some_lie(rng), some_stop(rng), dirt(rng))
        try:
            errors.append(errors_um(view))
        except NotFound:
            refused += 1
    assert refused <= 2
    assert np.sqrt(np.mean(np.square(errors))) < 4.0
    assert np.abs(errors).max() < 12.0


def test_the_predicted_error_is_honest_in_clean_pictures() -> None:
    rng = np.random.default_rng(4)
    ratios = []
    for _ in range(12):
        lie = some_lie(rng)
        view = gap_view(rng, some_camera_1(rng), lie, some_stop(rng))
        seen = view.found()
        for slit, gap_mm, sense in ((seen.slit_1, view.gaps_mm[0], 1.0), (seen.slit_2, view.gaps_mm[1], -1.0)):
            lever_mm = math.dist(slit.seat.middle, view.truth[1]) / view.optics.px_per_mm
            true_px = (gap_mm + sense * math.radians(lie.dt_deg) * lever_mm) * view.optics.px_per_mm
            ratios.append((slit.width_px - true_px) / math.sqrt(slit.covariance[0][0]))
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 1.5


# -- in millimetres ----------------------------------------------------------------------------------------


def plane_of(optics: Optics, moved_mm: tuple[float, float] = (0.0, 0.0)) -> PlaneMap:
    """The camera's true map, or one that is falsified by a shift."""
    offset = optics.offset_px - optics.matrix @ np.array(moved_mm)
    return PlaneMap.from_arrays(optics.matrix, offset, 0.0, optics.centre_px)


def lying(view: GapView, plane: PlaneMap, corner: tuple[int, int] = (-1, -1)) -> seating.Seating:
    """What the product makes of a picture, with this map."""
    battery = RECIPE.battery.model_copy(update={"corner": CORNERS[corner]})
    recipe = RECIPE.model_copy(update={"battery": battery})
    believed = Pose(*view.base)
    expected = seating.expect_gap(plane, recipe, believed, view.expected.blur_px)
    scale = view.optics.px_per_mm
    limits = Limits(corner_skip_px=2.0 * scale, min_contrast=40.0)
    return seating.seating(plane, recipe, find_gap(view.pixels, expected, Search(0.3 * scale, 0.3), limits), believed)


@pytest.mark.parametrize("corner", CORNERS)
def test_offset_gap_and_seat_come_out_as_they_were_set(corner: tuple[int, int]) -> None:
    lie = Lie(0.021, -0.034, 0.012, seat_mm=(53.24, 85.17), battery_mm=(53.02, 84.95), corner=corner)
    place = Place(0.11, -0.07, 0.8)
    view = gap_view(np.random.default_rng(5), Camera(-88.0, blur_px=1.2), lie, place)
    seen = lying(view, plane_of(view.optics), corner)
    assert seen.offset == pytest.approx((lie.dx_mm, lie.dy_mm, lie.dt_deg), abs=0.0015)
    inwards = 0.1 - corner[0] * lie.dx_mm, 0.1 - corner[1] * lie.dy_mm
    assert (seen.gap_x_mm, seen.gap_y_mm) == pytest.approx(inwards, abs=0.0005)
    shifted = Place(0.0, 0.0, -place.t_deg).point(place.x_mm, place.y_mm)
    grown = corner[0] * (lie.seat_mm[0] - 53.2) / 2, corner[1] * (lie.seat_mm[1] - 85.2) / 2
    assert seen.seat == pytest.approx((shifted[0] + grown[0], shifted[1] + grown[1], 0.0), abs=0.002)
    assert seen.against_base[:2] == pytest.approx(np.add(seen.offset[:2], seen.seat[:2]), abs=1e-12)


@pytest.mark.parametrize("moved_mm", [(0.1, 0.0), (0.0, -0.1), (-0.07, 0.07)])
def test_a_hand_eye_that_is_falsified_by_a_tenth_of_a_millimetre_changes_nothing(
    moved_mm: tuple[float, float],
) -> None:
    rng = np.random.default_rng(6)
    for _ in range(3):
        view = gap_view(rng, some_camera_1(rng), some_lie(rng), some_stop(rng))
        true, false = (lying(view, plane_of(view.optics, by)) for by in ((0.0, 0.0), moved_mm))
        assert false.offset[:2] == pytest.approx(true.offset[:2], abs=0.0002)
        assert false.offset.dt_deg == pytest.approx(true.offset.dt_deg, abs=0.001)  # other pixels, other noise


def test_the_worst_corner_is_the_one_that_a_turn_moves_furthest() -> None:
    assert seating.worst_mm(RECIPE, Offset(0.01, 0.0, 0.0)) == pytest.approx(0.01)
    diagonal_mm = math.hypot(RECIPE.battery.width_mm, RECIPE.battery.height_mm)
    assert seating.worst_mm(RECIPE, Offset(0.0, 0.0, 0.01)) == pytest.approx(math.radians(0.01) * diagonal_mm, rel=1e-6)


# -- refusals ----------------------------------------------------------------------------------------------


def refused(pixels: np.ndarray, expected: ExpectedGap) -> str:
    with pytest.raises(NotFound) as caught:
        find_gap(pixels, expected, Search(41.0, 0.3), Limits(corner_skip_px=272.7, min_contrast=40.0))
    return str(caught.value)


def looked_at(things: object) -> tuple[np.ndarray, ExpectedGap]:
    """A picture of other things where the corner of a seated battery is expected."""
    rng = np.random.default_rng(7)
    view = gap_view(rng)
    pixels = render(Scene(45.0, placed(things, HERE)), view.optics, rng)
    return pixels, view.expected


def test_an_empty_seat_is_refused() -> None:
    assert re.search(
        r"of the slit along the width: \d+ of \d+ stretches show a dark slit", refused(*looked_at(base(BASE)))
    )


def test_a_battery_on_the_rim_of_its_seat_is_refused() -> None:
    jammed = assembly(BASE, BatteryDrawing(), Place(-0.13, 0.0, 0.0))
    assert "along the height" in refused(*looked_at(jammed))


def test_a_slit_that_is_too_narrow_to_be_measured_is_refused_with_its_width() -> None:
    view = gap_view(np.random.default_rng(8), PLAIN_CAMERA, Lie(dx_mm=-0.09, dy_mm=0.0))
    assert re.search(
        r"only \d\.\d px wide, from 2 px on it can be measured|show a dark slit", refused(view.pixels, view.expected)
    )


def test_a_turned_battery_is_refused_with_its_angle() -> None:
    view = gap_view(np.random.default_rng(9), PLAIN_CAMERA, Lie(dt_deg=0.45, dx_mm=0.05, dy_mm=0.05))
    assert re.search(
        r"turn: the battery's edge along the width is turned by [+-]0\.4\d\d deg", refused(view.pixels, view.expected)
    )


def test_a_corner_whose_slit_goes_on_is_refused() -> None:
    """Two crossing slots are no seat."""
    seat = Place(BASE.seat_x_mm, BASE.seat_y_mm)
    slots = [
        Polygon(np.array([[-40.0, -42.6], [30.0, -42.6], [30.0, -42.5], [-40.0, -42.5]]), SLIT),
        Polygon(np.array([[-26.6, -60.0], [-26.5, -60.0], [-26.5, 40.0], [-26.6, 40.0]]), SLIT),
    ]
    plate = Polygon(np.array([[-90.0, -140.0], [90.0, -140.0], [90.0, 30.0], [-90.0, 30.0]]), BODY)
    assert "corner: " in refused(*looked_at((plate, *placed(slots, seat))))


def test_dark_and_overexposed_pictures_are_refused() -> None:
    rng = np.random.default_rng(10)
    dark, bright = (gap_view(rng, Camera(exposure=exposure)) for exposure in (0.02, 3.0))
    assert refused(dark.pixels, dark.expected).startswith("light")
    assert refused(bright.pixels, bright.expected).startswith("saturation")


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["noise", "stripes", "flat", "view"]))
def test_no_picture_makes_the_finder_fail_otherwise_than_by_refusing(seed: int, kind: str) -> None:
    rng = np.random.default_rng(seed)
    pixels = rng.integers(0, 256, (400, 500), dtype=np.uint8)
    if kind == "stripes":
        pixels = np.where((np.arange(500) // 7) % 2, 200, 30).astype(np.uint8) + np.zeros((400, 1), np.uint8)
    elif kind == "flat":
        pixels = np.full((400, 500), rng.integers(0, 256), np.uint8)
    corner, far = (Px(float(u), float(v)) for u, v in rng.uniform(-50, 500, (2, 2)))
    across = Px(corner.u - (far.v - corner.v), corner.v + far.u - corner.u)
    if corner == far:
        return
    expected = ExpectedGap(ExpectedEdge(corner, far, True), ExpectedEdge(corner, across, False), 55.0, 1.1)
    with pytest.raises(NotFound):
        find_gap(pixels, expected, Search(20.0, 0.3), Limits(corner_skip_px=20.0))


# -- the renderer's part -----------------------------------------------------------------------------------


@pytest.mark.parametrize("gap_mm", [0.01, 0.02, 0.05, 0.1])
def test_the_picture_of_a_slit_is_the_blurred_profile_however_narrow_it_is(gap_mm: float) -> None:
    seat, lie = Place(BASE.seat_x_mm, BASE.seat_y_mm), Lie(dx_mm=gap_mm - 0.1)
    held = placed(textured(battery(BatteryDrawing(), SLIT), 0.0), seat @ lie.seat_from_battery)
    wall_mm = seat.point(-BASE.seat_width_mm / 2, -30.0)
    plain = replace(Optics.aimed(wall_mm, looks="down"), noise=0.0, black=0.0, light=Light(0.0, 0.0, 0.0))
    scene = Scene(45.0, [*textured(base(BASE, SLIT), 0.0), *held])
    row = render(scene, plain, np.random.default_rng(0))[plain.height // 2].astype(float)
    past = np.arange(row.size) - (plain.width - 1) / 2
    sigma = math.hypot(plain.blur_px, math.sqrt(1 / 12)) * math.sqrt(2)
    step = np.vectorize(lambda d: 0.5 * (1 + math.erf(d / sigma)))
    wanted = BODY + (SLIT - BODY) * step(past) + (FOIL - SLIT) * step(past - gap_mm * plain.px_per_mm)
    assert np.abs(row - wanted)[np.abs(past) < 40].max() < 0.6


def test_the_benchmark_runs_and_writes_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench_gap.main(2, 400, tmp_path / "bench-gap.json")
    figures = json.loads((tmp_path / "bench-gap.json").read_text(encoding="utf-8"))
    assert figures["gap"]["clean"]["sigma_um"] < 1.0
    assert figures["drift"]["quiet_units"] == 400
    assert "one unit, 1 sigma" in capsys.readouterr().out
