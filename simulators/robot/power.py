"""Motors, servos, alarm and the safety inputs: what state the controller is in, and what it therefore refuses."""

from collections.abc import Callable

from simulators.clock import Clock
from simulators.robot import text
from simulators.robot.motions import position, pulses
from simulators.robot.registers import AUTO_HELD, AUTO_RELEASED, MANUAL, Registers
from simulators.robot.text import Command, Refusal
from simulators.robot.world import World

EMERGENCY, INTERLOCK, NO_ALARM = "12.600", "12.400", "0.0"
ALL_AXES = tuple(range(1, text.AXES + 1))
WISHES = {"ON": True, "PWR": True, "OFF": False, "FREE": False}


class Power:
    """The state that the safety inputs, the alarms and the power commands change."""

    def __init__(self, world: World, registers: Registers) -> None:
        self.alarm = NO_ALARM
        self.motor = False
        self._servo = [False] * text.AXES
        self._world = world
        self._clock: Clock = world.clock
        self._registers = registers

    def trip(self, alarm: str) -> None:
        """Alarm: power off with brakes."""
        self.alarm = alarm
        self.switch(False, ALL_AXES, motor=False)

    def switch(self, on: bool, axes: tuple[int, ...], *, motor: bool) -> None:
        """Set the servos of these axes, and the motor power."""
        self.motor = motor
        for axis in axes:
            self._servo[axis - 1] = on
        self._world.arm.power(self.motor and any(self._servo))

    def wish(self, command: Command) -> tuple[bool, tuple[int, ...]]:
        """On or off, and for which axes. Raises Refusal."""
        wish, _, axis = (part.strip() for part in command.rest.partition("("))
        if command.word in ("ORIGIN", "ORGRTN"):
            return True, ()
        if wish not in WISHES:
            raise Refusal("5.201")
        if wish == "PWR":
            return True, ()
        return WISHES[wish], (text.integer(axis.removesuffix(")"), 1, text.AXES),) if axis else ALL_AXES

    def permit_power(self) -> None:
        """Raises Refusal while nothing may be switched on."""
        if self._world.estop_pressed:
            raise Refusal(EMERGENCY)
        if self.alarm != NO_ALARM:
            raise Refusal("6.399")
        if self._registers.mode == AUTO_HELD:
            raise Refusal("0.21")

    def permit_motion(self, *, only_automatic: bool) -> None:
        """Raises Refusal while nothing may move, whatever the axes."""
        self.permit_power()
        if self.interlocked:
            raise Refusal(INTERLOCK)
        if only_automatic and self._registers.mode != AUTO_RELEASED:
            raise Refusal("0.20")

    def permit_axes(self, axes: tuple[int, ...]) -> None:
        """Raises Refusal when one of these axes has no power."""
        if not self.motor:
            raise Refusal("6.300")
        if not all(self._servo[axis - 1] for axis in axes):
            raise Refusal("6.301")

    @property
    def interlocked(self) -> bool:
        """The interlock input stops motion."""
        return not self._world.robot_enable or self._world.guard_open

    def queries(self) -> dict[str, Callable[[str], str]]:
        """The questions about the state and the position."""
        everything = [True] * text.AXES
        state: dict[str, Callable[[str], str]] = {
            "EMG": lambda rest: str(int(self._world.estop_pressed)),
            "ALM": lambda rest: self.alarm,
            "MOTOR": lambda rest: str(2 if self.motor and all(self._servo) else int(self.motor)),
            "SERVO": lambda rest: _all_and_each(self._servo),
            "ORIGIN": lambda rest: _all_and_each(everything),
            "WHRXY": lambda rest: position(self._world.arm.joints_at(self._clock.now())),
            "WHERE": lambda rest: pulses(self._world.arm.joints_at(self._clock.now())),
            "VER": lambda rest: "RCX340 V1.20,R0000",
            "CONFIG": lambda rest: "YK400XG",
        }
        return state | {kind: self._port_query(kind) for kind in ("DI", "DO", "MO", "SI", "SO")}

    def _port_query(self, kind: str) -> Callable[[str], str]:
        return lambda rest: self._registers.port(kind, rest, self._dedicated())

    def _dedicated(self) -> tuple[int, int]:
        """Output ports 0 (emergency stop, CPU, servo, alarm) and 1 (automatic, origin complete)."""
        emergency, servo, alarm = self._world.estop_pressed, all(self._servo), self.alarm != NO_ALARM
        automatic = self._registers.mode != MANUAL
        return emergency | 1 << 1 | servo << 2 | alarm << 3, automatic | 1 << 1


def _all_and_each(flags: list[bool]) -> str:
    return f"{int(all(flags))} {','.join(str(int(flag)) for flag in flags)}"
