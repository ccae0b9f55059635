"""The elementary data types: their ranges, and how values wrap around. Pure.

At run time BOOL is a bool, everything else an int; TIME counts microseconds.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Family = Literal["bool", "bits", "int", "time", "literal"]


@dataclass(frozen=True, slots=True)
class Type:
    """One elementary data type."""

    name: str
    family: Family
    bits: int = 0
    signed: bool = False

    def holds(self, value: int) -> bool:
        """Whether a literal of that value may stand where this type is wanted."""
        least = -(1 << (self.bits - 1)) if self.signed else 0
        return self.family in ("bits", "int") and least <= value < least + (1 << self.bits)

    def wrapping(self) -> Callable[[int], int]:
        """What keeps the low bits of a number, as the PLC's memory does."""
        mask, half, whole = (1 << self.bits) - 1, 1 << (self.bits - 1), 1 << self.bits
        if self.signed:
            return lambda value: ((value + half) & mask) - half if not -half <= value < half else value
        return lambda value: value & mask if not 0 <= value < whole else value


BOOL = Type("BOOL", "bool", 1)
TIME = Type("TIME", "time", 64, signed=True)
INT = Type("INT", "int", 16, signed=True)
LITERAL = Type("integer literal", "literal")  # takes the type of what it meets
TYPES = {
    each.name: each
    for each in (
        BOOL,
        Type("BYTE", "bits", 8),
        Type("WORD", "bits", 16),
        Type("DWORD", "bits", 32),
        Type("SINT", "int", 8, signed=True),
        INT,
        Type("DINT", "int", 32, signed=True),
        Type("USINT", "int", 8),
        Type("UINT", "int", 16),
        Type("UDINT", "int", 32),
        TIME,
    )
}
