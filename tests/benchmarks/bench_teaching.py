"""How exact teaching, verification and hysteresis test are: `python -m tests.benchmarks.bench_teaching [cells units]`.

Part 1 commissions simulated cells with the paper's robot (+-0.01 mm, +-0.004 deg) over the real protocols. Then, with
an arm that repeats exactly, bases and batteries are set up anywhere within +-1 mm and +-1.5 deg of their taught place:
what is found is compared with the world's truth. Part 2 asks on synthetic boards from which movement on a verification
refuses, and how exact hysteresis and run-out come out. Prints tables and writes build/bench-teaching.json.
"""

import asyncio
import json
import logging
import math
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from cellctl.calibration.hysteresis import APPROACHES, USED, hysteresis
from cellctl.calibration.tool_centre import solve_tool_centre
from cellctl.geometry import Offset, Pose
from cellctl.procedures.golden import difference
from simulators.supply import Delivery
from tests.board_scenes import BOARD, NOISE, UP, moved_camera, see, stops, turned_plate, verified
from tests.golden_scenes import deliveries, mark_errors_um, marks_of, taught_in
from tests.whole_cell import Bench, whole_cell

OUT = Path("build/bench-teaching.json")
LIMIT_UM, LEVER_MM = 20.0, 100.0
TRIES = 200
MOST_INTERRUPTIONS = 5
REPEATS = 5
STUDENT = math.sqrt((REPEATS - 1) / (REPEATS - 3))  # rms of Student's t


def main(cells: int, units: int) -> None:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    result: dict[str, Any] = {"differential": asyncio.run(differential(cells, units))}
    print_differential(result["differential"])
    result |= {"verification": verification(), "hysteresis": lost_motion(), "run_out": run_out()}
    print_boards(result)
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


# -- part 1: whole cells ---------------------------------------------------------------------------------------


@dataclass
class Found:
    """What was found, over all cells."""

    marks_um: dict[str, list[float]] = field(default_factory=lambda: {"base": [], "battery": []})
    angles_mdeg: dict[str, list[float]] = field(default_factory=lambda: {"base": [], "battery": []})
    placed_um: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    rejected: int = 0


async def differential(cells: int, units: int) -> dict[str, Any]:
    """Errors of differences from the golden assembly, and of the golden assembly itself, over some cells."""
    found, interrupted = Found(), 0
    for seed in range(1, cells + 1):
        say(f"cell {seed} of {cells}")
        while True:
            try:
                await one_cell(found, seed, units)
                break
            except AssertionError as error:  # a computer that stood still for a quarter of a second aborts the cell
                interrupted += 1
                say(f"interrupted: {error}")
                if interrupted > MOST_INTERRUPTIONS:
                    raise
    marks, angles, placed = found.marks_um, found.angles_mdeg, found.placed_um
    return {
        "cells": cells,
        "units_per_cell": units,
        "rejected": found.rejected,
        "interrupted": interrupted,
        **{f"{part}_mark_rms_um": rms(values) for part, values in marks.items()},
        **{f"{part}_mark_worst_um": worst(values) for part, values in marks.items()},
        **{f"{part}_angle_rms_mdeg": rms(values) for part, values in angles.items()},
        **{f"{part}_angle_worst_mdeg": worst(values) for part, values in angles.items()},
        "placed_worst_corner_rms_um": rms(placed),
        "placed_worst_corner_max_um": worst(placed),
        "taught_place_error_over_uncertainty_rms": rms(found.ratios),
    }


async def one_cell(found: Found, seed: int, units: int) -> None:
    """Commissioned with the paper's robot, taught again and run with one that repeats exactly."""
    with tempfile.TemporaryDirectory() as folder:
        async with whole_cell(Path(folder), seed=seed) as bench:
            await bench.commission(REPEATS)
            scattered = taught_in(bench)
            bench.world.arm.repeatability_mm = bench.world.arm.repeatability_deg = 0.0
            await bench.job("teach", repeats=1, pairs=1)
            set_up = deliveries(np.random.default_rng(seed), units)
            bench.world.queue_deliveries(set_up)
            records = await bench.produce(units)
            off = difference(scattered.base_from_battery, taught_in(bench).base_from_battery)
            found.ratios += [off.x_mm / scattered.uncertainty_mm, off.y_mm / scattered.uncertainty_mm]
            compare(found, bench, records, set_up)


