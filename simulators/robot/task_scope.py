"""Names as a program sees them: a SUB has variables of its own, and ERR and ERL tell of the last error."""

from dataclasses import dataclass, field

from simulators.robot.codes import Refusal
from simulators.robot.language.values import Value
from simulators.robot.machine import Machine, MachineScope
from simulators.robot.tables import GLOBALS, Variables


@dataclass
class Own:
    """The variables of one SUB that runs, and the names that it shares with the whole program."""

    variables: Variables = field(default_factory=Variables)
    shared: set[str] = field(default_factory=set)


class TaskScope(MachineScope):
    """`own` has one entry for each SUB that has been called and has not ended."""

    def __init__(self, machine: Machine) -> None:
        super().__init__(machine, strict=False)
        self.own: list[Own] = []
        self.error: Refusal | None = None

    def home(self, name: str) -> Variables:
        """Where a variable of this name is kept."""
        if not self.own or name in self.own[-1].shared or GLOBALS.fullmatch(name):
            return self._machine.variables
        return self.own[-1].variables

    def variable(self, name: str, indices: tuple[int, ...]) -> Value:
        """Raises Refusal."""
        return self.home(name).get(name, indices)

    def set_variable(self, name: str, indices: tuple[int, ...], value: Value) -> None:
        """Raises Refusal."""
        self.home(name).set(name, indices, value)

    def setting(self, name: str, index: int | None) -> Value:
        """Raises Refusal."""
        if name == "ERR":
            return self._machine.dialect.error_number(self.error.code) if self.error is not None else 0
        if name == "ERL":
            return (self.error.line or 0) if self.error is not None else 0
        return super().setting(name, index)
