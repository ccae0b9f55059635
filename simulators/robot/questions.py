"""What the controller answers to a question: its state by name, or the value of an expression."""

from collections.abc import Callable

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.expressions import expression
from simulators.robot.language.names import nothing, optional_number, program_command
from simulators.robot.language.tokens import Reader
from simulators.robot.language.values import PointData, Value
from simulators.robot.machine import Machine, MachineScope
from simulators.robot.programs import Programs
from simulators.robot.settings import AXIS_DEFAULTS

VERSIONS = {"rcx3": "RCX340 V1.20,R0000", "rcx2": "V8.02,R1021-V5.10-V1.01/V1.01/V1.01/V1.01"}


class Questions:
    """One line of text for one question."""

    def __init__(self, machine: Machine, programs: Programs) -> None:
        self._machine, self._programs = machine, programs
        self._scope = MachineScope(machine, strict=True)
        state: dict[str, Callable[[], str]] = {
            "MODE": lambda: machine.dialect.mode(machine.mode),
            "EMG": lambda: machine.dialect.emergency(machine.world.estop_pressed),
            "ALM": lambda: machine.dialect.code(machine.alarms.standing or Code.OK),
            "MOTOR": lambda: str(machine.power.level),
            "SERVO": lambda: machine.dialect.servo(machine.power.servo),
            "WHERE": lambda: machine.dialect.position(machine.targets.here_in_pulses()),
            "WHRXY": lambda: machine.dialect.position(machine.targets.here()),
            "ARMCND": lambda: machine.dialect.hand(machine.arm.joints_at(machine.clock.now()).hand),
            "ARMSEL": lambda: str(machine.settings.number("ARMSEL")),
            "HAND": lambda: machine.frames.hand,
            "SHIFT": lambda: machine.frames.shift,
            "SPEED": self._speeds,
            "UNIT": lambda: "MM/DEG" if machine.settings.number("UNIT") else "PULSE",
            "ABSRST": lambda: machine.dialect.absolute(machine.power.origin),
            "SEQUENCE": lambda: "DISABLE,STOP",
            "VER": lambda: machine.dialect.options.version or VERSIONS[machine.dialect.name],
            "CONFIG": lambda: machine.dialect.options.config or machine.arm.scara.name,
            "MSG": self._message,
            "MEM": lambda: f"{len(machine.tables.points)}/{machine.tables.highest_point + 1}",
        }
        self._answers = {word: _alone(tell) for word, tell in state.items()}
        self._answers["ORIGIN"] = self._origin
        self._answers["TSKMON"] = lambda rest: programs.monitor(program_command(rest))
        self._answers |= {name: self._axis_setting(name) for name in AXIS_DEFAULTS}

    def answer(self, text: str) -> str:
        """One line; raises Refusal."""
        reader = Reader(text)
        word = reader.take().text if reader.token.kind == "name" else ""
        name = self._machine.dialect.questions.get(word)
        if name is not None:
            if reader.accept("["):
                _robot_one(reader)
            return self._answers[name](reader.rest())
        return self._value(text, word, alone=reader.ended)

    def _value(self, text: str, word: str, *, alone: bool) -> str:
        machine = self._machine
        if not text or (alone and not machine.settings.knows(word) and not self._is_value(word)):
            raise Refusal(Code.NO_SUCH_COMMAND)
        return self._text(expression(text)(self._scope))

    def _is_value(self, word: str) -> bool:
        is_point = word[:1] == "P" and word[1:].isdecimal()
        return is_point or self._machine.variables.knows(word)

    def _text(self, value: Value) -> str:
        if isinstance(value, PointData):
            return self._machine.dialect.point(value)
        return self._machine.dialect.number(value) if isinstance(value, float) else str(value)

    def _speeds(self) -> str:
        settings = self._machine.settings
        return f"{settings.number('ASPEED')},{settings.number('MSPEED')}"

    def _message(self) -> str:
        history = self._machine.alarms.history
        code = history[-1].code if history else Code.STARTED
        return f"{self._machine.dialect.code(code)}:{code.words}"

    def _origin(self, rest: str) -> str:
        optional_number(rest)
        return self._machine.dialect.origin(self._machine.power.origin)

    def _axis_setting(self, name: str) -> Callable[[str], str]:
        def tell(rest: str) -> str:
            if not rest:
                return ",".join(str(value) for value in self._machine.settings.axes(name))
            axis = expression(rest)(self._scope)
            return str(self._machine.settings.value(name, axis if isinstance(axis, int) else 0))

        return tell


def _alone(tell: Callable[[], str]) -> Callable[[str], str]:
    """A question that takes nothing behind its word."""

    def answer(rest: str) -> str:
        nothing(rest)
        return tell()

    return answer


def _robot_one(reader: Reader) -> None:
    if reader.take().text != "1":
        raise Refusal(Code.ROBOT_NUMBER)
    reader.expect("]")
