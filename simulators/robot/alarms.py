"""The standing alarm, and what has been reported: the controller's memory of its troubles."""

from collections import deque
from typing import NamedTuple

from simulators.robot.codes import Code
from simulators.robot.log import Log

REMEMBERED = 500


class Report(NamedTuple):
    """A code at a world time, with the line of the program that it concerns."""

    at_s: float
    code: Code
    line: int | None


class Alarms:
    """At most one alarm stands: the first, until it is reset; an emergency stop takes its place."""

    def __init__(self, log: Log) -> None:
        self.standing: Code | None = None
        self.history: deque[Report] = deque(maxlen=REMEMBERED)
        self._log = log

    def report(self, at_s: float, code: Code, line: int | None = None) -> None:
        """Something for the display; no alarm stands because of it."""
        self.history.append(Report(at_s, code, line))
        self._log.add("report", code=code, line=line)

    def trip(self, at_s: float, code: Code) -> None:
        """An alarm comes up."""
        if self.standing is None or code is Code.EMERGENCY_STOP:
            self.standing = code
        self.report(at_s, code)
        self._log.add("alarm", code=code)

    def reset(self) -> None:
        """Clear it."""
        self.standing = None
        self._log.add("alarm", code=None)
