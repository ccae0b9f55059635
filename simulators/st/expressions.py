"""Expressions, by precedence climbing. Pure."""

from simulators.st.errors import StError
from simulators.st.literals import literal
from simulators.st.nodes import Argument, Binary, Call, Expression, Literal, Name, Unary
from simulators.st.reader import Reader
from simulators.st.types import BOOL

# IEC 61131-3:2013 table 71; a greater number binds more tightly
BINDING = {"OR": 1, "XOR": 2, "AND": 3, "&": 3, "=": 4, "<>": 4, "<": 5, ">": 5, "<=": 5, ">=": 5}
BINDING |= {"+": 6, "-": 6, "*": 7, "/": 7, "MOD": 7}


def expression(reader: Reader, binds: int = 1) -> Expression:
    """Read an expression whose operators bind at least so tightly."""
    with reader.nested():
        left = _operand(reader)
        while BINDING.get(_sign(reader), 0) >= binds:
            token = reader.operator()
            sign = "AND" if token.text == "&" else token.text
            left = Binary(token.spot, sign, left, expression(reader, BINDING[sign] + 1))
    return left


def _sign(reader: Reader) -> str:
    return reader.token.text if reader.token.kind in ("keyword", "sign") else ""


def _operand(reader: Reader) -> Expression:
    token = reader.token
    if reader.sees("NOT", "-"):
        reader.operator()
        with reader.nested():
            return Unary(token.spot, token.text, _operand(reader))
    if reader.accept("("):
        inner = expression(reader)
        reader.expect(")", "to close the parenthesis")
        return inner
    if reader.sees("TRUE", "FALSE"):
        return Literal(token.spot, reader.take().text == "TRUE", BOOL)
    if token.kind in ("number", "literal"):
        return literal(reader.take())
    if token.kind == "address":
        raise StError(token.spot, f"{token.text} is used directly; declare a variable AT {token.text}")
    named = name(reader, "a value")
    if not reader.sees("("):
        return named
    if len(named.parts) > 1:
        raise StError(named.spot, f"{named} is no function")
    return Call(named.spot, named.parts[0], arguments(reader))


def name(reader: Reader, what: str) -> Name:
    """Read `variable` or `instance.member`."""
    first = reader.name(what)
    if not reader.accept("."):
        return Name(first.spot, (first.text,))
    return Name(first.spot, (first.text, reader.name("the name of a member").text))


def arguments(reader: Reader) -> tuple[Argument, ...]:
    """Read the arguments of a call with its parentheses. One that has no name comes alone."""
    reader.expect("(", "to begin the arguments")
    found: list[Argument] = []
    while not reader.accept(")"):
        if found:
            reader.expect(",", "between arguments")
        argument = _argument(reader)
        if any(other.name.lower() == argument.name.lower() for other in found):
            raise StError(argument.spot, "more than one argument: name them" if not argument.name else "given twice")
        found.append(argument)
    return tuple(found)


def _argument(reader: Reader) -> Argument:
    token, sign = reader.token, reader.after.text
    if token.kind != "name" or sign not in (":=", "=>"):
        return Argument(token.spot, "", expression(reader))
    reader.take()
    reader.take()
    out = sign == "=>"
    return Argument(token.spot, token.text, name(reader, "a variable") if out else expression(reader), out)
