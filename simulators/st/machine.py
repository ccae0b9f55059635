"""A program in a PLC: its memory, one scan after the other, its addresses, and the online view by name. Pure."""

from collections.abc import Mapping

from simulators.st.compiler import compile_program
from simulators.st.errors import StError
from simulators.st.library import NOWHERE, Block, Frame, Slot, TimeBase
from simulators.st.types import BOOL, Type

NO_TIME_OF_ITS_OWN: Mapping[str, TimeBase] = {}


class Machine:
    """Executes the one PROGRAM of a source text. Raises StError when the source is not in the subset.

    Timers look at `time`, which whoever calls `scan` moves on. `time_of` gives the function blocks at these paths
    ("client", "client.silent") another time; StError when there are none.
    """

    def __init__(
        self,
        source: str,
        *,
        name: str = "program",
        time: TimeBase,
        time_of: Mapping[str, TimeBase] = NO_TIME_OF_ITS_OWN,
    ) -> None:
        try:
            self._program = compile_program(source)
            if unknown := [path for path in time_of if not isinstance(_kind(self._program, path), Block)]:
                raise StError(NOWHERE, f"there is no function block {', '.join(unknown)} in the PROGRAM")
        except StError as error:
            error.source = name
            raise
        self._time, self._time_of = time, dict(time_of)
        self._name = name
        self._frame: Frame = []
        self._start()

    def _start(self) -> None:
        self._frame[:] = self._program.frame(self._time, self._time_of)

    def scan(self) -> None:
        """One cycle. Raises StFault where a PLC would stop."""
        try:
            self._program.step(self._frame)
        except StError as fault:
            fault.source = self._name
            raise

    def power_cycle(self) -> None:
        """All variables get their initial values but those that are RETAIN."""
        kept = {slot.at: self._frame[slot.at] for slot in self._program.slots.values() if slot.retain}
        self._start()
        for at, value in kept.items():
            self._frame[at] = value

    @property
    def memory(self) -> Frame:
        """The program's own memory, for fast exchange; the places are in `located`. It is the same list for ever."""
        return self._frame

    def located(self, prefix: str) -> dict[str, int]:
        """Where in the memory the variables are whose addresses begin so, by address."""
        slots = self._program.slots.values()
        return {slot.address: slot.at for slot in slots if slot.address.startswith(prefix)}

    def __getitem__(self, path: str) -> int | bool:
        """The value of a variable, as "accepted" or "client.served"."""
        frame, slot = self._find(path)
        value: int | bool = frame[slot.at]
        return value

    def __setitem__(self, path: str, value: int | bool) -> None:
        """Force a variable; raises ValueError when the value does not fit."""
        frame, slot = self._find(path)
        assert isinstance(slot.type, Type)
        fits = isinstance(value, bool) if slot.type is BOOL else slot.type.family == "time" or slot.type.holds(value)
        if not fits:
            raise ValueError(f"{path} is {slot.type.name} (got {value!r})")
        frame[slot.at] = value

    def _find(self, path: str) -> tuple[Frame, Slot]:
        frame, block = self._frame, self._program
        *instances, last = path.lower().split(".")
        for name in instances:
            slot = block.slots.get(name)
            if slot is None or not isinstance(slot.type, Block):
                raise KeyError(f"{self._name} has no {path}")
            frame, block = frame[slot.at], slot.type
        slot = block.slots.get(last)
        if slot is None or isinstance(slot.type, Block):
            raise KeyError(f"{self._name} has no {path}")
        return frame, slot


def _kind(block: Block, path: str) -> Type | Block | None:
    kind: Type | Block | None = block
    for name in path.lower().split("."):
        slot = kind.slots.get(name) if isinstance(kind, Block) else None
        kind = slot.type if slot else None
    return kind
