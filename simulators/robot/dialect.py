"""What the two generations of controllers have in common on the line: the words they share and how they say things."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar, NamedTuple

from simulators.robot.codes import Code, Refusal
from simulators.robot.language import commands, names
from simulators.robot.language.nodes import Arguments
from simulators.robot.language.tokens import upper
from simulators.robot.language.values import PointData
from simulators.robot.modes import Mode
from simulators.robot.options import Options
from simulators.scara import Hand

AXES = commands.AXES
SETTINGS = ("ASPEED", "MSPEED", "SPEED", "ACCEL", "DECEL", "TOLE", "OUTPOS", "ARCH", "WEIGHT", "ORGORD", "AXWGHT")


class Command(NamedTuple):
    """A line from a client, taken apart as far as the mark: a question or something to do."""

    is_question: bool
    text: str


class Dialect:
    """One generation. Its instances hold what a controller of it has been set to say."""

    name = ""
    longest_line = 80  # without the line's end
    highest_point = 9999
    decimals = 2
    accepted: str | None = None  # said when an operation begins
    finished = "OK"  # and when it has ended
    begins_data: str | None = None
    keeps_order = False  # a line waits until what the last one began has ended
    mode_at_start = Mode.AUTO
    modes_that_move: tuple[Mode, ...] = (Mode.AUTO,)
    servo_at_start = False
    greeting: str | None = None
    is_network_unit = False  # the network is a board of its own, with its own commands
    outpos = "OUTPOS"  # the setting that its OUTPOS is
    group_shift = 16  # of an error's group in ERR
    alarm_by_name = False  # while an alarm stands it answers with its code
    words: ClassVar[Arguments] = {}
    questions: ClassVar[dict[str, str]] = {}  # word -> its name in both generations

    def __init__(self, options: Options) -> None:
        self.options = options

    def command(self, line: str) -> Command | None:
        """Take a line apart; None for one that says nothing. Raises Refusal LONG_COMMAND, NO_START."""
        text = line.strip(" \t")
        if not text:
            return None
        if len(text) > self.longest_line:
            raise Refusal(Code.LONG_COMMAND)
        if not text.startswith("@"):
            raise Refusal(Code.NO_START)
        body = upper(text[1:]).strip()
        is_question = body.startswith("?")
        body = body.removeprefix("?").strip()
        return Command(is_question, body) if body or is_question else None

    @property
    def ends_within(self) -> str | None:
        """The setting that says how near to its end a motion counts as done; None: when it has arrived."""
        return {"tolerance": "TOLE", "outpos": self.outpos}.get(self.options.ends_at)

    @property
    def busy(self) -> Code:
        """Why a motion is refused while another runs."""
        return Code.MOVING

    def code(self, code: Code) -> str:
        """`group.class`."""
        raise NotImplementedError

    def error_number(self, code: Code) -> int:
        """What ERR is in a program: the group, and the class in its lower bytes."""
        group, number = map(int, self.code(code).split("."))
        return group << self.group_shift | number

    def code_of(self, text: str) -> Code:
        """The code that is written so; raises ValueError."""
        raise NotImplementedError

    def failure(self, code: Code) -> str:
        """The line that refuses or reports a failure."""
        raise NotImplementedError

    def answer(self, lines: Sequence[str]) -> list[str]:
        """What a question is answered by."""
        raise NotImplementedError

    def position(self, point: PointData) -> str:
        """Where the arm is."""
        raise NotImplementedError

    def point(self, point: PointData) -> str:
        """A point of the table."""
        raise NotImplementedError

    def emergency(self, pressed: bool) -> str:
        """The emergency stop."""
        raise NotImplementedError

    def mode(self, mode: Mode) -> str:
        """The mode."""
        raise NotImplementedError

    def origin(self, done: Sequence[bool]) -> str:
        """Whether the axes know where they are."""
        raise NotImplementedError

    def absolute(self, done: Sequence[bool]) -> str:
        """The same of their absolute encoders."""
        return self.origin(done)

    def hand(self, hand: Hand) -> str:
        """The side of the elbow."""
        return str(int(hand))

    def servo(self, axes: Sequence[int]) -> str:
        """0 braked, 1 on, 2 free, of each axis."""
        raise NotImplementedError

    def number(self, value: float) -> str:
        """A length or an angle; never -0."""
        return f"{round(value, self.decimals) + 0.0:.{self.decimals}f}"


def shared_words(arch_name: str, jog_axes: str) -> dict[str, tuple[str, Callable[[str], object]]]:
    """Commands that both generations have: what they are called, and what reads their argument."""
    motions: dict[str, Callable[[str], object]] = {
        "MOVE": partial(commands.move, arch_name=arch_name),
        "MOVEI": partial(commands.move, arch_name=arch_name),
        "DRIVE": partial(commands.drive, arch_name=arch_name),
        "DRIVEI": partial(commands.drive, arch_name=arch_name),
        "PMOVE": partial(commands.pallet_move, arch_name=arch_name),
        "JOG": partial(commands.step, axes=jog_axes),
        "INCH": partial(commands.step, axes=jog_axes),
    }
    others: dict[str, Callable[[str], object]] = {
        "SERVO": commands.power,
        "RIGHTY": names.nothing,
        "LEFTY": names.nothing,
        "CHANGE": names.word,
        "SHIFT": names.word,
        "AUTO": names.nothing,
        "MANUAL": names.nothing,
        "RUN": names.program_command,
        "STOP": names.program_command,
        "RESET": names.program_command,
        "TEACH": names.point_number,
        "ARMTYP": commands.value,
        "IDIST": commands.value,
        "SET": names.ports,
        "WAIT": names.arm_word,
        "READ": names.file_name,
        "WRITE": names.file_name,
    }
    settings = dict.fromkeys(SETTINGS, commands.value)
    return {word: (word, read) for word, read in (motions | others | settings).items()}
