"""Focus and light are followed: quiet while they are as taught, a warning in time, and nothing is forgotten."""

import itertools
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellctl.learnt.taught import taught_in_use
from cellctl.machine import State
from cellctl.monitoring.light import FIRST_PICTURES, MOST_GROWTH, Cause, Trend, after, growth, warnings
from cellctl.monitoring.light_watch import Kept, LightWatch, standing_text
from cellctl.recipe import Recipe
from cellctl.recipe_light import RecipeLight
from cellctl.strict_toml import load
from cellctl.vision import Appearance
from simulators.product import load_product
from simulators.world import World
from tests.vision_scenes import Camera, base_view
from tests.whole_cell import ROOT, SEED, running, simulated, whole_cell

TAUGHT = Appearance(1.1, 100.0, 2.7, 35.0, 135.0, 0.0)
LEAST = 40.0
QUIET = np.array([0.03, 1.5, 0.15, 1.0, 1.5, 0.0])  # what pictures of good parts differ by, one sigma


def followed(looks: list[Appearance], taught: Appearance | None = TAUGHT) -> Trend:
    trend = Trend(taught=taught)
    for look in looks:
        trend = after(trend, look)
    return trend


def scattered(rng: np.random.Generator, about: Appearance, count: int) -> list[Appearance]:
    return [Appearance(*np.maximum(0.0, rng.normal(about, QUIET))) for _ in range(count)]


def causes(trend: Trend) -> set[Cause]:
    return {warn.cause for warn in warnings(trend, LEAST) if warn.severity >= 1.0}


def test_a_cell_that_stays_as_taught_is_never_blamed() -> None:
    rng = np.random.default_rng(1)
    trend = Trend(taught=TAUGHT)
    for look in scattered(rng, TAUGHT, 3000):
        trend = after(trend, look)
        assert not causes(trend)


@pytest.mark.parametrize(
    ("worn", "cause"),
    [
        (TAUGHT._replace(blur_px=1.9), Cause.FOCUS),
        (TAUGHT._replace(contrast=75.0, bright=110.0), Cause.LIGHT),
        (TAUGHT._replace(contrast=130.0, bright=165.0), Cause.EXPOSURE),
        (TAUGHT._replace(bright=250.0), Cause.EXPOSURE),
        (TAUGHT._replace(saturated=0.02), Cause.EXPOSURE),
        (TAUGHT._replace(noise=4.0), Cause.NOISE),
        (TAUGHT._replace(blur_px=1.5, contrast=88.0), Cause.FOCUS),
    ],
)
def test_every_wear_gets_its_cause_and_its_figures(worn: Appearance, cause: Cause) -> None:
    trend = followed([worn] * 40)
    assert causes(trend) == {cause}
    sentence = next(warn.sentence for warn in warnings(trend, LEAST) if warn.cause is cause)
    assert "when taught" in sentence


def test_a_single_odd_picture_warns_nobody() -> None:
    odd = Appearance(3.0, 45.0, 8.0, 5.0, 50.0, 0.0)
    for number in range(1, 20):
        assert not causes(followed([TAUGHT] * number + [odd]))


def test_a_lamp_that_fails_at_once_is_noticed_within_ten_pictures() -> None:
    half = TAUGHT._replace(contrast=55.0, bright=90.0)
    assert Cause.LIGHT in causes(followed([TAUGHT] * 30 + [half] * 10))


def test_near_the_least_contrast_is_a_warning_whatever_was_taught() -> None:
    faint = TAUGHT._replace(contrast=46.0)
    assert causes(followed([faint] * 5, faint)) == {Cause.LIGHT}
    assert causes(followed([faint] * 5, None)) == {Cause.LIGHT}


def test_without_a_recipe_s_light_the_first_pictures_are_the_measure() -> None:
    rng = np.random.default_rng(2)
    trend = followed(scattered(rng, TAUGHT, FIRST_PICTURES - 1), None)
    assert trend.taught is None
    trend = after(trend, Appearance(9.0, 20.0, 9.0, 0.0, 20.0, 0.0))  # one bad picture among them does not matter
    assert trend.taught is not None
    assert trend.taught.blur_px == pytest.approx(1.1, abs=0.05)
    assert trend.first == ()


@pytest.mark.parametrize(("blur_px", "exposure"), [(2.2, 1.0), (1.1, 0.6), (1.7, 0.7)])
def test_the_noise_of_a_measured_place_grows_as_the_bound_says(blur_px: float, exposure: float) -> None:
    rng = np.random.default_rng(3)
    good = base_view(rng, Camera(noise=4.0), texture=0.0).base()
    worn = base_view(rng, Camera(noise=4.0, blur_px=blur_px, exposure=exposure), texture=0.0).base()
    expected = growth(good.circle.appearance, worn.circle.appearance).total
    assert worn.circle.sd_px / good.circle.sd_px == pytest.approx(expected, rel=0.25)
    assert expected > MOST_GROWTH


looks = st.builds(
    Appearance,
    blur_px=st.floats(0.1, 4.5),
    contrast=st.floats(0.0, 255.0),
    noise=st.floats(0.0, 50.0),
    dark=st.floats(0.0, 255.0),
    bright=st.floats(0.0, 255.0),
    saturated=st.floats(0.0, 1.0),
)


