"""RCX340 and RCX320: data and OK answer a question, RUN and END an operation, NG=group.class refuses."""

from collections.abc import Sequence
from typing import ClassVar

from simulators.robot.codes import Code, code_by_text
from simulators.robot.dialect import Dialect, shared_words
from simulators.robot.language import commands, names
from simulators.robot.language.nodes import Arguments
from simulators.robot.language.values import PointData
from simulators.robot.modes import Mode

AXIS_NUMBERS = "123456"
MODE_NUMBERS = {Mode.AUTO: 2, Mode.HELD: 1, Mode.MANUAL: 0}
OWN_WORDS: Arguments = {
    "MOTOR": ("MOTOR", commands.power),
    "ALMRST": ("ALMRST", names.nothing),
    "ORIGIN": ("ORIGIN", names.optional_number),
    "ORGRTN": ("ORIGIN", names.optional_number),
    "JOGXY": ("JOGXY", lambda text: commands.step(text, AXIS_NUMBERS)),
    "INCHXY": ("INCHXY", lambda text: commands.step(text, AXIS_NUMBERS)),
    "TCHXY": ("TCHXY", names.point_number),
    "LOAD": ("LOAD", names.program_command),
    "ARMSEL": ("ARMSEL", commands.value),
    "WEIGHTG": ("WEIGHTG", commands.value),
    "CONTPLS": ("CONTPLS", commands.value),
    "TORQUE": ("TORQUE", commands.value),
}
QUESTIONS = (
    *("MODE", "EMG", "ALM", "MOTOR", "SERVO", "ORIGIN", "WHERE", "WHRXY", "ARMCND", "ARMSEL", "HAND", "SHIFT"),
    *("TSKMON", "VER", "CONFIG", "MSG", "MEM"),
    *("ACCEL", "DECEL", "TOLE", "OUTPOS", "ARCH", "ORGORD", "AXWGHT", "CONTPLS", "TORQUE"),
)


class Rcx3(Dialect):
    """The newer generation."""

    name = "rcx3"
    longest_line = 255
    highest_point = 29999
    decimals = 3
    accepted = "RUN"
    finished = "END"
    begins_data = "BEGIN"
    greeting = "Welcome to RCX340"
    words: ClassVar[Arguments] = shared_words("A3", AXIS_NUMBERS) | OWN_WORDS
    questions: ClassVar[dict[str, str]] = {word: word for word in QUESTIONS}

    def code(self, code: Code) -> str:
        """Unpadded, unless it is set to 06.204."""
        group, number = code.rcx3.split(".")
        return f"{int(group):02}.{int(number):03}" if self.options.padded_codes and code is not Code.OK else code.rcx3

    @property
    def busy(self) -> Code:
        """As it is set."""
        return code_by_text(self.options.busy)

    def code_of(self, text: str) -> Code:
        """By the newer list."""
        return code_by_text(text)

    def failure(self, code: Code) -> str:
        """NG=5.252."""
        return f"NG={self.code(code)}"

    def answer(self, lines: Sequence[str]) -> list[str]:
        """The data and OK."""
        return [*lines, "OK"]

    def position(self, point: PointData) -> str:
        """Nine fields, or as many as it is set to; pulses are six or nine."""
        fields = self.options.where_fields if point.in_pulses else self.options.position_fields
        return " ".join(self.point(point).split(" ")[:fields])

    def point(self, point: PointData) -> str:
        """Nine fields with single blanks."""
        numbers = (f"{round(v)}" if point.in_pulses else self.number(v) for v in point.values)
        return f"{' '.join(numbers)} {point.hand} {point.revolutions[0]} {point.revolutions[1]}"

    def emergency(self, pressed: bool) -> str:
        """0 or 1."""
        return str(int(pressed))

    def mode(self, mode: Mode) -> str:
        """-1 to 2."""
        return str(MODE_NUMBERS.get(mode, -1))

    def origin(self, done: Sequence[bool]) -> str:
        """All and each."""
        return f"{int(all(done))} {','.join(str(int(axis)) for axis in done)}"

    def servo(self, axes: Sequence[int]) -> str:
        """All and each."""
        return f"{int(all(axis == 1 for axis in axes))} {','.join(str(axis) for axis in axes)}"
