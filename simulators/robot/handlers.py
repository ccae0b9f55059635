"""What commands do, whoever gives them: a client on the line, or a statement of a program."""

from collections.abc import Callable

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.assignments import (
    Assignment,
    CoordinateTarget,
    PointTarget,
    PortTarget,
    SettingTarget,
    TableTarget,
    VariableTarget,
)
from simulators.robot.language.commands import Drive, Move, Number, PalletMove, Power, Step, axis_number
from simulators.robot.language.nodes import Statement
from simulators.robot.language.values import PointData, PortRef, Scope, integer, number
from simulators.robot.machine import Machine
from simulators.robot.operation import Ending, Operation, Work
from simulators.robot.power import ALL_AXES
from simulators.robot.refusals import Kind

MOTOR_S, SERVO_S, ORIGIN_S, RESET_S = 0.2, 0.1, 0.3, 0.03
MOTIONS = ("MOVE", "MOVEI", "DRIVE", "DRIVEI", "PMOVE")
JOGS = ("JOG", "JOGXY", "INCH", "INCHXY")
POWERS = ("SERVO", "MOTOR", "ORIGIN", "ALMRST")


class Handlers:
    """Assignments and settings are done at once; motions and power commands return what goes on with them."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    # -- at once -----------------------------------------------------------------------------------------

    def assign(self, wanted: Assignment, scope: Scope) -> None:
        """`target = value`; raises Refusal."""
        machine, target = self._machine, wanted.target
        if isinstance(target, PointTarget):
            value = wanted.value(scope)
            assert isinstance(value, PointData)
            machine.tables.points[machine.tables.point_number(integer(target.number(scope)))] = value
        elif isinstance(target, CoordinateTarget):
            point = integer(target.number(scope))
            machine.tables.set_coordinate(point, target.axis, number(wanted.value(scope)))
        elif isinstance(target, PortTarget):
            machine.ports.write(target.port(scope), integer(wanted.value(scope)))
        elif isinstance(target, SettingTarget):
            machine.settings.set(target.name, Number((wanted.value,), target.axis), scope)
        elif isinstance(target, TableTarget):
            self._define(target, wanted, scope)
        else:
            self._set_variable(target, wanted, scope)

    def set(self, wanted: Statement, scope: Scope) -> bool:
        """A setting; False when the word is none. Raises Refusal."""
        machine, argument = self._machine, wanted.argument
        if wanted.word in ("RIGHTY", "LEFTY"):
            machine.settings.put("ARMSEL", 1 if wanted.word == "RIGHTY" else 2)
        elif wanted.word in ("CHANGE", "SHIFT"):
            machine.frames.choose(wanted.word, str(argument))
        elif wanted.word in ("SET", "RESET OUTPUT"):
            assert isinstance(argument, tuple)
            self._switch_outputs(argument, scope, on=wanted.word == "SET")
        elif machine.settings.knows(wanted.word):
            assert isinstance(argument, Number)
            machine.settings.set(wanted.word, argument, scope)
        else:
            return False
        return True

    # -- what goes on ------------------------------------------------------------------------------------

    def motion(self, wanted: Statement, scope: Scope, kind: Kind) -> Work:
        """MOVE, MOVEI, DRIVE, DRIVEI, PMOVE; raises Refusal."""
        machine, argument = self._machine, wanted.argument
        permit, relative = machine.permit_motion(kind), wanted.word.endswith("I")
        if isinstance(argument, Move):
            return machine.motions.move(argument, scope, permit, relative=relative)
        if isinstance(argument, Drive):
            return machine.motions.drive(argument, scope, permit, relative=relative)
        assert isinstance(argument, PalletMove)
        return machine.motions.pallet(argument, scope, permit)

    def jog(self, wanted: Statement) -> Work:
        """JOG, JOGXY, INCH, INCHXY; raises Refusal."""
        machine, step = self._machine, wanted.argument
        assert isinstance(step, Step)
        permit = machine.permit_motion(Kind.JOG)
        straight = wanted.word.endswith("XY") or machine.settings.number("UNIT") == 1
        if wanted.word.startswith("INCH"):
            return machine.jog.inch(step, permit, straight=straight)
        dead_man_s = machine.dialect.options.dead_man_s
        return machine.jog.jog(step, permit, straight=straight, dead_man_s=dead_man_s)

    def power(self, wanted: Statement, scope: Scope) -> Work:
        """SERVO, MOTOR, ORIGIN, ALMRST; raises Refusal."""
        if wanted.word == "ALMRST":
            return self._reset_alarm()
        if wanted.word == "ORIGIN":
            return self._find_origin()
        machine, argument = self._machine, wanted.argument
        assert isinstance(argument, Power)
        on = argument.wish in ("ON", "PWR")
        machine.permit(Kind.POWER_ON if on else Kind.POWER_OFF)
        axis = axis_number(argument.axis, scope) if argument.axis is not None else None
        takes_s = MOTOR_S if wanted.word == "MOTOR" or (on and not machine.power.motor) else SERVO_S
        return self._after(takes_s, lambda: machine.power.switch(argument.wish, axis))

    def _reset_alarm(self) -> Work:
        machine = self._machine
        machine.permit(Kind.ALARM_RESET)
        standing = machine.alarms.standing
        if standing is not None and standing.needs_power_cycle and machine.dialect.options.latching_alarms:
            raise Refusal(standing)
        return self._after(RESET_S, machine.alarms.reset)

    def _find_origin(self) -> Work:
        """Absolute encoders: nothing moves, the positions are read again."""
        machine = self._machine
        machine.permit(Kind.POWER_ON)
        if not machine.power.motor:
            raise Refusal(Code.MOTOR_OFF)

        def found() -> None:
            machine.power.origin = [True] * len(ALL_AXES)

        return self._after(ORIGIN_S, found)

    def _after(self, takes_s: float, do: Callable[[], None]) -> Work:
        async def work(operation: Operation) -> Ending:
            if await operation.until(self._machine.clock.now() + takes_s):
                do()
            return operation.ending

        return work

    # -- details -----------------------------------------------------------------------------------------

    def _define(self, target: TableTarget, wanted: Assignment, scope: Scope) -> None:
        entry = integer(target.number(scope))
        if self._machine.frames.in_use(target.kind, entry):
            raise Refusal(Code.HAND_IN_USE if target.kind == "H" else Code.SHIFT_IN_USE)
        self._machine.tables.set_entry(target.kind, entry, wanted.numbers, tool_on_r=wanted.tool_on_r)

    def _set_variable(self, target: VariableTarget, wanted: Assignment, scope: Scope) -> None:
        indices = tuple(integer(index(scope)) for index in target.indices)
        scope.set_variable(target.name, indices, wanted.value(scope))

    def _switch_outputs(self, ports: tuple[Callable[[Scope], PortRef], ...], scope: Scope, *, on: bool) -> None:
        for port in ports:
            ref = port(scope)
            self._machine.ports.write(ref, (1 << (len(ref.bits) or 8)) - 1 if on else 0)
