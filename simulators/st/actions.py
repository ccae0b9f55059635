"""Statements become functions that change the frame. Pure."""

from collections.abc import Callable

from simulators.st.errors import StError
from simulators.st.library import Block, Frame, Run
from simulators.st.nodes import Argument, Assign, Body, Case, If, Invoke, Name, Statement
from simulators.st.scope import Scope
from simulators.st.types import BOOL, Type
from simulators.st.values import value_of, wanted

Act = Callable[[Frame], None]


def action_of(body: Body, scope: Scope) -> Act:
    """All statements one after the other."""
    acts = tuple(_act(statement, scope) for statement in body)
    if len(acts) == 1:
        return acts[0]

    def run(frame: Frame) -> None:
        for act in acts:
            act(frame)

    return run


def _act(statement: Statement, scope: Scope) -> Act:
    match statement:
        case Assign():
            return _assign(statement, scope)
        case Invoke():
            return _invoke(statement, scope)
        case If():
            return _if(statement, scope)
        case Case():
            return _case(statement, scope)


def _assign(statement: Assign, scope: Scope) -> Act:
    kind, at = scope.write(statement.target)
    value = wanted(statement.value, scope, kind, str(statement.target))

    def run(frame: Frame) -> None:
        frame[at] = value(frame)

    return run


def _invoke(statement: Invoke, scope: Scope) -> Act:
    slot, block = scope.instance(statement.instance)
    at, step = slot.at, block.step
    given = tuple(_input(argument, block, scope) for argument in statement.arguments if not argument.out)
    taken = tuple(_output(argument, block, scope) for argument in statement.arguments if argument.out)

    def run(frame: Frame) -> None:
        inner = frame[at]
        for to, value in given:
            inner[to] = value(frame)
        step(inner)
        for to, source in taken:
            frame[to] = inner[source]

    return run


def _input(argument: Argument, block: Block, scope: Scope) -> tuple[int, Run]:
    kind, at = _parameter(argument, block, "VAR_INPUT")
    return at, wanted(argument.value, scope, kind, f"{argument.name} of {block.name}")


def _output(argument: Argument, block: Block, scope: Scope) -> tuple[int, int]:
    kind, source = _parameter(argument, block, "VAR_OUTPUT")
    assert isinstance(argument.value, Name)
    target, to = scope.write(argument.value)
    if target is not kind:
        raise StError(argument.value.spot, f"{argument.name} of {block.name} is {kind.name} (got {target.name})")
    return to, source


def _parameter(argument: Argument, block: Block, section: str) -> tuple[Type, int]:
    slot = block.slots.get(argument.name.lower())
    if slot is None or slot.section != section or not isinstance(slot.type, Type):
        names = ", ".join(each.name for each in block.slots.values() if each.section == section)
        what = "inputs" if section == "VAR_INPUT" else "outputs"
        raise StError(argument.spot, f"{what} of {block.name} are {names or 'none'}, given by name")
    return slot.type, slot.at


def _if(statement: If, scope: Scope) -> Act:
    branches = tuple(
        (wanted(condition, scope, BOOL, "a condition"), action_of(body, scope))
        for condition, body in statement.branches
    )
    otherwise = action_of(statement.otherwise, scope)
    if len(branches) == 1:
        ((condition, then),) = branches
        return lambda frame: then(frame) if condition(frame) else otherwise(frame)

    def run(frame: Frame) -> None:
        for condition, then in branches:
            if condition(frame):
                then(frame)
                return
        otherwise(frame)

    return run


def _case(statement: Case, scope: Scope) -> Act:
    subject = value_of(statement.subject, scope)
    if subject.type.family != "int":
        raise StError(statement.spot, f"CASE goes by a whole number (got {subject.type.name})")
    table: dict[int | bool, Act] = {}
    for labels, body in statement.branches:
        act = action_of(body, scope)
        for label in labels:
            if label.value in table or not subject.type.holds(label.value):
                why = "stands twice" if label.value in table else f"does not fit into {subject.type.name}"
                raise StError(label.spot, f"label {label.value} {why}")
            table[label.value] = act
    otherwise, run = action_of(statement.otherwise, scope), subject.run
    return lambda frame: table.get(run(frame), otherwise)(frame)
