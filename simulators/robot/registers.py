"""What the controller remembers: settings, points, outputs; and the commands that only read or write these."""

from collections.abc import Callable

from simulators.arm import Hand
from simulators.robot import text
from simulators.robot.text import PointData, Refusal

AUTO_RELEASED, AUTO_HELD, MANUAL = 2, 1, 0
PERCENT = {"ASPEED": 100, "MSPEED": 20, "SPEED": 100}
AXIS_PERCENT = {"ACCEL": 100, "DECEL": 100, "TORQUE": 100}
NUMBERS = {"WEIGHT": 2, "WEIGHTG": 2000, "ARCH": 2000, "ARMSEL": 1, "IDIST": 1000}
AXIS_NUMBERS = {"TOLE": 80, "OUTPOS": 2000, "CONTPLS": 2000, "ORGORD": 1, "AXWGHT": 0}
LARGEST = {"IDIST": 10000, "ARMSEL": 2, "WEIGHT": 5, "WEIGHTG": 5000}
PORTS = range(8)
FIRST_USER_PORT = 2


class Registers:
    """The controller's memory. Handlers take the text behind the word and raise Refusal."""

    def __init__(self) -> None:
        self.mode = AUTO_RELEASED
        self.hand = Hand.RIGHTY
        self.points: dict[int, PointData] = {}
        self._numbers = PERCENT | NUMBERS
        self._by_axis = {name: [value] * text.AXES for name, value in (AXIS_PERCENT | AXIS_NUMBERS).items()}
        self._bytes = {kind: [0] * len(PORTS) for kind in ("DI", "DO", "MO", "SI", "SO")}
        self._globals = [0] * 8
        self._chosen = {"CHANGE": "OFF", "SHIFT": "OFF"}

    def number(self, name: str) -> int:
        """The value of a setting."""
        return self._numbers[name]

    def share(self, name: str) -> float:
        """ACCEL or DECEL as the fraction that holds for all axes."""
        return min(self._by_axis[name]) / 100

    def settings(self) -> dict[str, Callable[[str], None]]:
        """The commands that OK answers."""
        own: dict[str, Callable[[str], None]] = {
            "P": self._set_point,
            "LOC": self._set_coordinate,
            "ASGI": self._set_global,
            "RIGHTY": lambda rest: self._set_hand(Hand.RIGHTY, rest),
            "LEFTY": lambda rest: self._set_hand(Hand.LEFTY, rest),
            "CHANGE": lambda rest: self._choose("CHANGE", "H", rest),
            "SHIFT": lambda rest: self._choose("SHIFT", "S", rest),
            "AUTO": lambda rest: self._set_mode(AUTO_RELEASED, rest),
            "MANUAL": lambda rest: self._set_mode(MANUAL, rest),
        }
        numbers = {name: self._setter(name) for name in self._numbers}
        by_axis = {name: self._axis_setter(name) for name in self._by_axis}
        return own | numbers | by_axis | {kind: self._port_setter(kind) for kind in ("DO", "MO", "SO")}

    def queries(self) -> dict[str, Callable[[str], str]]:
        """The commands that a value and OK answer."""
        own: dict[str, Callable[[str], str]] = {
            "MODE": lambda rest: str(self.mode),
            "P": lambda rest: str(self.point(f"P{rest}")),
            "LOC": self._coordinate,
            "ASGI": lambda rest: str(self._globals[text.integer(rest, 0, 7)]),
            "ARMCND": lambda rest: str(int(self.hand)),
            "HAND": lambda rest: self._chosen["CHANGE"],
            "SHIFT": lambda rest: self._chosen["SHIFT"],
        }
        numbers = {name: self._getter(name) for name in self._numbers}
        return own | numbers | {name: self._axis_getter(name) for name in self._by_axis}

    def port(self, kind: str, rest: str, dedicated: tuple[int, int]) -> str:
        """A port's byte or one of its bits; ports 0 and 1 show the controller's own state."""
        port, bit = text.port_and_bit(rest)
        if port not in PORTS:
            raise Refusal("4.211")
        shows_state = port < FIRST_USER_PORT and kind in ("DO", "SO")
        byte = dedicated[port] if shows_state else self._bytes[kind][port]
        return str(byte if bit is None else byte >> bit & 1)

    def point(self, name: str) -> PointData:
        """A stored point by name; raises Refusal 6.204."""
        try:
            return self.points[text.point_number(name)]
        except KeyError:
            raise Refusal("6.204") from None

    def _set_point(self, rest: str) -> None:
        name, equals, value = rest.partition("=")
        if not equals:
            raise Refusal("5.201")
        self.points[text.point_number(f"P{name.strip()}")] = text.point_data(value)

    def _set_coordinate(self, rest: str) -> None:
        left, _, value = rest.partition("=")
        axis, point = self._coordinate_of(left)
        old = self.point(point)
        values = (*old.values[: axis - 1], text.number(value), *old.values[axis:])
        self.points[text.point_number(point)] = old._replace(values=values)

    def _coordinate(self, rest: str) -> str:
        axis, point = self._coordinate_of(rest)
        value = self.point(point)
        return str(round(value.values[axis - 1])) if value.in_pulses else text.three_decimals(value.values[axis - 1])

    def _coordinate_of(self, rest: str) -> tuple[int, str]:
        axis, bracket, point = rest.strip().removesuffix(")").partition("(")
        if not bracket:
            raise Refusal("5.201")
        return text.integer(axis, 1, 6), point

    def _set_global(self, rest: str) -> None:
        index, equals, value = rest.partition("=")
        if not equals:
            raise Refusal("5.201")
        self._globals[text.integer(index, 0, 7)] = text.integer(value, -(2**30), 2**30 - 1)

    def _set_hand(self, hand: Hand, rest: str) -> None:
        _nothing(rest)
        self.hand = hand

    def _set_mode(self, mode: int, rest: str) -> None:
        _nothing(rest)
        if self.mode not in (AUTO_RELEASED, MANUAL):
            raise Refusal("0.21")
        self.mode = mode

    def _choose(self, what: str, letter: str, rest: str) -> None:
        name = rest.strip()
        if name != "OFF":
            text.integer(name.removeprefix(letter) if name.startswith(letter) else "", 0, 39)
        self._chosen[what] = name

    def _setter(self, name: str) -> Callable[[str], None]:
        def set_it(rest: str) -> None:
            low = 0 if name.startswith("WEIGHT") else 1
            largest = LARGEST.get(name, 100 if name in PERCENT else 99999)
            self._numbers[name] = text.integer(rest, low, largest)

        return set_it

    def _getter(self, name: str) -> Callable[[str], str]:
        return lambda rest: str(self._numbers[name])

    def _axis_setter(self, name: str) -> Callable[[str], None]:
        largest = 100 if name in AXIS_PERCENT else 99999

        def set_it(rest: str) -> None:
            if found := text.INDEXED.fullmatch(rest):
                axis = text.integer(found[1], 1, text.AXES)
                self._by_axis[name][axis - 1] = round(text.ranged(text.number(found[2]), 1, largest))
            else:
                self._by_axis[name] = [text.integer(rest, 1, largest)] * text.AXES

        return set_it

    def _axis_getter(self, name: str) -> Callable[[str], str]:
        def get(rest: str) -> str:
            values, axis = self._by_axis[name], rest.strip().removeprefix("(").removesuffix(")")
            return str(values[text.integer(axis, 1, text.AXES) - 1]) if axis else ",".join(map(str, values))

        return get

    def _port_setter(self, kind: str) -> Callable[[str], None]:
        def set_it(rest: str) -> None:
            left, equals, value = rest.partition("=")
            if not equals:
                raise Refusal("5.201")
            port, bit = text.port_and_bit(left)
            if port not in PORTS or port < FIRST_USER_PORT:
                raise Refusal("4.211")
            new = text.integer(value, 0, 255 if bit is None else 1)
            old = self._bytes[kind][port]
            self._bytes[kind][port] = new if bit is None else old & ~(1 << bit) | new << bit

        return set_it


def _nothing(rest: str) -> None:
    if rest.strip():
        raise Refusal("5.251")
