"""RCX240, RCX14x, RCX22x: a question is answered by its data alone, everything else by one OK when it has been done."""

from collections.abc import Sequence
from typing import ClassVar

from simulators.robot.codes import BY_RCX2, Code, code_by_text
from simulators.robot.dialect import AXES, Dialect, shared_words
from simulators.robot.language import commands, names
from simulators.robot.language.nodes import Arguments
from simulators.robot.language.values import PointData
from simulators.robot.modes import Mode
from simulators.scara import Hand

AXIS_LETTERS = "XYZRAB"
MOST_AXES = 8
JAPANESE = {  # half-width katakana, one byte each
    Code.UNDEFINED_IDENTIFIER: "ｼｷﾍﾞﾂｼ ﾐﾃｲｷﾞ",
    Code.EMERGENCY_STOP: "ﾋｼﾞｮｳﾃｲｼ ON",
    Code.NO_POINT: "ﾎﾟｲﾝﾄ ﾅｼ",
}
KATAKANA = {ord("｡") + k: chr(0xA1 + k) for k in range(63)}
OWN_WORDS: Arguments = {
    "PROGRAM": ("PROGRAM", names.nothing),
    "SYSTEM": ("SYSTEM", names.nothing),
    "EMGRST": ("ALMRST", names.nothing),
    "ABSRST": ("ORIGIN", names.optional_number),
    "SWI": ("LOAD", names.program_command),
    "OUTPOS": ("CONTPLS", commands.value),  # from where on a motion with CONT may be followed
    "UNIT": ("UNIT", commands.value),
    "SEND": ("READ", names.sent_file),
    "ETHER": ("ETHER", names.network_setting),
}
SAME_QUESTIONS = ("EMG", "SERVO", "ORIGIN", "ABSRST", "WHERE", "WHRXY", "SPEED", "UNIT", "SEQUENCE", "VER", "CONFIG")


class Rcx2(Dialect):
    """The older generation."""

    name = "rcx2"
    keeps_order = True
    servo_at_start = True
    is_network_unit = True
    alarm_by_name = True
    outpos = "CONTPLS"
    group_shift = 8
    modes_that_move = (Mode.AUTO, Mode.MANUAL)
    words: ClassVar[Arguments] = shared_words("Z", AXIS_LETTERS) | OWN_WORDS
    questions: ClassVar[dict[str, str]] = {word: word for word in SAME_QUESTIONS} | {
        "MOD": "MODE",
        "ARM": "ARMCND",
        "MSG": "MSG",
        "HAND": "HAND",
        "SHIFT": "SHIFT",
        "MEM": "MEM",
    }

    def code(self, code: Code) -> str:
        """As the older list has it."""
        return code.rcx2

    def code_of(self, text: str) -> Code:
        """The first code of the older list, or of the newer one, that is written so."""
        return BY_RCX2.get(text) or code_by_text(text)

    def failure(self, code: Code) -> str:
        """5.52:Command does not exist, or NG=5.52 when it is set so."""
        if self.options.errors == "ng":
            return f"NG={code.rcx2}"
        words = code.words
        if self.options.language == "japanese":
            words = JAPANESE.get(code, "ｴﾗｰ").translate(KATAKANA)
        return f"{code.rcx2}:{words}"

    def answer(self, lines: Sequence[str]) -> list[str]:
        """The data alone."""
        return list(lines)

    def position(self, point: PointData) -> str:
        """[POS] and six fields of eight columns."""
        return "[POS]" + self.point(point)

    def point(self, point: PointData) -> str:
        """Six fields of eight columns; the hand behind them when it is said."""
        return "".join(f"{round(v) if point.in_pulses else self.number(v):>8}" for v in point.values)

    def emergency(self, pressed: bool) -> str:
        """ON or OFF."""
        return "ON" if pressed else "OFF"

    def mode(self, mode: Mode) -> str:
        """A word."""
        return str((Mode.AUTO if mode is Mode.HELD else mode).value)

    def origin(self, done: Sequence[bool]) -> str:
        """A word."""
        return "COMPLETE" if all(done) else "INCOMPLETE"

    def absolute(self, done: Sequence[bool]) -> str:
        """A word, and when it is incomplete each axis from 8 to 1."""
        return "COMPLETE" if all(done) else f"INCOMPLETE,{_from_eight([int(axis) for axis in done])}"

    def hand(self, hand: Hand) -> str:
        """A word."""
        return hand.name

    def servo(self, axes: Sequence[int]) -> str:
        """ON when all are, and each axis from 8 to 1."""
        return f"{'ON' if all(axis == 1 for axis in axes) else 'OFF'},{_from_eight(axes)}"


def _from_eight(digits: Sequence[int]) -> str:
    return "9" * (MOST_AXES - AXES) + "".join(str(digit) for digit in reversed(digits))
