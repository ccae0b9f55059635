"""The controller's language: command lines to words and values. Pure; a Refusal carries the code to answer."""

import re
from typing import NamedTuple

LONGEST_LINE = 255
AXES = 4
NUMBER = re.compile(r"[+-]?(?:\d{1,9}(?:\.\d{0,9})?|\.\d{1,9})", re.ASCII)
INTEGER = re.compile(r"[+-]?\d{1,9}", re.ASCII)
WORD = re.compile(r"([A-Z]+)(?:\s*\[\s*(\d)\s*\])?")
POINT_NUMBER = re.compile(r"P(\d{1,5})", re.ASCII)
LARGEST_POINT_NUMBER = 29999
INDEXED = re.compile(r"\s*\(\s*(\d+)\s*\)\s*=\s*(\S+)\s*")
DRIVES = re.compile(r"\s*(\(\s*\d\s*,[^()]*\)(?:\s*,\s*\(\s*\d\s*,[^()]*\))*)\s*(?:,(.*))?")
DRIVE = re.compile(r"\(\s*(\d)\s*,([^()]*)\)")
STEP = re.compile(r"\s*([1-6])\s*([+-])\s*")
PORT = re.compile(r"\s*(?:(\d)\s*\(\s*(\d?)\s*\)|\(\s*(\d)(\d)\s*\))\s*")


class Refusal(Exception):
    """The command is answered by NG=code."""

    def __init__(self, code: str) -> None:
        super().__init__(code)
        self.code = code


class Command(NamedTuple):
    """A line taken apart; `rest` is what follows the word, in upper case."""

    is_query: bool
    word: str
    rest: str


class PointData(NamedTuple):
    """A point: six values in pulses or in mm and degrees, the hand (0 = as it is), two revolution flags."""

    values: tuple[float, ...]
    in_pulses: bool
    hand: int = 0
    revolutions: tuple[int, int] = (0, 0)

    def __str__(self) -> str:
        numbers = (f"{round(v)}" if self.in_pulses else three_decimals(v) for v in self.values)
        return f"{' '.join(numbers)} {self.hand} {self.revolutions[0]} {self.revolutions[1]}"


class Drive(NamedTuple):
    """One axis and where to."""

    axis: int
    value: float
    in_pulses: bool


def three_decimals(value: float) -> str:
    """As the controller prints lengths and angles; never -0.000."""
    return f"{round(value, 3) + 0.0:.3f}"


def parse_command(line: str) -> Command | None:
    """Take a line apart; None for one that says nothing. Raises Refusal 14.x, 4.204 and 5.252."""
    text = line.strip()
    if not text:
        return None
    if len(text) > LONGEST_LINE:
        raise Refusal("14.220")
    if not text.startswith("@"):
        raise Refusal("14.222")
    body = text[1:].strip().upper()
    if not body:
        return None
    is_query = body.startswith("?")
    found = WORD.match(body := body.removeprefix("?").strip())
    if not found:
        raise Refusal("5.252")
    if found[2] not in (None, "1"):
        raise Refusal("4.204")
    return Command(is_query, found[1], body[found.end() :])


def integer(text: str, low: int, high: int) -> int:
    """A whole number in a range; raises Refusal 5.202 or 4.208."""
    if not INTEGER.fullmatch(digits := text.strip()):
        raise Refusal("5.202")
    return int(ranged(int(digits), low, high))


def number(text: str) -> float:
    """A number; raises Refusal 5.202."""
    if not NUMBER.fullmatch(digits := text.strip()):  # strip knows more blanks than float does
        raise Refusal("5.202")
    return float(digits)


def ranged(value: float, low: float, high: float) -> float:
    """The value when it is in range; raises Refusal 4.208."""
    if not low <= value <= high:
        raise Refusal("4.208")
    return value


def point_number(text: str) -> int:
    """The number in P123; raises Refusal 5.201 or 4.201."""
    found = POINT_NUMBER.fullmatch(text.strip())
    if not found:
        raise Refusal("5.201")
    if int(found[1]) > LARGEST_POINT_NUMBER:
        raise Refusal("4.201")
    return int(found[1])


def point_data(text: str) -> PointData:
    """Six values, then perhaps the hand, then perhaps two revolution flags. Raises Refusal."""
    fields = text.split()
    if not all(NUMBER.fullmatch(field) for field in fields):
        raise Refusal("5.202")
    if len(fields) not in (6, 7, 9):
        raise Refusal("5.202" if len(fields) > 6 else "4.212")
    flags = [integer(field, -1, 2) for field in fields[6:]] + [0] * (9 - len(fields))
    in_pulses = not any("." in field for field in fields[:6])
    if flags[0] < 0:
        raise Refusal("5.202")
    return PointData(tuple(map(float, fields[:6])), in_pulses, flags[0], (flags[1], flags[2]))


def targets_and_options(text: str) -> tuple[list[str], dict[str, str]]:
    """The comma-separated pieces: first the targets, then options `S=20` or `CONT`. Raises Refusal."""
    pieces = [piece.strip() for piece in text.split(",")]
    count = next((k for k, piece in enumerate(pieces) if "=" in piece or piece == "CONT"), len(pieces))
    return pieces[:count], options(pieces[count:])


def options(pieces: list[str]) -> dict[str, str]:
    """Options by name. Raises Refusal 5.238."""
    found: dict[str, str] = {}
    for piece in pieces:
        name, equals, value = (part.strip() for part in piece.partition("="))
        if name not in ("S", "ACC", "DEC", "VEL", "CONT") or bool(equals) == (name == "CONT"):
            raise Refusal("5.238")
        found[name] = value
    return found


def drives(text: str) -> tuple[list[Drive], dict[str, str]]:
    """`(1,10.00),(2,5.0),S=5` as axes and options. Raises Refusal."""
    found = DRIVES.fullmatch(text)
    if not found:
        raise Refusal("5.201")
    wanted = [Drive(int(axis), number(value), "." not in value) for axis, value in DRIVE.findall(found[1])]
    if any(not 1 <= drive.axis <= AXES for drive in wanted):
        raise Refusal("4.205")
    return wanted, options([piece.strip() for piece in found[2].split(",")] if found[2] else [])


def axis_and_sign(text: str) -> tuple[int, int]:
    """`1+` as axis number and sign. Raises Refusal 5.201 or 4.205."""
    found = STEP.fullmatch(text)
    if not found:
        raise Refusal("5.201")
    if int(found[1]) > AXES:
        raise Refusal("4.205")
    return int(found[1]), 1 if found[2] == "+" else -1


def port_and_bit(text: str) -> tuple[int, int | None]:
    """`2()`, `2(3)` or `(23)` as port and bit. Raises Refusal 5.201 or 5.204."""
    found = PORT.fullmatch(text)
    if not found:
        raise Refusal("5.201")
    port, bit = (found[1], found[2]) if found[1] is not None else (found[3], found[4])
    if bit and int(bit) > 7:
        raise Refusal("5.204")
    return int(port), int(bit) if bit else None
