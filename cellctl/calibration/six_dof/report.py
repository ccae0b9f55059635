"""A hand-eye result in six degrees of freedom as text for people and as a table for a file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cellctl.calibration.six_dof.adjust import Sigmas
from cellctl.calibration.six_dof.freedom import Turns, direction_text
from cellctl.calibration.six_dof.pairs import CARRIER
from cellctl.calibration.six_dof.peers import OURS, Judged
from cellctl.calibration.six_dof.rigid import FloatArray, quaternion_from_rotation, vector_from_rotation
from cellctl.calibration.six_dof.solve import RobotCamera

NAMED = 8  # sightings left out that are named; of more the number is said
HELD = {"eye_in_hand": "robot", "eye_to_hand": "tool"}  # what the target is fixed to
MOUNT = {"eye_in_hand": "eye in hand", "eye_to_hand": "eye to hand"}


def as_dict(result: RobotCamera, robot_ahead_s: float | None = None) -> dict[str, Any]:
    """All figures; units are in the keys."""
    carrier, held = CARRIER[result.kind], HELD[result.kind]
    return {
        "kind": result.kind,
        f"{carrier}_from_camera": pose_dict(result.camera),
        f"{held}_from_target": pose_dict(result.target),
        "sd_mm": _sd_mm(result).tolist(),
        "sd_deg": _sd_deg(result).tolist(),
        "covariance": result.covariance.tolist(),
        "covariance_of": [f"{axis}_mm" for axis in "xyz"] + [f"turn_{axis}_rad" for axis in "xyz"],
        "poses": len(result.pairs) + len(result.left_out),
        "used": len(result.pairs),
        "left_out": list(result.left_out),
        "rotation_spread_deg": list(result.turns.spread_deg),
        "noise": result.sigmas._asdict(),
        "residual": result.residual._asdict(),
        "hold_out": result.hold_out._asdict(),
        "robot_ahead_s": robot_ahead_s,
        "robot_ahead_sd_s": result.late_sd_s,
        "given_along_axis_mm": result.known.place_mm if result.known else None,
    }


def pose_dict(motion: FloatArray) -> dict[str, list[float]]:
    """A pose as place, quaternion and rotation vector."""
    return {
        "place_mm": motion[:3, 3].tolist(),
        "quaternion_xyzw": quaternion_from_rotation(motion[:3, :3]).tolist(),
        "turn_deg": np.degrees(vector_from_rotation(motion[:3, :3])).tolist(),
    }


def report_text(result: RobotCamera, robot_ahead_s: float | None = None) -> str:
    """The quality report, one figure per line."""
    carrier, held = CARRIER[result.kind], HELD[result.kind]
    total = len(result.pairs) + len(result.left_out)
    rows = [
        ("mount", f"{MOUNT[result.kind]}: the camera stands still in the {carrier} frame"),
        ("poses", f"{total}, {len(result.pairs)} used"),
        *_left_out(result.left_out),
        ("rotation", turns_text(result.turns)),
        *_delay(result, robot_ahead_s),
        (f"{carrier}_from_camera", _pose_text(result.camera)),
        ("  one sigma", _sd_text(result)),
        (f"{held}_from_target", _pose_text(result.target)),
        ("noise found", _noise_text(result.sigmas)),
        ("residual", f"{result.residual.place_mm:.3g} mm, {result.residual.turn_deg:.3g} deg rms"),
        ("hold-out", f"{result.hold_out.place_mm:.3g} mm, {result.hold_out.turn_deg:.3g} deg rms at poses left out of "
                     "the fit"),
        *_note(result),
    ]  # fmt: skip
    return "\n".join(f"{name:<19}{text}" for name, text in rows)


def turns_text(turns: Turns) -> str:
    """How far the arm turns, and about what."""
    first, second, third = turns.spread_deg
    return f"{first:.1f} deg about {turns.axis}, {second:.1f} and {third:.1f} deg across it"


def compare_text(judged: Sequence[Judged]) -> str:
    """Errors at poses left out: ours, and how many times larger OpenCV's are."""
    ours = next(one.hold_out for one in judged if one.name == OURS)
    lines = [f"{'at poses left out':<19}{'mm rms':>10}{'deg rms':>10}{'mm ratio':>10}"]
    for one in judged:
        if one.hold_out is None or ours is None:
            lines.append(f"{one.name:<19}no result: {one.why_not}")
            continue
        ratio = one.hold_out.place_mm / ours.place_mm if ours.place_mm > 0 else math.nan
        lines.append(f"{one.name:<19}{one.hold_out.place_mm:>10.4g}{one.hold_out.turn_deg:>10.4g}{ratio:>10.2f}")
    return "\n".join(lines)


