"""The commands that move the arm: MOVE, MOVEI, DRIVE, DRIVEI, INCH, INCHXY, JOG, JOGXY."""

from collections.abc import Callable
from typing import NamedTuple

from simulators.arm import (
    HIGHEST,
    LINE_MM_PER_S,
    LOWEST,
    Arm,
    Hand,
    Joints,
    ToolPose,
    Unreachable,
    forward,
    inverse,
)
from simulators.clock import Clock
from simulators.robot import text
from simulators.robot.operation import Operation, Work, wait_until
from simulators.robot.registers import Registers
from simulators.robot.text import PointData, Refusal

PULSES = (2912.711, 2912.711, 1638.4, 682.6667)  # per degree, degree, mm, degree
ALL_AXES = (1, 2, 3, 4)
JOG_STEP = 5.0  # mm or degrees in which the end of a jog is looked for
UNREACHABLE = {"position": "2.301", "axis": "2.334", "way": "2.335"}


class Pace(NamedTuple):
    """Fractions of the arm's own speed and accelerations."""

    speed: float
    accel: float
    decel: float


class Motions:
    """Turns motion commands into motions of the arm. `permit` raises Refusal when these axes may not move now."""

    def __init__(
        self, clock: Clock, arm: Arm, registers: Registers, permit: Callable[[tuple[int, ...], bool], None]
    ) -> None:
        self._clock = clock
        self._arm = arm
        self._registers = registers
        self._permit = permit

    def commands(self) -> dict[str, tuple[Callable[[str], Work], str]]:
        """Word -> what prepares it (raising Refusal), and how it ends when the client stops it."""
        stop = "NG=1.8"
        return {
            "MOVE": (lambda rest: self._move(rest, relative=False), stop),
            "MOVEI": (lambda rest: self._move(rest, relative=True), stop),
            "DRIVE": (lambda rest: self._drive(rest, relative=False), stop),
            "DRIVEI": (lambda rest: self._drive(rest, relative=True), stop),
            "INCHXY": (lambda rest: self._inch(rest, straight=True), stop),
            "INCH": (lambda rest: self._inch(rest, straight=False), stop),
            "JOGXY": (lambda rest: self._jog(rest, straight=True), "END"),
            "JOG": (lambda rest: self._jog(rest, straight=False), "END"),
        }

    # -- the commands ------------------------------------------------------------------------------------

    def _move(self, rest: str, *, relative: bool) -> Work:
        (kind, *names), options = text.targets_and_options(rest)
        if kind not in ("P", "L") or not names:
            raise Refusal("5.201")
        straight = kind == "L"
        pace = self._pace(options, straight=straight)
        direct = [None if text.POINT_NUMBER.fullmatch(name) else text.point_data(name) for name in names]
        self._permit(ALL_AXES, True)
        points = [point or self._registers.point(name) for point, name in zip(direct, names, strict=True)]
        first, *others = points
        arrival_s = self._begin(first, pace, straight=straight, relative=relative)

        async def work(operation: Operation) -> str:
            ending = await self._travel(operation, arrival_s)
            for point in others:
                if ending != "END":
                    break
                ending = await self._travel(operation, self._begin(point, pace, straight=straight, relative=relative))
            return ending

        return work

    def _drive(self, rest: str, *, relative: bool) -> Work:
        drives, options = text.drives(rest)
        pace = self._pace(options, straight=False)
        self._permit(tuple(drive.axis for drive in drives), True)
        joints = list(self._arm.joints_at(self._clock.now()))
        for axis, value, in_pulses in drives:
            wanted = value / PULSES[axis - 1] if in_pulses else value
            joints[axis - 1] = wanted + joints[axis - 1] if relative else wanted
        return self._one_motion(self._start(Joints(*joints), pace))

    def _inch(self, rest: str, *, straight: bool) -> Work:
        axis, sign = text.axis_and_sign(rest)
        self._permit(ALL_AXES if straight else (axis,), False)
        now_s, step = self._clock.now(), sign * self._registers.number("IDIST")
        if straight:
            pose = _changed(self._arm.commanded_at(now_s), axis, step / 1000)
            return self._one_motion(self._start(ToolPose(*pose), self._manual_pace(), straight=True))
        joints = _changed(self._arm.joints_at(now_s), axis, step / PULSES[axis - 1])
        return self._one_motion(self._start(Joints(*joints), self._manual_pace()))

    def _jog(self, rest: str, *, straight: bool) -> Work:
        axis, sign = text.axis_and_sign(rest)
        self._permit(ALL_AXES if straight else (axis,), False)
        target: ToolPose | Joints
        if straight:
            target = self._end_of_line(axis, sign)
        else:
            limit = (HIGHEST if sign > 0 else LOWEST)[axis - 1]
            here = self._arm.joints_at(self._clock.now())
            target = Joints._make((*here[: axis - 1], limit, *here[axis:]))
        arrival_s = self._start(target, self._manual_pace(), straight=straight)
        return lambda operation: self._travel(operation, arrival_s, dead_man=True)

    # -- how they move -----------------------------------------------------------------------------------

    def _one_motion(self, arrival_s: float) -> Work:
        return lambda operation: self._travel(operation, arrival_s)

    async def _travel(self, operation: Operation, arrival_s: float, *, dead_man: bool = False) -> str:
        ending = await operation.until(arrival_s, dead_man=dead_man)
        if ending is None:
            return "END"
        await wait_until(self._clock, self._arm.halt())
        return ending

    def _begin(self, point: PointData, pace: Pace, *, straight: bool, relative: bool) -> float:
        target, hand = self._target(point, relative=relative)
        return self._start(target, pace, straight=straight, hand=hand)

    def _target(self, point: PointData, *, relative: bool) -> tuple[ToolPose | Joints, Hand | None]:
        now_s = self._clock.now()
        values = point.values[: text.AXES]
        if point.in_pulses:
            start = self._arm.joints_at(now_s) if relative else (0.0,) * text.AXES
            pairs = zip(values, PULSES, start, strict=True)
            return Joints._make(value / ratio + before for value, ratio, before in pairs), None
        if relative:
            here = self._arm.commanded_at(now_s)
            return ToolPose(*[a + b for a, b in zip(values, here, strict=True)]), None
        return ToolPose(*values), Hand(point.hand) if point.hand else self._registers.hand

    def _start(
        self, target: ToolPose | Joints, pace: Pace, *, straight: bool = False, hand: Hand | None = None
    ) -> float:
        try:
            return self._arm.start(
                target, hand=hand, straight=straight, speed=pace.speed, accel=pace.accel, decel=pace.decel
            )
        except Unreachable as refused:
            here = self._arm.joints_at(self._clock.now()).hand
            across = "2.319" if here is Hand.RIGHTY else "2.320"
            raise Refusal(UNREACHABLE.get(refused.kind, across)) from refused

    def _pace(self, options: dict[str, str], *, straight: bool) -> Pace:
        registers = self._registers
        if "VEL" in options:
            if not straight:
                raise Refusal("5.238")
            speed = text.ranged(text.number(options["VEL"]), 0.1, LINE_MM_PER_S) / LINE_MM_PER_S
        else:
            speed = _percent(options, "S", registers.number("SPEED"))
        accel = registers.share("ACCEL") * _percent(options, "ACC", 100)
        decel = registers.share("DECEL") * _percent(options, "DEC", 100)
        return Pace(speed * registers.number("ASPEED") / 100, accel, decel)

    def _manual_pace(self) -> Pace:
        return Pace(self._registers.number("MSPEED") / 100, 1.0, 1.0)

    def _end_of_line(self, axis: int, sign: int) -> ToolPose:
        now_s = self._clock.now()
        pose, hand = self._arm.commanded_at(now_s), self._arm.joints_at(now_s).hand
        while True:
            further = ToolPose(*_changed(pose, axis, sign * JOG_STEP))
            try:
                inverse(further, hand)
            except Unreachable:
                return pose
            pose = further


def pulses(joints: Joints) -> str:
    """As ?WHERE prints them."""
    return " ".join(str(round(value * ratio)) for value, ratio in zip((*joints, 0, 0), (*PULSES, 1, 1), strict=True))


def position(joints: Joints) -> str:
    """As ?WHRXY prints it."""
    return str(PointData((*forward(joints), 0.0, 0.0), False, int(joints.hand)))


def _percent(options: dict[str, str], name: str, otherwise: int) -> float:
    value = text.number(options[name]) if name in options else otherwise
    return text.ranged(value, 0.01, 100) / 100


def _changed(values: tuple[float, ...], axis: int, by: float) -> list[float]:
    return [value + (by if k == axis else 0.0) for k, value in enumerate(values, 1)]
