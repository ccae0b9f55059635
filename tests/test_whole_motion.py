"""The ways whose times are predicted are the ways that the arm of a running cell takes."""

import math
from itertools import pairwise
from pathlib import Path

import pytest

from cellctl.assembly.stretches import stretches, taught_places
from cellctl.learnt.taught import taught_in_use
from cellctl.recipe import load_recipe
from tests.whole_cell import ROOT, whole_cell

PARTS_LIE_OFF_MM = 1.5
TURNED_DEG = 2.5


async def test_a_unit_s_motions_are_the_stretches_that_are_predicted(learnt: Path, tmp_path: Path) -> None:
    text = (ROOT / "recipes" / "x85.toml").read_text(encoding="utf-8")
    recipes = tmp_path / "recipes"
    recipes.mkdir()
    (recipes / "x85.toml").write_text(text.replace('"when_needed"', '"never"'), encoding="utf-8")
    async with whole_cell(tmp_path, learnt=learnt, recipes=recipes) as bench:
        await bench.produce(2)
        moves = bench.robot_log.of("moves")
        recipe = load_recipe(bench.config.paths.recipes, "x85")
        ways = stretches(taught_places(taught_in_use(bench.config, recipe)), bench.config, recipe)
    legs = [leg for way in ways for leg in way.legs]
    assert recipe.motion.touch_mm is not None
    assert len(legs) == 13
    for move, leg in zip(moves[-len(legs) :], legs, strict=True):
        assert math.dist(move.ends[:2], leg.to[:2]) < PARTS_LIE_OFF_MM
        assert move.ends.z_mm == pytest.approx(leg.to.z_mm, abs=1e-3)
        assert abs(move.ends.r_deg - leg.to.r_deg) < TURNED_DEG


async def test_only_the_way_down_is_left_before_its_end(learnt: Path, tmp_path: Path) -> None:
    """Nothing blends into the approach of a stop, which must come from one side."""
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.produce(1)
        moves = bench.robot_log.of("moves")
    blended = [(before, after) for before, after in pairwise(moves) if before.blends]
    assert len(blended) == 2
    for before, after in blended:
        assert before.ends[:2] == pytest.approx(after.ends[:2], abs=1e-6)
        assert after.ends.z_mm - before.ends.z_mm == pytest.approx(6.0, abs=1e-3)
