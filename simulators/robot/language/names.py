"""Arguments that are names: programs, tasks, files, ports, frames. Text to value. Pure. All raise Refusal."""

import re
from collections.abc import Callable
from dataclasses import dataclass

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.commands import pieces
from simulators.robot.language.expressions import expression, port_reference
from simulators.robot.language.tokens import Reader
from simulators.robot.language.values import PortRef, Scope

PROGRAM = re.compile(r"<\s*([A-Z0-9_]{1,32})\s*>", re.ASCII)
TASK = re.compile(r"T(\d{1,2})", re.ASCII)
PROGRAM_NUMBER = re.compile(r"PG(\d{1,3})", re.ASCII)
POINT = re.compile(r"P?\s*(\d{1,5})", re.ASCII)
FILES = ("PGM", "PNT", "PCM", "PRM", "SFT", "HND", "PLT", "VAR", "ARY", "DIR", "LOG", "MEM")


@dataclass(frozen=True, slots=True)
class ProgramCommand:
    """LOAD, RUN, STOP, RESET, START ...: a program by name or number, a task."""

    name: str | None = None
    task: int | None = None
    number: int | None = None


@dataclass(frozen=True, slots=True)
class FileName:
    """What READ and WRITE carry: a kind of file, one point, or one program."""

    kind: str
    program: str | None = None
    point: int | None = None


def nothing(text: str) -> None:
    """A command that stands alone."""
    if text.strip():
        raise Refusal(Code.COMMAND_LINE)


def optional_number(text: str) -> None:
    """ORIGIN 1, ORIGIN 0, ORIGIN(2): which robot or axis; there is one robot and its axes return together."""
    if text.strip():
        expression(text)


def word(text: str) -> str:
    """One word."""
    reader = Reader(text)
    found = reader.name()
    reader.end()
    return found


def program_command(text: str) -> ProgramCommand:
    """`<NAME>,T1`, `T1`, `<NAME>`, `PG1,T1`, or nothing."""
    found = ProgramCommand()
    for piece in pieces(text) if text.strip() else []:
        if match := PROGRAM.fullmatch(piece):
            found = ProgramCommand(match[1], found.task, found.number)
        elif match := TASK.fullmatch(piece):
            found = ProgramCommand(found.name, int(match[1]), found.number)
        elif match := PROGRAM_NUMBER.fullmatch(piece):
            found = ProgramCommand(found.name, found.task, int(match[1]))
        else:
            raise Refusal(Code.PROGRAM_NAME if piece.startswith("<") else Code.SYNTAX)
    return found


def port(text: str) -> Callable[[Scope], PortRef]:
    """A port and nothing else."""
    reader = Reader(text)
    found = port_reference(reader)
    if found is None:
        raise Refusal(Code.SYNTAX)
    reader.end()
    return found


def ports(text: str) -> tuple[Callable[[Scope], PortRef], ...]:
    """One or several ports."""
    return tuple(port(piece) for piece in pieces(text))


def point_number(text: str) -> int:
    """`5` or `P5`."""
    found = POINT.fullmatch(text.strip())
    if not found:
        raise Refusal(Code.SYNTAX)
    return int(found[1])


def arm_word(text: str) -> None:
    """WAIT ARM is all that a client may wait for."""
    if text.strip() != "ARM":
        raise Refusal(Code.SYNTAX)


def file_name(text: str) -> FileName:
    """`PNT`, `P5`, `<NAME>` and the like."""
    name = text.strip()
    if name in FILES:
        return FileName(name)
    if found := PROGRAM.fullmatch(name):
        return FileName("PGM", program=found[1])
    if name.startswith("P") and (found := POINT.fullmatch(name)):
        return FileName("PNT", point=int(found[1]))
    raise Refusal(Code.SYNTAX)


def sent_file(text: str) -> FileName:
    """`PNT TO CMU`: to the serial line or the network, whichever asks."""
    name, to, where = (part.strip() for part in text.partition(" TO "))
    if not to or where not in ("CMU", "ETH"):
        raise Refusal(Code.SYNTAX)
    return file_name(name)


def network_setting(text: str) -> tuple[str, str]:
    """`ECHO 0`, or `ECHO` alone."""
    name, _, setting = text.strip().partition(" ")
    if name != "ECHO" or setting.strip() not in ("", "0", "1"):
        raise Refusal(Code.SYNTAX)
    return name, setting.strip()
