"""What is wrong in a Structured Text program, and where. Pure."""

from typing import NamedTuple


class Spot(NamedTuple):
    """A place in the source; both count from 1."""

    line: int
    column: int


class StError(Exception):
    """The program is not in the subset, or contradicts itself. `str()` is file:line:column: what is wrong."""

    def __init__(self, spot: Spot, message: str) -> None:
        super().__init__(message)
        self.spot = spot
        self.message = message
        self.source = "program"

    def __str__(self) -> str:
        return f"{self.source}:{self.spot.line}:{self.spot.column}: {self.message}"


class StFault(StError):
    """A running program did what a PLC answers with STOP: it divided by zero."""
