"""How exact the hand-eye calibration is, and whether it knows: `python -m tests.benchmarks.bench_calibration [cells]`.

Random cells of three kinds, each calibrated with 15 poses by a robot of +-0.01 mm and +-0.004 deg (3 sigma); beside it,
on the same pictures, the closed form without lens and robot error, and OpenCV's five methods. Prints tables and writes
build/bench-calibration.json.
"""

import importlib.util
import json
import math
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from cellctl.assembly.map_error import MapError
from cellctl.calibration.accuracy import Mark
from cellctl.calibration.hand_eye import HandEye, solve_hand_eye
from cellctl.calibration.linear import grid_fits, linear_start
from cellctl.calibration.plan import Plan, PlanRequest, plan_hand_eye
from cellctl.calibration.problem import Looks
from cellctl.calibration.scara import pose_array
from cellctl.calibration.six_dof.pairs import Pairs
from cellctl.calibration.six_dof.peers import METHODS, opencv_camera
from cellctl.calibration.six_dof.rigid import rigid, rotation_from_vector
from cellctl.geometry import Mm, Pose, Px
from cellctl.mount import FLAGS, Stop
from drivers.rcx import Point
from drivers.reach import Limits
from tests.benchmarks.bench_calibration_spatial import real, real_text, simulated, simulated_text
from tests.calibration_cells import (
    BOARD,
    CASES,
    CENTRE,
    PX_PER_MM,
    STATED,
    Case,
    Cell,
    differential_um,
    task,
    true_cell,
)

OUT = Path("build/bench-calibration.json")
TURNS_DEG: dict[Case, tuple[float, ...]] = {"eye_in_hand": (30, 90), "eye_to_hand": (30, 90), "arm_2": (0,)}
VIEW_MM = np.stack(np.meshgrid(np.linspace(-8, 8, 9), np.linspace(-6, 6, 7)), -1).reshape(-1, 2)
HELD_OUT = 12  # poses per cell that no fit has seen
DISTANCE_MM, TILT_SD_DEG, DEPTH_SD_MM = 110.0, 0.02, 0.03  # what a plate's pose would be, for solvers that want one
LIMITS = Limits(inner_reach_mm=135, outer_reach_mm=398, r_min_deg=-180, r_max_deg=180)
OURS, CLOSED = "cellctl", "closed form"
MARK = Mark(Mm(0.0, 0.0), (Mm(-7.0, 4.0), Mm(7.0, 4.0)))
IN_DEG = np.diag([1.0, 1.0, math.degrees(1.0)])
Row = dict[str, Any]
Errors = dict[str, list[np.ndarray]]
Say = Callable[[str], None]


def main(cells: int) -> None:
    """All tables."""
    result = bench(cells, lambda text: print(text, file=sys.stderr, flush=True))
    for part in (planar_text(result["planar"]), simulated_text(result["six_dof"]), real_text(result["real_arm"])):
        print(part)
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    if importlib.util.find_spec("tests.benchmarks.bench_lens"):
        print(flush=True)
        subprocess.run([sys.executable, "-m", "tests.benchmarks.bench_lens"], check=True)


def bench(cells: int, say: Say) -> dict[str, Any]:
    """All figures."""
    rows = []
    for case in CASES:
        for turn_deg in TURNS_DEG[case]:
            rows += planar(case, turn_deg, cells, say)
    return {"cells": cells, "planar": rows, "six_dof": simulated(cells, say), "real_arm": real(say)}


def planar(case: Case, turn_deg: float, cells: int, say: Say) -> list[Row]:
    """One kind of cell with one range of rotation: all methods on the same pictures."""
    view: Errors = defaultdict(list)
    held: Errors = defaultdict(list)
    moved: list[np.ndarray] = []
    known: dict[str, list[float]] = defaultdict(list)
    for seed in range(cells):
        cell, rng = true_cell(case, seed), np.random.default_rng([seed, 1])
        found_plan = planned(cell, turn_deg)
        dots = cell.see(found_plan.stops, rng)
        found = solved(cell, found_plan, dots)
        maps = {OURS: found.plane_map.mm_from_px, **peers(cell, found_plan, dots, rng)}
        stops = unseen(cell, turn_deg, rng)
        for name, to_mm in maps.items():
            view[name].append(view_um(cell, to_mm))
            held[name].append(held_out_um(cell, stops, to_mm, np.random.default_rng([seed, 2])))
        moved.append(differential_um(cell, found.plane_map, rng))
        note_squares(cell, found, known, rng)
        if seed % 20 == 19:
            say(f"{case}, R +-{turn_deg:g} deg: {seed + 1} of {cells}")
    rows = [row(case, turn_deg, name, view[name], held[name], (view[OURS], held[OURS])) for name in view]
    rows[0] |= {
        "differential_rms_um": rms(np.concatenate(moved)),
        "differential_worst_um": float(np.concatenate(moved).max()),
        "predicted_absolute_um": rms(known["absolute_um"]),
        "normalised_variance_absolute": float(np.mean(known["absolute"])),
        "normalised_variance_differential": float(np.mean(known["differential"])),
    }
    return rows


