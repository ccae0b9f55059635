"""How sure a placement is, on the fast cell: judged by the world's true corners."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cellctl.assembly.budget import EdgeAgain, Needs
from cellctl.assembly.stops import out_of_reach
from cellctl.geometry import Mm, Pose
from cellctl.recipe import Recipe
from simulators.layout import build_layout
from simulators.supply import Form, Scatter, Supply
from tests.benchmarks.bench_budget import Population, drawn, figures, run
from tests.fast_cell import FastCell, Placed, Policy
from tests.fast_eyes import ExactEyes, known_exactly

CONFIG, X85, PRODUCT = drawn()


def stated(**placement: object) -> Recipe:
    """X85 with another [placement] table."""
    return X85.model_copy(update={"placement": X85.placement.model_copy(update=placement)})


def exact_cell(seed: int, recipe: Recipe = X85, repeats: int = 10) -> FastCell:
    """A cell whose cameras are known exactly and whose parts are straight."""
    layout = build_layout(np.random.default_rng([seed, 2]))
    cell = FastCell(seed, CONFIG, recipe, PRODUCT, layout)
    calibrations = known_exactly("camera-1", layout.camera_1), known_exactly("camera-2", layout.camera_2)
    eyes = ExactEyes(recipe, (layout.camera_1, layout.camera_2), np.random.default_rng([seed, 4]))
    cell.commission(eyes, calibrations, Form(), repeats)
    return cell


def assembled(policy: Policy, recipe: Recipe, scatter: Scatter, cells: int = 5, units: int = 40) -> list[Placed]:
    """Units of several cells."""
    placed = []
    for seed in range(cells):
        cell, supply = exact_cell(seed, recipe), Supply(np.random.default_rng([seed, 3]), scatter)
        placed += [cell.assemble(supply.next(), [policy])[policy] for _ in range(units)]
    return placed


@pytest.mark.parametrize("policy", ["never", "always"])
def test_true_errors_are_spread_as_predicted(policy: Policy) -> None:
    """200 units of 5 cells: of an even spread the quarters hold 50 +- 18 units (3 sigma)."""
    placed = assembled(policy, stated(battery_size_sd_mm=0.02), Scatter())
    quarters = np.histogram([unit.probability for unit in placed], bins=4, range=(0.0, 1.0))[0]
    assert quarters == pytest.approx([50.0] * 4, abs=18)
    assert np.mean([unit.probability <= 0.99 for unit in placed]) >= 0.97


def test_uniform_sizes_are_placed_well_by_both_corners_and_stopped_by_one() -> None:
    recipe = stated(battery_size_sd_mm=0.08 / math.sqrt(3))
    scatter = Scatter(size_uniform=True)
    for unit in assembled("always", recipe, scatter, cells=2):
        assert unit.prediction.good
        assert unit.fit.worst_mm < 0.030
        assert unit.fit.clearance_mm > 0.0
    by_one = assembled("never", recipe, scatter, cells=2)
    assert max(unit.fit.worst_mm for unit in by_one) > 0.040
    assert not any(unit.prediction.good for unit in by_one)


def test_it_is_known_before_any_unit_is_seen_who_is_looked_at_twice() -> None:
    assert exact_cell(1, stated(aim_mm=None)).budgets["when_needed"].needs == Needs(False, False)
    assert exact_cell(1, stated(aim_mm=0.025)).budgets["when_needed"].needs == Needs(False, True)
    assert exact_cell(1, stated(aim_mm=None)).budgets["always"].needs == Needs(True, True)
    wavy = exact_cell(1, stated(aim_mm=None, battery_form_um=1.0)).budgets["when_needed"]
    assert wavy.needs == Needs(False, True)
    wavier = exact_cell(1, stated(aim_mm=None, battery_form_um=1.0, base_form_um=2.0)).budgets["when_needed"]
    assert wavier.needs == Needs(True, True)
    assert wavier.planned(wavier.needs).p99_mm < wavier.planned(Needs(False, True)).p99_mm


def test_the_second_look_gives_a_wavy_part_its_direction_and_leaves_a_straight_one_alone() -> None:
    for form_um, gain in ((0.0, 0.9), (2.0, 0.6)):
        budget = exact_cell(2, stated(base_form_um=form_um, battery_size_sd_mm=0.0)).budgets["always"]
        once, twice = (budget.planned(Needs(again, False)).p99_mm for again in (False, True))
        assert twice < once
        assert (twice / once < gain) == (form_um > 0.0)


def test_what_the_second_stretch_says_turns_the_base_by_its_share() -> None:
    """A wavy first stretch that is turned by 0.01 deg against the long baseline gives nearly all of it up."""
    cell = exact_cell(3, stated(base_form_um=5.0))
    budget, there = cell.budgets["always"], cell.taught.robot_from_base
    wrong = there @ Pose(0.0, 0.0, 0.01)
    away_mm = -math.radians(0.01) * X85.base.second_view.view_x_mm
    taught = budget.second_edge.found
    seen = taught._replace(offset_mm=taught.offset_mm + away_mm, turn_rad=taught.turn_rad - math.radians(0.01))
    mended = budget.base(None, wrong, EdgeAgain(None, seen)).pose
    assert mended.t_deg - there.t_deg == pytest.approx(0.0, abs=0.002)


def test_a_robot_that_is_worse_than_stated_is_found_by_its_calibrations() -> None:
    cell = exact_cell(4)
    budget = cell.budgets["never"]
    worse = replace(budget, calibrations=tuple(c.model_copy(update={"robot_factor": 2.0}) for c in budget.calibrations))
    assert worse.planned(Needs(False, False)).p99_mm > 1.2 * budget.planned(Needs(False, False)).p99_mm
    better = replace(
        budget, calibrations=tuple(c.model_copy(update={"robot_factor": 0.5}) for c in budget.calibrations)
    )
    assert better.planned(Needs(False, False)).p99_mm == budget.planned(Needs(False, False)).p99_mm


def test_golden_assemblies_that_were_seated_badly_count() -> None:
    budget = exact_cell(5).budgets["never"]
    worse = replace(budget, taught=budget.taught.model_copy(update={"spread_mm": 0.03}))
    assert (
        worse.planned(Needs(False, False)).shares["teaching"]
        > 2 * budget.planned(Needs(False, False)).shares["teaching"]
    )


def test_every_source_has_its_share() -> None:
    shares = (
        exact_cell(6, stated(base_form_um=1.0, battery_form_um=1.0))
        .budgets["never"]
        .planned(Needs(False, False))
        .shares
    )
    assert {"robot stops", "R axis", "teaching", "part size", "base edge form", "battery edge form"} <= set(shares)
    assert {"camera 1", "camera 2", "calibration camera 1", "calibration camera 2"} <= set(shares)


def test_a_second_look_out_of_reach_is_named() -> None:
    assert list(out_of_reach(CONFIG, X85)) == []
    far = X85.base.model_copy(update={"second_edge_from_mm": 180.0, "second_edge_to_mm": 194.0})
    said = list(out_of_reach(CONFIG, X85.model_copy(update={"base": far})))
    assert len(said) == 1
    assert "second stretch of the base's edge" in said[0]


def test_pictures_of_wavy_parts_in_dirt_are_predicted_too() -> None:
    """The benchmark in short: pictures, finders, calibration, teaching, both policies."""
    population = Population(
        "short", 1.0, ("never", "when_needed"), form_um=(1.0, 1.0), nuisances=True, repeats=2, units_per_cell=8
    )
    (batch,) = run(8, (population,), processes=1)
    by_one, by_need = figures(batch.samples["never"]), figures(batch.samples["when_needed"])
    assert by_one["stopped_percent"] == 100.0
    assert by_need["predicted_p99_um"] < 0.7 * by_one["predicted_p99_um"]
    assert by_need["within_predicted_p99_percent"] >= 90.0
    assert by_need["looks"] > 2.0
    assert batch.refused <= 1


def test_the_middle_of_the_seat_is_the_frame_of_the_corners() -> None:
    corners = exact_cell(7).budgets["never"].corners
    assert corners[0] == Mm(-26.5, -42.5)
