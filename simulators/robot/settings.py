"""Speeds, accelerations, tolerances: numbers for the robot or for each of its axes."""

from collections.abc import Callable
from dataclasses import dataclass, field

from simulators.robot.codes import Code, Refusal
from simulators.robot.dialect import AXES
from simulators.robot.language.commands import Number, axis_number
from simulators.robot.language.values import Scope, integer, number

DEFAULTS = {
    "ASPEED": 100,
    "MSPEED": 20,
    "SPEED": 100,
    "WEIGHT": 2,
    "WEIGHTG": 2000,
    "ARMSEL": 1,
    "ARMTYP": 0,
    "IDIST": 1000,
    "UNIT": 0,
}
AXIS_DEFAULTS = {
    "ACCEL": 100,
    "DECEL": 100,
    "TORQUE": 100,
    "TOLE": 80,
    "OUTPOS": 2000,
    "CONTPLS": 2000,
    "ARCH": 2000,
    "ORGORD": 1,
    "AXWGHT": 0,
}
PERCENT = ("ASPEED", "MSPEED", "SPEED", "ACCEL", "DECEL", "TORQUE")
RANGES = {
    **dict.fromkeys(PERCENT, (1, 100)),
    "WEIGHT": (0, 5),
    "WEIGHTG": (0, 5000),
    "ARMSEL": (1, 2),
    "ARMTYP": (0, 1),
    "IDIST": (1, 50000),
    "UNIT": (0, 1),
    "ORGORD": (0, 123456),
}
OTHERWISE = (0, 9999999)
COUNTS = {"ARMTYP": (1, 2)}  # for now, and for after a program reset


@dataclass
class Settings:
    """Numbers by name. `changed` is told the name after each change."""

    changed: Callable[[str], None]
    _whole: dict[str, int] = field(default_factory=lambda: dict(DEFAULTS))
    _by_axis: dict[str, list[int]] = field(
        default_factory=lambda: {name: [value] * AXES for name, value in AXIS_DEFAULTS.items()}
    )

    def restore(self) -> None:
        """As they are at power on."""
        self._whole = dict(DEFAULTS)
        self._by_axis = {name: [value] * AXES for name, value in AXIS_DEFAULTS.items()}

    def number(self, name: str) -> int:
        """A setting of the robot."""
        return self._whole[name]

    def axes(self, name: str) -> list[int]:
        """A setting of each axis."""
        return list(self._by_axis[name])

    def share(self, name: str) -> float:
        """A percentage of each axis as the fraction that holds for all of them."""
        return min(self._by_axis[name]) / 100

    def payload_kg(self) -> float:
        """What the controller believes that the arm carries."""
        return self._whole["WEIGHTG"] / 1000

    def knows(self, name: str) -> bool:
        """Whether there is such a setting."""
        return name in self._whole or name in self._by_axis

    def value(self, name: str, axis: int | None) -> int:
        """For an expression; raises Refusal AXIS_NUMBER, NO_SUCH_COMMAND."""
        if name in self._whole:
            return self._whole[name]
        if name not in self._by_axis:
            raise Refusal(Code.NO_SUCH_COMMAND)
        if axis is not None and not 1 <= axis <= AXES:
            raise Refusal(Code.AXIS_NUMBER)
        return self._by_axis[name][(axis or 1) - 1]

    def set(self, name: str, given: Number, scope: Scope) -> None:
        """For the robot, for one axis, or for all of them; raises Refusal."""
        low, high = RANGES.get(name, OTHERWISE)
        found = [integer(number(each(scope)), low, high) for each in given.values]
        if name in self._by_axis and given.axis is not None and len(found) == 1:
            self._by_axis[name][axis_number(given.axis, scope) - 1] = found[0]
        elif name in self._by_axis and given.axis is None and len(found) in (1, AXES):
            self._by_axis[name] = found * AXES if len(found) == 1 else found
        elif name in self._whole and given.axis is None and len(found) in COUNTS.get(name, (1,)):
            self.put(name, found[0])
        else:
            raise Refusal(Code.COMMAND_LINE)
        self.changed(name)

    def put(self, name: str, value: int) -> None:
        """Set one for the robot, as its own pendant does. WEIGHT is in kg, WEIGHTG the same in grams."""
        self._whole[name] = value
        if name == "WEIGHT":
            self._whole["WEIGHTG"] = value * 1000
        elif name == "WEIGHTG":
            self._whole["WEIGHT"] = round(value / 1000)