def planned(cell: Cell, turn_deg: float) -> Plan:
    """The plan that the daemon would make, within reach."""
    request = PlanRequest(margin_mm=0.5, rotation_deg=turn_deg)
    return plan_hand_eye(task(cell.setup, cell.mount, reaches=reached), request)


def reached(stop: Stop) -> bool:
    at = Point(stop.tool.x_mm, stop.tool.y_mm, 60.0, stop.tool.t_deg)
    return not LIMITS.objection(at, hand=FLAGS[stop.elbow])


def solved(cell: Cell, plan: Plan, dots: np.ndarray) -> HandEye:
    scatter = cell.mount.scatter(plan.stops, STATED.robot_sd_mm, STATED.robot_sd_deg)
    return solve_hand_eye(cell.kind, Looks(plan.poses, dots, None, scatter), BOARD.points_mm)


# -- the others --------------------------------------------------------------------------------------------------------


def peers(cell: Cell, plan: Plan, dots: np.ndarray, rng: np.random.Generator) -> dict[str, Callable[..., np.ndarray]]:
    """What the same pictures give without lens and robot error, and by OpenCV's solvers."""
    linear = linear_start(cell.kind, pose_array(plan.poses), dots, BOARD.points_mm)
    maps = {CLOSED: lambda px: np.linalg.solve(linear.matrix, (np.asarray(px) - linear.offset).T).T}
    pairs = spatial(cell, plan, dots, rng)
    for name in METHODS:
        try:
            camera = opencv_camera(name, pairs)
        except ValueError:
            camera = np.full((4, 4), np.nan)
        maps[f"OpenCV {name}"] = lambda px, camera=camera: through(camera, px)
    return maps


def spatial(cell: Cell, plan: Plan, dots: np.ndarray, rng: np.random.Generator) -> Pairs:
    """The same as poses in space: the plate's pose as a plate finder would give it, the height as drawn."""
    fits, count = grid_fits(dots, BOARD.points_mm), len(dots)
    turns = np.arctan2(fits[:, 1, 0], fits[:, 0, 0])
    places = np.column_stack([(fits[:, :, 2] - CENTRE) / PX_PER_MM, np.full(count, DISTANCE_MM)])
    places[:, 2] += rng.normal(0, DEPTH_SD_MM, count)
    flip = np.diag([1.0, -1.0, -1.0]) if cell.kind == "eye_in_hand" else np.eye(3)  # z points away from the camera
    tilts = rotation_from_vector(
        np.column_stack([rng.normal(0, math.radians(TILT_SD_DEG), (count, 2)), np.zeros(count)])
    )
    about = rotation_from_vector(np.column_stack([np.zeros((count, 2)), turns]))
    robot = rigid(
        rotation_from_vector(np.radians([[0.0, 0.0, pose.t_deg] for pose in plan.poses])),
        [[pose.x_mm, pose.y_mm, 0.0] for pose in plan.poses],
    )
    return Pairs(cell.kind, robot, rigid(tilts @ about @ flip, places), tuple(map(str, range(count))))


def through(camera: np.ndarray, px: np.ndarray) -> np.ndarray:
    """Where px lie in the carrier's plane by a camera's pose in space."""
    away = np.column_stack([(np.asarray(px) - CENTRE) / PX_PER_MM, np.full(len(px), DISTANCE_MM)])
    return (away @ camera[:3, :3].T + camera[:3, 3])[:, :2]


# -- judging -----------------------------------------------------------------------------------------------------------


def view_um(cell: Cell, to_mm: Callable[..., np.ndarray]) -> np.ndarray:
    """Errors of the map over the picture, um."""
    points = cell.axis_mm + VIEW_MM
    return np.hypot(*(to_mm(cell.camera.px_from_mm(points)) - points).T) * 1000


def unseen(cell: Cell, turn_deg: float, rng: np.random.Generator) -> list[Stop]:
    """Stops that no fit has seen, somewhere over the board, at any rotation of the range."""
    stops: list[Stop] = []
    while len(stops) < HELD_OUT:
        at = Px(*(CENTRE + rng.uniform(-300, 300, 2)).tolist())
        elbow = "lefty" if cell.case == "arm_2" and len(stops) % 2 else "righty"
        where = task(cell.setup, cell.mount)
        stop = where.stop_seeing(Mm(4.8, 3.6), at, float(rng.uniform(-turn_deg, turn_deg)), elbow)
        stops += [stop] if reached(stop) else []
    return stops


