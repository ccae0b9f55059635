"""What the controller keeps by number: points, hands (tools), shifts (work frames), pallets; and its variables."""

import re
from dataclasses import dataclass, field
from typing import NamedTuple

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.values import HIGHEST, LARGEST, LOWEST, PointData, Value, checked, number

HIGHEST_HAND, HIGHEST_SHIFT, HIGHEST_PALLET = 31, 39, 39
GLOBALS = re.compile(r"(A?)SG([IR])(\d{1,2})", re.ASCII)
HIGHEST_GLOBAL = {"": 31, "A": 7}
MOST_VARIABLES = 500
MOST_ELEMENTS = 10_000
PALLET_POINTS = 5


class HandData(NamedTuple):
    """A tool: on the second arm a pulse difference, on the R axis an angle; then a length and a height in mm."""

    turn: float
    length_mm: float
    height_mm: float
    on_r: bool


class ShiftData(NamedTuple):
    """A work frame in robot coordinates."""

    dx_mm: float
    dy_mm: float
    dz_mm: float
    dr_deg: float


class Pallet(NamedTuple):
    """How many places along each edge, and the first of the five points that span it."""

    nx: int
    ny: int
    nz: int
    first_point: int


@dataclass
class Tables:
    """Survives an alarm; whether it survives a restart is the battery's matter."""

    highest_point: int
    points: dict[int, PointData] = field(default_factory=dict)
    hands: dict[int, HandData] = field(default_factory=dict)
    shifts: dict[int, ShiftData] = field(default_factory=dict)
    pallets: dict[int, Pallet] = field(default_factory=dict)

    def point(self, point_number: int) -> PointData:
        """Raises Refusal POINT_NUMBER, NO_POINT."""
        try:
            return self.points[self.point_number(point_number)]
        except KeyError:
            raise Refusal(Code.NO_POINT) from None

    def point_number(self, point_number: int) -> int:
        """The number when there can be such a point; raises Refusal POINT_NUMBER."""
        if not 0 <= point_number <= self.highest_point:
            raise Refusal(Code.POINT_NUMBER)
        return point_number

    def set_coordinate(self, point_number: int, axis: int, value: float) -> None:
        """One value of a point that is there; raises Refusal."""
        old = self.point(point_number)
        values = (*old.values[: axis - 1], float(value), *old.values[axis:])
        self.points[point_number] = old._replace(values=values)

    def set_entry(self, kind: str, entry: int, numbers: tuple[float, ...], *, tool_on_r: bool) -> None:
        """Define a hand (H), a shift (S) or a pallet (PL); raises Refusal."""
        highest = {"H": HIGHEST_HAND, "S": HIGHEST_SHIFT, "PL": HIGHEST_PALLET}[kind]
        wrong = {"H": Code.HAND_NUMBER, "S": Code.SHIFT_NUMBER, "PL": Code.PALLET_NUMBER}[kind]
        if not 0 <= entry <= highest:
            raise Refusal(wrong)
        if kind == "H":
            self.hands[entry] = HandData(numbers[0], numbers[1], numbers[2], tool_on_r)
        elif kind == "S":
            self.shifts[entry] = ShiftData(numbers[0], numbers[1], numbers[2], numbers[3])
        else:
            self._set_pallet(entry, numbers)

    def pallet(self, entry: int) -> Pallet:
        """Raises Refusal PALLET_NUMBER, UNDEFINED_PALLET."""
        if not 0 <= entry <= HIGHEST_PALLET:
            raise Refusal(Code.PALLET_NUMBER)
        if entry not in self.pallets:
            raise Refusal(Code.UNDEFINED_PALLET)
        return self.pallets[entry]

    def _set_pallet(self, entry: int, numbers: tuple[float, ...]) -> None:
        nx, ny, nz = (round(n) for n in numbers)
        if not (1 <= nx <= 32767 and 1 <= ny <= 32767 and 1 <= nz <= 32767):
            raise Refusal(Code.PALLET_PARAMETER)
        first = 3996 - PALLET_POINTS * entry  # P3996 .. P4000 span pallet 0, the five before them pallet 1
        self.pallets[entry] = Pallet(nx, ny, nz, first)


class Variables:
    """Global ones by name; A% whole numbers, A! and A numbers with a point, A$ texts. Unset ones are 0 or empty."""

    def __init__(self) -> None:
        self._values: dict[tuple[str, tuple[int, ...]], Value] = {}
        self._sizes: dict[str, tuple[int, ...]] = {}

    def knows(self, name: str) -> bool:
        """Whether it has ever been set, or is always there."""
        return GLOBALS.fullmatch(name) is not None or any(known == name for known, _ in self._values)

    def dimension(self, name: str, sizes: tuple[int, ...]) -> None:
        """Declare an array; raises Refusal SUBSCRIPT."""
        elements = 1
        for size in sizes:
            elements *= size + 1
        if not sizes or min(sizes) < 0 or elements > MOST_ELEMENTS:
            raise Refusal(Code.SUBSCRIPT)
        self._sizes[name] = sizes

    def get(self, name: str, indices: tuple[int, ...]) -> Value:
        """Raises Refusal UNDEFINED_ARRAY, SUBSCRIPT, OUT_OF_RANGE."""
        self._check(name, indices)
        return self._values.get((name, indices), "" if name.endswith("$") else 0)

    def set(self, name: str, indices: tuple[int, ...], value: Value) -> None:
        """Raises Refusal TYPE_MISMATCH and those of `get`."""
        self._check(name, indices)
        if (name, indices) not in self._values and len(self._values) >= MOST_VARIABLES + MOST_ELEMENTS:
            raise Refusal(Code.MEMORY_FULL)
        self._values[name, indices] = _fitting(name, value)

    def items(self) -> list[tuple[str, Value]]:
        """The plain variables."""
        return sorted((name, value) for (name, indices), value in self._values.items() if not indices)

    def _check(self, name: str, indices: tuple[int, ...]) -> None:
        if found := GLOBALS.fullmatch(name):
            if indices or int(found[3]) > HIGHEST_GLOBAL[found[1]]:
                raise Refusal(Code.OUT_OF_RANGE)
        elif indices:
            sizes = self._sizes.get(name)
            if sizes is None:
                raise Refusal(Code.UNDEFINED_ARRAY)
            if len(sizes) != len(indices) or not all(0 <= k <= size for k, size in zip(indices, sizes, strict=True)):
                raise Refusal(Code.SUBSCRIPT)


def _fitting(name: str, value: Value) -> Value:
    if name.endswith("$"):
        if not isinstance(value, str):
            raise Refusal(Code.TYPE_MISMATCH)
        return value[:255]
    is_whole = name.endswith("%") or ((found := GLOBALS.fullmatch(name)) is not None and found[2] == "I")
    found_number = checked(number(value))
    if is_whole:
        if not LOWEST <= found_number <= HIGHEST:
            raise Refusal(Code.OUT_OF_RANGE)
        return round(found_number)
    if abs(found_number) > LARGEST * 1000:
        raise Refusal(Code.OUT_OF_RANGE)
    return float(found_number)
