"""`cellctl calibrate hand-eye`: where a camera is on, or beside, any robot, out of files of poses."""

import json
from pathlib import Path
from typing import Any, NamedTuple

import click

from cellctl.calibration.errors import CalibrationError, UnreadablePoses
from cellctl.calibration.six_dof.align import Stream, estimate_delay, pairs_in_one, pairs_in_time, streams
from cellctl.calibration.six_dof.freedom import amplification, check_freedom
from cellctl.calibration.six_dof.pairs import Kind, Pairs
from cellctl.calibration.six_dof.peers import compare
from cellctl.calibration.six_dof.report import as_dict, compare_dicts, compare_text, plan_dict, plan_text, report_text
from cellctl.calibration.six_dof.rigid import FloatArray
from cellctl.calibration.six_dof.solve import RobotCamera, solve
from cellctl.calibration.six_dof.table import Table, read_table
from cellctl.desk.commands import OK
from cellctl.learnt.references import write_whole

REFUSED = 1
MOST_BYTES = 100_000_000


class HandEyeOrder(NamedTuple):
    """What the command line asks for."""

    files: tuple[Path, ...]
    kind: Kind
    robot_ahead_ms: float | None
    along_axis_mm: float | None
    plan: bool
    compare: bool
    out: Path | None
    as_json: bool


class Solved(NamedTuple):
    """A result, and the delay between two streams."""

    result: RobotCamera
    robot_ahead_s: float | None


def calibrate_poses(order: HandEyeOrder) -> int:
    """Read, align, solve, report; the exit code, 1 with a sentence for what cannot be solved."""
    try:
        tables = [_read(path) for path in order.files]
        return _planned(order, tables[0]) if order.plan else _told(order, _solved(order, tables))
    except CalibrationError as error:
        if order.as_json:
            click.echo(json.dumps({"ok": False, "check": error.check, "detail": error.detail}))
        else:
            click.echo(str(error), err=True)
        return REFUSED


def _read(path: Path) -> Table:
    try:
        if path.stat().st_size > MOST_BYTES:
            raise UnreadablePoses(str(path), f"larger than {MOST_BYTES // 1_000_000} MB: thin it out")
        return read_table(str(path), path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise UnreadablePoses(str(path), f"cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError:
        raise UnreadablePoses(str(path), "is not a text file") from None


def _planned(order: HandEyeOrder, table: Table) -> int:
    """What the robot's poses alone can tell, before any picture."""
    if "robot_from_tool" not in table.poses:
        raise UnreadablePoses(table.name, "a plan needs the columns robot_from_tool.* (or its inverse)")
    robot: FloatArray = table.poses["robot_from_tool"]
    turns = check_freedom(order.kind, robot, along_axis_known=order.along_axis_mm is not None)
    noise = amplification(order.kind, robot)
    click.echo(
        json.dumps(plan_dict(len(robot), turns, noise)) if order.as_json else plan_text(len(robot), turns, noise)
    )
    return OK


def _solved(order: HandEyeOrder, tables: list[Table]) -> Solved:
    if len(tables) == 1:
        return Solved(solve(pairs_in_one(order.kind, tables[0]), order.along_axis_mm), None)
    robot, camera = streams(*tables)
    target = next(table for table in tables if "camera_from_target" in table.poses)
    if order.robot_ahead_ms is not None:
        ahead_s = order.robot_ahead_ms / 1000
        pairs = pairs_in_time(order.kind, robot, target, ahead_s)
        return Solved(solve(_without_swing(pairs), order.along_axis_mm), ahead_s)
    return _at_its_time(order, robot, camera, target)


def _at_its_time(order: HandEyeOrder, robot: Stream, camera: Stream, target: Table) -> Solved:
    """The delay from the turning, then as part of the solution; poses are taken at the time that this gives."""
    ahead_s = estimate_delay(robot, camera).robot_ahead_s
    first = solve(pairs_in_time(order.kind, robot, target, ahead_s), order.along_axis_mm)
    ahead_s += first.late_s or 0.0
    result = solve(pairs_in_time(order.kind, robot, target, ahead_s), order.along_axis_mm)
    return Solved(result, ahead_s + (result.late_s or 0.0))


def _without_swing(pairs: Pairs) -> Pairs:
    """The same with a delay that is given and not looked for."""
    return Pairs(pairs.kind, pairs.robot, pairs.target, pairs.names)


def _told(order: HandEyeOrder, solved: Solved) -> int:
    result, ahead_s = solved
    found: dict[str, Any] = {"ok": True, **as_dict(result, ahead_s)}
    judged = compare(result.pairs, result.sigmas, result.known) if order.compare else []
    if judged:
        found["compared"] = compare_dicts(judged)
    if order.out is not None:
        write_whole(order.out, (json.dumps(found, indent=1) + "\n").encode())
    if order.as_json:
        click.echo(json.dumps(found))
        return OK
    click.echo(report_text(result, ahead_s))
    if judged:
        click.echo(f"\n{compare_text(judged)}")
    if order.out is not None:
        click.echo(f"\nwritten to {order.out}")
    return OK
