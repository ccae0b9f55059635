"""What the language computes with: numbers, texts, points. Pure."""

import math
import re
from collections.abc import Callable
from typing import NamedTuple, Protocol

from simulators.robot.codes import Code, Refusal

LOWEST, HIGHEST = -(2**30), 2**30 - 1  # of a whole number
LARGEST = 999999.9  # of a number with a point
FIELD = re.compile(r"[+-]?(?:\d{1,9}(?:\.\d{0,9})?|\.\d{1,9})", re.ASCII)
FLAG = re.compile(r"[+-]?\d{1,4}", re.ASCII)
TRUE, FALSE = -1, 0


class PointData(NamedTuple):
    """A point: six values in pulses or in mm and degrees, the hand (0 = not said), two revolution flags."""

    values: tuple[float, ...]
    in_pulses: bool
    hand: int = 0
    revolutions: tuple[int, int] = (0, 0)


class PortRef(NamedTuple):
    """Bits of a port, the first the most significant; all eight when there are none."""

    kind: str  # DI, DO, MO, SI, SO, LO, TO
    port: int
    bits: tuple[int, ...] = ()


Value = int | float | str | PointData


class Scope(Protocol):
    """Where names have values. All raise Refusal."""

    def variable(self, name: str, indices: tuple[int, ...]) -> Value:
        """A variable's value."""

    def set_variable(self, name: str, indices: tuple[int, ...], value: Value) -> None:
        """Give a variable a value."""

    def point(self, number: int) -> PointData:
        """A point of the table."""

    def port(self, port: PortRef) -> int:
        """What an input or output shows."""

    def setting(self, name: str, index: int | None) -> Value:
        """A setting of the controller: WHRXY, ASPEED, ACCEL(1), ARMTYP ..."""


Expression = Callable[[Scope], Value]


def number(value: Value) -> int | float:
    """The value as a number; raises Refusal TYPE_MISMATCH."""
    if isinstance(value, int | float):
        return value
    raise Refusal(Code.TYPE_MISMATCH)


def integer(value: Value, low: int = LOWEST, high: int = HIGHEST) -> int:
    """The value as a whole number, rounded, in a range; raises Refusal TYPE_MISMATCH or PARAMETER_RANGE."""
    found = round(number(value))
    if not low <= found <= high:
        raise Refusal(Code.PARAMETER_RANGE)
    return found


def real(value: Value, low: float, high: float) -> float:
    """The value as a number in a range; raises Refusal TYPE_MISMATCH or PARAMETER_RANGE."""
    found = number(value)
    if not low <= found <= high:
        raise Refusal(Code.PARAMETER_RANGE)
    return float(found)


def checked(value: int | float) -> int | float:
    """A computed number; raises Refusal OUT_OF_RANGE when the controller cannot hold it."""
    if not math.isfinite(value) or abs(value) > (HIGHEST if isinstance(value, int) else 1e15):
        raise Refusal(Code.OUT_OF_RANGE)
    return value


def looks_like_point(text: str) -> bool:
    """Whether this begins as a list of numbers; no expression of points begins with one."""
    return text[:1] in tuple("+-.0123456789")


def point_data(text: str) -> PointData:
    """Six values, then perhaps the hand, then perhaps two revolution flags. Pulses unless one has a point.

    Raises Refusal DATA, TOO_FEW_DATA.
    """
    fields = text.split()
    if not all(FIELD.fullmatch(field) for field in fields):
        raise Refusal(Code.DATA)
    if len(fields) not in (6, 7, 9):
        raise Refusal(Code.DATA if len(fields) > 6 else Code.TOO_FEW_DATA)
    if not all(FLAG.fullmatch(field) for field in fields[6:]):
        raise Refusal(Code.DATA)
    hand, *turns = [int(field) for field in fields[6:]] + [0] * (9 - len(fields))
    if not 0 <= hand <= 2 or not all(-1 <= turn <= 1 for turn in turns):
        raise Refusal(Code.DATA)
    in_pulses = not any("." in field for field in fields[:6])
    return PointData(tuple(map(float, fields[:6])), in_pulses, hand, (turns[0], turns[1]))


def point_sum(a: PointData, b: PointData, sign: int) -> PointData:
    """Axis by axis; raises Refusal COORDINATE_TYPE when one is in pulses and the other is not."""
    if a.in_pulses is not b.in_pulses:
        raise Refusal(Code.COORDINATE_TYPE)
    values = tuple(checked(x + sign * y) for x, y in zip(a.values, b.values, strict=True))
    return a._replace(values=values)
