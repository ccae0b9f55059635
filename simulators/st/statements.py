"""Statements. None of them loops or jumps, so every scan comes to its end. Pure."""

from simulators.st.errors import StError
from simulators.st.expressions import arguments, expression, name
from simulators.st.literals import literal
from simulators.st.nodes import Assign, Body, Case, Expression, If, Invoke, Literal, Statement
from simulators.st.reader import Reader
from simulators.st.types import LITERAL


def body(reader: Reader, *ends: str, to_label: bool = False) -> Body:
    """Read statements up to one of these keywords, or to the next label of CASE; that is left standing."""
    found = []
    with reader.nested():
        while not (reader.sees(*ends) or reader.token.kind == "end" or (to_label and _at_label(reader))):
            if not reader.accept(";"):
                found.append(_statement(reader))
                reader.expect(";", "after the statement")
    return tuple(found)


def _at_label(reader: Reader) -> bool:
    return reader.token.kind in ("number", "literal") or reader.sees("-")


def _statement(reader: Reader) -> Statement:
    reader.operators = 0
    if reader.accept("IF"):
        return _if(reader)
    if reader.accept("CASE"):
        return _case(reader)
    target = name(reader, "a statement")
    if reader.sees("("):
        return Invoke(target, arguments(reader))
    reader.expect(":=", f"after {target}")
    return Assign(target, expression(reader))


def _if(reader: Reader) -> If:
    branches = [_branch(reader)]
    while reader.accept("ELSIF"):
        branches.append(_branch(reader))
    return If(tuple(branches), _otherwise(reader, "END_IF"))


def _branch(reader: Reader) -> tuple[Expression, Body]:
    reader.operators = 0
    condition = expression(reader)
    reader.expect("THEN", "after the condition")
    return condition, body(reader, "ELSIF", "ELSE", "END_IF")


def _otherwise(reader: Reader, end: str) -> Body:
    statements = body(reader, end) if reader.accept("ELSE") else ()
    reader.expect(end, "to end the statement")
    return statements


def _case(reader: Reader) -> Case:
    spot = reader.token.spot
    subject = expression(reader)
    reader.expect("OF", "after the value of CASE")
    branches = []
    while not reader.sees("ELSE", "END_CASE"):
        labels = [_label(reader)]
        while reader.accept(","):
            labels.append(_label(reader))
        reader.expect(":", "after the labels of CASE")
        branches.append((tuple(labels), body(reader, "ELSE", "END_CASE", to_label=True)))
    return Case(spot, subject, tuple(branches), _otherwise(reader, "END_CASE"))


def _label(reader: Reader) -> Literal:
    spot = reader.token.spot
    negative = reader.accept("-")
    label = literal(reader.literal("a number as label of CASE"))
    if label.type is not LITERAL:
        raise StError(spot, "labels of CASE are plain numbers")
    return Literal(spot, -label.value if negative else label.value, LITERAL)