def compare_dicts(judged: Sequence[Judged]) -> list[dict[str, Any]]:
    """The same for a file."""
    return [
        {"name": one.name, "why_not": one.why_not, **(one.hold_out._asdict() if one.hold_out else {})} for one in judged
    ]


def plan_text(count: int, turns: Turns, noise: FloatArray) -> str:
    """What poses without pictures can tell."""
    along = [direction_text(direction, turns.carrier) for direction in turns.directions]
    each = "; ".join(f"{factor:.2f} mm along {name}" for factor, name in zip(noise.tolist(), along, strict=True))
    return (
        f"{count} poses: they turn {turns_text(turns)}\n"
        f"they will do; 1 mm of noise in every sighting becomes, in the camera's place, {each}"
    )


def plan_dict(count: int, turns: Turns, noise: FloatArray) -> dict[str, Any]:
    """The same for programs."""
    return {
        "ok": True,
        "poses": count,
        "rotation_spread_deg": list(turns.spread_deg),
        "directions": turns.directions.tolist(),
        "directions_frame": turns.carrier,
        "place_mm_per_mm_of_noise": noise.tolist(),
    }


def _pose_text(motion: FloatArray) -> str:
    x, y, z = motion[:3, 3].tolist()
    rx, ry, rz = np.degrees(vector_from_rotation(motion[:3, :3])).tolist()
    return f"x {x:+.3f} y {y:+.3f} z {z:+.3f} mm, turned by ({rx:+.4f}, {ry:+.4f}, {rz:+.4f}) deg"


def _noise_text(noise: Sigmas) -> str:
    place = f"{noise.lateral_mm:.3g} mm across the view, {noise.depth_mm:.3g} mm in depth"
    return f"{place}, {noise.roll_deg:.3g} deg of roll, {noise.tilt_deg:.3g} deg of tilt (one sigma of a sighting)"


def _sd_mm(result: RobotCamera) -> FloatArray:
    return np.asarray(np.sqrt(np.diag(result.covariance)[:3]), np.float64)


def _sd_deg(result: RobotCamera) -> FloatArray:
    return np.asarray(np.degrees(np.sqrt(np.diag(result.covariance)[3:])), np.float64)


def _sd_text(result: RobotCamera) -> str:
    x, y, z = _sd_mm(result).tolist()
    rx, ry, rz = _sd_deg(result).tolist()
    return f"x  {x:.3f} y  {y:.3f} z  {z:.3f} mm,           ( {rx:.4f},  {ry:.4f},  {rz:.4f}) deg"


def _left_out(names: Sequence[str]) -> list[tuple[str, str]]:
    if not names:
        return []
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return [("left out as wrong", f"{len(names)}: {', '.join(names[:NAMED])}{more}")]


def _delay(result: RobotCamera, robot_ahead_s: float | None) -> list[tuple[str, str]]:
    if robot_ahead_s is None:
        return []
    sd = "" if result.late_sd_s is None else f" +- {result.late_sd_s * 1000:.2f}"
    return [("time", f"the robot's clock is {robot_ahead_s * 1000:+.2f}{sd} ms ahead of the camera's")]


def _note(result: RobotCamera) -> list[tuple[str, str]]:
    if result.known is None:
        return []
    axis = direction_text(result.known.direction, CARRIER[result.kind])
    return [
        ("note", f"the place along {axis} is the {result.known.place_mm:g} mm that were given, it was not measured")
    ]