def compare(found: Found, bench: Bench, records: list[dict[str, Any]], set_up: list[Delivery]) -> None:
    """Against the world's truth; a unit that was rejected has nothing to compare."""
    both = [pair for pair in zip(records, set_up, strict=True) if pair[0]["verdict"] == "placed"]
    found.rejected += len(records) - len(both)
    seen, true = [record for record, _ in both], [delivery for _, delivery in both]
    for part, (centre, mark) in marks_of(bench).items():
        found.marks_um[part] += mark_errors_um(seen, true, part, centre, mark).ravel().tolist()
        found.angles_mdeg[part] += [
            (record[f"{part}_dt_deg"] - getattr(delivery, part).dt_deg) * 1000 for record, delivery in both
        ]
    found.placed_um += [verdict.fit.worst_mm * 1000 for verdict in bench.world.verdicts if verdict.fit]


def print_differential(found: dict[str, Any]) -> None:
    print(f"differences from the golden assembly, {found['cells']} cells x {found['units_per_cell']} units, exact arm")
    print(f"({found['rejected']} units rejected, {found['interrupted']} cells begun again)")
    print(f"{'':10}{'mark um rms':>14}{'worst':>8}{'angle mdeg rms':>17}{'worst':>8}")
    for part in ("base", "battery"):
        print(
            f"{part:10}{found[f'{part}_mark_rms_um']:>14.2f}{found[f'{part}_mark_worst_um']:>8.2f}"
            f"{found[f'{part}_angle_rms_mdeg']:>17.2f}{found[f'{part}_angle_worst_mdeg']:>8.2f}"
        )
    print(
        f"placed: worst corner {found['placed_worst_corner_rms_um']:.1f} um rms, "
        f"{found['placed_worst_corner_max_um']:.1f} um at most"
    )
    print(
        f"golden assembly with the paper's robot, {REPEATS} repeats: error of the taught place "
        f"{found['taught_place_error_over_uncertainty_rms']:.2f} x its stated uncertainty ({STUDENT:.2f} expected: the "
        "spread of so few repeats is itself that uncertain)"
    )


# -- part 2: boards --------------------------------------------------------------------------------------------


def verification() -> dict[str, Any]:
    """How often a verification refuses, against how far the camera has moved or turned."""
    say("verification")
    table: dict[str, Any] = {"limit_um": LIMIT_UM, "lever_mm": LEVER_MM, "tries": TRIES}
    for kind, name in (("eye_in_hand", "camera_1"), ("eye_to_hand", "camera_2")):
        for shift_um in (0, 10, 20, 30, 40, 60, 100):
            camera = moved_camera(kind, Offset(shift_um / 1000, 0.0, 0.0))
            table[f"{name}_refused_at_{shift_um}_um"] = refused(kind, camera)
        for turn_mdeg in (10, 20, 50, 100, 200):
            camera = moved_camera(kind, Offset(0.0, 0.0, turn_mdeg / 1000))
            table[f"{name}_refused_at_{turn_mdeg}_mdeg"] = refused(kind, camera)
        one = verified(kind, see(kind, Pose(0.0, 0.0, 0.0), np.random.default_rng(0)))
        table |= {f"{name}_shift_sd_um": one.shift_sd_um, f"{name}_turn_sd_mdeg": one.turn_sd_mdeg}
    return table


def refused(kind: Any, camera: Pose) -> float:
    """Part of the tries."""
    tries = [verified(kind, see(kind, camera, np.random.default_rng(seed))) for seed in range(TRIES)]
    return sum(not one.holds(LIMIT_UM, LEVER_MM) for one in tries) / TRIES