@given(st.lists(looks, min_size=1, max_size=30), st.booleans())
def test_trends_stay_within_what_was_seen_and_read_back_as_they_were(seen: list[Appearance], known: bool) -> None:
    watch = LightWatch("x", LEAST, {"camera-1 hole": Trend(taught=TAUGHT if known else None)})
    for look in seen:
        watch.see("camera-1", {"hole": look})
    now = watch.trends["camera-1 hole"].now
    assert now is not None
    for value, values in zip(now, zip(*seen, strict=True), strict=True):
        assert min(values) - 1e-4 <= value <= max(values) + 1e-4
    text = Kept.model_validate(watch.record(), strict=False).model_dump_json()
    assert Kept.model_validate_json(text).trends == watch.trends


def test_a_warning_is_said_once_and_its_end_too() -> None:
    watch = LightWatch("x", LEAST, {"camera-1 hole": Trend(taught=TAUGHT), "camera-1 edge": Trend(taught=TAUGHT)})
    said: list[list[str]] = []
    worn = TAUGHT._replace(blur_px=2.0)
    for look in [TAUGHT] * 3 + [worn] * 30 + [TAUGHT] * 60:
        watch.see("camera-1", {"hole": look, "edge": look})
        said.append(watch.sentences)
    counts = [len(sentences) for sentences in said]
    assert counts[2] == 0
    assert counts[32] == 1
    assert counts[-1] == 0
    assert sum(abs(b - a) for a, b in itertools.pairwise(counts)) == 2
    assert "camera-1 edge: its blur is" in said[32][0] or "camera-1 hole: its blur is" in said[32][0]


# -- the whole cell ----------------------------------------------------------------------------------------


def lit(world: World) -> str:
    """The [light] of a recipe for this cell, as its pictures truly are."""
    tables = {"base_hole": (1, 99), "base_edge": (1, 85), "battery_edge_1": (2, 124), "battery_edge_2": (2, 122)}
    text = ""
    for name, (camera, contrast) in tables.items():
        optics = world.layout.camera_1 if camera == 1 else world.layout.camera_2
        levels = f"contrast = {contrast}\nnoise = 2.8\ndark = 36\nbright = {36 + contrast}"
        text += f"\n[light.{name}]\nblur_px = {optics.blur_px:.3f}\n{levels}\n"
    return text


async def test_slow_wear_is_warned_of_before_a_picture_is_refused_or_a_battery_misplaced(
    learnt: Path, tmp_path: Path
) -> None:
    """Camera 1's focus works loose while camera 2's lamp fails, a little with every unit; judged by the world."""
    recipes = tmp_path / "recipes"
    recipes.mkdir()
    text = (ROOT / "recipes" / "x85.toml").read_text(encoding="utf-8")
    (recipes / "x85.toml").write_text(text + lit(World(SEED, load_product(ROOT / "recipes" / "x85.toml"))), "utf-8")
    async with simulated(tmp_path, learnt=learnt, recipes=recipes) as bench:
        async with running(bench):
            await bench.ready()
            await bench.start(0)
            while not any(record["fault"] == "V2" for record in bench.records(40)):
                made = len(bench.world.verdicts)
                bench.world.inject("camera_1", "defocus", px=min(0.2 * made, 2.8))
                bench.world.inject("camera_2", "dim", light=1.0 - 0.05 * made)
                await bench.when(lambda made=made: len(bench.world.verdicts) > made)
            await bench.command("stop", State.STOPPED)
        records = bench.records(100)
        refused = next(n for n, record in enumerate(records) if record["fault"] == "V2")
        warned = {cause: first_warned(records, *cause) for cause in (("camera-1", "focus"), ("camera-2", "light"))}
        fits = [verdict.fit for verdict in bench.world.verdicts[:refused] if verdict.fit]
        async with running(bench):
            await bench.ready()
            standing = (await bench.ask("status"))["light"]
    assert "contrast" in records[refused]["sentence"]
    assert 0 < warned["camera-1", "focus"] < refused - 2
    assert 0 < warned["camera-2", "light"] < refused - 2
    assert len(fits) > refused // 2
    assert all(fit.good and fit.worst_mm < 0.040 for fit in fits)
    assert "camera-1 " in standing
    assert "px, 1.0" in standing
    assert "camera-2 " in standing
    assert "pictures below 40 are refused" in standing


def first_warned(records: list[dict[str, Any]], camera: str, cause: str) -> int:
    """Number of the first unit whose record has the warning."""
    return next(
        n
        for n, record in enumerate(records)
        for feature, found in record["data"]["light"]["warned"].items()
        if feature.startswith(camera) and any(warn[0] == cause for warn in found)
    )


async def test_after_teaching_anew_the_trends_begin_anew(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.produce(1)
        state = bench.config.paths.state
        recipe = load(ROOT / "recipes" / "x85.toml", Recipe)
        of = taught_in_use(bench.config, recipe).id
        assert standing_text(state, recipe, of) == f"being learnt (1 of {FIRST_PICTURES} pictures)"
        assert standing_text(state, recipe, "another") == f"being learnt (0 of {FIRST_PICTURES} pictures)"
        recipe = recipe.model_copy(
            update={"light": RecipeLight.model_validate(tomllib.loads(lit(bench.world))["light"])}
        )
        assert standing_text(state, recipe, of) == "as taught (0 pictures)"
