"""Is the predicted placement error true: `python -m tests.benchmarks.bench_budget [units]`.

Simulated units in populations: cells, each with its own bolts, calibration by pictures, teaching and robot; units with
their own sizes, form and pictures. The world says how each battery truly lies; the controller knows only what it
measures and what recipe and cell.toml state. Two processes. Prints tables, writes build/bench-budget.json.
"""

import json
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from cellctl.config import CellConfig, load_config
from cellctl.geometry import Pose
from cellctl.recipe import Recipe, load_recipe
from cellctl.vision import NotFound
from simulators.arm import Arm
from simulators.clock import Clock
from simulators.layout import build_layout
from simulators.moves import Go
from simulators.product import Product, load_product
from simulators.scara import ToolPose
from simulators.supply import Form, Scatter, Supply
from simulators.ways import Pace
from tests.fast_cell import Calibrations, Eyes, FastCell, Policy, Robot
from tests.fast_eyes import RenderedEyes, calibrated

ROOT = Path(__file__).resolve().parent.parent.parent
OUT = Path("build/bench-budget.json")
UNITS = 10_000
PROCESSES = 2
LIMIT_MM = 0.04
STATED = 0.01 / 3, 0.004 / 3  # the robot's data sheet, one sigma
PERCENT = 100.0
GOLDEN_PARTS = 50


@dataclass(frozen=True)
class Population:
    """What its cells and units are like. Ranges are drawn evenly per cell."""

    name: str
    share: float  # of all units
    policies: tuple[Policy, ...]
    form_um: tuple[float, float] = (0.0, 0.0)
    stated_form: bool = True  # else the recipe says that edges are straight
    size_uniform: bool = False
    worn: tuple[float, float] = (1.0, 1.0)  # the robot's scatter over its data sheet
    nuisances: bool = False
    pairs: int = 1
    repeats: int = 10
    units_per_cell: int = 100


POPULATIONS = (
    Population("as built", 0.34, ("when_needed",)),
    Population(
        "nuisances",
        0.36,
        ("never", "when_needed"),
        form_um=(0.0, 2.0),
        worn=(1.0, 1.5),
        nuisances=True,
        pairs=3,
        repeats=4,
        units_per_cell=60,
    ),
    Population("form 0.5 um", 0.06, ("never", "when_needed", "always"), form_um=(0.5, 0.5), pairs=3, repeats=4),
    Population("form 1 um", 0.06, ("never", "when_needed", "always"), form_um=(1.0, 1.0), pairs=3, repeats=4),
    Population("form 2 um", 0.06, ("never", "when_needed", "always"), form_um=(2.0, 2.0), pairs=3, repeats=4),
    Population("sizes +-0.08 mm", 0.06, ("never", "when_needed", "always"), size_uniform=True),
    Population("form unstated", 0.06, ("never",), form_um=(0.3, 1.0), stated_form=False, pairs=3, repeats=4),
)


class Sample(NamedTuple):
    """One unit under one policy, in mm."""

    p99_mm: float
    expected_mm: float
    off_mm: float
    probability: float
    clearance_mm: float
    looks: tuple[int, int]
    go: bool


@dataclass
class Batch:
    """What one cell gave."""

    population: str
    samples: dict[str, list[Sample]] = field(default_factory=dict)
    shares: dict[str, dict[str, float]] = field(default_factory=dict)
    refused: int = 0


def main(units: int) -> None:
    batches = run(units)
    result = {"limit_um": 1e3 * LIMIT_MM, "units": units, "added_cycle_s": added_cycle_s(), **summary(batches)}
    print(tables(result))
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


