"""`target = value`: points, coordinates, outputs, settings of an axis, hands, shifts, pallets, variables. Pure."""

import re
from collections.abc import Callable
from dataclasses import dataclass

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.commands import point
from simulators.robot.language.expressions import LOCATION, expression, point_reference, port_reference, read_expression
from simulators.robot.language.tokens import Reader
from simulators.robot.language.values import FIELD, Expression, PortRef, Scope, Value

TABLES = re.compile(r"([HS])(\d{1,2})", re.ASCII)
PALLET = ("PL", "PDEF")
AXIS_SETTINGS = ("ACCEL", "DECEL", "TOLE", "OUTPOS", "CONTPLS", "ARCH", "TORQUE", "AXWGHT", "ORGORD")


@dataclass(frozen=True, slots=True)
class PointTarget:
    """A point of the table."""

    number: Expression


@dataclass(frozen=True, slots=True)
class CoordinateTarget:
    """One value of a point."""

    axis: int
    number: Expression


@dataclass(frozen=True, slots=True)
class PortTarget:
    """Output bits."""

    port: Callable[[Scope], PortRef]


@dataclass(frozen=True, slots=True)
class SettingTarget:
    """A setting of one axis."""

    name: str
    axis: Expression


@dataclass(frozen=True, slots=True)
class TableTarget:
    """A hand (H), a shift (S) or a pallet (PL); the value is a list of numbers."""

    kind: str
    number: Expression


@dataclass(frozen=True, slots=True)
class VariableTarget:
    """A variable, or an element of an array."""

    name: str
    indices: tuple[Expression, ...]


Target = PointTarget | CoordinateTarget | PortTarget | SettingTarget | TableTarget | VariableTarget


@dataclass(frozen=True, slots=True)
class Assignment:
    """What shall be so."""

    target: Target
    value: Callable[[Scope], Value]
    numbers: tuple[float, ...] = ()  # of a table's entry
    tool_on_r: bool = False  # a hand that turns with the R axis


def assignment(text: str) -> Assignment | None:
    """None when the text assigns nothing. Raises Refusal when it does so wrongly."""
    reader = Reader(text)
    target = _target_and_equals(reader)
    if target is None:
        return None
    rest = reader.rest().strip()
    if not rest:
        raise Refusal(Code.SYNTAX)
    if isinstance(target, TableTarget):
        return _table_entry(target, rest)
    if isinstance(target, PointTarget):
        return Assignment(target, point(rest))
    return Assignment(target, expression(rest))


def whole_target(text: str) -> Target:
    """A target that is all of this text; raises Refusal."""
    reader = Reader(text)
    target = _target(reader)
    reader.end()
    return target


def told(target: Target, text: str) -> Assignment:
    """The assignment of what somebody has typed: a text, a point, or a number. Raises Refusal DATA."""
    if isinstance(target, VariableTarget) and target.name.endswith("$"):
        words = text.strip('"')
        return Assignment(target, lambda scope: words)
    if isinstance(target, PointTarget):
        return Assignment(target, point(text))
    if not FIELD.fullmatch(text):
        raise Refusal(Code.DATA)
    return Assignment(target, expression(text))


def _target_and_equals(reader: Reader) -> Target | None:
    if reader.token.kind != "name":
        return None
    try:
        target = _target(reader)
    except Refusal:
        return None  # read as a command, it is said better what is wrong
    return target if reader.accept("=") else None


def _target(reader: Reader) -> Target:
    if (number_of_point := point_reference(reader)) is not None:
        return PointTarget(number_of_point)
    if (port := port_reference(reader)) is not None:
        return PortTarget(port)
    name = reader.name()
    if found := TABLES.fullmatch(name):
        number_in_table = int(found[2])
        return TableTarget(found[1], lambda scope: number_in_table)
    if location := LOCATION.fullmatch(name):
        return _coordinate(int(location[1]), reader)
    indices = _indices(reader)
    if name in AXIS_SETTINGS and len(indices) == 1:
        return SettingTarget(name, indices[0])
    if name in PALLET and len(indices) == 1:
        return TableTarget("PL", indices[0])
    return VariableTarget(name, tuple(indices))


def _coordinate(axis: int, reader: Reader) -> CoordinateTarget:
    reader.expect("(")
    number_of_point = point_reference(reader)
    reader.expect(")")
    if number_of_point is None:
        raise Refusal(Code.SYNTAX)
    return CoordinateTarget(axis, number_of_point)


def _indices(reader: Reader) -> list[Expression]:
    found = []
    if reader.accept("("):
        while not reader.accept(")"):
            found.append(read_expression(reader))
            if not reader.accept(","):
                reader.expect(")")
                break
    return found


def _table_entry(target: TableTarget, text: str) -> Assignment:
    tool_on_r = target.kind == "H" and text.rsplit(maxsplit=1)[-1] == "R"
    fields = text.split()[:-1] if tool_on_r else text.replace(",", " ").split() if target.kind == "PL" else text.split()
    if not all(FIELD.fullmatch(field) for field in fields):
        raise Refusal(Code.DATA)
    wanted = {"H": (3, 4, 6), "S": (4, 6), "PL": (3,)}[target.kind]
    if len(fields) not in wanted:
        raise Refusal(Code.TOO_FEW_DATA if len(fields) < max(wanted) else Code.DATA)
    return Assignment(target, lambda scope: 0, tuple(float(field) for field in fields), tool_on_r)
