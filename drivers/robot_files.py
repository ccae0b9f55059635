"""The controller's memory as files of text lines, its point table, and its programs."""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from drivers.controller import Controller
from drivers.errors import Mismatch, Refused
from drivers.rcx import LONGEST_COMMAND, Pulses, parse_byte
from drivers.rcx_points import StoredPoint, parse_points, point_line

READABLE = ("PGM", "PNT", "HND", "SFT", "PLT", "VAR", "PRM", "DIR", "LOG", "MEM")
WRITABLE = ("PGM", "PNT", "HND", "SFT", "PLT", "VAR")
PROGRAM_NAME = re.compile(r"[A-Z0-9_]{1,32}", re.ASCII)
TASK = re.compile(r"(\S+?)\s*,\s*(\d+)\s*,\s*([RSUW])\s*,\s*(-?\d+)", re.ASCII)
NO_POINT = {"6.204", "6.4"}  # codes, newer and older
STATE_PORT, RUNNING_BIT = "DO1()", 3


class TaskState(NamedTuple):
    """What a task does: R runs, S stopped, U suspended, W waits."""

    program: str
    line: int
    state: str
    priority: int


class Files:
    """READ and WRITE. All raise Refused, NoAnswer, LinkLost, Garbled; ValueError for what cannot be asked."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    async def read(self, name: str) -> list[str]:
        """The lines of PNT, HND, SFT, PLT, VAR, PRM, DIR, LOG, MEM or PGM (all programs)."""
        return await self._controller.fetch(_one_of(name, READABLE))

    async def write(self, name: str, lines: Sequence[str]) -> None:
        """Lines as `read` gives them; entries that they do not name are left as they are."""
        _check_lines(lines)
        await self._controller.store(_one_of(name, WRITABLE), lines)


class Points:
    """The point table. All raise Refused, NoAnswer, LinkLost, Garbled; ValueError for a point that there cannot be."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    async def all(self) -> dict[int, StoredPoint]:
        """Every point that is defined, by number."""
        return self._parsed("READ PNT", await self._controller.fetch("PNT"))

    async def one(self, number: int) -> StoredPoint | None:
        """One point; None when it is not defined."""
        dialect, talk = self._controller.dialect, self._controller.talk
        if not 0 <= number <= dialect.highest_point:
            raise ValueError(f"P{number} is outside P0 .. P{dialect.highest_point}")
        line = dialect.read_point(number)
        try:
            if not line.startswith("@READ"):
                answer = await talk.ask(line)
                return self._parsed(line, [f"P{number}={text}" for text in answer]).get(number)
            async with self._controller.turn:
                return self._parsed(line, await talk.fetch(line)).get(number)
        except Refused as refused:
            if refused.code in NO_POINT:
                return None
            raise

    async def write(self, number: int, point: StoredPoint) -> None:
        """Define one point; raises Mismatch when it reads back otherwise."""
        dialect = self._controller.dialect
        await self._controller.set(point_line(number, point, dialect))
        if (now := await self.one(number)) is None or not _same(now, point, dialect.decimals):
            raise Mismatch(self._controller.device, f"P{number} was written and reads back as {now}")

    async def write_all(self, points: Mapping[int, StoredPoint]) -> None:
        """Define these points, all of them or none; others are left as they are."""
        lines = [point_line(number, point, self._controller.dialect) for number, point in sorted(points.items())]
        await self._controller.store("PNT", lines)

    async def here(self) -> Pulses:
        """The axes in pulses, as a point taught here would have them."""
        return await self._controller.pulses()

    def _parsed(self, asked: str, lines: Sequence[str]) -> dict[int, StoredPoint]:
        try:
            return parse_points(lines)
        except ValueError as error:
            raise self._controller.talk.garbled(asked, [str(error)]) from error


class Programs:
    """Robot programs. All raise Refused, NoAnswer, LinkLost, Garbled; ValueError for a name that none can have."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    async def names(self) -> list[str]:
        """Of the programs that are stored."""
        lines = await self._controller.fetch("DIR")
        names = [line.split(",")[1].strip() for line in lines if line.count(",") >= 1]
        return [name for name in names if PROGRAM_NAME.fullmatch(name)]

    async def read(self, name: str) -> list[str]:
        """The lines of a program; the first is its NAME."""
        return await self._controller.fetch(f"<{_program(name)}>")

    async def write(self, name: str, lines: Sequence[str]) -> None:
        """Store a program in the place of one of the same name; NAME= is put before the lines when they lack it."""
        _check_lines(lines)
        head = [] if lines and lines[0].replace(" ", "").upper().startswith("NAME=") else [f"NAME={_program(name)}"]
        await self._controller.store(f"<{_program(name)}>", [*head, *lines])

    async def load(self, name: str, task: int = 1) -> None:
        """Make it the program that RUN begins."""
        await self._controller.talk.set(self._controller.dialect.load(_program(name), task))

    async def run(self) -> None:
        """Begin the program, or go on where it was stopped. It moves the arm: nothing of ours is known afterwards."""
        self._controller.forget()
        await self._controller.set("RUN")

    async def stop(self) -> None:
        """All programs stop where they are, and the arm with them."""
        self._controller.forget()
        await self._controller.set("STOP")

    async def reset(self) -> None:
        """Back to the first line, without which a stopped program goes on with the motion that it was in."""
        await self._controller.set("RESET")

    async def running(self) -> bool:
        """Whether a program runs."""
        return bool(await self._controller.value(STATE_PORT, parse_byte) >> RUNNING_BIT & 1)

    async def task(self, number: int = 1) -> TaskState:
        """What a task does; only the newer generation tells it."""
        return await self._controller.value(f"TSKMON T{number}", parse_task)


def parse_task(line: str) -> TaskState | None:
    """`PROGRAM,5,R,32`; None when it is anything else."""
    found = TASK.fullmatch(line.strip())
    return TaskState(found[1], int(found[2]), found[3], int(found[4])) if found else None


def _same(now: StoredPoint, wanted: StoredPoint, decimals: int) -> bool:
    rounded = [round(value, 0 if wanted.in_pulses else decimals) for value in wanted.values]
    near = all(abs(a - b) < 1e-6 for a, b in zip(now.values, rounded, strict=True))
    return near and now.in_pulses is wanted.in_pulses and now.hand == wanted.hand


def _program(name: str) -> str:
    if not PROGRAM_NAME.fullmatch(name):
        raise ValueError(f"{name!r} is no program name: up to 32 of A-Z 0-9 _")
    return name


def _one_of(name: str, names: Sequence[str]) -> str:
    if name not in names:
        raise ValueError(f"{name!r} is none of the files {', '.join(names)}")
    return name


def _check_lines(lines: Sequence[str]) -> None:
    """Raises ValueError for a line that the controller could not take as it is, or would take for the file's end."""
    for number, line in enumerate(lines, 1):
        if not line.strip() or len(line) >= LONGEST_COMMAND or not (line.isascii() and line.isprintable()):
            raise ValueError(
                f"line {number}, {line!r}, is no line of a file: 1 to {LONGEST_COMMAND - 1} printable ASCII characters"
            )
