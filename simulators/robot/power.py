"""Motor power, servos, brakes, and whether the axes know where they are."""

from simulators.robot.dialect import AXES
from simulators.robot.log import Log
from simulators.robot.options import Options
from simulators.robot.world import World

BRAKED, ON, FREE = 0, 1, 2
STATES = {"ON": ON, "PWR": BRAKED, "OFF": BRAKED, "FREE": FREE}
ALL_AXES = tuple(range(1, AXES + 1))
Z = 2  # index of the axis that has a weight to bear
WHOLE_STROKE_MM = 1000.0


class Power:
    """What the safety inputs, the alarms and the power commands change."""

    def __init__(self, world: World, log: Log, options: Options) -> None:
        self.motor = False
        self.servo = [BRAKED] * AXES
        self.origin = [True] * AXES
        self._world, self._log, self._options = world, log, options
        self._z_was = BRAKED

    @property
    def all_on(self) -> bool:
        """Motor power and every servo."""
        return self.motor and all(axis == ON for axis in self.servo)

    @property
    def level(self) -> int:
        """0 off, 1 motor power, 2 motor power and all servos."""
        return 2 if self.all_on else int(self.motor)

    def on(self, axes: tuple[int, ...]) -> bool:
        """Whether these servos hold their axes."""
        return all(self.servo[axis - 1] == ON for axis in axes)

    def switch(self, wish: str, axis: int | None) -> None:
        """ON, OFF, FREE or PWR; without an axis the motor power goes with it."""
        if axis is None:
            self.motor = wish in ("ON", "PWR")
        elif wish == "ON":
            self.motor = True
        for each in (axis,) if axis else ALL_AXES:
            if wish != "PWR":
                self.servo[each - 1] = STATES[wish]
        self._tell()

    def cut(self) -> None:
        """An alarm or the emergency stop: power off, brakes on."""
        self.motor = False
        self.servo = [BRAKED] * AXES
        self._tell()

    def _tell(self) -> None:
        self._world.arm.power(self.motor and ON in self.servo)
        self._bear_z(self._z_was, self.servo[Z])
        self._z_was = self.servo[Z]
        self._log.add("power", motor=self.motor, servo=tuple(self.servo))

    def _bear_z(self, before: int, now: int) -> None:
        """The third axis sinks while nothing holds it, and a little until its brake does."""
        arm, options = self._world.arm, self._options
        if now == FREE and before != FREE:
            arm.sink(WHOLE_STROKE_MM, options.free_z_mm_per_s)
        elif before == FREE and now != FREE:
            arm.halt(hard=True)
        elif before == ON and now == BRAKED:
            arm.sink(options.brake_sag_mm, options.free_z_mm_per_s)
