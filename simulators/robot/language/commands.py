"""What stands behind a command word: text to argument. Pure. All raise Refusal."""

from collections.abc import Callable
from dataclasses import dataclass

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.expressions import expression, read_expression
from simulators.robot.language.tokens import Reader
from simulators.robot.language.values import (
    Expression,
    PointData,
    Scope,
    integer,
    looks_like_point,
    point_data,
)

AXES = 4
OPENING, CLOSING = "([{", ")]}"

PointOf = Callable[[Scope], PointData]


@dataclass(frozen=True, slots=True)
class ArchOption:
    """How high, and how far below it the travel may begin and end; whole numbers are pulses."""

    height: Expression
    below: tuple[Expression, ...] = ()


@dataclass(frozen=True, slots=True)
class MoveOptions:
    """What stands behind the targets of a motion."""

    speed: Expression | None = None
    accel: Expression | None = None
    decel: Expression | None = None
    path_speed: Expression | None = None
    arch: ArchOption | None = None
    stop_on: Expression | None = None
    blends: bool = False


@dataclass(frozen=True, slots=True)
class Move:
    """MOVE and MOVEI: `kind` is P, L or C."""

    kind: str
    targets: tuple[PointOf, ...]
    options: MoveOptions


@dataclass(frozen=True, slots=True)
class Drive:
    """DRIVE and DRIVEI: axes and where to; a point stands for its own value of that axis."""

    axes: tuple[tuple[Expression, Expression], ...]
    options: MoveOptions


@dataclass(frozen=True, slots=True)
class PalletMove:
    """PMOVE: a place on a pallet."""

    pallet: Expression
    place: Expression
    options: MoveOptions


@dataclass(frozen=True, slots=True)
class Step:
    """JOG, INCH: an axis and a sign."""

    axis: int
    sign: int


@dataclass(frozen=True, slots=True)
class Power:
    """SERVO, MOTOR: ON, OFF, FREE or PWR, for one axis or all."""

    wish: str
    axis: Expression | None


@dataclass(frozen=True, slots=True)
class Number:
    """A setting for the robot, one of its axes, or two numbers."""

    values: tuple[Expression, ...]
    axis: Expression | None = None


def pieces(text: str) -> list[str]:
    """The parts between the commas that stand in no bracket and no quotes."""
    found, depth, quoted, begun = [], 0, False, 0
    for at, letter in enumerate(text):
        if letter == '"':
            quoted = not quoted
        elif quoted:
            continue
        elif letter in OPENING:
            depth += 1
        elif letter in CLOSING:
            depth -= 1
        elif letter == "," and depth <= 0:
            found.append(text[begun:at].strip())
            begun = at + 1
    return [*found, text[begun:].strip()]


def value(text: str) -> Number:
    """An expression, `(axis)=expression`, or several expressions."""
    if text.lstrip().startswith("("):
        reader = Reader(text)
        if axis := _axis_and_equals(reader):
            return Number((expression(reader.rest()),), axis)
    return Number(tuple(expression(piece) for piece in pieces(text)))


def point(text: str) -> PointOf:
    """A list of numbers or an expression."""
    if looks_like_point(text):
        literal = point_data(text)
        return lambda scope: literal
    found = expression(text)

    def evaluate(scope: Scope) -> PointData:
        result = found(scope)
        if not isinstance(result, PointData):
            raise Refusal(Code.DATA)
        return result

    return evaluate


def move(text: str, arch_name: str) -> Move:
    """`P,P1,P2,S=20` and the like."""
    kind, *rest = pieces(text)
    targets, given = _until_options(rest)
    if kind not in ("P", "L", "C") or not targets or (kind == "C" and len(targets) % 2):
        raise Refusal(Code.SYNTAX)
    options = _options(given, arch_name)
    if (options.arch and kind != "P") or (options.path_speed and kind == "P"):
        raise Refusal(Code.OPTION)
    return Move(kind, tuple(point(target) for target in targets), options)


