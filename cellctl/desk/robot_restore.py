"""A backup against the controller: what differs, and putting it back."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import click

from cellctl.desk.commands import run_loop
from cellctl.desk.robot_backup import KINDS, PARAMETERS, Backup, entry_of, read_all, read_memory
from cellctl.desk.robot_link import Which, at_desk
from cellctl.strict_toml import load
from drivers.rcx_points import parse_points
from drivers.robot import Robot

MISSING = "-"
WIDEST = 60


class Difference(NamedTuple):
    """One entry that is not the same; None where there is none."""

    kind: str
    name: str
    in_file: str | None
    in_controller: str | None

    @property
    def restorable(self) -> bool:
        """Whether putting the file back changes it: nothing is deleted, and parameters are a person's."""
        return self.in_file is not None and self.kind != PARAMETERS


def diff(which: Which, path: Path, *, as_json: bool) -> int:
    """Print what differs; 0 when nothing does. Raises ClickException, SettingsError, DeviceError."""
    wanted = load(path, Backup)
    found = differences(wanted, run_loop(read_memory(which)))
    if as_json:
        click.echo(json.dumps({"same": not found, "differences": [entry._asdict() for entry in found]}))
    else:
        click.echo(_table(found) if found else f"the controller keeps what {path} says, of {wanted.made_at}")
    return 1 if found else 0


def restore(which: Which, path: Path, *, sure: bool, other: bool, as_json: bool) -> int:
    """Show what differs, ask, write it, read everything again; 0 when the controller then keeps what the file says.

    Entries that only the controller has are left alone. Raises ClickException, SettingsError, DeviceError.
    """
    if as_json and not sure:
        raise click.ClickException("--json asks nothing, so say --yes as well")
    wanted = load(path, Backup)
    there = run_loop(read_memory(which))
    check_identity(wanted, there, path, other=other)
    changes = [entry for entry in differences(wanted, there) if entry.restorable]
    if changes and not sure:
        click.echo(_table(changes))
        click.confirm(f"write these {len(changes)} entries of {path} into the controller?", abort=True)
    if changes:
        there = run_loop(_written(which, wanted, changes))
    return _end(path, changes, differences(wanted, there), as_json=as_json)


def differences(wanted: Backup, there: Backup) -> list[Difference]:
    """Entry by entry, in the order of the kinds."""
    file, controller = wanted.entries, there.entries
    order = [*KINDS, "programs"]
    names = sorted({*file, *controller}, key=lambda name: (order.index(name[0]), len(name[1]), name[1]))
    return [
        Difference(*name, file.get(name), controller.get(name))
        for name in names
        if file.get(name) != controller.get(name)
    ]


def check_identity(wanted: Backup, there: Backup, path: Path, *, other: bool) -> None:
    """Raises ClickException for a file of another controller, unless that is wanted."""
    mine, its = there.controller, wanted.controller
    if its.dialect != mine.dialect:
        raise click.ClickException(f"{path} is of an {its.dialect} controller, this is an {mine.dialect}: not restored")
    foreign = [
        f"{what} {file!r} against {controller!r}"
        for what, file, controller in (
            ("serial", its.serial, mine.serial),
            ("configuration", its.configuration, mine.configuration),
        )
        if file != controller
    ]
    if foreign and not other:
        raise click.ClickException(
            f"{path} is of another controller ({', '.join(foreign)}): say --other if that is meant"
        )


async def _written(which: Which, wanted: Backup, changes: Sequence[Difference]) -> Backup:
    """What the controller keeps after the changed entries, and only these, were written."""
    async with at_desk(which) as desk:
        try:
            await _write(desk.robot, wanted, {(entry.kind, entry.name) for entry in changes})
        except ValueError as error:
            done = "what came before it is written, see `cellctl robot diff`"
            raise click.ClickException(f"{error}: not written; {done}") from error
        return await read_all(desk)


async def _write(robot: Robot, wanted: Backup, changed: set[tuple[str, str]]) -> None:
    for kind, name in KINDS.items():
        lines = [line for line in getattr(wanted, kind) if (kind, entry_of(kind, line)[0]) in changed]
        if lines and kind == "points":
            await robot.points.write_all(parse_points(lines))
        elif lines:
            await robot.files.write(name, lines)
    for program, lines in wanted.programs.items():
        if ("programs", program) in changed:
            await robot.programs.write(program, lines)


def _end(path: Path, changes: Sequence[Difference], left: Sequence[Difference], *, as_json: bool) -> int:
    failed = [entry for entry in left if entry.restorable]
    kept = [entry for entry in left if not entry.restorable]
    if as_json:
        keys = {"written": changes, "failed": failed, "left": kept}
        click.echo(json.dumps({key: [entry._asdict() for entry in entries] for key, entries in keys.items()}))
        return 1 if failed else 0
    if failed:
        click.echo(f"written, but these read back otherwise:\n{_table(failed)}")
    else:
        click.echo(f"{len(changes)} entries of {path} written and read back" if changes else "nothing to write")
    if kept:
        click.echo(f"left as they are (a person sets parameters, and nothing is deleted):\n{_table(kept)}")
    return 1 if failed else 0


def _table(entries: Sequence[Difference]) -> str:
    rows = [
        ("", "", "file", "controller"),
        *((e.kind, e.name, _shown(e.in_file), _shown(e.in_controller)) for e in entries),
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    return "\n".join(
        "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[3]]).rstrip()
        for row in rows
    )


def _shown(value: str | None) -> str:
    if value is None:
        return MISSING
    first, *more = value.split("\n")
    text = f"{first} ... ({len(more) + 1} lines)" if more else first
    return text if len(text) <= WIDEST else f"{text[: WIDEST - 3]}..."
