"""Program units become blocks and functions, with every declaration checked. Pure."""

from dataclasses import dataclass, field
from functools import lru_cache

from simulators.st.actions import action_of
from simulators.st.declarations import parse
from simulators.st.errors import Spot, StError
from simulators.st.functions import Function, conversion
from simulators.st.library import STANDARD_BLOCKS, Block, Slot
from simulators.st.nodes import Unit, Variable
from simulators.st.scope import Scope
from simulators.st.types import BOOL, LITERAL, TIME, TYPES, Type

WIDTHS = {"X": 1, "B": 8, "W": 16, "D": 32}


@dataclass
class _Known:
    """What was declared so far. A unit uses only what stands above it, so nothing can contain itself."""

    functions: dict[str, Function] = field(default_factory=dict)
    blocks: dict[str, Block] = field(default_factory=lambda: dict(STANDARD_BLOCKS))
    programs: list[Block] = field(default_factory=list)

    def check_free(self, name: str, spot: Spot) -> None:
        """Raise StError when that name has a meaning already."""
        small = name.lower()
        taken = small in self.functions or small in self.blocks or name.upper() in TYPES or conversion(name)
        if taken or any(small == program.name.lower() for program in self.programs):
            raise StError(spot, f"{name} is the name of something else")


@lru_cache(maxsize=4)
def compile_program(source: str) -> Block:
    """The one PROGRAM of a source text; raises StError with the place of the first fault."""
    known = _Known()
    units = parse(source)
    for unit in units:
        known.check_free(unit.name, unit.spot)
        _compile(unit, known)
    if len(known.programs) != 1:
        spot = units[-1].spot if units else Spot(1, 1)
        raise StError(spot, f"exactly one PROGRAM is needed (got {len(known.programs)})")
    return known.programs[0]


def _compile(unit: Unit, known: _Known) -> None:
    slots: dict[str, Slot] = {}
    for variable in unit.variables:
        known.check_free(variable.name, variable.spot)
        if variable.name.lower() in (*slots, unit.name.lower()):
            raise StError(variable.spot, f"{variable.name} is declared twice")
        slots[variable.name.lower()] = _slot(variable, unit, known, at=len(slots) + 1)
    _check_addresses(slots)
    if unit.kind == "FUNCTION":
        known.functions[unit.name.lower()] = _function(unit, slots, known)
        return
    block = Block(unit.name, slots, action_of(unit.body, Scope(slots, known.functions)))
    if unit.kind == "PROGRAM":
        known.programs.append(block)
    else:
        known.blocks[unit.name.lower()] = block


def _slot(variable: Variable, unit: Unit, known: _Known, at: int) -> Slot:
    kind = TYPES.get(variable.type_name.upper()) or known.blocks.get(variable.type_name.lower())
    if kind is None:
        raise StError(variable.type_spot, f"there is no type {variable.type_name} (types stand before their use)")
    if why := _forbidden(variable, unit.kind, kind):
        raise StError(variable.spot, f"{variable.name}: {why}")
    initial = _initial(variable, kind) if isinstance(kind, Type) else 0
    return Slot(
        at,
        variable.name,
        kind,
        variable.section,
        initial,
        initial if variable.constant else None,
        variable.retain,
        variable.address,
        variable.spot,
    )


def _forbidden(variable: Variable, unit_kind: str, kind: Type | Block) -> str:
    """Why such a variable cannot be, empty when it can."""
    in_var = variable.section == "VAR"
    reasons = {
        "a PROGRAM has neither inputs nor outputs": unit_kind == "PROGRAM" and not in_var,
        "a FUNCTION has no outputs but its result": unit_kind == "FUNCTION" and variable.section == "VAR_OUTPUT",
        "a FUNCTION keeps nothing, so it has no function blocks": unit_kind == "FUNCTION" and isinstance(kind, Block),
        "only a PROGRAM has RETAIN variables": variable.retain and unit_kind != "PROGRAM",
        "only variables in VAR are CONSTANT or RETAIN": (variable.constant or variable.retain) and not in_var,
        "only a PROGRAM has addresses": bool(variable.address) and unit_kind != "PROGRAM",
        "a function block has no value, no address, and is not RETAIN": isinstance(kind, Block)
        and bool(variable.constant or variable.retain or variable.initial or variable.address),
        "a CONSTANT needs a value": variable.constant and variable.initial is None,
        "a CONSTANT has no address": bool(variable.address and variable.constant),
    }
    return next((reason for reason, holds in reasons.items() if holds), "")


def _initial(variable: Variable, kind: Type) -> int | bool:
    given = variable.initial
    if given is None:
        return False if kind is BOOL else 0
    if given.type is kind or (given.type is LITERAL and kind.holds(given.value)):
        return given.value
    raise StError(given.spot, f"{variable.name} is {kind.name}, which this value is not")


def _check_addresses(slots: dict[str, Slot]) -> None:
    seen: dict[str, Slot] = {}
    for slot in slots.values():
        if not slot.address:
            continue
        assert isinstance(slot.type, Type)
        if slot.address in seen:
            raise StError(slot.spot, f"{slot.name}: {slot.address} is {seen[slot.address].name} already")
        if slot.type is TIME or slot.type.bits != WIDTHS[slot.address[2]]:
            raise StError(slot.spot, f"{slot.name}: {slot.type.name} does not fit to {slot.address}")
        seen[slot.address] = slot


def _function(unit: Unit, slots: dict[str, Slot], known: _Known) -> Function:
    result = TYPES.get(unit.result.upper())
    if result is None:
        raise StError(unit.spot, f"there is no type {unit.result}")
    own = Slot(len(slots) + 1, unit.name, result, "VAR", False if result is BOOL else 0)
    slots = {**slots, unit.name.lower(): own}
    return Function(Block(unit.name, slots, action_of(unit.body, Scope(slots, known.functions))), result)
