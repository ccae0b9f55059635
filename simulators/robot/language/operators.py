"""What expressions compute. Pure; everything raises Refusal."""

import math
import operator
from collections.abc import Callable
from typing import Any

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.values import (
    FALSE,
    TRUE,
    Expression,
    PointData,
    PortRef,
    Scope,
    Value,
    checked,
    integer,
    number,
    point_sum,
)

FUNCTIONS: dict[str, Callable[[float], float]] = {
    "ABS": abs,
    "INT": math.floor,
    "SIN": math.sin,
    "COS": math.cos,
    "TAN": math.tan,
    "ATN": math.atan,
    "SQR": math.sqrt,
    "RADDEG": math.degrees,
    "DEGRAD": math.radians,
}
COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "=": operator.eq,
    "<>": operator.ne,
    "><": operator.ne,
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    "=<": operator.le,
    ">=": operator.ge,
    "=>": operator.ge,
}
LOGIC: tuple[tuple[str, Callable[[int, int], int]], ...] = (
    ("XOR", operator.xor),
    ("OR", operator.or_),
    ("AND", operator.and_),
)


def truth(compare: Callable[[Any, Any], bool]) -> Callable[[Value, Value], Value]:
    """Both numbers or both texts."""

    def decide(a: Value, b: Value) -> Value:
        if isinstance(a, PointData) or isinstance(b, PointData) or isinstance(a, str) is not isinstance(b, str):
            raise Refusal(Code.TYPE_MISMATCH)
        return TRUE if compare(a, b) else FALSE

    return decide


def plus(a: Value, b: Value) -> Value:
    """Numbers, texts, or points."""
    if isinstance(a, PointData) and isinstance(b, PointData):
        return point_sum(a, b, 1)
    if isinstance(a, str) and isinstance(b, str):
        return a + b
    return checked(number(a) + number(b))


def minus(a: Value, b: Value) -> Value:
    """Numbers, or points."""
    if isinstance(a, PointData) and isinstance(b, PointData):
        return point_sum(a, b, -1)
    return checked(number(a) - number(b))


def times(a: Value, b: Value) -> Value:
    """Numbers."""
    return checked(number(a) * number(b))


def divided(a: Value, b: Value) -> Value:
    """Numbers; a number with a point comes out."""
    if number(b) == 0:
        raise Refusal(Code.DIVISION_BY_ZERO)
    return checked(number(a) / number(b))


def remainder(a: Value, b: Value) -> Value:
    """Whole numbers; the sign is that of the first."""
    whole, divisor = bits(a), bits(b)
    if divisor == 0:
        raise Refusal(Code.DIVISION_BY_ZERO)
    return whole - divisor * int(whole / divisor)


def raised(a: Value, b: Value) -> Value:
    """Numbers; whole ones stay whole while they can be held."""
    try:
        result = float(number(a)) ** float(number(b))
    except (OverflowError, ZeroDivisionError):
        raise Refusal(Code.OUT_OF_RANGE) from None
    if isinstance(result, complex):
        raise Refusal(Code.FUNCTION_CALL)
    whole = isinstance(a, int) and isinstance(b, int) and b >= 0 and abs(result) < 2**30
    return checked(int(result) if whole else result)


def applied(function: Callable[[float], float], argument: Expression) -> Expression:
    """A function of one number."""

    def compute(scope: Scope) -> Value:
        try:
            return checked(function(number(argument(scope))))
        except (ValueError, OverflowError):
            raise Refusal(Code.FUNCTION_CALL) from None

    return compute


def coordinate(axis: int, point: Expression) -> Expression:
    """One value of a point."""

    def look(scope: Scope) -> Value:
        found = point(scope)
        if not isinstance(found, PointData):
            raise Refusal(Code.TYPE_MISMATCH)
        value = found.values[axis - 1]
        return round(value) if found.in_pulses else value

    return look


def on_bits(combine: Callable[[int, int], int]) -> Callable[[Value, Value], Value]:
    """Both as bits."""
    return lambda a, b: combine(bits(a), bits(b))


def bits(value: Value) -> int:
    """A number as 32 bits."""
    return integer(value, -(2**31), 2**31 - 1)


def port(kind: str, port: str | None, numbers: list[int]) -> PortRef:
    """The port and bits of `DO2(3)` (port and bits apart) or `DO(23)` (both in one number)."""
    if port is not None:
        if any(not 0 <= bit <= 7 for bit in numbers):
            raise Refusal(Code.BIT_NUMBER)
        return PortRef(kind, int(port), tuple(numbers))
    if not numbers or len({number // 10 for number in numbers}) > 1 or numbers[0] < 0:
        raise Refusal(Code.SYNTAX)
    if any(number % 10 > 7 for number in numbers):
        raise Refusal(Code.BIT_NUMBER)
    return PortRef(kind, numbers[0] // 10, tuple(number % 10 for number in numbers))
