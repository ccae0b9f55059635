"""Characters to tokens with their places. Pure.

Lexical elements after IEC 61131-3:2013 table 1..8, less what not every PLC brand has: only (* *) comments, no pragmas,
no strings, ASCII outside comments.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

from simulators.st.errors import Spot, StError

TOKEN = re.compile(
    r"""(?P<blank>[ \t\r\n\f]+)
    |(?P<comment>\(\*.*?\*\))
    |(?P<address>%[A-Za-z0-9.]+)
    |(?P<literal>[A-Za-z0-9_]+\#(?:-?[0-9A-Za-z_.]+)?(?:\#[0-9A-Za-z_]+)?)
    |(?P<number>\d[\d_]*(?:\.\d[\d_]*)?(?:[Ee][-+]?\d+)?)
    |(?P<name>[A-Za-z_][A-Za-z0-9_]*)
    |(?P<sign>:=|=>|<=|>=|<>|\*\*|\.\.|[-+*/=<>(),;:.&\[\]])
    |(?P<odd>.)""",
    re.ASCII | re.VERBOSE | re.DOTALL,
)


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


KEYWORDS = _words(
    """AND AT CASE CONSTANT ELSE ELSIF END_CASE END_FUNCTION END_FUNCTION_BLOCK END_IF END_PROGRAM END_VAR FALSE
    FUNCTION FUNCTION_BLOCK IF MOD NOT OF OR PROGRAM RETAIN THEN TRUE VAR VAR_INPUT VAR_OUTPUT XOR"""
)
NOT_SUPPORTED = _words(
    """ABSTRACT ACTION ARRAY BY CLASS CONFIGURATION DATE DATE_AND_TIME DO DT END_ACTION END_CONFIGURATION END_FOR
    END_REPEAT END_RESOURCE END_STEP END_STRUCT END_TRANSITION END_TYPE END_WHILE EXIT EXTENDS F_EDGE FINAL FOR FROM
    GOTO IMPLEMENTS INITIAL_STEP INTERFACE INTERNAL LDATE LINT LREAL LTIME LWORD METHOD NAMESPACE NON_RETAIN ON OVERRIDE
    PERSISTENT POINTER PRIORITY PRIVATE PROTECTED PUBLIC R_EDGE READ_ONLY READ_WRITE REAL REF_TO REPEAT RESOURCE RETURN
    SINGLE STEP STRING STRUCT SUPER TASK THIS TIME_OF_DAY TO TOD TRANSITION TYPE ULINT UNTIL USING VAR_ACCESS
    VAR_CONFIG VAR_EXTERNAL VAR_GLOBAL VAR_IN_OUT VAR_TEMP WHILE WITH WSTRING"""
)
ODD = {
    "(": "comment is never closed with *)",
    "/": "comments are written (* like this *)",
    "{": "pragmas are not portable",
    "'": "strings are not supported",
    '"': "strings are not supported",
    "%": "an address is written %IX0.0, %QX0.0, %IW0 or %MW0",
    "#": "a literal is written 16#FF or T#500ms",
}


class Token(NamedTuple):
    """`kind` is keyword, name, number, literal, address, sign or end; `text` is in capitals for keywords."""

    kind: str
    text: str
    spot: Spot


def tokens_of(source: str) -> list[Token]:
    """All tokens, the last of kind end. Raises StError at the first character that starts none."""
    return list(_tokens(source))


def _tokens(source: str) -> Iterator[Token]:
    line, line_at = 1, 0
    for match in TOKEN.finditer(source):
        kind, text = match.lastgroup or "odd", match[0]
        spot = Spot(line, match.start() - line_at + 1)
        if kind not in ("blank", "comment"):
            yield _checked(kind, text, spot, source[match.start() : match.start() + 2])
        if breaks := text.count("\n"):
            line, line_at = line + breaks, match.start() + text.rindex("\n") + 1
    yield Token("end", "the end of the file", Spot(line, len(source) - line_at + 1))


def _checked(kind: str, text: str, spot: Spot, two: str) -> Token:
    if two in ("(*", "//", "/*"):
        raise StError(spot, ODD[two[0]])
    if kind == "odd":
        raise StError(spot, ODD.get(text, f"{text!r} has no meaning here"))
    if kind != "name":
        return Token(kind, text, spot)
    if text.upper() in NOT_SUPPORTED:
        raise StError(spot, f"{text.upper()} is a keyword that is not supported")
    if "__" in text or text.endswith("_"):
        raise StError(spot, f"{text}: underscores that are doubled or last are not portable")
    return Token("keyword", text.upper(), spot) if text.upper() in KEYWORDS else Token("name", text, spot)
