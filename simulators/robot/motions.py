"""MOVE, MOVEI, DRIVE, DRIVEI, PMOVE: what they ask of the arm, and how they go on until they end."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from simulators.moves import Arc, Arch, Go, Line, Order, Plan
from simulators.robot.codes import Code, Refusal
from simulators.robot.language.commands import Drive, Move, MoveOptions, PalletMove, axis_number
from simulators.robot.language.values import Expression, PointData, Scope, integer, number, real
from simulators.robot.log import Log
from simulators.robot.operation import Ending, Operation, Work, wait_until
from simulators.robot.settings import Settings
from simulators.robot.targets import Targets
from simulators.robot.world import World
from simulators.scara import Joints, Unreachable, forward
from simulators.ways import Pace

ALL_AXES = (1, 2, 3, 4)
LOOK_AGAIN_S = 0.002  # at a STOPON condition
SLOWEST_MM_PER_S = 0.1
TOP_OF_STROKE_MM = 0.0
NOTICED_S = 1.0

Permit = Callable[[tuple[int, ...]], None]  # raises Refusal when these axes may not move now


@dataclass(frozen=True)
class Given:
    """The options of a motion, evaluated. `arch_mm`: the height, and how far below it the travel begins and ends."""

    pace: Pace
    blends: bool = False
    arch_mm: tuple[float, float, float] | None = None
    stop_on: Callable[[], bool] | None = None


class Motions:
    """Each method begins a motion at once, so that what cannot be done is refused, and returns what goes on with it.

    `speed` is the share of full speed that the mode leaves; `begun` is told of every motion that begins.
    """

    def __init__(
        self,
        world: World,
        settings: Settings,
        targets: Targets,
        speed: Callable[[], float],
        begun: Callable[[Plan], None],
        log: Log,
    ) -> None:
        self._clock, self._arm = world.clock, world.arm
        self._settings, self._targets = settings, targets
        self._speed, self._begun, self._log = speed, begun, log
        self.ends_within: str | None = None  # the setting by which a motion counts as done before it has arrived
        self.last: Plan | None = None
        self.last_blends = False
        self._done: Plan | None = None
        self._halted: Plan | None = None

    @property
    def settles(self) -> bool:
        """Whether the last motion counts as done, though the arm may still creep to its end."""
        return self._done is not None and self._done is self.last and not self.last_blends

    def move(self, wanted: Move, scope: Scope, permit: Permit, *, relative: bool) -> Work:
        """MOVE and MOVEI."""
        given = self._given(wanted.options, scope)
        permit(ALL_AXES)
        points = [target(scope) for target in wanted.targets]
        per_motion = 2 if wanted.kind == "C" else 1
        first, *others = [points[k : k + per_motion] for k in range(0, len(points), per_motion)]
        begun = self._begin(wanted.kind, first, given, relative=relative)

        async def work(operation: Operation) -> Ending:
            plan = begun
            for group in others:
                if not await self.travel(operation, plan, given):
                    return operation.ending
                plan = self._begin(wanted.kind, group, given, relative=relative)
            await self.travel(operation, plan, given)
            return operation.ending

        return work

    def drive(self, wanted: Drive, scope: Scope, permit: Permit, *, relative: bool) -> Work:
        """DRIVE and DRIVEI."""
        given = self._given(wanted.options, scope)
        axes = tuple(axis_number(axis, scope) for axis, _ in wanted.axes)
        permit(axes)
        joints = list(self._arm.joints_at(self._clock.now()))
        for axis, (_, where) in zip(axes, wanted.axes, strict=True):
            by = self._axis_target(axis, where(scope))
            joints[axis - 1] = by + joints[axis - 1] if relative else by
        return self.one(self.start(Go(Joints(*joints)), given), given)

    def pallet(self, wanted: PalletMove, scope: Scope, permit: Permit) -> Work:
        """PMOVE: up to the top, across, and down onto a place of a pallet."""
        given = self._given(wanted.options, scope)
        permit(ALL_AXES)
        point = self._targets.pallet_place(integer(wanted.pallet(scope)), integer(wanted.place(scope)))
        place, hand = self._targets.place(point)
        over = given.arch_mm or (TOP_OF_STROKE_MM, 0.0, 0.0)
        return self.one(self.start(Arch(place, *over, hand=hand), given), given)

    def start(self, order: Order, given: Given) -> Plan:
        """Let the arm begin; raises Refusal when it cannot."""
        try:
            plan = self._arm.start(order, given.pace, blends=given.blends, follows=self.settles)
        except Unreachable as unreachable:
            raise self._targets.why_not(unreachable) from unreachable
        except RuntimeError:
            raise Refusal(Code.MOVING) from None
        way, begins, ends = type(order).__name__, forward(plan.start), forward(plan.end)
        times = {"begins_s": plan.begin_s, "ends_s": plan.end_s}
        self._log.add("moves", way=way, begins=begins, ends=ends, **times, blends=given.blends)
        self.last, self.last_blends = plan, given.blends
        self._begun(plan)
        return plan

    def full_pace(self) -> Pace:
        """As quick as the mode and the payload allow."""
        quick = self._arm.scara.quickness(self._settings.payload_kg())
        return Pace(self._speed(), quick, quick)

    def halt(self) -> float:
        """Stop the arm; the world time at which it stands."""
        stands_s = self._arm.halt()
        if self.last is not self._halted:
            self._halted = self.last
            self._log.add("halted", at=self._arm.commanded_at(stands_s), stands_s=stands_s)
        return stands_s

    def one(self, plan: Plan, given: Given) -> Work:
        """The rest of a single motion."""

        async def work(operation: Operation) -> Ending:
            await self.travel(operation, plan, given)
            return operation.ending

        return work

    async def travel(self, operation: Operation, plan: Plan, given: Given) -> bool:
        """Until the motion ends or, when it blends, may be followed; False when it was interrupted: then it stands."""
        near = "CONTPLS" if given.blends else self.ends_within
        done_s = plan.near_s(self._within(near)) if near else plan.end_s
        if given.stop_on is not None and await self._stopped_on(operation, done_s, given.stop_on):
            return True
        if await operation.until(done_s) and (given.blends or self._arm.arrives(plan)):
            self._done = plan
            return True
        await operation.until(done_s + NOTICED_S)  # something has stopped the arm, and will say so
        await wait_until(self._clock, self.halt())
        return not operation.interrupted

    async def _stopped_on(self, operation: Operation, done_s: float, condition: Callable[[], bool]) -> bool:
        while self._clock.now() < done_s and await operation.until(min(self._clock.now() + LOOK_AGAIN_S, done_s)):
            if condition():
                await wait_until(self._clock, self.halt())
                return True
        return False

    # -- what is asked -----------------------------------------------------------------------------------

    def _begin(self, kind: str, points: Sequence[PointData], given: Given, *, relative: bool) -> Plan:
        *via, (place, hand) = [self._targets.place(point, relative=relative) for point in points]
        order: Order
        if kind == "C":
            order = Arc(via[0][0], place, hand)
        elif kind == "L":
            order = Line(place, hand)
        elif given.arch_mm is not None:
            order = Arch(place, *given.arch_mm, hand=hand)
        else:
            order = Go(place, hand)
        return self.start(order, given)

    def _given(self, options: MoveOptions, scope: Scope) -> Given:
        settings, scara = self._settings, self._arm.scara
        path_mm_per_s = None
        if options.path_speed is not None:
            path_mm_per_s = real(options.path_speed(scope), SLOWEST_MM_PER_S, scara.line_mm_per_s) * self._speed()
        speed = _percent(options.speed, settings.number("SPEED"), scope) * self._speed()
        quick = scara.quickness(settings.payload_kg())
        accel = settings.share("ACCEL") * _percent(options.accel, 100, scope) * quick
        decel = settings.share("DECEL") * _percent(options.decel, 100, scope) * quick
        stop_on = options.stop_on
        return Given(
            Pace(speed, accel, decel, path_mm_per_s),
            options.blends,
            self._arch_mm(options, scope),
            None if stop_on is None else lambda: number(stop_on(scope)) != 0,
        )

    def _arch_mm(self, options: MoveOptions, scope: Scope) -> tuple[float, float, float] | None:
        if options.arch is None:
            return None
        begin_mm, end_mm = [abs(self._height_mm(each, scope)) for each in options.arch.below] or (0.0, 0.0)
        return self._height_mm(options.arch.height, scope), begin_mm, end_mm

    def _height_mm(self, expression: Expression, scope: Scope) -> float:
        """A place of the third axis; a whole number is in pulses."""
        value = number(expression(scope))
        return self._targets.axis_value(3, value, in_pulses=isinstance(value, int))

    def _axis_target(self, axis: int, value: object) -> float:
        if isinstance(value, PointData):
            return self._targets.axis_value(axis, value.values[axis - 1], in_pulses=value.in_pulses)
        if isinstance(value, int | float):
            return self._targets.axis_value(axis, value, in_pulses=isinstance(value, int))
        raise Refusal(Code.TYPE_MISMATCH)

    def _within(self, setting: str) -> list[float]:
        """So near to its end each axis has to be, in degrees or mm."""
        return [
            pulses / ratio for pulses, ratio in zip(self._settings.axes(setting), self._targets.pulses, strict=True)
        ]


def _percent(expression: Expression | None, otherwise: int, scope: Scope) -> float:
    value = number(expression(scope)) if expression is not None else otherwise
    return real(value, 0.01, 100) / 100