def lost_motion() -> dict[str, float]:
    """The hysteresis test with 4 repeats: errors of the differences that it prints."""
    say("hysteresis")
    lag, errors, stated = np.array([0.010, 0.015, 0.005]), [], []
    for seed in range(TRIES):
        found = hysteresis(*stops(np.random.default_rng(seed), 4, lag))
        true = (np.array(APPROACHES) - np.array(USED)) * lag * 1000
        errors.append((found.difference - true)[1:])
        stated.append(found.difference_sd)
    error, sd = np.sqrt(np.mean(np.square(errors), axis=(0, 1))), np.mean(stated, axis=0)
    return {
        "xy_error_rms_um": float(np.hypot(*error[:2]) / math.sqrt(2)),
        "xy_stated_um": float(np.hypot(*sd[:2]) / math.sqrt(2)),
        "r_error_rms_mdeg": float(error[2]),
        "r_stated_mdeg": float(sd[2]),
    }


def run_out() -> dict[str, float]:
    """Rotation centre and eccentricity from nine rotations: errors against the stated ones."""
    say("run-out")
    centre, eccentricity, stated = [], [], []
    for seed in range(TRIES):
        poses, dots, true = turned_plate(np.random.default_rng(seed))
        found = solve_tool_centre(poses, dots, BOARD.points_mm, UP, NOISE)
        centre += [found.map_dx_um, found.map_dy_um]
        eccentricity += [(a - b) * 1000 for a, b in zip(found.eccentricity_mm, true, strict=True)]
        stated.append((found.sd_um, found.eccentricity_sd_um))
    sd = np.mean(stated, axis=0) / math.sqrt(2)
    return {
        "centre_error_rms_um": rms(centre),
        "centre_stated_um": float(sd[0]),
        "eccentricity_error_rms_um": rms(eccentricity),
        "eccentricity_stated_um": float(sd[1]),
    }


def print_boards(result: dict[str, Any]) -> None:
    found = result["verification"]
    print(f"\nverification refuses, part of {TRIES} tries, limit {LIMIT_UM:g} um at {LEVER_MM:g} mm")
    for unit in ("um", "mdeg"):
        keys = [key for key in found if key.startswith("camera_1_refused") and key.endswith(f"_{unit}")]
        moved = [key.split("_")[-2] for key in keys]
        print(f"{f'moved {unit}':<12}" + "".join(f"{step:>8}" for step in moved))
        for name in ("camera_1", "camera_2"):
            print(f"{name:<12}" + "".join(f"{found[key.replace('camera_1', name)]:>8.3f}" for key in keys))
    for name in ("camera_1", "camera_2"):
        shift_um, turn_mdeg = found[f"{name}_shift_sd_um"], found[f"{name}_turn_sd_mdeg"]
        print(f"{name:<12}shift known to {shift_um:.1f} um, turn to {turn_mdeg:.1f} mdeg")
    lag, tool = result["hysteresis"], result["run_out"]
    print(
        f"hysteresis  {lag['xy_error_rms_um']:.2f} um rms (stated {lag['xy_stated_um']:.2f}), "
        f"{lag['r_error_rms_mdeg']:.2f} mdeg (stated {lag['r_stated_mdeg']:.2f})"
    )
    print(
        f"tool        centre {tool['centre_error_rms_um']:.2f} um per axis (stated {tool['centre_stated_um']:.2f}), "
        f"run-out {tool['eccentricity_error_rms_um']:.2f} um (stated {tool['eccentricity_stated_um']:.2f})"
    )


def rms(values: list[float]) -> float:
    return math.sqrt(sum(value**2 for value in values) / len(values))


def worst(values: list[float]) -> float:
    return max(abs(value) for value in values)


def say(text: str) -> None:
    """Progress for whoever waits."""
    print(f"bench-teaching: {text}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    asked = [int(argument) for argument in sys.argv[1:3]]
    main(*(asked or [3, 30]))
