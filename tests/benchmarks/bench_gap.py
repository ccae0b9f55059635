"""How true the look at the gap is, how soon drift is found: `python -m tests.benchmarks.bench_gap [pictures] [units]`.

Pictures of a corner of a seated battery, judged by where the renderer put its edges: error of the gap per axis, with
the true map of camera 1 and with one whose hand-eye is falsified by 0.1 mm. Then drift: how many units pass before a
shift is found, how often a quiet cell is blamed, and whether the right cause is named. Two processes. Prints tables,
writes build/bench-gap.json.
"""

import json
import logging
import math
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import structlog

from cellctl.assembly import seating
from cellctl.calibration.plane_map import PlaneMap
from cellctl.geometry import Pose
from cellctl.monitoring.drift import Cause, Drift, Observation, after, restarted
from cellctl.vision import Limits, NotFound, Search
from cellctl.vision.gap import find_gap
from tests.drift_units import RECIPE, DriftCell, Imperfect
from tests.gap_scenes import (
    CLEAN,
    SEARCH_MM,
    TURN_DEG,
    Dirt,
    GapView,
    Lie,
    dirt,
    gap_view,
    some_camera_1,
    some_lie,
    some_stop,
)

OUT = Path("build/bench-gap.json")
PICTURES, UNITS = 2000, 2_000_000
PROCESSES = 2
CHUNK = 100  # pictures of a piece of work
FALSIFIED_MM = 0.1
SERIES = 4000  # units of one cell from teaching to teaching
CASES = 200  # shifts, and causes
MOST_UNITS = 600  # until a cause must have shown


class Regime(NamedTuple):
    """A kind of pictures."""

    name: str
    lie: Callable[[np.random.Generator], Lie]
    dirt: Callable[[np.random.Generator], Dirt]


def _clean(_: np.random.Generator) -> Dirt:
    return CLEAN


def _gap_of(low_mm: float, high_mm: float) -> Callable[[np.random.Generator], Lie]:
    def lie(rng: np.random.Generator) -> Lie:
        dx, dy = rng.uniform(low_mm, high_mm, 2) - 0.1
        return replace(some_lie(rng), dx_mm=float(dx), dy_mm=float(dy))

    return lie


REGIMES = (
    Regime("clean", some_lie, _clean),
    Regime("gap 0.02 to 0.04 mm", _gap_of(0.02, 0.04), _clean),
    Regime("gap 0.15 to 0.20 mm", _gap_of(0.15, 0.20), _clean),
    Regime("dirt, glare, rims, walls", some_lie, dirt),
    Regime("twice as strong", some_lie, lambda rng: dirt(rng, strong=True)),
)


def main(pictures: int, units: int, out: Path = OUT) -> None:
    began_s = time.monotonic()
    result: dict[str, Any] = {"gap": {}, "drift": {}}
    spawn = get_context("spawn")  # a forked child would inherit the locks of cv2's threads
    with ProcessPoolExecutor(PROCESSES, spawn, initializer=_alone) as pool:
        for number, regime in enumerate(REGIMES):
            works = [
                pool.submit(regime_pictures, number, seed, min(CHUNK, pictures - seed * CHUNK))
                for seed in range(math.ceil(pictures / CHUNK))
            ]
            result["gap"][regime.name] = summary([row for work in _shown(works, regime.name) for row in work.result()])
        result["drift"] = drift_figures(pool, units)
    result["took_s"] = round(time.monotonic() - began_s, 1)
    print_tables(result)
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def _alone() -> None:
    """A process of the benchmark: one thread, and no log of the drift that it finds."""
    cv2.setNumThreads(1)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))


def _shown(works: list[Any], name: str) -> Iterator[Any]:
    """The works as they are done, with progress on standard error."""
    for done, work in enumerate(as_completed(works), 1):
        print(f"\r\033[K{name}: {done} of {len(works)}", end="\n" if done == len(works) else "", file=sys.stderr)
        yield work


# -- pictures ----------------------------------------------------------------------------------------------


class Row(NamedTuple):
    """One picture: errors with the true map, and how far those with a falsified one are from them; nan: refused."""

    dx_um: float
    dy_um: float
    dt_mdeg: float
    sigmas_x: float
    sigmas_y: float
    moved_um: float
    ms: float


REFUSED = Row(*[math.nan] * 7)


def regime_pictures(number: int, seed: int, count: int) -> list[Row]:
    """So many pictures of a regime."""
    rng, regime = np.random.default_rng([number, seed]), REGIMES[number]
    return [_row(rng, regime) for _ in range(count)]


