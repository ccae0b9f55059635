"""Expressions, read once and evaluated as often as needed. Pure.

From the strongest to the weakest: brackets and functions, ^, sign, * and /, MOD, + and -, comparisons, NOT, AND, OR,
XOR. True is -1. `P5` and `P[A%]` are points, `DI(20)`, `DI2()`, `DO2(3,0)` are ports.
"""

import re
from collections.abc import Callable

from simulators.robot.codes import Code, Refusal
from simulators.robot.language import operators
from simulators.robot.language.operators import COMPARISONS, FUNCTIONS, LOGIC
from simulators.robot.language.tokens import Reader, number_of
from simulators.robot.language.values import Expression, PortRef, Scope, Value, checked, integer, number

PORT_NAME = re.compile(r"(DI|DO|MO|SI|SO|LO|TO)(\d{1,2})?", re.ASCII)
POINT_NAME = re.compile(r"P(\d{1,5})", re.ASCII)
LOCATION = re.compile(r"LOC([1-6])", re.ASCII)
SETTINGS = (
    *("ASPEED", "MSPEED", "SPEED", "ACCEL", "DECEL", "TOLE", "OUTPOS", "ARCH", "WEIGHT", "WEIGHTG", "ORGORD", "AXWGHT"),
    *("TORQUE", "ARMTYP", "ARMSEL", "ARMCND", "WHERE", "WHRXY", "TIMEOUT", "TCOUNTER", "IDIST", "CONTPLS"),
    *("ERR", "ERL"),
)
DEEPEST = 40


def expression(text: str) -> Expression:
    """An expression that is all of this text; raises Refusal: DATA for a number with something odd behind it."""
    reader = Reader(text)
    if reader.ended:
        raise Refusal(Code.SYNTAX)
    is_number = reader.token.kind == "number"
    found = read_expression(reader)
    if not reader.ended:
        raise Refusal(Code.DATA if is_number else Code.SYNTAX)
    return found


def read_expression(reader: Reader, depth: int = 0) -> Expression:
    """The longest expression that begins here."""
    return _logic(reader, depth, 0)


def port_reference(reader: Reader) -> Callable[[Scope], PortRef] | None:
    """`DI2()`, `DO2(3)`, `DO(23)`, `DO2(3,1,0)`; None, with nothing taken, when it is no port."""
    found = PORT_NAME.fullmatch(reader.token.text) if reader.token.kind == "name" else None
    if not found:
        return None
    reader.take()
    reader.expect("(")
    bits: list[Expression] = []
    while not reader.accept(")"):
        bits.append(read_expression(reader))
        if not reader.accept(","):
            reader.expect(")")
            break
    kind, port = found[1], found[2]
    return lambda scope: operators.port(kind, port, [integer(bit(scope), -99, 999) for bit in bits])


def point_reference(reader: Reader) -> Expression | None:
    """The number of the point in `P5`, `P[A%+1]`, or `P 5`; None, with nothing taken, when it is no point."""
    token = reader.token
    if token.kind != "name":
        return None
    if found := POINT_NAME.fullmatch(token.text):
        reader.take()
        return _constant(int(found[1]))
    if token.text == "P":
        mark = reader.mark()
        reader.take()
        if reader.accept("["):
            index = read_expression(reader)
            reader.expect("]")
            return index
        reader.back(mark)
    return None


# -- from the weakest to the strongest -------------------------------------------------------------------


def _logic(reader: Reader, depth: int, level: int) -> Expression:
    if level == len(LOGIC):
        return _negation(reader, depth)
    word, combine = LOGIC[level]
    left = _logic(reader, depth, level + 1)
    while reader.accept(word):
        left = _combined(left, _logic(reader, depth, level + 1), operators.on_bits(combine))
    return left


def _negation(reader: Reader, depth: int) -> Expression:
    if reader.accept("NOT"):
        inner = _negation(reader, _deeper(depth))
        return lambda scope: ~operators.bits(inner(scope))
    return _comparison(reader, depth)


def _comparison(reader: Reader, depth: int) -> Expression:
    left = _sum(reader, depth)
    while reader.token.kind == "sign" and (compare := COMPARISONS.get(reader.token.text)):
        reader.take()
        left = _combined(left, _sum(reader, depth), operators.truth(compare))
    return left


def _sum(reader: Reader, depth: int) -> Expression:
    left = _modulo(reader, depth)
    while reader.token.text in ("+", "-") and reader.token.kind == "sign":
        sign = 1 if reader.take().text == "+" else -1
        left = _combined(left, _modulo(reader, depth), operators.plus if sign > 0 else operators.minus)
    return left


def _modulo(reader: Reader, depth: int) -> Expression:
    left = _product(reader, depth)
    while reader.accept("MOD"):
        left = _combined(left, _product(reader, depth), operators.remainder)
    return left


def _product(reader: Reader, depth: int) -> Expression:
    left = _signed(reader, depth)
    while reader.token.text in ("*", "/") and reader.token.kind == "sign":
        combine = operators.times if reader.take().text == "*" else operators.divided
        left = _combined(left, _signed(reader, depth), combine)
    return left


def _signed(reader: Reader, depth: int) -> Expression:
    if reader.accept("-"):
        inner = _signed(reader, _deeper(depth))
        return lambda scope: checked(-number(inner(scope)))
    if reader.accept("+"):
        return _signed(reader, _deeper(depth))
    return _power(reader, depth)


def _power(reader: Reader, depth: int) -> Expression:
    base = _operand(reader, depth)
    if reader.accept("^"):
        return _combined(base, _signed(reader, _deeper(depth)), operators.raised)
    return base


def _operand(reader: Reader, depth: int) -> Expression:
    token = reader.token
    if token.kind == "number":
        return _constant(number_of(reader.take().text))
    if token.kind == "text":
        return _constant(reader.take().text.strip('"'))
    if reader.accept("("):
        inner = read_expression(reader, _deeper(depth))
        reader.expect(")")
        return inner
    if (point := point_reference(reader)) is not None:
        return lambda scope: scope.point(integer(point(scope)))
    if (port := port_reference(reader)) is not None:
        return lambda scope: scope.port(port(scope))
    return _named(reader, depth)


def _named(reader: Reader, depth: int) -> Expression:
    name = reader.name()
    arguments = _arguments(reader, depth)
    if (function := FUNCTIONS.get(name)) is not None:
        if arguments is None or len(arguments) != 1:
            raise Refusal(Code.FUNCTION_CALL)
        return operators.applied(function, arguments[0])
    if location := LOCATION.fullmatch(name):
        if arguments is None or len(arguments) != 1:
            raise Refusal(Code.SYNTAX)
        return operators.coordinate(int(location[1]), arguments[0])
    indices = arguments or []
    if name in SETTINGS:
        return lambda scope: scope.setting(name, integer(indices[0](scope)) if indices else None)
    return lambda scope: scope.variable(name, tuple(integer(index(scope)) for index in indices))


def _arguments(reader: Reader, depth: int) -> list[Expression] | None:
    if not reader.accept("("):
        return None
    found = []
    while not reader.accept(")"):
        found.append(read_expression(reader, _deeper(depth)))
        if not reader.accept(","):
            reader.expect(")")
            break
    return found


def _deeper(depth: int) -> int:
    if depth >= DEEPEST:
        raise Refusal(Code.STACK_OVERFLOW)
    return depth + 1


def _constant(value: Value) -> Expression:
    return lambda scope: value


def _combined(left: Expression, right: Expression, combine: Callable[[Value, Value], Value]) -> Expression:
    return lambda scope: combine(left(scope), right(scope))
