"""A recipe from pictures: what is found is the drawing's, what cannot be seen is asked for, nothing is half written."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cellctl.geometry import Px
from cellctl.lessons.values import CannotTeach, Value, of_file, recipe_of, text_of, write
from cellctl.lessons.values import given as settings_given
from cellctl.recipe import Recipe
from cellctl.strict_toml import load
from cellctl.vision import NotFound
from cellctl.vision.lesson import Pointed, first_battery
from simulators.render import disk
from tests.command_line import Ended, run
from tests.picture_album import FEW, MM_PER_PX, base_files, battery_files
from tests.vision_scenes import BASE, Camera, battery_view

X85 = Path(__file__).resolve().parent.parent / "recipes" / "x85.toml"
OTHER = replace(BASE, hole_radius_mm=2.2, edge_distance_mm=4.5)
SLANTED = Camera(turn_deg=170.0, blur_px=1.3)
USUAL = ("--from", X85, "--corner", "upper_right", "--mm-per-px", MM_PER_PX)
DRAWN = {"battery.corner", "battery.width_mm", "battery.height_mm", "base.seat_x_mm", "base.seat_y_mm"}


@pytest.fixture(scope="module")
def album(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of another base, seen by a camera that is mounted upside down, and of another corner of the battery."""
    folder = tmp_path_factory.mktemp("album")
    base_files(folder / "base", drawing=OTHER, camera=SLANTED)
    battery_files(folder / "battery", corner=(1, 1))
    return folder


def teach(album: Path, folder: Path, *options: object, base: Path | None = None) -> Ended:
    """Teach "mine" into a folder, with these options beside those that every recipe needs."""
    batteries = sorted((album / "battery").iterdir())  # as a shell expands an asterisk
    arguments = ["recipe", "teach", "mine", "--base", base or album / "base", "--battery", *batteries]
    return run(*arguments, "--folder", folder, "--out", folder / "drawn", *options)


