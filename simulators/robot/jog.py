"""JOG, JOGXY, INCH, INCHXY: the arm by hand, at manual speed."""

from simulators.moves import Go, Line, Order
from simulators.robot.language.commands import Step
from simulators.robot.motions import ALL_AXES, Given, Motions, Permit
from simulators.robot.operation import Ending, Operation, Work, wait_until
from simulators.robot.settings import Settings
from simulators.robot.targets import Targets, changed
from simulators.robot.world import World
from simulators.scara import Joints, ToolPose, Unreachable
from simulators.ways import Pace

LOOK_MM = 5.0  # or degrees, in which the end of a straight jog is looked for
MM_PER_UM = 0.001


class Jog:
    """`straight` moves the tool along x, y, z or turns it; else one axis of the arm moves."""

    def __init__(self, world: World, settings: Settings, targets: Targets, motions: Motions) -> None:
        self._clock, self._arm = world.clock, world.arm
        self._settings, self._targets, self._motions = settings, targets, motions

    def inch(self, step: Step, permit: Permit, *, straight: bool) -> Work:
        """A step of IDIST, in micrometres or pulses."""
        permit(ALL_AXES if straight else (step.axis,))
        by = step.sign * self._settings.number("IDIST")
        now_s = self._clock.now()
        order: Order
        if straight:
            order = Line(ToolPose(*changed(self._arm.commanded_at(now_s), step.axis, by * MM_PER_UM)))
        else:
            turn = by / self._targets.pulses[step.axis - 1]
            order = Go(Joints(*changed(self._arm.joints_at(now_s), step.axis, turn)))
        return self._motions.one(self._motions.start(order, self._given()), self._given())

    def jog(self, step: Step, permit: Permit, *, straight: bool, dead_man_s: float) -> Work:
        """As long as the client holds the key, or to the end of the range."""
        permit(ALL_AXES if straight else (step.axis,))
        order = Line(self._end_of_line(step)) if straight else Go(self._end_of_axis(step))
        plan = self._motions.start(order, self._given())

        async def work(operation: Operation) -> Ending:
            while self._clock.now() < plan.end_s:
                due_s = operation.held_s + dead_man_s
                if not await operation.until(min(plan.end_s, due_s)) or operation.held_s + dead_man_s <= due_s:
                    break
            await wait_until(self._clock, self._motions.halt())
            return operation.ending

        return work

    def _given(self) -> Given:
        return Given(Pace(self._settings.number("MSPEED") / 100))

    def _end_of_axis(self, step: Step) -> Joints:
        scara = self._arm.scara
        limit = (scara.highest if step.sign > 0 else scara.lowest)[step.axis - 1]
        here = self._arm.joints_at(self._clock.now())
        return Joints._make((*here[: step.axis - 1], limit, *here[step.axis :]))

    def _end_of_line(self, step: Step) -> ToolPose:
        now_s, scara = self._clock.now(), self._arm.scara
        pose, hand = self._arm.commanded_at(now_s), self._arm.joints_at(now_s).hand
        while True:
            further = ToolPose(*changed(pose, step.axis, step.sign * LOOK_MM))
            try:
                scara.inverse(further, hand)
            except Unreachable:
                return pose
            pose = further
