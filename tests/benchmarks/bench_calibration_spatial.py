"""Six degrees of freedom: ours beside OpenCV's five methods, against truth and on a real arm's recording."""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cellctl.calibration.six_dof.align import estimate_delay, pairs_in_time, streams
from cellctl.calibration.six_dof.peers import METHODS, OURS, compare, opencv_camera
from cellctl.calibration.six_dof.rigid import FloatArray, vector_from_rotation
from cellctl.calibration.six_dof.solve import solve
from cellctl.calibration.six_dof.table import read_table
from tests.arm_poses import REAL, looks, real_tables

KINDS = ("eye_in_hand", "eye_to_hand")
Row = dict[str, Any]
Say = Callable[[str], None]


def simulated(runs: int, say: Say) -> list[Row]:
    """Errors of the camera's pose against truth: 15 poses, +-20 deg of tilt, robot 3.3 um and 1.7 mdeg."""
    rows = []
    for kind in KINDS:
        errors: dict[str, list[FloatArray]] = {name: [] for name in (OURS, *METHODS)}
        squares = []
        for seed in range(runs):
            camera, _, pairs = looks(np.random.default_rng(seed), kind)  # type: ignore[arg-type]
            found = solve(pairs)
            away = _away(found.camera, camera)
            squares.append(float(away @ np.linalg.solve(found.covariance, away)) / 6)
            errors[OURS].append(away)
            for name in METHODS:
                errors[name].append(_away(opencv_camera(name, pairs), camera))
            if seed % 25 == 24:
                say(f"six dof, {kind}: {seed + 1} of {runs}")
        rows += [_row(kind, name, np.array(away), np.array(errors[OURS])) for name, away in errors.items()]
        rows[-len(errors)]["normalised_variance"] = float(np.mean(squares))
    return rows


def _away(found: FloatArray, true: FloatArray) -> FloatArray:
    return np.concatenate([found[:3, 3] - true[:3, 3], vector_from_rotation(found[:3, :3] @ true[:3, :3].T)])


def _row(kind: str, name: str, away: FloatArray, ours: FloatArray) -> Row:
    place_um, turn_mdeg = _sizes(away)
    best_um, best_mdeg = _sizes(ours)
    return {
        "kind": kind,
        "method": name,
        "place_median_um": float(np.median(place_um)),
        "place_worst_um": float(place_um.max()),
        "turn_median_mdeg": float(np.median(turn_mdeg)),
        "turn_worst_mdeg": float(turn_mdeg.max()),
        "place_ratio": float(np.median(place_um) / np.median(best_um)),
        "turn_ratio": float(np.median(turn_mdeg) / np.median(best_mdeg)),
    }


def _sizes(away: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.linalg.norm(away[:, :3], axis=1) * 1000, np.degrees(np.linalg.norm(away[:, 3:], axis=1)) * 1000


def real(say: Say) -> Row | None:
    """The recording of a real arm: aligned in time, wrong sightings left out, judged at sightings no fit has seen."""
    if not REAL.exists():
        say(f"no recording of a real arm here ({REAL.name})")
        return None
    with tempfile.TemporaryDirectory() as folder:
        tables = [read_table(path.name, path.read_text(encoding="utf-8")) for path in real_tables(Path(folder))]
    robot, camera = streams(*tables)
    delay = estimate_delay(robot, camera)
    ahead_s = delay.robot_ahead_s
    for _ in range(2):
        found = solve(pairs_in_time("eye_in_hand", robot, tables[1], ahead_s))
        ahead_s += found.late_s or 0.0
    say("real arm: solved, now the five methods")
    judged = compare(found.pairs, found.sigmas)
    return {
        "sightings": len(found.pairs) + len(found.left_out),
        "left_out": len(found.left_out),
        "robot_ahead_ms": ahead_s * 1000,
        "place_sd_mm": np.sqrt(np.diag(found.covariance)[:3]).tolist(),
        "hold_out_all_mm": found.hold_out.place_mm,
        "hold_out_all_deg": found.hold_out.turn_deg,
        "methods": [
            {"method": one.name, "why_not": one.why_not, **(one.hold_out._asdict() if one.hold_out else {})}
            for one in judged
        ],
    }


def simulated_text(rows: list[Row]) -> str:
    """One line per method; ratios of the medians to ours."""
    lines = [
        "\nSix degrees of freedom, 15 poses: place um median/worst (ratio), turn mdeg median/worst (ratio)",
        *(
            f"{row['kind']:<12}{row['method']:<11}{row['place_median_um']:9.1f} /{row['place_worst_um']:9.1f}"
            f" ({row['place_ratio']:5.2f}) {row['turn_median_mdeg']:9.1f} /{row['turn_worst_mdeg']:9.1f}"
            f" ({row['turn_ratio']:5.2f})"
            + (f"   normalised variance {row['normalised_variance']:.2f}" if "normalised_variance" in row else "")
            for row in rows
        ),
    ]
    return "\n".join(lines)


def real_text(row: Row | None) -> str:
    """The real arm; every method fitted to four fifths of 100 sightings and judged at the last fifth."""
    if row is None:
        return ""
    ours = row["methods"][0]["place_mm"]
    lines = [
        f"\nA real arm: {row['sightings']} sightings, {row['left_out']} left out as wrong, robot's clock "
        f"{row['robot_ahead_ms']:+.1f} ms ahead; all used: hold-out {row['hold_out_all_mm']:.2f} mm, "
        f"{row['hold_out_all_deg']:.3f} deg",
    ]
    for one in row["methods"]:
        if "place_mm" not in one:
            lines.append(f"{one['method']:<12} no result: {one['why_not']}")
            continue
        ratio = one["place_mm"] / ours
        lines.append(
            f"{one['method']:<12} hold-out {one['place_mm']:8.3f} mm ({ratio:5.2f}) {one['turn_deg']:8.4f} deg"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    print(simulated_text(simulated(20, lambda text: print(text, file=sys.stderr))))
