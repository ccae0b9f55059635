"""RCX text and values: what the controller's lines mean and how commands are written. Pure.

The dialect is that of the RCX340 and RCX320: a query is answered by data and OK, a setting by OK, an operation by
RUN and END, and any of them by NG=group.class instead.
"""

import math
import re
from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

from drivers.rcx_codes import meaning

LONGEST_COMMAND = 80  # characters, the "@" counted and the line end not
STOP = b"\x03"  # ends the running operation, needs no line end and gets no answer of its own
RIGHTY, LEFTY = 1, 2
AUTO_RELEASED = 2  # ?MODE: automatic, the control right released by the pendant

NG = re.compile(r"(?:NG\s*=\s*)?(\d{1,2})\.(\d{1,3})(?::.*)?", re.ASCII)
CODE_WITH_TEXT = re.compile(r"\d{1,2}\.\d{1,3}:", re.ASCII)
DECIMAL = re.compile(r"[+-]?(?:\d{1,9}(?:\.\d{0,9})?|\.\d{1,9})", re.ASCII)
FIELD_COUNTS = (6, 7, 9)
INTEGER = re.compile(r"[+-]?\d{1,9}", re.ASCII)
STATE_AND_AXES = re.compile(r"([01])(?:\s+[0-9](?:\s*,\s*[0-9])*)?", re.ASCII)


class Kind(Enum):
    """What a received line is for."""

    NOTHING = auto()  # blank line or greeting
    OK = auto()
    RUN = auto()
    END = auto()
    READY = auto()
    BEGIN = auto()
    FAILURE = auto()
    DATA = auto()


class Code(NamedTuple):
    """The controller's code for a refusal, a failure or an alarm."""

    group: int
    number: int

    def __str__(self) -> str:
        return f"{self.group}.{self.number}"

    @property
    def meaning(self) -> str:
        """A readable phrase, also for a code that is not in the table."""
        return meaning(self.group, self.number)


class Point(NamedTuple):
    """A tool position in robot coordinates: Z positive downwards, R counter-clockwise from above."""

    x_mm: float
    y_mm: float
    z_mm: float
    r_deg: float

    def __str__(self) -> str:
        return f"x={self.x_mm:.3f} y={self.y_mm:.3f} z={self.z_mm:.3f} mm r={self.r_deg:.3f} deg"


class Position(NamedTuple):
    """Where the arm stands, and on which side its elbow is (RIGHTY, LEFTY, 0 = not said)."""

    point: Point
    hand: int


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """What the controller said about itself. `alarm` is "" or the code, "12.600"."""

    mode: int
    emergency_stop: bool
    alarm: str
    motor_on: bool
    servo_on: bool
    origin_done: bool

    @property
    def ready(self) -> bool:
        """Whether it would accept a motion."""
        return not self.why_not_ready

    @property
    def why_not_ready(self) -> str:
        """One sentence with the remedy, "" when ready."""
        reasons = (
            (self.emergency_stop, "the emergency stop is pressed: release it, then reset the alarm"),
            (bool(self.alarm), f"alarm {self.alarm} ({_alarm_meaning(self.alarm)}) stands: reset it"),
            (self.mode != AUTO_RELEASED, f"mode is {self.mode}: select automatic on the pendant, release control"),
            (not self.motor_on, "the motor power is off: switch it on"),
            (not self.servo_on, "the servo is off: switch it on"),
            (not self.origin_done, "the origin is incomplete: a person must run the origin return"),
        )
        return next((why for is_so, why in reasons if is_so), "")


# -- received ------------------------------------------------------------------------------------------------


def classify(line: str) -> Kind:
    """What this line is for; any text that is no word of the protocol is data."""
    text = line.strip()
    if not text or text.startswith("Welcome"):
        return Kind.NOTHING
    if text in ("OK", "RUN", "END", "READY", "BEGIN"):
        return Kind[text]
    return Kind.FAILURE if text.startswith("NG") or CODE_WITH_TEXT.match(text) else Kind.DATA


def parse_failure(line: str) -> Code | None:
    """The code in `NG=6.204`, `NG=06.204` or an alarm's `6.204`; None when there is none."""
    found = NG.fullmatch(line.strip())
    return Code(int(found[1]), int(found[2])) if found else None


def parse_position(line: str) -> Position | None:
    """Six, seven or nine numbers, `[POS]` before them or not; None when it is anything else."""
    fields = line.strip().removeprefix("[POS]").split()
    if len(fields) not in FIELD_COUNTS or not all(DECIMAL.fullmatch(field) for field in fields):
        return None
    hand = fields[6] if len(fields) > 6 else "0"
    if hand not in ("0", "1", "2"):
        return None
    x, y, z, r = map(float, fields[:4])
    return Position(Point(x, y, z, r), int(hand))


def parse_integer(line: str) -> int | None:
    """A whole number alone on its line."""
    digits = line.strip()  # it knows more blanks than int does
    return int(digits) if INTEGER.fullmatch(digits) else None


def parse_flag(line: str) -> bool | None:
    """0 or 1, for the whole robot, with or without one digit per axis behind it (`1 1,1,1,1`)."""
    found = STATE_AND_AXES.fullmatch(line.strip())
    return found[1] == "1" if found else None


def parse_alarm(line: str) -> str | None:
    """The alarm's code as text, "" for `0.0`."""
    code = parse_failure(line)
    if code is None or not line.strip()[0].isdigit():
        return None
    return "" if code == (0, 0) else str(code)


STATUS_QUERIES = ("MODE", "EMG", "ALM", "MOTOR", "SERVO", "ORIGIN")


def parse_status(answers: tuple[str, ...]) -> RobotStatus | None:
    """The answers to STATUS_QUERIES in their order; None when one of them cannot be read."""
    mode, motor = parse_integer(answers[0]), parse_integer(answers[3])
    emergency, alarm = parse_flag(answers[1]), parse_alarm(answers[2])
    servo, origin = parse_flag(answers[4]), parse_flag(answers[5])
    if mode is None or motor is None or emergency is None or alarm is None or servo is None or origin is None:
        return None
    return RobotStatus(mode, emergency, alarm, motor in (1, 2), servo, origin)


# -- sent ----------------------------------------------------------------------------------------------------


def command(text: str) -> str:
    """A command line; raises ValueError when the controller could not take it."""
    line = f"@{text}"
    if len(line) > LONGEST_COMMAND or not (line.isascii() and line.isprintable()):
        raise ValueError(f"{line!r} is no command: at most {LONGEST_COMMAND} printable ASCII characters")
    return line


def query(what: str) -> str:
    """Ask for a value."""
    return command(f"?{what}")


def move(to: Point, *, hand: int, speed_pct: int, straight: bool) -> str:
    """Go there, point to point or on a line. Numbers without a decimal point would be pulses."""
    if not all(math.isfinite(number) for number in to):
        raise ValueError(f"{to} is no position")
    # adding 0.0 after rounding turns -0.000 into 0.000
    numbers = " ".join(f"{round(number, 3) + 0.0:.3f}" for number in (*to, 0.0, 0.0))
    return command(f"MOVE {'L' if straight else 'P'},{numbers} {hand},S={speed_pct}")


def _alarm_meaning(alarm: str) -> str:
    code = parse_failure(alarm)
    return code.meaning if code else "no code"
