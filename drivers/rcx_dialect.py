"""What a driver must know about one generation of controllers. Pure; the two generations are in `rcx2` and `rcx3`."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

from drivers.rcx import LONGEST_COMMAND, Code, Motion, RobotStatus, command
from drivers.rcx_codes import meaning

BUSY = ("0.5", "0.8")  # busy, try again


class Grammar(NamedTuple):
    """How lines answer each other."""

    ok_after_data: bool  # a question is answered by its data and OK; else by the data alone
    run_before_end: bool  # an operation is answered by RUN and ended by END; else one OK ends it
    answers_in_motion: bool  # also while the arm moves; else what is asked meanwhile waits


class Lines(NamedTuple):
    """What is sent for one motion: settings, each answered by OK, and the operation."""

    settings: tuple[str, ...]
    operation: str


class Dialect(ABC):
    """One generation. Texts of commands are without their `@`."""

    name: ClassVar[str]
    grammar: ClassVar[Grammar]
    decimals: ClassVar[int]  # of millimetres and degrees
    highest_point: ClassVar[int]
    greeting_s: ClassVar[float]  # in which a network client has been greeted, or never will be
    good_bye: ClassVar[str]  # with which a network client leaves; "" when it just goes
    before_talk: ClassVar[tuple[str, ...]]  # sent first on a network, each may be refused
    power_on: ClassVar[str]
    power_off: ClassVar[str]
    alarm_reset: ClassVar[str]
    origin_return: ClassVar[str]
    status_queries: ClassVar[tuple[str, ...]]
    hand_query: ClassVar[str]
    first_query: ClassVar[str]
    speed_query: ClassVar[str]  # of the automatic speed
    codes: ClassVar[dict[tuple[int, int], str]]

    def meaning(self, code: Code) -> str:
        """A readable phrase, also for a code that is not in the table."""
        return meaning(self.codes, *code)

    def is_busy(self, code: str) -> bool:
        """Whether the same command may be accepted a moment later."""
        return code in BUSY

    def number(self, value: float) -> str:
        """A length or an angle: without its decimal point it would be pulses. Raises ValueError for nan and inf."""
        if not math.isfinite(value):
            raise ValueError(f"{value} is no length or angle")
        return f"{round(value, self.decimals) + 0.0:.{self.decimals}f}"  # adding 0.0 turns -0.000 into 0.000

    @abstractmethod
    def more_queries(self, answers: Sequence[str]) -> tuple[str, ...]:
        """What else must be asked after these answers to `status_queries`; their answers may look like refusals."""

    @abstractmethod
    def status(self, answers: Sequence[str]) -> RobotStatus | None:
        """The answers to `status_queries` and `more_queries`; None when one of them cannot be read."""

    @abstractmethod
    def is_collision(self, code: Code) -> bool:
        """Whether the arm has most likely hit something, and may not stand where it says."""

    @abstractmethod
    def is_event(self, code: Code) -> bool:
        """Whether it reports something that has happened, as a stop, and so never answers a question."""

    @abstractmethod
    def move(self, motion: Motion) -> Lines:
        """Go there, point to point, on a line or over an arch. Raises ValueError for what cannot be said."""

    @abstractmethod
    def jog(self, axis: int, sign: int) -> Lines:
        """Move along or about an axis of the tool (x, y, z, r = 1 .. 4) while HOLD comes."""

    @abstractmethod
    def inch(self, axis: int, by: float) -> Lines:
        """One step, in mm or degrees."""

    @abstractmethod
    def read_point(self, point_number: int) -> str:
        """Ask for one point: a query (`?...`) or a READ."""

    @abstractmethod
    def payload(self, kg: float) -> tuple[str, str, int]:
        """The setting of what the arm carries, the query that reads it back, and the number that it must give."""

    @abstractmethod
    def load(self, program: str, task: int) -> str:
        """Make a program the one that RUN begins."""

    def options(self, motion: Motion) -> str:
        """What stands behind the target of a motion."""
        said = f",S={motion.speed_pct}"
        if motion.ramps.accel_pct != 100:
            said += f",ACC={motion.ramps.accel_pct}"
        if motion.ramps.decel_pct != 100:
            said += f",DEC={motion.ramps.decel_pct}"
        return said + (",CONT" if motion.blends else "")

    def target(self, motion: Motion, hand: str, arch: str) -> Lines:
        """The motion to a target said in the line itself, or by the last point of the table where that is too long."""
        way = "L" if motion.straight else "P"
        numbers = " ".join(self.number(number) for number in (*motion.to, 0.0, 0.0)) + hand
        options = arch + self.options(motion)
        text = f"MOVE {way},{numbers}{options}"
        if len(text) < LONGEST_COMMAND:
            return Lines((), command(text))
        point = f"P{self.highest_point}"
        return Lines((command(f"{point}={numbers}"),), command(f"MOVE {way},{point}{options}"))


def step_um(by: float) -> int:
    """A step in the controller's unit, 0.001 mm or 0.001 degrees; raises ValueError when it is none."""
    size = round(abs(by) * 1000) if math.isfinite(by) else 0
    if not 1 <= size <= MOST_UM:
        raise ValueError(f"a step of {by:g} is outside 0.001 .. {MOST_UM / 1000:g} mm or degrees")
    return size


MOST_UM = 10_000  # that clients have used