def held_out_um(
    cell: Cell, stops: Iterable[Stop], to_mm: Callable[..., np.ndarray], rng: np.random.Generator
) -> np.ndarray:
    """Where the middle dot is by picture and robot, against where it is: the robot errs at these stops as well."""
    errors = []
    for stop in stops:
        seen = to_mm(cell.see([stop], rng)[0][31:32])[0]
        if cell.kind == "eye_to_hand":  # the robot says where the held dot is, the camera sees it
            errors.append(np.subtract((stop.tool @ cell.board).point(4.8, 3.6), seen))
        else:
            place = cell.mount.frame(stop.tool, stop.elbow).point(*seen.tolist())
            errors.append(np.subtract(place, cell.board.point(4.8, 3.6)))
    return np.hypot(*np.array(errors).T) * 1000


def note_squares(cell: Cell, found: HandEye, known: dict[str, list[float]], rng: np.random.Generator) -> None:
    """Normalised squares of errors over the stated covariance: 1 on average when it is true."""
    middle = Px(*CENTRE.tolist())
    away = np.subtract(found.plane_map.mm_at(middle), cell.camera.mm_at(middle))
    known["absolute"].append(float(away @ np.linalg.solve(found.covariance_mm2(middle), away)) / 2)
    known["absolute_um"].append(found.predicted.absolute_um)
    taught = Pose(*cell.axis_mm.tolist(), 10.0)
    there = taught @ Pose(*rng.uniform(-1, 1, 2).tolist(), float(rng.uniform(-1.5, 1.5)))
    measured = [measure(cell, found, pose) for pose in (taught, there)]
    off = [np.array(true.inverse() @ seen) for true, seen in zip((taught, there), measured, strict=True)]
    error = off[1] - off[0]  # each in its own frame, as a placement has them
    spread = MapError.of("map", found.plane_map, found.covariance, taught, MARK).at(there).covariance
    spread = IN_DEG @ spread @ IN_DEG
    known["differential"].append(float(error @ np.linalg.solve(spread, error)) / 3)


def measure(cell: Cell, found: HandEye, pose: Pose) -> Pose:
    """A part's pose by the calibrated map."""
    seen = cell.camera.px_from_mm([pose.point(*point) for point in (MARK.point, *MARK.line)])
    point, start, end = found.plane_map.mm_from_px(seen)
    return Pose(float(point[0]), float(point[1]), math.degrees(math.atan2(*(end - start)[::-1])))


def rms(values: Iterable[float] | np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(np.asarray(values)))))


def row(
    case: Case,
    turn_deg: float,
    name: str,
    view: list[np.ndarray],
    held: list[np.ndarray],
    ours: tuple[list[np.ndarray], list[np.ndarray]],
) -> Row:
    failed = sum(not np.isfinite(one).all() for one in view)
    good = [(a, b) for a, b in zip(view, held, strict=True) if np.isfinite(a).all()]
    figures: Row = {"case": case, "turn_deg": turn_deg, "method": name, "failed": failed}
    if not good:
        return figures
    seen, out = (np.concatenate(part) for part in zip(*good, strict=True))
    figures |= {
        "absolute_rms_um": rms(seen),
        "absolute_worst_um": float(seen.max()),
        "held_out_rms_um": rms(out),
        "held_out_worst_um": float(out.max()),
    }
    figures["absolute_ratio"] = figures["absolute_rms_um"] / rms(np.concatenate(ours[0]))
    return figures


def planar_text(rows: list[Row]) -> str:
    """One line per method."""
    lines = [
        "Planar hand-eye, 15 poses, robot +-0.01 mm +-0.004 deg (3 sigma)",
        f"{'camera 1/2':<13}{'R':>5} {'method':<18}{'absolute rms':>13}{'worst':>11}{'held-out rms':>14}{'worst':>11}"
        f"{'ratio':>9}{'failed':>8}   um",
    ]
    for one in rows:
        start = f"{one['case']:<13}{one['turn_deg']:>5.0f} {one['method']:<18}"
        if "absolute_rms_um" not in one:
            lines.append(f"{start}{'no result':>13}{one['failed']:>66}")
            continue
        lines.append(
            f"{start}{one['absolute_rms_um']:>13.2f}{one['absolute_worst_um']:>11.1f}{one['held_out_rms_um']:>14.2f}"
            f"{one['held_out_worst_um']:>11.1f}{one['absolute_ratio']:>9.1f}{one['failed']:>8}"
        )
        if "differential_rms_um" in one:
            lines.append(
                f"{'':<19}differences {one['differential_rms_um']:.3f} rms, {one['differential_worst_um']:.2f} worst; "
                f"normalised variance {one['normalised_variance_absolute']:.2f} absolute, "
                f"{one['normalised_variance_differential']:.2f} differences"
            )
    return "\n".join(lines)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