def run(units: int, populations: tuple[Population, ...] = POPULATIONS, processes: int = PROCESSES) -> list[Batch]:
    """All cells of all populations; progress on stderr."""
    began_s, batches = time.monotonic(), []
    work = list(cells(units, populations))
    if processes == 1:
        return [one_cell(*item) for item in work]
    with ProcessPoolExecutor(processes, get_context("spawn")) as pool:
        waiting = [pool.submit(one_cell, *item) for item in work]
        for done in as_completed(waiting):
            batches.append(done.result())
            spent_s = time.monotonic() - began_s
            print(f"\r{len(batches)}/{len(work)} cells, {spent_s:.0f} s", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return batches


def cells(units: int, populations: tuple[Population, ...]) -> Iterator[tuple[int, Population, int]]:
    """Seed, population and number of units of every cell."""
    seed = 0
    for population in populations:
        left = round(units * population.share)
        while left > 0:
            count = min(left, population.units_per_cell)
            yield seed, population, count
            seed, left = seed + 1, left - count


# -- one cell --------------------------------------------------------------------------------------------------------


def one_cell(seed: int, population: Population, units: int) -> Batch:
    """Bolt it together, calibrate, teach, assemble."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng([seed, 5])
    form_um, worn = float(rng.uniform(*population.form_um)), float(rng.uniform(*population.worn))
    cell = commissioned(seed, population, form_um, worn)
    scatter = Scatter(size_uniform=population.size_uniform, base_form_mm=form_um / 1e3, battery_form_mm=form_um / 1e3)
    supply = Supply(np.random.default_rng([seed, 3]), scatter)
    batch = Batch(population.name, {policy: [] for policy in population.policies})
    shares: dict[str, list[dict[str, float]]] = {policy: [] for policy in population.policies}
    for _ in range(units):
        try:
            placed = cell.assemble(supply.next(), population.policies)
        except NotFound:
            batch.refused += 1
            continue
        for policy, unit in placed.items():
            predicted, lies = unit.prediction, unit.fit
            batch.samples[policy].append(
                Sample(
                    predicted.p99_mm,
                    predicted.expected_mm,
                    lies.worst_mm,
                    unit.probability,
                    lies.clearance_mm,
                    unit.looks,
                    predicted.good,
                )
            )
            shares[policy].append(dict(predicted.shares))
    batch.shares = {policy: mean_of(each) for policy, each in shares.items() if each}
    return batch


def commissioned(seed: int, population: Population, form_um: float, worn: float) -> FastCell:
    """A cell that has calibrated itself and was taught."""
    config, recipe, product = drawn()
    stated = {
        "base_form_um": form_um if population.stated_form else 0.0,
        "battery_form_um": form_um if population.stated_form else 0.0,
        "battery_size_sd_mm": 0.08 / 3**0.5 if population.size_uniform else 0.02,
    }
    recipe = recipe.model_copy(update={"placement": recipe.placement.model_copy(update=stated)})
    layout = build_layout(np.random.default_rng([seed, 2]))
    cell = FastCell(seed, config, recipe, product, layout, Robot(STATED[0] * worn, STATED[1] * worn))
    rng = np.random.default_rng([seed, 4])
    calibrations = calibrated(cell, "camera-1", rng), calibrated(cell, "camera-2", rng)
    planes = calibrations[0].plane, calibrations[1].plane
    eyes = RenderedEyes(recipe, (layout.camera_1, layout.camera_2), planes, rng)
    golden_mm = form_um / 1e3 if population.stated_form else 0.0  # who thinks parts are straight taught with such
    golden = Form(golden_mm, golden_mm, 10**6 + 1000 * seed)
    teach(cell, eyes, calibrations, golden, population)
    eyes.nuisances = population.nuisances
    return cell


def teach(cell: FastCell, eyes: Eyes, calibrations: Calibrations, golden: Form, population: Population) -> None:
    """A person who teaches takes other golden parts when the cell refuses to see them."""
    for again in range(GOLDEN_PARTS):
        try:
            parts = replace(golden, seed=golden.seed + 10 * again)
            return cell.commission(eyes, calibrations, parts, population.repeats, population.pairs)
        except NotFound:
            continue
    raise RuntimeError(f"{population.name}: none of {GOLDEN_PARTS} golden pairs can be seen")


@lru_cache(maxsize=1)
def drawn() -> tuple[CellConfig, Recipe, Product]:
    """The simulated cell's configuration, the recipe and the parts as drawn."""
    return (
        load_config(ROOT / "deploy" / "simulated-cell.toml"),
        load_recipe(ROOT / "recipes", "x85"),
        load_product(ROOT / "recipes" / "x85.toml"),
    )


def mean_of(shares: list[dict[str, float]]) -> dict[str, float]:
    names = {name for each in shares for name in each}
    mean = {name: sum(each.get(name, 0.0) for each in shares) / len(shares) for name in names}
    return dict(sorted(mean.items(), key=lambda item: -item[1]))


# -- what it means ---------------------------------------------------------------------------------------------------


def summary(batches: list[Batch]) -> dict[str, Any]:
    """Figures per population and policy, and of all units as production would treat them."""
    rows = []
    for population in dict.fromkeys(batch.population for batch in batches):
        own = [batch for batch in batches if batch.population == population]
        for policy in own[0].samples:
            samples = [sample for batch in own for sample in batch.samples[policy]]
            shares = mean_of([batch.shares[policy] for batch in own if policy in batch.shares])
            found = {"not_found": sum(batch.refused for batch in own), **figures(samples)}
            rows.append({"population": population, "policy": policy, **found, "shares": shares})
    stated = [batch for batch in batches if batch.population != "form unstated"]
    everything = [sample for batch in stated for sample in batch.samples.get("when_needed", [])]
    at_once = [sample for batch in stated for sample in batch.samples.get("never", [])]
    return {"rows": rows, "all when_needed": figures(everything), "all never": figures(at_once)}


def figures(samples: list[Sample]) -> dict[str, Any]:
    """Lengths in um, rates in percent."""
    if not samples:
        return {}
    probability = np.array([sample.probability for sample in samples])
    off = np.array([sample.off_mm for sample in samples])
    go = np.array([sample.go for sample in samples])
    bad = off > LIMIT_MM
    return {
        "units": len(samples),
        "predicted_p99_um": 1e3 * float(np.median([sample.p99_mm for sample in samples])),
        "true_p99_um": 1e3 * float(np.quantile(off, 0.99)),
        "expected_um": 1e3 * float(np.mean([sample.expected_mm for sample in samples])),
        "true_mean_um": 1e3 * float(off.mean()),
        "within_predicted_p50_percent": PERCENT * float(np.mean(probability <= 0.5)),
        "within_predicted_p90_percent": PERCENT * float(np.mean(probability <= 0.9)),
        "within_predicted_p99_percent": PERCENT * float(np.mean(probability <= 0.99)),
        "stopped_percent": PERCENT * float(np.mean(~go)),
        "beyond_limit": int(bad.sum()),
        "beyond_limit_stopped_percent": PERCENT * float(np.mean(~go[bad])) if bad.any() else None,
        "placed_beyond_limit_percent": PERCENT * float(np.mean(bad[go])) if go.any() else None,
        "placed_max_um": 1e3 * float(off[go].max()) if go.any() else None,
        "placed_that_fit_percent": fitting(samples),
        "looks": float(np.mean([sum(sample.looks) for sample in samples])),
    }


def fitting(samples: list[Sample]) -> float | None:
    """Of the batteries that were placed, how many lie in their seats."""
    clear = [sample.clearance_mm >= 0.0 for sample in samples if sample.go]
    return PERCENT * sum(clear) / len(clear) if clear else None


def added_cycle_s() -> dict[str, float]:
    """World seconds that a second look costs: the arm's own motions, settling and exposure; nothing of the protocol."""
    _, recipe, _ = drawn()
    cell = commissioned(0, Population("time", 1.0, ("always",), repeats=1), 0.0, 1.0)
    taught = cell.taught
    assert taught.second_edge is not None
    assert taught.second_corner is not None
    seat = taught.robot_from_base @ taught.base_from_battery @ taught.tool_from_battery.inverse()
    routes = {
        "camera 1": (taught.look_1, taught.second_edge.stop, taught.table_pick),
        "camera 2": (taught.look_2, taught.second_corner.stop, seat),
    }
    return {
        name: travel_s(recipe, [start, stop, end]) - travel_s(recipe, [start, end])
        for name, (start, stop, end) in routes.items()
    }


def travel_s(recipe: Recipe, poses: list[Pose]) -> float:
    """From the first pose to where the approach to the last one begins, stopping exactly at those in between."""
    clock, motion = Standing(), recipe.motion
    arm = Arm(clock, np.random.default_rng(0), start=_above(poses[0]))
    arm.powered = True
    for number, pose in enumerate(poses[1:], 2):
        before = Pose(pose.x_mm - motion.approach_mm, pose.y_mm - motion.approach_mm, pose.t_deg - motion.approach_deg)
        clock.now_s = arm.start(Go(_above(before)), Pace(motion.travel_speed_pct / 100)).end_s
        if number < len(poses):
            clock.now_s = arm.start(Go(_above(pose)), Pace(motion.touch_speed_pct / 100)).end_s
            clock.now_s += motion.settle_s + recipe.battery.exposure_us * 1e-6
    return clock.now_s


def _above(pose: Pose) -> ToolPose:
    return ToolPose(pose.x_mm, pose.y_mm, 60.0, pose.t_deg)


class Standing(Clock):
    """A clock that somebody else sets."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0

    def now(self) -> float:
        return self.now_s


def tables(result: dict[str, Any]) -> str:
    """For people."""
    lines = [
        "predicted and true error of the worst corner, um; share of true errors within the predicted quantile",
        f"{'population':<18}{'second look':<13}{'units':>6}{'p99 pred':>10}{'true':>7}{'in p50':>9}{'in p90':>8}"
        f"{'in p99':>8}{'stopped':>9}{'> 40 um':>9}{'of these':>10}{'placed >40':>12}{'fit':>9}{'looks':>7}",
    ]
    rows = result["rows"]
    for row in [
        *rows,
        *({"population": name, "policy": "", **result[name]} for name in ("all when_needed", "all never")),
    ]:
        if row.get("units"):
            lines.append(_row(row))
    lines += ["", "largest shares of the variance"]
    for row in rows:
        parts = ", ".join(f"{name} {share:.0%}" for name, share in list(row["shares"].items())[:5])
        lines.append(f"{row['population']:<18}{row['policy']:<13}{parts}")
    added = ", ".join(f"{name} +{seconds:.2f} s" for name, seconds in result["added_cycle_s"].items())
    missed = dict.fromkeys(f"{row['population']} {row['not_found']}" for row in rows if row["not_found"])
    lines += [
        "",
        f"a second look costs (arm, settling, exposure): {added}",
        f"not found by vision: {', '.join(missed) or 'none'}",
    ]
    return "\n".join(lines)


def _row(row: dict[str, Any]) -> str:
    return (
        f"{row['population']:<18}{row['policy']:<13}{row['units']:>6}{row['predicted_p99_um']:>10.1f}"
        f"{row['true_p99_um']:>7.1f}{_percent(row['within_predicted_p50_percent'], 9)}"
        f"{_percent(row['within_predicted_p90_percent'], 8)}{_percent(row['within_predicted_p99_percent'], 8, 2)}"
        f"{_percent(row['stopped_percent'], 9)}{row['beyond_limit']:>9}"
        f"{_percent(row['beyond_limit_stopped_percent'], 10)}{_percent(row['placed_beyond_limit_percent'], 12, 2)}"
        f"{_percent(row['placed_that_fit_percent'], 9)}{row['looks']:>7.2f}"
    )


def _percent(value: float | None, width: int, digits: int = 1) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:>{width - 1}.{digits}f}%"


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else UNITS)
