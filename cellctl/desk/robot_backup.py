"""What a robot's controller keeps, as a file: points, hands, shifts, pallets, variables, programs, parameters.

The lines are the controller's own, so a file is exact and can be read, compared and mended by people.
"""

import json
from collections import Counter
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Literal

import click
from pydantic import Field, ValidationError

from cellctl.desk.commands import run_loop
from cellctl.desk.robot_link import AtDesk, Which, at_desk
from cellctl.learnt.references import now, write_whole
from cellctl.strict_toml import LARGEST_FILE, Contradiction, Settings
from drivers.errors import Refused
from drivers.rcx_points import StoredPoint, parse_points

KINDS = {"points": "PNT", "hands": "HND", "shifts": "SFT", "pallets": "PLT", "variables": "VAR", "parameters": "PRM"}
PARAMETERS = "parameters"  # can be read, but only a person can set them

Entries = dict[tuple[str, str], str]  # kind and name -> value


class ControllerIdentity(Settings):
    """Whose memory it is."""

    dialect: Literal["rcx3", "rcx2"] = Field(description="Generation: rcx3 = RCX340/320, rcx2 = RCX240/14x/22x")
    version: str = Field(description="What the controller answers to ?VER")
    configuration: str = Field(description="What the controller answers to ?CONFIG")
    serial: str = Field(description="Serial number of the robot by cell.toml; empty when no cell named it")


class Backup(Settings):
    """The file."""

    schema_version: Literal[1] = Field(description="Version of this file's layout: 1")
    made_at: str = Field(description="When it was read, UTC")
    controller: ControllerIdentity
    points: list[str] = Field(description="P1=... lines")
    hands: list[str] = Field(description="H1=... lines")
    shifts: list[str] = Field(description="S1=... lines")
    pallets: list[str] = Field(description="PL(0)=... lines")
    variables: list[str] = Field(description="NAME=value lines")
    parameters: list[str] = Field(description="NAME=value lines; for comparing only")
    programs: dict[str, list[str]] = Field(description="Lines by name of the program")

    def contradictions(self) -> Iterator[Contradiction]:
        """Points are points, and none is said twice; of other lines only the controller knows what they should be."""
        try:
            datetime.fromisoformat(self.made_at)
        except ValueError:
            yield "made_at", "must be a date and time such as 2026-11-22T10:00:00+00:00"
        try:
            names = Counter(entry_of("points", line)[0] for line in self.points)
        except ValueError as error:
            yield "points", str(error)
            return
        if twice := [name for name, count in names.items() if count > 1]:
            yield "points", f"says {twice[0]} twice"

    @property
    def entries(self) -> Entries:
        """Everything by kind and name, however it was written, so that two backups can be compared."""
        named: Entries = {}
        for kind in KINDS:
            for line in getattr(self, kind):
                name, value = entry_of(kind, line)
                named[kind, name] = f"{named.get((kind, name), '')} {value}".strip()
        return named | {("programs", name): "\n".join(lines) for name, lines in self.programs.items()}


def backup(which: Which, path: Path, *, force: bool, as_json: bool) -> int:
    """Read everything and write the file, whole or not at all. Raises ClickException, SettingsError, DeviceError."""
    if path.exists() and not force:
        raise click.ClickException(f"{path} exists: choose another name, or --force to replace it")
    read = run_loop(read_memory(which))
    data = text_of(read).encode()
    if len(data) > LARGEST_FILE:
        raise click.ClickException(f"{path} would have {len(data)} bytes, such files have at most {LARGEST_FILE}")
    try:
        write_whole(path, data)
    except OSError as error:
        raise click.ClickException(f"{path}: {error.strerror}") from error
    counts = {kind: len(getattr(read, kind)) for kind in (*KINDS, "programs")}
    if as_json:
        click.echo(json.dumps({"file": str(path), **counts}))
    else:
        click.echo(f"{path}: " + ", ".join(f"{count} {kind}" for kind, count in counts.items()))
    return 0


async def read_memory(which: Which) -> Backup:
    """What a controller keeps. Raises ClickException, SettingsError, DeviceError."""
    async with at_desk(which) as desk:
        return await read_all(desk)


async def read_all(desk: AtDesk) -> Backup:
    """What the controller keeps now. Raises ClickException, DeviceError."""
    robot = desk.robot
    identity = await robot.identity()
    lines = {kind: await _file(desk, name) for kind, name in KINDS.items()}
    programs = {name: await robot.programs.read(name) for name in await robot.programs.names()}
    told = {
        "schema_version": 1,
        "made_at": now().isoformat(timespec="seconds"),
        "controller": {
            "dialect": robot.dialect.name,
            "version": identity.version,
            "configuration": identity.configuration,
            "serial": desk.serial,
        },
        **lines,
        "programs": programs,
    }
    try:
        return Backup.model_validate(told)
    except ValidationError as error:
        said = error.errors(include_url=False)[0]["msg"]
        raise click.ClickException(f"the controller tells what no backup can hold: {said}") from error


def text_of(backup: Backup) -> str:
    """The file's text: TOML, one line of the controller on each line."""
    head = [f"schema_version = {backup.schema_version}", f"made_at = {_quoted(backup.made_at)}"]
    lists = [line for kind in KINDS for line in _list(kind, getattr(backup, kind))]
    identity = [f"{key} = {_quoted(value)}" for key, value in backup.controller.model_dump().items()]
    programs = [line for name, lines in backup.programs.items() for line in _list(name, lines)]
    return "\n".join([*head, *lists, "", "[controller]", *identity, "", "[programs]", *programs, ""])


async def _file(desk: AtDesk, name: str) -> list[str]:
    """The lines of a file; none when this controller does not have it."""
    try:
        return [line.strip() for line in await desk.robot.files.read(name)]
    except Refused:
        return []


def entry_of(kind: str, line: str) -> tuple[str, str]:
    """What a line is about and what it says, however it was written."""
    if kind == "points":
        ((number, point),) = parse_points([line]).items()
        return f"P{number}", _shown(point)
    name, _, value = line.partition("=")
    return "".join(name.split()), " ".join(value.split())


def _shown(point: StoredPoint) -> str:
    numbers = (f"{value:.0f}" if point.in_pulses else f"{value:.3f}" for value in point.values)
    return " ".join([*numbers, *map(str, (point.hand, *point.turns))])


def _list(key: str, lines: list[str]) -> list[str]:
    return ["", f"{key} = [", *(f"    {_quoted(line)}," for line in lines), "]"]


def _quoted(text: str) -> str:
    """As JSON writes it; of texts TOML allows no raw delete character."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
