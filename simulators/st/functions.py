"""The conversions X_TO_Y, and what else an expression may call. Pure.

Conversions keep the low bits, as IEC 61131-3 leaves it to the maker and nearly all do; TIME converts from and to ms.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from simulators.st.library import Block, Slot
from simulators.st.types import BOOL, TYPES, Type

US_PER_MS = 1000


@dataclass(frozen=True, slots=True)
class Function:
    """A FUNCTION of the program: `block` has its inputs, and its result under its own name."""

    block: Block
    result: Type

    def inputs(self) -> dict[str, Slot]:
        """By name in small letters."""
        return {name: slot for name, slot in self.block.slots.items() if slot.section == "VAR_INPUT"}


@dataclass(frozen=True, slots=True)
class Conversion:
    """A function of the language, X_TO_Y."""

    name: str
    source: Type
    result: Type
    work: Callable[[Any], Any]


def conversion(name: str) -> Conversion | None:
    """The conversion of that name (any case), None when there is none."""
    source, to, target = name.upper().partition("_TO_")
    if to and source != target and source in TYPES and target in TYPES:
        return _conversion(name.upper(), TYPES[source], TYPES[target])
    return None


def _conversion(name: str, source: Type, target: Type) -> Conversion | None:
    if "time" in (source.family, target.family):
        return _time_conversion(name, source, target)
    if target is BOOL:
        return Conversion(name, source, target, bool)
    wrap = target.wrapping()
    return Conversion(name, source, target, lambda value: wrap(int(value)))


def _time_conversion(name: str, source: Type, target: Type) -> Conversion | None:
    if source.family == "int":
        return Conversion(name, source, target, lambda value: value * US_PER_MS)
    if target.family != "int":
        return None
    wrap = target.wrapping()
    return Conversion(name, source, target, lambda value: wrap(value // US_PER_MS))
