"""Poses from CSV text. The header says what each column is, in which unit, and from which frame to which.

    # lines that begin with # and empty lines are skipped
    time_s,robot_from_tool.x_mm,robot_from_tool.y_mm,robot_from_tool.z_mm,robot_from_tool.qx,...,camera_from_target.qw

`time_s` is needed in two files that are to be brought to one time. A pose is `robot_from_tool` or its inverse
`tool_from_robot`, `camera_from_target` or its inverse `target_from_camera`. Its place is `x_mm y_mm z_mm` or
`x_m y_m z_m`. Its rotation is one of: `qx qy qz qw`, a quaternion; `rx_deg ry_deg rz_deg` or `rx_rad ry_rad rz_rad`,
a vector along the axis, as long as the angle; `roll_deg pitch_deg yaw_deg`, about the fixed x, then y, then z;
`r_deg`, about z alone, as a SCARA reports it. Columns may come in any order.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from cellctl.calibration.errors import UnreadablePoses
from cellctl.calibration.six_dof.rigid import (
    FloatArray,
    inverse,
    rigid,
    rotation_from_quaternion,
    rotation_from_vector,
)

Frame = Literal["robot_from_tool", "camera_from_target"]

FRAMES: dict[str, tuple[Frame, bool]] = {  # column prefix: the pose it means, and whether it is inverted
    "robot_from_tool": ("robot_from_tool", False),
    "tool_from_robot": ("robot_from_tool", True),
    "camera_from_target": ("camera_from_target", False),
    "target_from_camera": ("camera_from_target", True),
}
PLACES = {("x_mm", "y_mm", "z_mm"): 1.0, ("x_m", "y_m", "z_m"): 1000.0}  # to mm
QUATERNION, ROLL, TURN = ("qx", "qy", "qz", "qw"), ("roll_deg", "pitch_deg", "yaw_deg"), ("r_deg",)
VECTORS = {("rx_deg", "ry_deg", "rz_deg"): np.pi / 180, ("rx_rad", "ry_rad", "rz_rad"): 1.0}  # to rad
ROTATIONS = (QUATERNION, *VECTORS, ROLL, TURN)
TIME = "time_s"
MOST_ROWS = 200_000
MOST_QUATERNION_ERROR = 0.01  # length against 1
FARTHEST_MM = 1e5


@dataclass(frozen=True, eq=False)
class Table:
    """What a file holds: poses (n, 4, 4) by name, the line of each, and its time if there is one."""

    name: str
    lines: tuple[int, ...]
    time_s: FloatArray | None
    poses: dict[Frame, FloatArray] = field(default_factory=dict)


def read_table(name: str, text: str) -> Table:
    """The poses in CSV text. Raises UnreadablePoses with file, line, column and remedy."""
    rows = _rows(name, text)
    if not rows:
        raise UnreadablePoses(name, "there are no rows; the first must be a header such as " + _example())
    (at, header), *body = rows
    columns = _columns(name, at, header)
    if not body:
        raise UnreadablePoses(name, "there is a header and nothing below it")
    numbers = _numbers(name, header, body)
    values = {column: numbers[:, index] for index, column in enumerate(columns)}
    lines = tuple(line for line, _ in body)
    time_s = values.pop(TIME, None)
    if time_s is not None:
        _check_times(name, lines, time_s)
    return Table(
        name, lines, time_s, {frame: _poses(name, lines, prefix, values) for frame, prefix in _given(name, values)}
    )


def _example() -> str:
    parts = [f"robot_from_tool.{part}" for part in ("x_mm", "y_mm", "z_mm", *QUATERNION)]
    return ",".join([TIME, *parts])


def _rows(name: str, text: str) -> list[tuple[int, list[str]]]:
    """Line number and fields of every row that is not a comment."""
    rows: list[tuple[int, list[str]]] = []
    reader = csv.reader(io.StringIO(text.removeprefix("\ufeff"), newline=""), skipinitialspace=True, strict=True)
    try:
        for row in reader:
            if row and any(part.strip() for part in row) and not row[0].startswith("#"):
                rows.append((reader.line_num, [part.strip() for part in row]))
            if len(rows) > MOST_ROWS:
                raise UnreadablePoses(f"{name}:{reader.line_num}", f"more than {MOST_ROWS} rows: thin them out")
    except csv.Error as error:
        raise UnreadablePoses(f"{name}:{reader.line_num}", f"this is no CSV ({error})") from None
    return rows


def _columns(name: str, line: int, header: Sequence[str]) -> Sequence[str]:
    for index, column in enumerate(header, 1):
        where = f"{name}:{line}:{index}"
        prefix, _, part = column.partition(".")
        known = part and prefix in FRAMES and any(part in parts for parts in (*PLACES, *ROTATIONS))
        if column != TIME and not known:
            raise UnreadablePoses(
                where,
                f"unknown column {column[:60]!r}: the first row must be a header such as {_example()}; see "
                "`cellctl calibrate hand-eye --help`",
            )
        if column in header[: index - 1]:
            raise UnreadablePoses(where, f"column {column} is there twice")
    return header


def _numbers(name: str, header: Sequence[str], body: Sequence[tuple[int, list[str]]]) -> FloatArray:
    numbers = np.empty((len(body), len(header)))
    for index, (line, row) in enumerate(body):
        if len(row) != len(header):
            raise UnreadablePoses(f"{name}:{line}", f"{len(row)} fields, the header has {len(header)}")
        for column, text in enumerate(row):
            numbers[index, column] = _number(f"{name}:{line}:{column + 1}", header[column], text)
    return numbers


def _number(where: str, column: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = np.nan
    if not np.isfinite(number) or (column != TIME and abs(number) > FARTHEST_MM):
        raise UnreadablePoses(where, f"{column} must be a number within +-{FARTHEST_MM:g} (got {text[:40]!r})")
    return number


def _check_times(name: str, lines: Sequence[int], time_s: FloatArray) -> None:
    back = np.flatnonzero(np.diff(time_s) <= 0)
    if len(back):
        at = int(back[0]) + 1
        raise UnreadablePoses(
            f"{name}:{lines[at]}",
            f"{TIME} must grow from row to row (got {float(time_s[at]):.6f} after {float(time_s[at - 1]):.6f})",
        )


def _given(name: str, values: dict[str, FloatArray]) -> list[tuple[Frame, str]]:
    """The poses of the file, each with its columns' prefix."""
    used = {column.partition(".")[0] for column in values}
    for prefix, other in (("robot_from_tool", "tool_from_robot"), ("camera_from_target", "target_from_camera")):
        if {prefix, other} <= used:
            raise UnreadablePoses(name, f"{prefix} and {other} are the same pose: give one of them")
    return [(frame, prefix) for prefix, (frame, _) in FRAMES.items() if prefix in used]


