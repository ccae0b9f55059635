"""RCX text and values that both generations of controllers share: what lines are, numbers, points, the state. Pure.

What differs between the generations is in `rcx2` and `rcx3`.
"""

import re
from dataclasses import dataclass
from enum import Enum, auto
from typing import NamedTuple

LONGEST_COMMAND = 80  # characters, the "@" counted and the line end not
STOP = b"\x03"  # ends the running operation, needs no line end and gets no answer of its own
HOLD = b"\x16"  # keeps a jog going
RIGHTY, LEFTY = 1, 2
AXES = 4

NG = re.compile(r"(?:NG\s*=\s*)?(\d{1,2})\.(\d{1,3})(?::.*)?", re.ASCII)
CODE_WITH_TEXT = re.compile(r"\d{1,2}\.\d{1,3}:", re.ASCII)
DECIMAL = re.compile(r"[+-]?(?:\d{1,9}(?:\.\d{0,9})?|\.\d{1,9})", re.ASCII)
FIELD_COUNTS = (6, 7, 9)
INTEGER = re.compile(r"[+-]?\d{1,9}", re.ASCII)
CONTROL = dict.fromkeys(range(32))  # no answer has any; an echo may


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


class Pulses(NamedTuple):
    """The four axes in the controller's pulses."""

    axis_1: int
    axis_2: int
    axis_3: int
    axis_4: int


class Ramps(NamedTuple):
    """Acceleration and deceleration of a motion as shares of what the arm can do."""

    accel_pct: int = 100
    decel_pct: int = 100


class Arch(NamedTuple):
    """A motion over something: up to `top_z_mm`, across, and down.

    The way across may begin `rise_mm` below the top and must end `sink_mm` below it.
    """

    top_z_mm: float
    rise_mm: float = 0.0
    sink_mm: float = 0.0


class Motion(NamedTuple):
    """One motion. `blends`: the next one may begin before this one has quite ended."""

    to: Point
    hand: int
    speed_pct: int
    straight: bool = False
    ramps: Ramps = Ramps()
    arch: Arch | None = None
    blends: bool = False


class Mode(Enum):
    """Who may move the arm."""

    AUTOMATIC = "automatic"
    HELD = "automatic, the pendant holds the control"
    MANUAL = "manual"
    OTHER = "none in which the arm may be moved"


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """What the controller said about itself. `alarm` is "" or the code, "12.600"; `alarm_means` its words."""

    mode: Mode
    emergency_stop: bool
    alarm: str
    motor_on: bool
    servo_on: bool
    origin_done: bool
    alarm_means: str = ""

    @property
    def ready(self) -> bool:
        """Whether it would accept a motion."""
        return not self.why_not_ready

    @property
    def why_not_ready(self) -> str:
        """One sentence with the remedy, "" when ready."""
        reasons = (
            (self.emergency_stop, "the emergency stop is pressed: release it, then reset the alarm"),
            (bool(self.alarm), f"alarm {self.alarm} ({self.alarm_means}) stands: reset it"),
            (
                self.mode is not Mode.AUTOMATIC,
                f"the mode is {self.mode.value}: select automatic on the pendant, release control",
            ),
            (not self.motor_on, "the motor power is off: switch it on"),
            (not self.servo_on, "the servo is off: switch it on"),
            (not self.origin_done, "the origin is incomplete: a person must run the origin return"),
        )
        return next((why for is_so, why in reasons if is_so), "")


def classify(line: str) -> Kind:
    """What this line is for; any text that is no word of the protocol is data."""
    text = line.strip()
    if not text or text.startswith("Welcome"):
        return Kind.NOTHING
    if text in ("OK", "RUN", "END", "READY", "BEGIN"):
        return Kind[text]
    return Kind.FAILURE if text.startswith("NG") or CODE_WITH_TEXT.match(text) else Kind.DATA


def parse_failure(line: str) -> Code | None:
    """The code in `NG=6.204`, `NG=06.204`, `6.4:words` or an alarm's `6.204`; None when there is none."""
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
    x, y, z, r = map(float, fields[:AXES])
    return Position(Point(x, y, z, r), int(hand))


def parse_pulses(line: str) -> Pulses | None:
    """Four to nine whole numbers, `[POS]` before them or not; None when it is anything else."""
    fields = line.strip().removeprefix("[POS]").split()
    if not AXES <= len(fields) <= max(FIELD_COUNTS) or not all(INTEGER.fullmatch(field) for field in fields):
        return None
    return Pulses(*map(int, fields[:AXES]))


def parse_integer(line: str) -> int | None:
    """A whole number alone on its line."""
    digits = line.strip()  # it knows more blanks than int does
    return int(digits) if INTEGER.fullmatch(digits) else None


def parse_leading_integer(line: str) -> int | None:
    """A whole number, alone or before what a comma or a stroke parts from it (`100/50,20`)."""
    return parse_integer(re.split("[,/]", line, maxsplit=1)[0])


def parse_byte(line: str) -> int | None:
    """The eight bits of a port."""
    value = parse_integer(line)
    return value if value is not None and 0 <= value <= 255 else None


def parse_flag_alone(line: str) -> bool | None:
    """0 or 1."""
    return {"0": False, "1": True}.get(line.strip())


def parse_hand(line: str) -> int | None:
    """RIGHTY or LEFTY, by number or by name; 0 when the controller says neither."""
    text = line.strip().upper()
    if text in ("0", "1", "2"):
        return int(text)
    return {"RIGHTY": RIGHTY, "LEFTY": LEFTY}.get(text)


def command(text: str) -> str:
    """A command line; raises ValueError when the controller could not take it."""
    line = f"@{text}"
    if len(line) > LONGEST_COMMAND or not (line.isascii() and line.isprintable()):
        raise ValueError(f"{line!r} is no command: at most {LONGEST_COMMAND} printable ASCII characters")
    return line


def query(what: str) -> str:
    """Ask for a value."""
    return command(f"?{what}")
