"""The search that knows nothing: which of all outlines is meant, wherever and however large it is."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellctl.vision import NotFound
from cellctl.vision.lesson import NEARBY, Pointed, first_base, first_battery, next_base
from cellctl.vision.recognise import Undecided, away_px, recognise_corner, recognise_edge, recognise_hole
from simulators.render import Polygon, disk
from tests.benchmarks import bench_recipe
from tests.vision_scenes import BASE, Camera, base_view, battery_view, clutter, some_camera, some_place

SEEDS = range(2)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_base_is_recognised_whatever_its_size_place_and_polarity(seed: int) -> None:
    rng = np.random.default_rng(seed)
    radius_mm = float(rng.uniform(0.8, 3.2))
    drawing = replace(BASE, hole_radius_mm=radius_mm, edge_distance_mm=float(rng.uniform(radius_mm + 1.6, 6.3)))
    camera = replace(some_camera(rng), noise=float(rng.uniform(2.0, 5.0)))
    view = base_view(rng, camera, some_place(rng, 1.0, 5.0), drawing)
    inverted = bool(seed % 2)
    pixels = 255 - view.pixels if inverted else view.pixels
    hole = recognise_hole(pixels).circle
    edge = recognise_edge(pixels, hole)
    assert math.dist(hole.centre, view.truth[0]) < 2.0
    assert hole.radius_px == pytest.approx(radius_mm * view.optics.px_per_mm, abs=2.0)
    assert hole.dark_inside is not inverted
    assert max(away_px(edge.edge, point) for point in view.truth[1:]) < 3.0
    assert edge.length_px > 1200


@pytest.mark.parametrize("seed", SEEDS)
def test_a_corner_is_recognised_whichever_it_is(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    corner = ((-1, 1), (1, 1))[seed]
    view = battery_view(rng, some_camera(rng), some_place(rng, 1.0, 5.0), corner)
    found = recognise_corner(view.pixels)
    assert math.dist(found.at, view.truth[0]) < 3.0
    assert found.bright_inside
    assert not recognise_corner(255 - view.pixels).bright_inside


@pytest.mark.parametrize("seed", SEEDS)
def test_among_scratches_and_dirt_the_right_features_are_taken_or_a_person_is_asked(seed: int) -> None:
    rng = np.random.default_rng(200 + seed)
    view = base_view(rng, Camera(), some_place(rng))
    dirty = base_view(rng, Camera(), some_place(rng), over=clutter(rng, view.optics))
    try:
        lesson = first_base(dirty.pixels, Pointed())
    except Undecided:
        return
    assert math.dist(lesson.seen.circle.centre, dirty.truth[0]) < 0.3
    assert max(away_px(lesson.expected[1], point) for point in dirty.truth[1:]) < 1.0


def test_the_clean_stretch_ends_where_the_edge_is_damaged() -> None:
    rng = np.random.default_rng(7)
    notch = Polygon(np.array([[3.0, 5.6], [4.5, 5.6], [4.5, 7.0], [3.0, 7.0]]), 45.0)
    view = base_view(rng, over=[notch])
    start, end = first_base(view.pixels, Pointed()).clean
    from_hole_mm = [(point.u - view.truth[0].u) / view.optics.px_per_mm for point in (start, end)]
    assert min(from_hole_mm) < -9.0
    assert max(from_hole_mm) == pytest.approx(3.0, abs=0.25)


def test_the_rounded_corner_is_not_part_of_the_clean_stretch() -> None:
    view = battery_view(np.random.default_rng(8))
    lesson = first_battery(view.pixels, Pointed())
    for start, _ in lesson.clean:
        assert math.dist(start, lesson.seen.corner) / view.optics.px_per_mm == pytest.approx(0.95, abs=0.2)


def test_other_pictures_are_measured_like_the_first_one_wherever_the_part_lies() -> None:
    rng = np.random.default_rng(9)
    first = first_base(base_view(rng, place=some_place(rng)).pixels, Pointed())
    moved = base_view(rng, place=some_place(rng, 1.0, 1.5))
    with pytest.raises(NotFound):
        next_base(moved.pixels, first.expected, NEARBY)
    lesson = next_base(moved.pixels, first.expected, NEARBY._replace(position_px=350.0, angle_deg=4.0))
    assert math.dist(lesson.seen.circle.centre, moved.truth[0]) < 0.1


@pytest.mark.parametrize(
    "learn", [lambda p: first_base(p, Pointed()), lambda p: first_battery(p, Pointed())], ids=["base", "battery"]
)
def test_a_picture_without_features_is_refused(learn) -> None:
    rng = np.random.default_rng(10)
    for pixels in (np.full((1944, 2592), 90, np.uint8), rng.normal(90, 12, (1944, 2592)).clip(0, 255).astype(np.uint8)):
        with pytest.raises(NotFound):
            learn(pixels)


def test_a_battery_is_no_base_and_a_base_no_battery() -> None:
    rng = np.random.default_rng(11)
    with pytest.raises(NotFound, match="no round outline"):
        first_base(battery_view(rng).pixels, Pointed())
    with pytest.raises(NotFound):
        first_battery(base_view(rng).pixels, Pointed())


def test_equal_holes_are_a_persons_choice_and_pointing_decides() -> None:
    rng = np.random.default_rng(12)
    view = base_view(rng, drawing=replace(BASE, hole_radius_mm=1.5), over=[disk((-7.3, 1.0), 1.4, 30.0)])
    with pytest.raises(Undecided) as caught:
        first_base(view.pixels, Pointed())
    assert len(caught.value.candidates) == 2
    centre = view.truth[0]
    pointed = Pointed(hole=(centre._replace(u=centre.u + 9.0), 1.5 * view.optics.px_per_mm - 8.0))
    assert math.dist(first_base(view.pixels, pointed).seen.circle.centre, centre) < 0.1


def test_the_benchmark_prints_and_writes_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench_recipe.main(1, 200, tmp_path / "bench.json", ["clean"])
    figures = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))
    assert figures["recognised"]["clean base"]["right"] == figures["recognised"]["clean battery"]["right"] == 1
    assert figures["watch"]["false_warnings"] == 0
    assert all(1.2 < row["noise_growth"] < 1.45 for row in figures["watch"]["wear"].values())
    assert "right  asked" in capsys.readouterr().out
