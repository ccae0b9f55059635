"""Numbers, based numbers, typed numbers and durations as they are written. Pure."""

import re

from simulators.st.errors import StError
from simulators.st.nodes import Literal
from simulators.st.tokens import Token
from simulators.st.types import BOOL, LITERAL, TIME, TYPES

US_PER = {"d": 86_400_000_000, "h": 3_600_000_000, "m": 60_000_000, "s": 1_000_000, "ms": 1000}
DURATION = re.compile(r"(-?)" + "".join(rf"(?:(\d+(?:\.\d+)?){unit}_?)?" for unit in US_PER), re.ASCII | re.IGNORECASE)
LONGEST_MS = 2**31 - 1  # a TIME of 32 bits, as many PLCs have it
DIGITS = {"2": "01", "8": "01234567", "16": "0123456789ABCDEF"}
MOST_DIGITS = 40


def literal(token: Token) -> Literal:
    """The value of a number or literal token; raises StError when it has none."""
    if token.kind == "number":
        return Literal(token.spot, _decimal(token, token.text), LITERAL)
    prefix, _, rest = token.text.partition("#")
    if prefix.upper() in ("T", "TIME"):
        return Literal(token.spot, _duration_us(token, rest), TIME)
    if prefix in DIGITS:
        return Literal(token.spot, _based(token, prefix, rest), LITERAL)
    return _typed(token, prefix.upper(), rest)


def _typed(token: Token, prefix: str, rest: str) -> Literal:
    kind = TYPES.get(prefix)
    if kind is None:
        raise StError(token.spot, f"{token.text}: there is no type {prefix}; bases are 2, 8 and 16")
    if kind is BOOL:
        if rest.upper() not in ("0", "1", "TRUE", "FALSE"):
            raise StError(token.spot, f"{token.text}: BOOL is TRUE or FALSE")
        return Literal(token.spot, rest.upper() in ("1", "TRUE"), BOOL)
    base, sharp, digits = rest.partition("#")
    if sharp and base not in DIGITS:
        raise StError(token.spot, f"{token.text}: bases are 2, 8 and 16")
    value = _based(token, base, digits) if sharp else _signed(token, rest)
    if not kind.holds(value):
        raise StError(token.spot, f"{value} does not fit into {kind.name}")
    return Literal(token.spot, value, kind)


def _signed(token: Token, text: str) -> int:
    return -_decimal(token, text[1:]) if text.startswith("-") else _decimal(token, text)


def _decimal(token: Token, text: str) -> int:
    digits = text.replace("_", "")
    if not (digits.isdigit() and len(digits) <= MOST_DIGITS):
        raise StError(token.spot, f"{token.text[:MOST_DIGITS]} is no whole number (REAL is not supported)")
    return int(digits)


def _based(token: Token, base: str, text: str) -> int:
    digits = text.replace("_", "").upper()
    if not digits or len(digits) > MOST_DIGITS or set(digits) - set(DIGITS[base]):
        raise StError(token.spot, f"{token.text[:MOST_DIGITS]} is no number to base {base}")
    return int(digits, int(base))


def _duration_us(token: Token, text: str) -> int:
    match = DURATION.fullmatch(text)
    if match is None or not any(match.groups()[1:]):
        raise StError(token.spot, f"{token.text}: a duration is written T#1h2m3s500ms")
    given = [(number, US_PER[unit]) for number, unit in zip(match.groups()[1:], US_PER, strict=True) if number]
    if any("." in number for number, _ in given[:-1]):
        raise StError(token.spot, f"{token.text}: only the last part may have decimals")
    if any(len(number) > MOST_DIGITS for number, _ in given):
        raise StError(token.spot, "a TIME has 32 bits of ms, less than 25 days")
    total_us = sum(_exact_us(number, unit_us) for number, unit_us in given)
    if total_us > LONGEST_MS * 1000:
        raise StError(token.spot, f"{token.text}: a TIME has 32 bits of ms, less than 25 days")
    return -total_us if match[1] else total_us


def _exact_us(number: str, unit_us: int) -> int:
    whole, _, decimals = number.partition(".")
    return int(whole) * unit_us + int(decimals or "0") * unit_us // int(10 ** len(decimals))
