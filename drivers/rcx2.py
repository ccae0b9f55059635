"""The older generation: RCX240, RCX141, RCX142, RCX40, RCX221, RCX222. Pure.

A query is answered by its data alone, everything else by one OK when it has been done; a refusal is `group.class:text`
or NG=group.class. What is sent while the arm moves waits until it stands. Two decimals. No hand in a position.
"""

import math
import re
from collections.abc import Sequence
from typing import ClassVar

from drivers.rcx import LEFTY, Code, Mode, Motion, RobotStatus, command, parse_byte, parse_failure
from drivers.rcx_codes import RCX2
from drivers.rcx_dialect import Dialect, Grammar, Lines, step_um

AXIS_LETTERS = "XYZR"
MODES = {"AUTO": Mode.AUTOMATIC, "MANUAL": Mode.MANUAL, "PROGRAM": Mode.OTHER, "SYSTEM": Mode.OTHER}
SERVO = re.compile(r"(ON|OFF)(?:\s*,\s*[0-9]{1,8})?", re.ASCII)
ORIGIN = re.compile(r"(COMPLETE|INCOMPLETE)(?:\s*,\s*[0-9]{1,8})?", re.ASCII)
ALARM_BIT = 3  # of output port 0
MOTOR_GROUP = 17
STOPPED = Code(0, 7)


class Rcx2(Dialect):
    """The RCX240's and its relatives'."""

    name = "rcx2"
    grammar = Grammar(ok_after_data=False, run_before_end=False, answers_in_motion=False)
    decimals = 2
    highest_point = 9999
    greeting_s = 0.3
    good_bye = "LOGOUT"  # leaving without it stops the robot with an error
    before_talk = ("ETHER ECHO 0",)
    power_on, power_off = "SERVO ON", "SERVO OFF"
    alarm_reset = "EMGRST"
    origin_return = "ABSRST"
    status_queries = ("MOD", "EMG", "SERVO", "ORIGIN", "DO0()")
    hand_query = "ARM"
    first_query = "MOD"
    speed_query = "SPEED"
    codes: ClassVar[dict[tuple[int, int], str]] = RCX2

    def more_queries(self, answers: Sequence[str]) -> tuple[str, ...]:
        """There is no query for an alarm: an output tells that one stands, the last message which it is."""
        bits = parse_byte(answers[4])
        return ("MSG",) if bits is not None and bits >> ALARM_BIT & 1 else ()

    def status(self, answers: Sequence[str]) -> RobotStatus | None:
        """By words. The servo's state is the motor power's, too."""
        mode = MODES.get(answers[0].strip().upper())
        emergency = {"ON": True, "OFF": False}.get(answers[1].strip().upper())
        servo, origin = SERVO.fullmatch(answers[2].strip()), ORIGIN.fullmatch(answers[3].strip())
        if mode is None or emergency is None or servo is None or origin is None or parse_byte(answers[4]) is None:
            return None
        alarm, means = self._alarm(answers[5]) if len(answers) > 5 else ("", "")
        on = servo[1] == "ON"
        return RobotStatus(mode, emergency, alarm, on, on, origin[1] == "COMPLETE", means)

    def _alarm(self, message: str) -> tuple[str, str]:
        code = parse_failure(message)
        return (str(code), self.meaning(code)) if code else ("?", "which the controller does not name")

    def is_collision(self, code: Code) -> bool:
        """Which codes of the motors mean a collision is not known for certain, so any of them may."""
        return code.group == MOTOR_GROUP

    def is_event(self, code: Code) -> bool:
        """A stop."""
        return code == STOPPED

    def move(self, motion: Motion) -> Lines:
        """The hand is a setting of its own."""
        arch = ""
        if motion.arch is not None:
            if motion.arch.rise_mm or motion.arch.sink_mm:
                raise ValueError("this controller's arch has a height only: rise and sink must be 0")
            arch = f",Z={self.number(motion.arch.top_z_mm)}"
        lines = self.target(motion, "", arch)
        return Lines((command("LEFTY" if motion.hand == LEFTY else "RIGHTY"), *lines.settings), lines.operation)

    def jog(self, axis: int, sign: int) -> Lines:
        """Axes by letter, along the tool's coordinates in the unit of millimetres."""
        return Lines((command("UNIT 1"),), command(f"JOG {_step(axis, sign)}"))

    def inch(self, axis: int, by: float) -> Lines:
        """Axes by letter."""
        settings = (command("UNIT 1"), command(f"IDIST {step_um(by)}"))
        return Lines(settings, command(f"INCH {_step(axis, by)}"))

    def read_point(self, point_number: int) -> str:
        """A file of one line."""
        return command(f"READ P{point_number}")

    def payload(self, kg: float) -> tuple[str, str, int]:
        """In whole kilograms, never less than it is."""
        return f"WEIGHT {math.ceil(kg)}", "WEIGHT", math.ceil(kg)

    def load(self, program: str, task: int) -> str:
        """There is one task that a client can choose a program for."""
        if task != 1:
            raise ValueError(f"task {task}: this controller loads programs into task 1 only")
        return command(f"SWI <{program}>")


def _step(axis: int, sign: float) -> str:
    return f"{AXIS_LETTERS[axis - 1]}{'+' if sign > 0 else '-'}"
