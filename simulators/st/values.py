"""Expressions become functions of the frame, with their types checked. Pure.

Types are never converted by themselves: what one PLC widens silently another refuses. Only a plain integer takes the
type of what it meets.
"""

from typing import NamedTuple

from simulators.st.errors import Spot, StError
from simulators.st.functions import Function, conversion
from simulators.st.library import Frame, Run, TimeBase
from simulators.st.nodes import Binary, Call, Expression, Literal, Name, Unary
from simulators.st.operators import comparison, operation
from simulators.st.scope import Scope
from simulators.st.types import BOOL, LITERAL, Type


class Value(NamedTuple):
    """A way to get a value. `constant` is that value where it never changes."""

    type: Type
    run: Run
    constant: int | bool | None = None


def constant(kind: Type, value: int | bool) -> Value:
    """A value that never changes."""
    return Value(kind, lambda frame: value, value)


def value_of(node: Expression, scope: Scope) -> Value:
    """How to compute an expression; raises StError for types that do not go together."""
    match node:
        case Literal():
            return constant(node.type, node.value)
        case Name():
            kind, run, known = scope.read(node)
            return Value(kind, run) if known is None else constant(kind, known)
        case Unary():
            return _unary(node, scope)
        case Binary():
            return _binary(node, scope)
        case Call():
            return _call(node, scope)


def wanted(node: Expression, scope: Scope, kind: Type, what: str) -> Run:
    """How to compute an expression that must be of that type; `what` says for whom."""
    spot = _spot_of(node)
    value = _adapted(value_of(node, scope), kind, spot)
    if value.type is not kind:
        raise StError(spot, f"{what} is {kind.name} (got {value.type.name}){_hint(value.type, kind)}")
    return value.run


def _spot_of(node: Expression) -> Spot:
    return _spot_of(node.left) if isinstance(node, Binary) else node.spot


def _hint(given: Type, kind: Type) -> str:
    name = f"{given.name}_TO_{kind.name}"
    return f"; convert it with {name}" if conversion(name) else ""


def _adapted(value: Value, kind: Type, spot: Spot) -> Value:
    """A plain integer as a constant of that type; anything else as it is."""
    if value.type is not LITERAL or kind.family not in ("int", "bits"):
        return value
    assert value.constant is not None
    if not kind.holds(value.constant):
        raise StError(spot, f"{value.constant} does not fit into {kind.name}")
    return constant(kind, value.constant)


def _unary(node: Unary, scope: Scope) -> Value:
    value = value_of(node.operand, scope)
    run, kind = value.run, value.type
    if node.sign == "NOT" and kind is BOOL:
        return Value(kind, lambda frame: not run(frame))
    if node.sign == "NOT" and kind.family == "bits":
        mask = (1 << kind.bits) - 1
        return Value(kind, lambda frame: run(frame) ^ mask)
    if node.sign == "-" and kind is LITERAL:
        return constant(kind, -run([]))
    if node.sign == "-" and kind.signed:
        wrap = kind.wrapping()
        return Value(kind, lambda frame: wrap(-run(frame)))
    raise StError(node.spot, f"{node.sign} does not go with {kind.name}")


def _binary(node: Binary, scope: Scope) -> Value:
    left, right = value_of(node.left, scope), value_of(node.right, scope)
    left = _adapted(left, right.type, _spot_of(node.left))
    right = _adapted(right, left.type, _spot_of(node.right))
    kind = left.type
    if kind is not right.type:
        raise StError(node.spot, f"{node.sign} needs two values of one type (got {kind.name} and {right.type.name})")
    if compare := comparison(node.sign, kind):
        return Value(BOOL, compare(left.run, right.run))
    combine = operation(node.sign, kind, node.spot)
    if combine is None:
        raise StError(node.spot, f"{node.sign} does not go with {kind.name}")
    run = combine(left.run, right.run)
    return constant(kind, run([])) if kind is LITERAL else Value(kind, run)


def _call(node: Call, scope: Scope) -> Value:
    function = scope.functions.get(node.name.lower())
    if function is not None:
        return _called(node, function, scope)
    found = conversion(node.name)
    if found is None:
        raise StError(node.spot, f"there is no function {node.name} (functions are declared before their use)")
    if len(node.arguments) != 1 or node.arguments[0].name:
        raise StError(node.spot, f"{found.name} takes one value without a name")
    run, work = wanted(node.arguments[0].value, scope, found.source, f"the argument of {found.name}"), found.work
    return Value(found.result, lambda frame: work(run(frame)))


def _called(node: Call, function: Function, scope: Scope) -> Value:
    block = function.block
    given = _inputs(node, function, scope)
    fresh, step, result_at = block.frame(TimeBase(), {}), block.step, block.slots[block.name.lower()].at

    def run(frame: Frame) -> int | bool:
        inner = fresh.copy()
        for to, value in given:
            inner[to] = value(frame)
        step(inner)
        result: int | bool = inner[result_at]
        return result

    return Value(function.result, run)


def _inputs(node: Call, function: Function, scope: Scope) -> tuple[tuple[int, Run], ...]:
    """Where each input stands in the function's frame, and how to compute it. All must be given, by name."""
    inputs = function.inputs()
    given = {argument.name.lower(): argument for argument in node.arguments}
    for name, argument in given.items():
        if name not in inputs or argument.out:
            names = ", ".join(slot.name for slot in inputs.values())
            raise StError(argument.spot, f"{function.block.name} takes {names or 'nothing'}, by name")
    found = []
    for name, slot in inputs.items():
        if name not in given:
            raise StError(node.spot, f"{function.block.name} lacks {slot.name}")
        assert isinstance(slot.type, Type)
        what = f"{slot.name} of {function.block.name}"
        found.append((slot.at, wanted(given[name].value, scope, slot.type, what)))
    return tuple(found)