def _poses(name: str, lines: Sequence[int], prefix: str, values: dict[str, FloatArray]) -> FloatArray:
    """(n, 4, 4) out of the columns with this prefix."""
    parts = {column.partition(".")[2]: value for column, value in values.items() if column.startswith(f"{prefix}.")}
    place = next((wanted for wanted in PLACES if set(wanted) <= set(parts)), None)
    turn = next((wanted for wanted in ROTATIONS if set(wanted) <= set(parts)), None)
    if place is None or turn is None or set(parts) != {*place, *turn}:
        raise UnreadablePoses(
            name,
            f"{prefix} must have three columns for its place (x_mm y_mm z_mm, or _m) and those of one rotation "
            f"({'; '.join(' '.join(names) for names in ROTATIONS)}); it has {' '.join(parts)}",
        )
    places_mm = np.stack([parts[axis] for axis in place], -1) * PLACES[place]
    poses = rigid(_rotations(name, lines, turn, np.stack([parts[axis] for axis in turn], -1)), places_mm)
    return inverse(poses) if FRAMES[prefix][1] else poses


def _rotations(name: str, lines: Sequence[int], kind: tuple[str, ...], values: FloatArray) -> FloatArray:
    if kind == QUATERNION:
        return _from_quaternions(name, lines, values)
    if kind in VECTORS:
        return rotation_from_vector(values * VECTORS[kind])
    angles = np.radians(values)
    if kind == TURN:
        return rotation_from_vector(angles * np.array([0.0, 0.0, 1.0]))
    about_x, about_y, about_z = (rotation_from_vector(angles[:, i, None] * np.eye(3)[i]) for i in range(3))
    return np.asarray(about_z @ about_y @ about_x, np.float64)


def _from_quaternions(name: str, lines: Sequence[int], values: FloatArray) -> FloatArray:
    lengths = np.linalg.norm(values, axis=1)
    odd = np.flatnonzero(np.abs(lengths - 1) > MOST_QUATERNION_ERROR)
    if len(odd):
        at = int(odd[0])
        raise UnreadablePoses(
            f"{name}:{lines[at]}", f"a rotation's quaternion must be of length 1 (got {float(lengths[at]):.4g})"
        )
    return rotation_from_quaternion(values)
