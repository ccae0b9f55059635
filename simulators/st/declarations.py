"""Program units and their variables. Pure."""

import re
from dataclasses import replace

from simulators.st.errors import StError
from simulators.st.literals import literal
from simulators.st.nodes import Literal, Unit, Variable
from simulators.st.reader import Reader
from simulators.st.statements import body
from simulators.st.tokens import Token
from simulators.st.types import BOOL, LITERAL

UNITS = {"FUNCTION": "END_FUNCTION", "FUNCTION_BLOCK": "END_FUNCTION_BLOCK", "PROGRAM": "END_PROGRAM"}
SECTIONS = ("VAR", "VAR_INPUT", "VAR_OUTPUT")
NUMBER = r"(?:0|[1-9]\d{0,4})"
ADDRESS = re.compile(rf"%[IQM](?:X{NUMBER}\.[0-7]|[BWD]{NUMBER})", re.ASCII)


def parse(source: str) -> tuple[Unit, ...]:
    """The units of a program in their order; raises StError with the place of the first fault."""
    reader = Reader(source)
    units = []
    while reader.token.kind != "end":
        units.append(_unit(reader))
    return tuple(units)


def _unit(reader: Reader) -> Unit:
    if not reader.sees(*UNITS):
        raise reader.wrong("FUNCTION, FUNCTION_BLOCK or PROGRAM")
    kind = reader.take().text
    named = reader.name(f"the name of the {kind}")
    result = ""
    if kind == "FUNCTION":
        reader.expect(":", "before the type of the function")
        result = reader.name("the type of the function").text
    variables: list[Variable] = []
    while reader.sees(*SECTIONS):
        variables += _section(reader)
    statements = body(reader, UNITS[kind])
    reader.expect(UNITS[kind], f"to end {named.text}")
    return Unit(named.spot, kind, named.text, result, tuple(variables), statements)


def _section(reader: Reader) -> list[Variable]:
    section = reader.take().text
    constant, retain = reader.accept("CONSTANT"), reader.accept("RETAIN")
    found: list[Variable] = []
    while not reader.accept("END_VAR"):
        for variable in _declaration(reader, section):
            if found and bool(found[0].address) != bool(variable.address):
                raise StError(variable.spot, "variables with an address need a VAR block of their own")
            found.append(replace(variable, constant=constant, retain=retain))
    return found


def _declaration(reader: Reader, section: str) -> list[Variable]:
    names = [reader.name("a variable or END_VAR")]
    while reader.accept(","):
        names.append(reader.name("a variable"))
    address = _address(reader, names)
    reader.expect(":", f"before the type of {names[-1].text}")
    kind = reader.name("a type")
    initial = _initial(reader) if reader.accept(":=") else None
    reader.expect(";", "after the declaration")
    return [Variable(name.spot, name.text, section, kind.text, kind.spot, initial, address=address) for name in names]


def _address(reader: Reader, names: list[Token]) -> str:
    if not reader.accept("AT"):
        return ""
    token = reader.take()
    if token.kind != "address" or not ADDRESS.fullmatch(token.text.upper()):
        raise StError(token.spot, f"an address is written %IX0.0, %QX0.0, %IW0 or %MW0 (got {token.text})")
    if len(names) > 1:
        raise StError(names[1].spot, f"two variables at {token.text}")
    return token.text.upper()


def _initial(reader: Reader) -> Literal:
    token = reader.token
    if reader.sees("TRUE", "FALSE"):
        return Literal(token.spot, reader.take().text == "TRUE", BOOL)
    negative = reader.accept("-")
    value = literal(reader.literal("a literal as initial value"))
    if negative and value.type is not LITERAL:
        raise StError(token.spot, "write the sign inside the literal")
    return Literal(token.spot, -value.value if negative else value.value, value.type)
