"""The controller without its clients: everything that it knows and drives, and what it therefore refuses."""

from collections.abc import Callable

from simulators.robot.alarms import Alarms
from simulators.robot.codes import Code, Refusal
from simulators.robot.dialect import AXES, Dialect
from simulators.robot.dialogue import Dialogue
from simulators.robot.frames import OFF, Frames
from simulators.robot.jog import Jog
from simulators.robot.language.values import PointData, PortRef, Value
from simulators.robot.log import Log
from simulators.robot.mishaps import Mishaps
from simulators.robot.modes import Mode
from simulators.robot.motions import Motions, Permit
from simulators.robot.operation import Operation
from simulators.robot.ports import Ports, Wiring
from simulators.robot.power import ALL_AXES, Power
from simulators.robot.refusals import Kind, Situation, refusal
from simulators.robot.settings import Settings
from simulators.robot.tables import Tables, Variables
from simulators.robot.targets import Targets
from simulators.robot.world import World

EMERGENCY_BIT, CPU_BIT, SERVO_BIT, ALARM_BIT = 0, 1, 2, 3  # of output port 0
AUTO_BIT, ORIGIN_BIT, PROGRAM_BIT, RESET_BIT = 0, 1, 3, 4  # of output port 1


class Machine:
    """`running` says whether a program runs, `at_start` whether all are reset."""

    def __init__(self, world: World, dialect: Dialect, wiring: Wiring) -> None:
        self.world, self.clock, self.arm = world, world.clock, world.arm
        self.dialect = dialect
        options = dialect.options
        self.arm.scara = self.arm.scara.as_set(
            pulse_scale=options.pulse_scale, margin_deg=options.soft_limit_margin_deg
        )
        self.log = Log(world.clock.now)
        self.alarms = Alarms(self.log)
        self.power = Power(world, self.log, options)
        self.settings = Settings(self._setting_changed)
        self.tables = Tables(dialect.highest_point)
        self.variables = Variables()
        self.dialogue = Dialogue(self.log)
        self.frames = Frames(self.tables)
        self.ports = Ports(wiring, self.dedicated, self._output_changed)
        self.mishaps = Mishaps(self)
        self.targets = Targets(self.arm, self.clock.now, self.settings, self.tables, self.frames)
        self.motions = Motions(world, self.settings, self.targets, self.speed, self.mishaps.watch, self.log)
        self.motions.ends_within = dialect.ends_within
        self.jog = Jog(world, self.settings, self.targets, self.motions)
        self.operation: Operation | None = None
        self.running: Callable[[], bool] = lambda: False
        self.at_start: Callable[[], bool] = lambda: True
        self.stop_programs: Callable[[Code], None] = lambda code: None
        self.arm_locked = False
        self.timed_out = False
        self._mode = dialect.mode_at_start

    # -- its state ---------------------------------------------------------------------------------------

    @property
    def mode(self) -> Mode:
        """Of operation."""
        return self._mode

    @mode.setter
    def mode(self, mode: Mode) -> None:
        self._mode = mode
        self.log.add("mode", mode=mode)

    @property
    def interlocked(self) -> bool:
        """The interlock input stops motion."""
        return not self.world.robot_enable or self.world.guard_open

    @property
    def moving(self) -> bool:
        """A client's motion is under way, or the arm still moves."""
        operating = self.operation is not None and self.operation.moves
        return operating or (self.arm.driven_at(self.clock.now()) and not self.motions.settles)

    def speed(self) -> float:
        """The share of full speed that the mode leaves."""
        return self.settings.number("MSPEED" if self.mode is Mode.MANUAL else "ASPEED") / 100

    def dedicated(self) -> tuple[int, int]:
        """The output ports 0 and 1."""
        first = (
            self.world.estop_pressed << EMERGENCY_BIT
            | 1 << CPU_BIT
            | self.power.all_on << SERVO_BIT
            | (self.alarms.standing is not None) << ALARM_BIT
        )
        automatic = self.mode in (Mode.AUTO, Mode.HELD)
        second = (
            automatic << AUTO_BIT
            | all(self.power.origin) << ORIGIN_BIT
            | self.running() << PROGRAM_BIT
            | self.at_start() << RESET_BIT
        )
        return first, second

    # -- what it refuses ---------------------------------------------------------------------------------

    def permit(self, kind: Kind, axes: tuple[int, ...] = ALL_AXES) -> None:
        """Raises Refusal when something of this kind cannot be done now with these axes."""
        code = refusal(kind, self.situation(kind, axes))
        if code is Code.WHILE_ALARM and self.dialect.alarm_by_name:
            code = self.alarms.standing
        if code is Code.MOVING and kind in Kind.MOTION | Kind.JOG:
            code = self.dialect.busy
        if code is not None:
            raise Refusal(code)

    def permit_motion(self, kind: Kind) -> Permit:
        """The same, for axes that are known later."""
        return lambda axes: self.permit(kind, axes)

    def situation(self, kind: Kind, axes: tuple[int, ...]) -> Situation:
        """The controller as it is."""
        operating = self.operation is not None
        may_blend = kind is Kind.MOTION and not operating
        return Situation(
            emergency=self.world.estop_pressed,
            alarm=self.alarms.standing,
            mode=self.mode,
            modes_that_move=self.dialect.modes_that_move,
            interlocked=self.interlocked,
            arm_locked=self.arm_locked,
            moving=self.moving and not may_blend,
            operating=operating,
            running=self.running(),
            motor=self.power.motor,
            servo=self.power.on(axes),
            origin=all(self.power.origin),
        )

    # -- what happens to it ------------------------------------------------------------------------------

    def report(self, code: Code, line: int | None = None) -> None:
        """Something for the display."""
        self.alarms.report(self.clock.now(), code, line)

    def trip(self, code: Code) -> None:
        """An alarm: power off with brakes, and what runs fails."""
        if self.arm.moving_at(self.clock.now()):
            self.motions.halt()
        self.alarms.trip(self.clock.now(), code)
        self.power.cut()
        if code is Code.EMERGENCY_STOP and self.dialect.options.outputs_on_emergency == "clear":
            self.ports.clear_outputs()
        self.stop_programs(code)
        if self.operation is not None:
            self.operation.interrupt(code)

    def start_up(self, *, origin: bool) -> None:
        """As after switching the control power on; what the battery keeps is kept."""
        dialect = self.dialect
        self.operation = None
        self.alarms.standing = None
        self.settings.restore()
        self.frames.hand = self.frames.shift = OFF
        self.ports.clear_outputs()
        self.mode = dialect.mode_at_start
        self.power.cut()
        self.power.origin = [origin] * AXES
        servo = dialect.options.servo_at_start
        if (dialect.servo_at_start if servo is None else servo) and not self.world.estop_pressed:
            self.power.switch("ON", None)
        self.report(Code.STARTED)

    def stop_arm(self, code: Code) -> None:
        """The arm stops and keeps its power; what moves it fails."""
        if self.arm.moving_at(self.clock.now()):
            self.motions.halt()
        self.stop_programs(code)
        if self.operation is not None and self.operation.moves:
            self.operation.interrupt(code)

    def _setting_changed(self, name: str) -> None:
        if name == "ARMTYP":  # 0 is right, as 1 is of the other
            self.settings.put("ARMSEL", self.settings.number("ARMTYP") + 1)

    def _output_changed(self, kind: str, port: int, byte: int) -> None:
        self.log.add("output", port=f"{kind}{port}", byte=byte)