def drive(text: str, arch_name: str) -> Drive:
    """`(1,10.00),(2,5.00),S=20` and the like."""
    axes, given = _until_options(pieces(text))
    if not axes:
        raise Refusal(Code.SYNTAX)
    options = _options(given, arch_name)
    if options.arch or options.path_speed or options.blends:
        raise Refusal(Code.OPTION)
    return Drive(tuple(_pair(axis) for axis in axes), options)


def pallet_move(text: str, arch_name: str) -> PalletMove:
    """`(0,5),S=20` and the like."""
    place, *given = pieces(text)
    pallet, position = _pair(place)
    options = _options(given, arch_name)
    if options.path_speed:
        raise Refusal(Code.OPTION)
    return PalletMove(pallet, position, options)


def step(text: str, axes: str) -> Step:
    """An axis as this generation names it, and + or -."""
    name, sign = text.strip()[:-1].strip(), text.strip()[-1:]
    if sign not in ("+", "-") or len(name) != 1:
        raise Refusal(Code.SYNTAX)
    if name not in axes:
        raise Refusal(Code.AXIS_NAME)
    if axes.index(name) >= AXES:
        raise Refusal(Code.AXIS_NUMBER)
    return Step(axes.index(name) + 1, 1 if sign == "+" else -1)


def power(text: str) -> Power:
    """ON, OFF, FREE or PWR, then perhaps an axis in brackets."""
    reader = Reader(text)
    wish = reader.name()
    if wish not in ("ON", "OFF", "FREE", "PWR"):
        raise Refusal(Code.SYNTAX)
    if reader.ended:
        return Power(wish, None)
    reader.expect("(")
    inner = reader.rest().rstrip()
    if not inner.endswith(")"):
        raise Refusal(Code.SYNTAX)
    return Power(wish, expression(inner[:-1]))


def _axis_and_equals(reader: Reader) -> Expression | None:
    reader.expect("(")
    axis = read_expression(reader)
    reader.expect(")")
    return axis if reader.accept("=") else None


def _pair(text: str) -> tuple[Expression, Expression]:
    if not (text.startswith("(") and text.endswith(")")):
        raise Refusal(Code.SYNTAX)
    both = pieces(text[1:-1])
    if len(both) != 2:
        raise Refusal(Code.SYNTAX)
    return expression(both[0]), expression(both[1])


def _until_options(parts: list[str]) -> tuple[list[str], list[str]]:
    first = next((k for k, part in enumerate(parts) if _is_option(part)), len(parts))
    return parts[:first], parts[first:]


def _is_option(part: str) -> bool:
    return part == "CONT" or part.startswith("STOPON") or ("=" in part and not part.startswith("("))


def _options(parts: list[str], arch_name: str) -> MoveOptions:
    found: dict[str, object] = {}
    for part in parts:
        key, read = _option(part, arch_name)
        if key in found:
            raise Refusal(Code.OPTION)
        found[key] = read
    return MoveOptions(**found)  # type: ignore[arg-type]


def _option(part: str, arch_name: str) -> tuple[str, object]:
    if part == "CONT":
        return "blends", True
    if part.startswith("STOPON"):
        return "stop_on", expression(part.removeprefix("STOPON"))
    name, _, text = (half.strip() for half in part.partition("="))
    keys = {"S": "speed", "SPEED": "speed", "ACC": "accel", "DEC": "decel", "VEL": "path_speed"}
    if name == arch_name:
        return "arch", _arch(text)
    if name not in keys:
        raise Refusal(Code.OPTION)
    return keys[name], expression(text)


def _arch(text: str) -> ArchOption:
    height, brace, inside = text.partition("{")
    if not brace:
        return ArchOption(expression(height))
    if not inside.endswith("}") or len(below := pieces(inside[:-1])) != 2:
        raise Refusal(Code.SYNTAX)
    return ArchOption(expression(height), (expression(below[0]), expression(below[1])))


def axis_number(expr: Expression, scope: Scope) -> int:
    """An axis's number; raises Refusal AXIS_NUMBER."""
    found = integer(expr(scope))
    if not 1 <= found <= AXES:
        raise Refusal(Code.AXIS_NUMBER)
    return found
