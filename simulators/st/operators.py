"""What the operators do, per family of types: two ways to get a value become one. Pure."""

from collections.abc import Callable

from simulators.st.errors import Spot, StFault
from simulators.st.library import Frame, Run
from simulators.st.types import Type

Combine = Callable[[Run, Run], Run]
COMPARISONS: dict[str, Combine] = {
    "=": lambda a, b: lambda frame: a(frame) == b(frame),
    "<>": lambda a, b: lambda frame: a(frame) != b(frame),
    "<": lambda a, b: lambda frame: a(frame) < b(frame),
    ">": lambda a, b: lambda frame: a(frame) > b(frame),
    "<=": lambda a, b: lambda frame: a(frame) <= b(frame),
    ">=": lambda a, b: lambda frame: a(frame) >= b(frame),
}
EQUALITY = {sign: COMPARISONS[sign] for sign in ("=", "<>")}
LOGIC: dict[str, Combine] = {
    "AND": lambda a, b: lambda frame: a(frame) and b(frame),
    "OR": lambda a, b: lambda frame: a(frame) or b(frame),
    "XOR": lambda a, b: lambda frame: a(frame) != b(frame),
}
BITWISE: dict[str, Combine] = {
    "AND": lambda a, b: lambda frame: a(frame) & b(frame),
    "OR": lambda a, b: lambda frame: a(frame) | b(frame),
    "XOR": lambda a, b: lambda frame: a(frame) ^ b(frame),
}
COMPARES = {"bool": EQUALITY, "bits": EQUALITY, "int": COMPARISONS, "time": COMPARISONS, "literal": COMPARISONS}


def comparison(sign: str, kind: Type) -> Combine | None:
    """How values of that type are compared, None when they are not."""
    return COMPARES[kind.family].get(sign)


def operation(sign: str, kind: Type, spot: Spot) -> Combine | None:
    """How two values of that type make a third, None when they do not."""
    if kind.family == "bool":
        return LOGIC.get(sign)
    if kind.family == "bits":
        return BITWISE.get(sign)
    if kind.family == "time":
        return _ADDING.get(sign)
    wrap = (lambda value: value) if kind.family == "literal" else kind.wrapping()
    return _arithmetic(wrap, spot).get(sign)


_ADDING: dict[str, Combine] = {
    "+": lambda a, b: lambda frame: a(frame) + b(frame),
    "-": lambda a, b: lambda frame: a(frame) - b(frame),
}


def _arithmetic(wrap: Callable[[int], int], spot: Spot) -> dict[str, Combine]:
    def divided(a: Run, b: Run) -> Run:
        return lambda frame: wrap(_quotient(a(frame), b(frame), spot))

    def remaining(a: Run, b: Run) -> Run:
        def run(frame: Frame) -> int:
            left, right = a(frame), b(frame)
            return wrap(left - right * _quotient(left, right, spot))

        return run

    return {
        "+": lambda a, b: lambda frame: wrap(a(frame) + b(frame)),
        "-": lambda a, b: lambda frame: wrap(a(frame) - b(frame)),
        "*": lambda a, b: lambda frame: wrap(a(frame) * b(frame)),
        "/": divided,
        "MOD": remaining,
    }


def _quotient(left: int, right: int, spot: Spot) -> int:
    """Towards zero, as IEC 61131-3 has it."""
    if right == 0:
        raise StFault(spot, "division by zero")
    whole = abs(left) // abs(right)
    return whole if (left < 0) == (right < 0) else -whole