class MachineScope:
    """Names as a client's command or a program's statement sees them. `strict`: an unset variable is an error."""

    def __init__(self, machine: Machine, *, strict: bool) -> None:
        self._machine = machine
        self._strict = strict

    def variable(self, name: str, indices: tuple[int, ...]) -> Value:
        """Raises Refusal DATA for one that was never set, when strict."""
        if self._strict and not self._machine.variables.knows(name):
            raise Refusal(Code.DATA)
        return self._machine.variables.get(name, indices)

    def set_variable(self, name: str, indices: tuple[int, ...], value: Value) -> None:
        """Raises Refusal."""
        self._machine.variables.set(name, indices, value)

    def point(self, number: int) -> PointData:
        """Raises Refusal."""
        return self._machine.tables.point(number)

    def port(self, port: PortRef) -> int:
        """Raises Refusal."""
        return self._machine.ports.read(port)

    def setting(self, name: str, index: int | None) -> Value:
        """Raises Refusal."""
        machine = self._machine
        if name == "WHRXY":
            return machine.targets.here()
        if name == "WHERE":
            return machine.targets.here_in_pulses()
        if name == "ARMCND":
            return int(machine.arm.joints_at(machine.clock.now()).hand)
        if name == "TCOUNTER":
            return int(machine.clock.now() * 100) % (1 << 30)
        if name == "TIMEOUT":
            return int(machine.timed_out)
        return machine.settings.value(name, index)
