"""Recipes: what a process engineer writes, what is refused, and that every shipped one loads."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.recipe import Recipe, list_recipes, load_recipe
from cellctl.recipe_parts import VIEW_HEIGHT_MM, VIEW_WIDTH_MM
from cellctl.strict_toml import SettingsError

RECIPES = Path(__file__).parent.parent / "recipes"
X85 = (RECIPES / "x85.toml").read_text()


def changed(text: str, **values: object) -> str:
    """The text with `key = value` replaced, where a key is written table__key."""
    for name, value in values.items():
        table, _, key = name.rpartition("__")
        head, body = text.split(f"[{table}]\n", 1) if table else ("", text)
        body, count = re.subn(rf"(?m)^{key} = \S+", f"{key} = {value}", body, count=1)
        assert count == 1, name
        text = f"{head}[{table}]\n{body}" if table else body
    return text


@pytest.fixture
def recipe(tmp_path: Path) -> Callable[..., Recipe]:
    """X85 with some values changed."""

    def recipe(**values: object) -> Recipe:
        (tmp_path / "changed.toml").write_text(changed(X85, **values))
        return load_recipe(tmp_path, "changed")

    return recipe


@pytest.fixture
def refused(recipe: Callable[..., Recipe]) -> Callable[..., list[str]]:
    """The keys and sentences that X85 with some values changed is refused with."""

    def refused(**values: object) -> list[str]:
        with pytest.raises(SettingsError) as caught:
            recipe(**values)
        return [re.sub(r"^.*?\.toml:\d+:\d+: ", "", line) for line in caught.value.lines]

    return refused


@pytest.mark.parametrize("name", list_recipes(RECIPES))
def test_every_recipe_of_the_repository_loads(name):
    recipe = load_recipe(RECIPES, name)
    assert recipe.model.lower() == name
    assert recipe.cameras == "both"


def test_the_repository_has_the_two_phones_of_the_demo():
    assert {"x60", "x85"} <= set(list_recipes(RECIPES))


def test_x85_is_the_phone_of_the_drawing():
    recipe = load_recipe(RECIPES, "x85")
    assert (recipe.battery.width_mm, recipe.battery.height_mm) == (53, 85)
    assert (recipe.seat_width_mm, recipe.seat_height_mm) == pytest.approx((53.2, 85.2))
    assert (recipe.base.seat_x_mm, recipe.base.seat_y_mm, recipe.base.seat_t_deg) == (18, -62, 0)


def test_a_copied_recipe_with_another_size_and_other_features_loads(recipe):
    new = recipe(
        model='"Z70"',
        base__hole_radius_mm=2.2,
        base__hole='"bright"',
        base__edge_distance_mm=4.5,
        base__edge_from_mm=-6,
        base__edge_to_mm=6.5,
        base__edge_bright_side='"outside"',
        base__view_y_mm=1.2,
        base__seat_x_mm=-14,
        base__seat_y_mm=-50,
        battery__width_mm=45,
        battery__height_mm=70,
        battery__corner='"upper_right"',
        battery__bright='"background"',
        limits__gap_mm=0.12,
    )
    assert (new.model, new.base.hole, new.battery.corner) == ("Z70", "bright", "upper_right")
    assert new.seat_height_mm == pytest.approx(70.24)


def test_the_single_camera_comparison_is_one_switch(recipe):
    assert recipe(cameras='"camera_2_only"').cameras == "camera_2_only"


# The hash


def test_the_hash_does_not_depend_on_comments_and_layout(recipe, tmp_path):
    (tmp_path / "bare.toml").write_text(re.sub(r"\s*#.*", "", X85).replace("3.0", "3"))
    bare = load_recipe(tmp_path, "bare")
    assert bare.hash == recipe().hash
    assert re.fullmatch(r"[0-9a-f]{64}", bare.hash)


def test_the_hash_changes_with_every_single_value(recipe):
    hashes = {
        recipe().hash,
        recipe(base__hole_radius_mm=3.0001).hash,
        recipe(cameras='"camera_2_only"').hash,
        recipe(pick__dwell_s=0.2).hash,
        recipe(place__dwell_s=0.2).hash,
        recipe(motion__touch_speed_pct=21).hash,
    }
    assert len(hashes) == 6


# What is refused, and where


@pytest.mark.parametrize(
    ("values", "line"),
    [
        (
            {"base__hole_radius_mm": 3000},
            "base.hole_radius_mm: must be at least 0.3 and at most 6 mm, is it in um? (got 3000)",
        ),
        (
            {"motion__settle_s": 50},
            "motion.settle_s: must be at least 0 and at most 2 s, is it in ms? (got 50)",
        ),
        (
            {"motion__travel_speed_pct": 0},
            "motion.travel_speed_pct: must be at least 1 and at most 100 % (got 0)",
        ),
        ({"schema_version": 2}, "schema_version: must be 1 (got 2)"),
        ({"limits__gap_mm": "nan"}, "limits.gap_mm: must be a finite number (got nan)"),
        ({"pick__retries": 1.5}, "pick.retries: must be a whole number (got 1.5)"),
    ],
)
def test_values_that_make_no_sense_are_refused(refused, values, line):
    assert refused(**values) == [line]


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"base__edge_from_mm": 6}, "base.edge_to_mm"),
        ({"base__edge_to_mm": 9}, "base.edge_to_mm"),
        ({"base__edge_from_mm": -9}, "base.edge_from_mm"),
        ({"base__view_y_mm": 6}, "base.hole_radius_mm"),
        ({"base__search_mm": 3}, "base.hole_radius_mm"),
        ({"base__seat_y_mm": -40}, "base.seat_y_mm"),
        ({"base__seat_x_mm": 40, "base__seat_y_mm": -30}, "base.seat_y_mm"),
        ({"battery__edge_x_mm": 12}, "battery.edge_x_mm"),
        ({"battery__edge_y_mm": 8}, "battery.edge_y_mm"),
        ({"battery__view_x_mm": 8}, "battery.view_x_mm"),
        ({"battery__width_mm": 10}, "battery.edge_x_mm"),
        ({"limits__part_tolerance_mm": 0.1}, "limits.part_tolerance_mm"),
        ({"limits__placement_mm": 0.1}, "limits.placement_mm"),
        ({"limits__base_offset_mm": 1.6}, "limits.base_offset_mm"),
        ({"limits__battery_offset_deg": 2.1}, "limits.battery_offset_deg"),
        ({"motion__travel_speed_pct": 10}, "motion.touch_speed_pct"),
    ],
)
def test_values_that_do_not_fit_together_are_refused_at_the_right_key(refused, values, key):
    assert key in [line.split(":")[0] for line in refused(**values)]


def test_a_view_error_names_the_reach_and_the_limit(refused):
    (line,) = refused(base__edge_to_mm=9)
    assert "can leave the camera's view" in line
    assert "9.5 mm is seen" in line


def corners_seen(x_mm: float, y_mm: float, search_mm: float, search_deg: float) -> list[tuple[float, float]]:
    """Where a feature may be, seen from the middle of the view: turned about it and shifted, at the extremes."""
    places = []
    for turn_rad in (-math.radians(search_deg), 0.0, math.radians(search_deg)):
        c, s = math.cos(turn_rad), math.sin(turn_rad)
        places += [
            (c * x_mm - s * y_mm + dx, s * x_mm + c * y_mm + dy)
            for dx in (-search_mm, search_mm)
            for dy in (-search_mm, search_mm)
        ]
    return places


@settings(max_examples=150, deadline=None)
@given(st.floats(-9, 0), st.floats(0, 9), st.floats(4, 9), st.floats(-1, 1), st.floats(1, 5), st.floats(0.5, 2))
def test_whatever_is_accepted_keeps_the_used_edge_inside_the_picture(
    start_mm, end_mm, distance_mm, view_x_mm, view_y_mm, search_mm
):
    base = load_recipe(RECIPES, "x85").base.model_dump() | {
        "edge_from_mm": start_mm,
        "edge_to_mm": end_mm,
        "edge_distance_mm": distance_mm,
        "view_x_mm": view_x_mm,
        "view_y_mm": view_y_mm,
        "search_mm": search_mm,
    }
    try:
        accepted = Recipe.model_validate({**load_recipe(RECIPES, "x85").model_dump(), "base": base}).base
    except ValueError:
        return
    for x_mm in (accepted.edge_from_mm, accepted.edge_to_mm):
        at = (x_mm - accepted.view_x_mm, accepted.edge_distance_mm - accepted.view_y_mm)
        for seen_x_mm, seen_y_mm in corners_seen(*at, accepted.search_mm, accepted.search_deg):
            assert abs(seen_x_mm) <= VIEW_WIDTH_MM / 2 + 1e-9
            assert abs(seen_y_mm) <= VIEW_HEIGHT_MM / 2 + 1e-9


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_whatever_numbers_a_recipe_holds_it_is_read_or_refused(tmp_path_factory, data):
    numbers = list(re.finditer(r"(?m)(?<== )-?[0-9.]+", X85))
    text = X85
    for number in sorted(
        data.draw(st.lists(st.sampled_from(numbers), max_size=4, unique_by=re.Match.start)),
        key=re.Match.start,
        reverse=True,
    ):
        value = data.draw(st.one_of(st.floats(-200, 200), st.floats(), st.integers()))
        text = f"{text[: number.start()]}{value}{text[number.end() :]}"
    path = tmp_path_factory.getbasetemp() / "fuzzed.toml"
    path.write_text(text)
    lines: tuple[str, ...] = ()
    try:
        load_recipe(path.parent, path.stem)
    except SettingsError as error:
        lines = error.lines
    assert all(re.match(r".*\.toml:\d+:\d+: [a-z_.]+: .", line) for line in lines)


# Names and folders


@pytest.mark.parametrize("name", ["../x85", "/etc/passwd", "X85", "x85.toml", "", ".", "x 85", "x85\n", "ä", "x/y"])
def test_names_that_are_not_plain_are_refused(name):
    with pytest.raises(SettingsError, match="must consist of a-z, 0-9 and - only"):
        load_recipe(RECIPES, name)


def test_a_recipe_that_is_not_there_is_refused():
    with pytest.raises(SettingsError, match=r"x99\.toml: there is no such file$"):
        load_recipe(RECIPES, "x99")


def test_the_list_shows_every_toml_file_also_the_misnamed_one(tmp_path):
    for name in ("b-2.toml", "a1.toml", "Copy of a1.toml", "notes.txt", "a1.toml~"):
        (tmp_path / name).write_text("")
    assert list_recipes(tmp_path) == ["Copy of a1", "a1", "b-2"]


def test_a_missing_folder_of_recipes_is_refused(tmp_path):
    with pytest.raises(SettingsError, match="the folder of recipes cannot be read: No such file or directory"):
        list_recipes(tmp_path / "absent")


@pytest.mark.parametrize(
    ("second", "key", "said"),
    [
        ((43.0, 44.0), "base.second_edge_to_mm", "at least 2 mm above"),
        ((1.0, 15.0), "base.second_edge_from_mm", "a second look is worth it from 15 mm on"),
        ((30.0, 57.0), "base.second_edge_to_mm", "can leave the camera's view"),
    ],
)
def test_a_second_stretch_of_edge_that_is_no_use_is_refused(refused, second, key, said):
    (line,) = refused(base__second_edge_from_mm=second[0], base__second_edge_to_mm=second[1])
    assert line.startswith(key)
    assert said in line


def test_half_a_second_stretch_is_refused(tmp_path):
    text = "\n".join(line for line in X85.splitlines() if not line.startswith("second_edge_to_mm"))
    (tmp_path / "half.toml").write_text(text)
    with pytest.raises(SettingsError, match="needs both second_edge_from_mm and second_edge_to_mm"):
        load_recipe(tmp_path, "half")


def test_a_recipe_without_a_placement_table_never_looks_twice(tmp_path):
    head, _, rest = X85.partition("[placement]\n")
    (tmp_path / "plain.toml").write_text(head + rest[rest.index("[motion]") :])
    assert load_recipe(tmp_path, "plain").placement.second_look == "never"
