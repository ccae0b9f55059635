"""The newer generation, RCX340 and RCX320. Pure.

A query is answered by data and OK, a setting by OK, an operation by RUN and END, and any of them by NG=group.class.
"""

import re
from collections.abc import Sequence
from typing import ClassVar

from drivers.rcx import Code, Mode, Motion, RobotStatus, command, parse_failure, parse_integer
from drivers.rcx_codes import RCX3
from drivers.rcx_dialect import Dialect, Grammar, Lines, step_um

STATE_AND_AXES = re.compile(r"([01])(?:\s+[0-9](?:\s*,\s*[0-9])*)?", re.ASCII)
MODES = {2: Mode.AUTOMATIC, 1: Mode.HELD, 0: Mode.MANUAL}
EVENT_GROUP = 1
MOTOR_ON = (1, 2)  # power, power and all servos
COLLISIONS = {(17, 800), (17, 801), (17, 910), (17, 911), (17, 912), (17, 915)}  # overload and deviation of a motor


class Rcx3(Dialect):
    """The RCX340's and RCX320's."""

    name = "rcx3"
    grammar = Grammar(ok_after_data=True, run_before_end=True, answers_in_motion=True)
    decimals = 3
    highest_point = 29999
    greeting_s = 0.5
    good_bye = ""
    before_talk = ()
    power_on, power_off = "MOTOR ON", "MOTOR OFF"
    alarm_reset = "ALMRST"
    origin_return = "ORIGIN"
    status_queries = ("MODE", "EMG", "ALM", "MOTOR", "SERVO", "ORIGIN")
    hand_query = "ARMCND"
    first_query = "MODE"
    speed_query = "ASPEED"
    codes: ClassVar[dict[tuple[int, int], str]] = RCX3

    def more_queries(self, answers: Sequence[str]) -> tuple[str, ...]:
        """Nothing."""
        return ()

    def status(self, answers: Sequence[str]) -> RobotStatus | None:
        """By numbers."""
        mode, motor = parse_integer(answers[0]), parse_integer(answers[3])
        emergency, alarm = parse_flag(answers[1]), parse_alarm(answers[2])
        servo, origin = parse_flag(answers[4]), parse_flag(answers[5])
        if mode is None or motor is None or emergency is None or alarm is None or servo is None or origin is None:
            return None
        code = parse_failure(alarm)
        means = self.meaning(code) if code else ""
        return RobotStatus(MODES.get(mode, Mode.OTHER), emergency, alarm, motor in MOTOR_ON, servo, origin, means)

    def is_collision(self, code: Code) -> bool:
        """Overload and deviation."""
        return code in COLLISIONS

    def is_event(self, code: Code) -> bool:
        """A group of its own."""
        return code.group == EVENT_GROUP

    def move(self, motion: Motion) -> Lines:
        """With the hand as seventh number."""
        if motion.arch is None:
            return self.target(motion, f" {motion.hand}", "")
        top, rise, sink = map(self.number, motion.arch)
        return self.target(motion, f" {motion.hand}", f",A3={top}{{{rise},{sink}}}")

    def jog(self, axis: int, sign: int) -> Lines:
        """Axes by number."""
        return Lines((), command(f"JOGXY {axis}{_sign(sign)}"))

    def inch(self, axis: int, by: float) -> Lines:
        """Axes by number."""
        return Lines((command(f"IDIST {step_um(by)}"),), command(f"INCHXY {axis}{_sign(by)}"))

    def read_point(self, point_number: int) -> str:
        """A query."""
        return command(f"?P{point_number}")

    def payload(self, kg: float) -> tuple[str, str, int]:
        """In grams."""
        grams = round(kg * 1000)
        return f"WEIGHTG {grams}", "WEIGHTG", grams

    def load(self, program: str, task: int) -> str:
        """Into a task."""
        return command(f"LOAD <{program}>,T{task}")


def parse_flag(line: str) -> bool | None:
    """0 or 1, for the whole robot, with or without one digit per axis behind it (`1 1,1,1,1`)."""
    found = STATE_AND_AXES.fullmatch(line.strip())
    return found[1] == "1" if found else None


def parse_alarm(line: str) -> str | None:
    """The alarm's code as text, "" for `0.0`."""
    code = parse_failure(line)
    if code is None or not line.strip()[0].isdigit():
        return None
    return "" if code == (0, 0) else str(code)


def _sign(number: float) -> str:
    return "+" if number > 0 else "-"