def _row(rng: np.random.Generator, regime: Regime) -> Row:
    lie = regime.lie(rng)
    view = gap_view(rng, some_camera_1(rng), lie, some_stop(rng), regime.dirt(rng))
    angle = rng.uniform(0.0, 2.0 * math.pi)
    moved = FALSIFIED_MM * math.cos(angle), FALSIFIED_MM * math.sin(angle)
    try:
        began_s = time.perf_counter()
        seen = _lying(view, (0.0, 0.0))
        ms = 1000.0 * (time.perf_counter() - began_s)
        false = _lying(view, moved)
    except NotFound:
        return REFUSED
    x, y, t = (
        1000.0 * (found - true) for found, true in zip(seen.offset, (lie.dx_mm, lie.dy_mm, lie.dt_deg), strict=True)
    )
    apart_um = 1000.0 * math.dist(false.offset[:2], seen.offset[:2])
    return Row(x, y, t, x / (1000.0 * seen.sd_x_mm), y / (1000.0 * seen.sd_y_mm), apart_um, ms)


def _lying(view: GapView, moved_mm: tuple[float, float]) -> seating.Seating:
    """What the product makes of a picture, camera 1's map shifted by so much."""
    optics, scale = view.optics, view.optics.px_per_mm
    offset = optics.offset_px - optics.matrix @ np.array(moved_mm)
    plane = PlaneMap.from_arrays(optics.matrix, offset, 0.0, optics.centre_px)
    expected = seating.expect_gap(plane, RECIPE, Pose(*view.base), view.expected.blur_px)
    limits = Limits(corner_skip_px=2.0 * scale, min_contrast=40.0)
    seen = find_gap(view.pixels, expected, Search(SEARCH_MM * scale, TURN_DEG), limits)
    return seating.seating(plane, RECIPE, seen, Pose(*view.base))


def summary(rows: list[Row]) -> dict[str, float]:
    """Figures of a regime."""
    table = np.array(rows)
    seen = table[~np.isnan(table[:, 0])]
    if not len(seen):
        return {"pictures": len(table), "refused_percent": 100.0}
    errors = seen[:, :2]
    return {
        "pictures": len(table),
        "refused_percent": 100.0 * (len(table) - len(seen)) / len(table),
        "bias_um": float(np.abs(errors.mean(axis=0)).max()),
        "sigma_um": float(errors.std(axis=0).max()),
        "rms_um": float(np.sqrt(np.mean(errors**2))),
        "worst_um": float(np.abs(errors).max()),
        "angle_sigma_mdeg": float(seen[:, 2].std()),
        "variance_of_normalised_errors": float(np.mean(seen[:, 3:5] ** 2)),
        "moved_by_falsified_hand_eye_rms_um": float(np.sqrt(np.mean(seen[:, 5] ** 2))),
        "moved_by_falsified_hand_eye_worst_um": float(seen[:, 5].max()),
        "median_ms": float(np.median(seen[:, 6])),
    }


# -- drift -------------------------------------------------------------------------------------------------


