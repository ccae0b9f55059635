"""What names mean inside one program unit. Pure."""

from dataclasses import dataclass
from operator import itemgetter

from simulators.st.errors import StError
from simulators.st.functions import Function
from simulators.st.library import Block, Run, Slot
from simulators.st.nodes import Name
from simulators.st.types import Type


@dataclass(frozen=True, slots=True)
class Scope:
    """The variables of a unit, and the functions that were declared before it. Names in small letters."""

    slots: dict[str, Slot]
    functions: dict[str, Function]

    def slot(self, name: Name) -> Slot:
        """The unit's own variable with the first part of that name."""
        slot = self.slots.get(name.parts[0].lower())
        if slot is None:
            raise StError(name.spot, f"{name.parts[0]} is not declared")
        return slot

    def instance(self, name: Name) -> tuple[Slot, Block]:
        """The function block that this name stands for."""
        slot = self.slot(name)
        if len(name.parts) > 1 or not isinstance(slot.type, Block):
            raise StError(name.spot, f"{name} is no function block, so it cannot be called as a statement")
        return slot, slot.type

    def read(self, name: Name) -> tuple[Type, Run, int | bool | None]:
        """Type, reading and, where it never changes, value of what this name stands for."""
        slot = self.slot(name)
        if len(name.parts) == 1:
            if isinstance(slot.type, Block):
                raise StError(name.spot, f"{name} is a function block; name one of its outputs")
            return slot.type, itemgetter(slot.at), slot.constant
        member = self._output(name, slot)
        at, inner = slot.at, member.at
        assert isinstance(member.type, Type)
        return member.type, lambda frame: frame[at][inner], None

    def _output(self, name: Name, slot: Slot) -> Slot:
        if not isinstance(slot.type, Block):
            raise StError(name.spot, f"{name.parts[0]} is no function block, so it has no {name.parts[1]}")
        member = slot.type.slots.get(name.parts[1].lower())
        if member is None or member.section != "VAR_OUTPUT":
            raise StError(name.spot, f"{name.parts[1]} is no output of {slot.type.name}")
        return member

    def write(self, name: Name) -> tuple[Type, int]:
        """Type and place in the frame of a variable that a statement may change."""
        slot = self.slot(name)
        refused = ""
        if len(name.parts) > 1 or isinstance(slot.type, Block):
            refused = "only its own call changes a function block"
        elif slot.constant is not None:
            refused = "it is a CONSTANT"
        elif slot.section == "VAR_INPUT":
            refused = "only the caller sets a VAR_INPUT"
        elif slot.address.startswith("%I"):
            refused = f"it is the input {slot.address}"
        if refused or isinstance(slot.type, Block):
            raise StError(name.spot, f"{name} cannot be assigned: {refused}")
        return slot.type, slot.at
