"""What truly happened at the controller, in order: the witness of every test about safety and lost links."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

REMEMBERED = 20_000


@dataclass(frozen=True, slots=True)
class Entry:
    """One event at a world time. `facts` depend on the kind; lengths in mm, angles in degrees, times in s."""

    number: int
    at_s: float
    kind: str
    facts: dict[str, Any]

    def __getattr__(self, name: str) -> Any:
        try:
            return self.facts[name]
        except KeyError:
            raise AttributeError(f"{self.kind} has no {name}") from None


class Log:
    """Entries of these kinds:

    joined, left (logged_out), turned away (client) · heard, said (client, line) · control (client, byte)
    refused (client, code) · moves (way, begins, ends, begins_s, ends_s, blends) · halted (at, stands_s)
    pendant moves (to) · safety (emergency, guard_open, enable) · power (motor, servo) · alarm, report (code)
    mode (mode) · output (port, byte) · program (task, name, state, line) · print (task, values)
    injected (fault, params)
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self.entries: deque[Entry] = deque(maxlen=REMEMBERED)
        self.listener: Callable[[Entry], None] | None = None
        self._now = now
        self._count = 0

    def add(self, kind: str, /, **facts: Any) -> None:
        """Write down what happens now."""
        self._count += 1
        entry = Entry(self._count, self._now(), kind, facts)
        self.entries.append(entry)
        if self.listener is not None:
            self.listener(entry)

    def of(self, *kinds: str, since: int = 0) -> list[Entry]:
        """The entries of these kinds whose number is above `since`."""
        return [entry for entry in self.entries if entry.kind in kinds and entry.number > since]