@pytest.fixture(scope="module")
def taught(album: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the recipe "mine", made from the album and x85; what was printed is in `printed`."""
    folder = tmp_path_factory.mktemp("taught")
    ended = teach(album, folder, *USUAL, "--set", "timing.unit_within_s=12", "base.search_mm=1.2")
    assert ended.code == 0, ended.err
    (folder / "printed").write_text(ended.out, encoding="utf-8")
    return folder


def test_what_pictures_show_is_found_without_being_told_and_the_rest_is_taken_over(taught: Path) -> None:
    recipe, origin = load(taught / "mine.toml", Recipe), load(X85, Recipe)
    base, battery = recipe.base, recipe.battery

    assert base.hole_radius_mm == pytest.approx(2.2, abs=0.001)
    assert base.edge_distance_mm == pytest.approx(4.5, abs=0.001)
    assert (base.hole, base.edge_bright_side, battery.bright) == ("dark", "base", "battery")
    assert base.edge_from_mm < -6.5
    assert base.edge_to_mm > 6.5
    assert battery.corner == "upper_right"
    assert 1.0 <= battery.edge_skip_mm <= 1.4  # the corner is rounded with 1 mm
    assert battery.edge_x_mm > 9
    assert battery.edge_y_mm > 5.5
    assert (base.seat_x_mm, recipe.motion, recipe.pick) == (origin.base.seat_x_mm, origin.motion, origin.pick)


def test_light_and_the_way_the_parts_lie_are_learnt_too(taught: Path) -> None:
    recipe = load(taught / "mine.toml", Recipe)
    assert recipe.light is not None
    assert recipe.pictures is not None
    assert recipe.light.base_hole.blur_px == pytest.approx(1.3, abs=0.07)
    assert recipe.light.battery_edge_1.blur_px == pytest.approx(1.1, abs=0.07)
    assert recipe.light.base_edge.noise == pytest.approx(2.6, abs=0.6)
    assert recipe.light.base_edge.bright - recipe.light.base_edge.dark == pytest.approx(85.0, abs=6.0)
    assert recipe.limits.min_contrast == pytest.approx(recipe.light.base_edge.contrast / 2, abs=2)
    assert recipe.pictures.base.turn_deg == pytest.approx(-170.0, abs=1.0)
    assert recipe.pictures.base.seen_from == "above"


def test_the_taught_recipe_finds_its_pictures_and_parts_that_lie_elsewhere(
    taught: Path, album: Path, tmp_path: Path
) -> None:
    base_files(tmp_path, 1, seed=9, drawing=OTHER, camera=replace(SLANTED, noise=4.0))
    ended = run("vision", "test", album / "base", album / "battery", tmp_path, "--recipe", taught / "mine.toml")
    assert ended.code == 0, ended.out
    assert "base: found 3 of 3" in ended.out
    assert "battery: found 2 of 2" in ended.out


def test_every_value_says_where_it_is_from_and_every_picture_is_drawn(taught: Path) -> None:
    text = (taught / "mine.toml").read_text(encoding="utf-8")
    assert "unit_within_s = 12.0            # One unit must be finished within this time, s; --set\n" in text
    assert "gap_mm = 0.1                    # Nominal gap between battery and seat on each side in mm; from x85" in text
    assert "Hole centre to reference edge in mm; measured in 2 pictures, sd 0." in text
    assert "base.hole_radius_mm                  2.2" in (taught / "printed").read_text(encoding="utf-8")
    assert len(list((taught / "drawn").iterdir())) == 2 * FEW
    assert sorted(path.name for path in taught.iterdir()) == ["drawn", "mine.toml", "printed"]


def test_what_cannot_be_seen_is_asked_for_by_the_name_of_its_option(album: Path, tmp_path: Path) -> None:
    ended = teach(album, tmp_path, "--corner", "upper_right", "--mm-per-px", MM_PER_PX)
    assert ended.code == 1
    for wanted in ("width_mm is not known: --battery-size", "seat_x_mm is not known: --seat", "--set pick.dwell_s"):
        assert wanted in ended.err
    assert "--mm-per-px" in teach(album, tmp_path, "--from", X85).err
    assert not list(tmp_path.iterdir())


def test_which_corner_it_is_is_never_guessed(album: Path, tmp_path: Path) -> None:
    unseen = [f"{key}={json.dumps(each.value)}" for key, each in of_file(X85).items() if key not in DRAWN]
    options = ["--battery-size", "53x85", "--seat", "18,-62,0", "--mm-per-px", MM_PER_PX, "--set", *unseen]
    ended = teach(album, tmp_path, *options)
    assert ended.code == 1
    assert "which corner the pictures show is not known: --corner" in ended.err


def test_a_recipe_that_exists_is_replaced_only_by_force(album: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("mine", encoding="utf-8")
    assert "exists" in teach(album, tmp_path, *USUAL).err
    assert (tmp_path / "mine.toml").read_text(encoding="utf-8") == "mine"
    recipe = recipe_of(of_file(X85))
    with pytest.raises(CannotTeach, match="exists"):
        write(tmp_path / "mine.toml", recipe, text_of(recipe, of_file(X85), ""), force=False)
    write(tmp_path / "mine.toml", recipe, text_of(recipe, of_file(X85), ""), force=True)
    assert load(tmp_path / "mine.toml", Recipe) == recipe
    assert [path.name for path in tmp_path.iterdir()] == ["mine.toml"]


def test_a_text_that_does_not_read_back_is_never_put_in_place(tmp_path: Path) -> None:
    recipe, values = recipe_of(of_file(X85)), of_file(X85)
    with pytest.raises(CannotTeach, match="read back"):
        write(tmp_path / "a.toml", recipe, text_of(recipe, values, "").replace("53.0", "53.1"), force=True)
    assert not list(tmp_path.iterdir())


def test_values_that_do_not_fit_together_are_named() -> None:
    with pytest.raises(CannotTeach, match=r"limits\.part_tolerance_mm: must be below gap_mm.*--set"):
        recipe_of(of_file(X85) | settings_given(["limits.gap_mm=0.05"]))
    with pytest.raises(CannotTeach, match="base is a value"):
        recipe_of({"base": Value(1.0, "--set"), **of_file(X85)})


def test_a_picture_of_something_else_is_named(album: Path, tmp_path: Path) -> None:
    (tmp_path / "mixed").mkdir()
    for name, source in (("a.png", "base/base-0.png"), ("b.tif", "battery/battery-0.tif")):
        (tmp_path / "mixed" / name).write_bytes((album / source).read_bytes())
    ended = teach(album, tmp_path, *USUAL, base=tmp_path / "mixed")
    assert ended.code == 1
    assert "b.tif: not as in a.png" in ended.err


def test_two_holes_alike_are_shown_with_numbers_and_a_person_points(album: Path, tmp_path: Path) -> None:
    twin = [disk((-5.5, 1.0), OTHER.hole_radius_mm - 0.1, 30.0)]
    base_files(tmp_path / "twins", 1, drawing=OTHER, over=twin)
    ended = teach(album, tmp_path, *USUAL, base=tmp_path / "twins")
    assert ended.code == 1
    assert "2 features could be it" in ended.err
    assert cv2.imread(str(tmp_path / "drawn" / "candidates-base-0.jpg")).shape == (972, 1296, 3)
    choices = [text.split()[-1] for text in ended.err.splitlines() if ": --hole " in text]
    larger = max(choices, key=lambda text: float(text.split(",")[2]))
    ended = teach(album, tmp_path, *USUAL, "--hole", larger, base=tmp_path / "twins")
    assert ended.code == 0, ended.err
    assert load(tmp_path / "mine.toml", Recipe).base.hole_radius_mm == pytest.approx(2.2, abs=0.001)


def test_edges_that_a_person_points_at_are_taken() -> None:
    view = battery_view(np.random.default_rng(5), corner=(1, 1))
    (u, v), one, two = view.truth
    pointed = Pointed(edges=tuple((Px(u + 0.1 * (end.u - u), v + 0.1 * (end.v - v) + 8.0), end) for end in (one, two)))
    lesson = first_battery(view.pixels, pointed)
    assert lesson.seen.corner == pytest.approx((u, v), abs=0.1)
    with pytest.raises(NotFound, match="no straight edge from"):
        first_battery(view.pixels, Pointed(edges=((Px(10.0, 10.0), Px(900.0, 20.0)), pointed.edges[1])))
    with pytest.raises(NotFound, match="both edges"):
        first_battery(view.pixels, Pointed(edges=pointed.edges[:1]))


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(model=st.text(max_size=40), description=st.text(max_size=200))
def test_any_text_in_a_recipe_reads_back_as_it_was(model: str, description: str, tmp_path: Path) -> None:
    values = of_file(X85) | {"model": Value(model, "a\nname"), "description": Value(description, "x")}
    try:
        recipe = recipe_of(values)
    except CannotTeach:
        return
    path = tmp_path / "r.toml"
    path.write_text(text_of(recipe, values, f"{model}\n{description}"), encoding="utf-8")
    assert load(path, Recipe) == recipe


@given(st.text(max_size=60))
def test_any_setting_is_taken_or_refused_with_its_text(text: str) -> None:
    before = of_file(X85)
    try:
        values = settings_given([text])
        recipe = recipe_of(before | values)
    except CannotTeach:
        return
    assert recipe == recipe_of(before) or set(values) <= set(before) | {"base.second_edge_from_mm"}
