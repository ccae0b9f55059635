"""Points to places where the arm can be sent."""

from collections.abc import Callable

from simulators.arm import Arm
from simulators.robot.codes import Code, Refusal
from simulators.robot.dialect import AXES
from simulators.robot.frames import Frames
from simulators.robot.language.values import PointData
from simulators.robot.settings import Settings
from simulators.robot.tables import PALLET_POINTS, Tables
from simulators.scara import Hand, Joints, ToolPose, Unreachable, forward

Place = ToolPose | Joints
WHY_NOT = {
    "position": Code.COORDINATE,
    "axis": Code.SOFT_LIMIT,
    "way": Code.MOVABLE_RANGE,
    "same": Code.ARC_SAME_POINT,
    "line": Code.ARC_ON_LINE,
    "arch": Code.ARCH,
}


class Targets:
    """What a point means: pulses or millimetres, which hand, in which frame."""

    def __init__(self, arm: Arm, now: Callable[[], float], settings: Settings, tables: Tables, frames: Frames) -> None:
        self._arm, self._now = arm, now
        self._settings, self._tables, self._frames = settings, tables, frames
        self.pulses = arm.scara.pulses  # per degree or millimetre of each axis
        self.flip_hands = False  # a mishap: the controller takes the other elbow

    @property
    def hand(self) -> Hand:
        """The hand for positions that say none."""
        return Hand(self._settings.number("ARMSEL"))

    def here(self) -> PointData:
        """Where the arm is, in the chosen frame, in mm and degrees."""
        joints = self._arm.joints_at(self._now())
        return PointData((*self._frames.said(forward(joints)), 0.0, 0.0), in_pulses=False, hand=int(joints.hand))

    def here_in_pulses(self) -> PointData:
        """Where the arm is, in pulses."""
        joints = self._arm.joints_at(self._now())
        pulses = tuple(float(round(value * ratio)) for value, ratio in zip(joints, self.pulses, strict=True))
        return PointData((*pulses, 0.0, 0.0), in_pulses=True, hand=int(joints.hand))

    def axis_value(self, axis: int, value: float, *, in_pulses: bool) -> float:
        """Degrees or millimetres of an axis."""
        return value / self.pulses[axis - 1] if in_pulses else value

    def place(self, point: PointData, *, relative: bool = False) -> tuple[Place, Hand | None]:
        """Where a point sends the arm, and with which hand (None: as it is)."""
        values = point.values[:AXES]
        if point.in_pulses:
            start = self._arm.joints_at(self._now()) if relative else (0.0,) * AXES
            pairs = zip(values, self.pulses, start, strict=True)
            return Joints._make(value / ratio + before for value, ratio, before in pairs), None
        if relative:
            here = self.here().values[:AXES]
            return self._frames.flange(ToolPose(*(a + b for a, b in zip(values, here, strict=True)))), None
        hand = Hand(point.hand) if point.hand else self.hand
        if self.flip_hands:
            hand = Hand.LEFTY if hand is Hand.RIGHTY else Hand.RIGHTY
        return self._frames.flange(ToolPose(*values)), hand

    def pallet_place(self, pallet: int, position: int) -> PointData:
        """The point of a place on a pallet, counted from 1 along x, then y, then z; raises Refusal."""
        entry = self._tables.pallet(pallet)
        if not 1 <= position <= entry.nx * entry.ny * entry.nz:
            raise Refusal(Code.PARAMETER_RANGE)
        corner, x_end, y_end, opposite, z_end = (
            self._tables.point(entry.first_point + k) for k in range(PALLET_POINTS)
        )
        layer, rest = divmod(position - 1, entry.nx * entry.ny)
        row, column = divmod(rest, entry.nx)
        a, b, c = (k / (n - 1) if n > 1 else 0.0 for k, n in ((column, entry.nx), (row, entry.ny), (layer, entry.nz)))
        if len({point.in_pulses for point in (corner, x_end, y_end, opposite, z_end)}) > 1:
            raise Refusal(Code.COORDINATE_TYPE)
        values = tuple(
            (1 - a) * (1 - b) * p1 + a * (1 - b) * p2 + (1 - a) * b * p3 + a * b * p4 + c * (p5 - p1)
            for p1, p2, p3, p4, p5 in zip(
                corner.values, x_end.values, y_end.values, opposite.values, z_end.values, strict=True
            )
        )
        return corner._replace(values=values)

    def why_not(self, unreachable: Unreachable) -> Refusal:
        """The code for a place that the arm cannot reach."""
        if unreachable.kind == "hand":
            righty = self._arm.joints_at(self._now()).hand is Hand.RIGHTY
            return Refusal(Code.RIGHTY_TO_LEFTY if righty else Code.LEFTY_TO_RIGHTY)
        return Refusal(WHY_NOT[unreachable.kind])


def changed(values: tuple[float, ...], axis: int, by: float) -> tuple[float, ...]:
    """The same with one axis changed."""
    return tuple(value + (by if k == axis else 0.0) for k, value in enumerate(values, 1))