def drift_figures(pool: ProcessPoolExecutor, units: int) -> dict[str, Any]:
    """Noise of a unit, delay of a shift by 10 um, false alarms, causes."""
    spread = unit_spread(3000 if units >= UNITS else 200)
    cases = CASES if units >= UNITS else max(1, units // 2000)
    blamed = [pool.submit(false_alarms, seed, units // PROCESSES, spread) for seed in range(PROCESSES)]
    delays = {
        f"after {learnt} units": pool.submit(delay_figures, learnt, cases, spread) for learnt in (60, 150, 600)
    } | {"with 9 um noise, after 600 units": pool.submit(delay_figures, 600, cases, (9.0, 9.0, 4.0))}
    named = {name: pool.submit(causes_named, name, max(1, cases // 5)) for name in WRONG}
    alarms = [work.result() for work in _shown(blamed, "quiet cells")]
    made = sum(number for number, _ in alarms)
    return {
        "sigma_of_a_unit": {"dx_um": spread[0], "dy_um": spread[1], "dt_mdeg": spread[2]},
        "units_until_10_um_is_found": {name: work.result() for name, work in delays.items()},
        "quiet_units": made,
        "false_alarms": sum(number for _, number in alarms),
        "units_per_false_alarm": made / max(1, sum(number for _, number in alarms)),
        "causes_named": {name: work.result() for name, work in named.items()},
    }


def unit_spread(count: int) -> tuple[float, float, float]:
    """What robot, pictures and parts do to one unit, 1 sigma: um, um, mdeg."""
    seen = np.array(list(DriftCell(np.random.default_rng(1)).units(count)))
    x, y, t = seen[:, :3].std(axis=0, ddof=1).tolist()
    return x, y, t


def _white(
    rng: np.random.Generator, count: int, spread: tuple[float, ...], shift: tuple[float, ...] = (0.0, 0.0, 0.0)
) -> list[Observation]:
    errors = rng.normal(0.0, spread, (count, 3)) + shift
    placed = np.column_stack([rng.normal(0.1, 0.6, count), rng.uniform(-1.0, 1.0, (count, 2))])
    return [Observation(*row) for row in np.hstack([errors, placed]).tolist()]


def false_alarms(seed: int, units: int, spread: tuple[float, ...]) -> tuple[int, int]:
    """Units of quiet cells, and how often they were blamed."""
    rng, alarms, made = np.random.default_rng([7, seed]), 0, 0
    while made < units:
        drift = Drift()
        for unit in _white(rng, min(SERIES, units - made), spread):
            drift, signal = after(drift, unit)
            made += 1
            if signal is not None:
                alarms += 1
                drift = restarted(drift) if signal.cause is Cause.CONSTANT else Drift()
    return made, alarms


def delay_figures(learnt: int, cases: int, spread: tuple[float, ...]) -> dict[str, float]:
    """Units until a shift by 10 um in any direction is found, when so many units were seen before."""
    rng = np.random.default_rng([8, learnt])
    took = []
    for _ in range(cases):
        drift = Drift()
        for unit in _white(rng, learnt, spread):
            drift, signal = after(drift, unit)
            drift = restarted(drift) if signal is not None else drift
        way = rng.uniform(0.0, 2.0 * math.pi)
        shift = (10.0 * math.cos(way), 10.0 * math.sin(way), 0.0)
        took.append(_found_after(drift, _white(rng, 300, spread, shift)))
    return {f"p{q}": float(np.percentile(took, q)) for q in (50, 95, 99)}


def _found_after(drift: Drift, seen: list[Observation]) -> int:
    for number, unit in enumerate(seen, 1):
        drift, signal = after(drift, unit)
        if signal is not None:
            return number
    return len(seen)


WRONG: dict[str, tuple[Imperfect, Imperfect, Cause]] = {  # as calibrated, what then happens, the right cause
    "camera 1 moved by 10 um": (Imperfect(), Imperfect(camera_1_mm=(0.01, 0.0)), Cause.CONSTANT),
    "camera 2 moved by 10 um": (Imperfect(), Imperfect(camera_2_mm=(0.0, 0.01)), Cause.CONSTANT),
    "R lost 6 mdeg at the seat": (Imperfect(), Imperfect(seat_t_deg=0.006), Cause.CONSTANT),
    "rotation centre off by 0.4 mm": (*[Imperfect(tool_centre_mm=(0.4, 0.0))] * 2, Cause.TOOL_CENTRE),
    "camera 2 scale off by 0.6 %": (*[Imperfect(camera_2_scale=0.006)] * 2, Cause.CAMERA_2_SCALE),
}


def causes_named(name: str, cases: int) -> dict[str, float]:
    """How often the first alarm names the right cause, in percent, and after how many units."""
    calibrated, happens, cause = WRONG[name]
    right, took = 0, []
    for case in range(cases):
        cell = DriftCell(np.random.default_rng([9, case]), wrong=calibrated)
        if calibrated != happens:
            list(cell.units(200))
        cell.watch.known, cell.wrong = restarted(cell.watch.known), happens
        before = len(cell.watch.known.alarms)
        number = next(
            (n for n, _ in enumerate(cell.units(MOST_UNITS), 1) if len(cell.watch.known.alarms) > before), MOST_UNITS
        )
        alarms = cell.watch.known.alarms[before:]
        right += bool(alarms) and alarms[0].cause is cause
        took.append(number)
    return {"right_percent": 100.0 * right / cases, "median_units": float(np.median(took))}


# -- tables ------------------------------------------------------------------------------------------------


def print_tables(result: dict[str, Any]) -> None:
    """For people."""
    print(
        f"{'gap':<26} {'pictures':>8} {'refused':>8} {'bias um':>8} {'1 sigma':>8} {'worst':>8} {'mdeg':>6} "
        f"{'chi2':>6} {'false hand-eye: rms, worst um':>30} {'ms':>6}"
    )
    for name, row in result["gap"].items():
        if row["refused_percent"] == 100.0:
            print(f"{name:<26} {row['pictures']:8.0f} {row['refused_percent']:7.1f}%")
            continue
        print(
            f"{name:<26} {row['pictures']:8.0f} {row['refused_percent']:7.1f}% {row['bias_um']:8.3f} "
            f"{row['sigma_um']:8.3f} {row['worst_um']:8.2f} {row['angle_sigma_mdeg']:6.2f} "
            f"{row['variance_of_normalised_errors']:6.2f} "
            f"{row['moved_by_falsified_hand_eye_rms_um']:20.3f} {row['moved_by_falsified_hand_eye_worst_um']:9.2f} "
            f"{row['median_ms']:6.1f}"
        )
    drift = result["drift"]
    sigma = drift["sigma_of_a_unit"]
    print(f"\none unit, 1 sigma: {sigma['dx_um']:.1f} {sigma['dy_um']:.1f} um {sigma['dt_mdeg']:.1f} mdeg")
    for name, delay in drift["units_until_10_um_is_found"].items():
        print(f"10 um found {name}: median {delay['p50']:.0f}, p95 {delay['p95']:.0f}, p99 {delay['p99']:.0f} units")
    print(
        f"quiet cells: {drift['false_alarms']} alarms in {drift['quiet_units']} units, "
        f"one in {drift['units_per_false_alarm']:.0f}"
    )
    for name, row in drift["causes_named"].items():
        print(f"{name:<32} named right {row['right_percent']:.0f} %, after {row['median_units']:.0f} units")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else PICTURES, int(sys.argv[2]) if len(sys.argv) > 2 else UNITS)
