"""The arm itself: where its tool truly is at any world time.

Motion is closed form in world time, so a fast world loses nothing of it. Every stop misses its target by the arm's
repeatability; the error of stop number k depends on the seed and k alone and grows in along the motion.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from simulators.clock import Clock
from simulators.moves import Go, Leg, Order, Plan, added, plan
from simulators.profile import at_rest
from simulators.scara import SAME_MM, YK400XG, Hand, Joints, Scara, ToolPose, Unreachable, forward, inverse
from simulators.ways import JointWay, Pace, between

__all__ = ["Arm", "Hand", "Joints", "Pace", "ToolPose", "Unreachable", "forward", "inverse"]

REMEMBERED_S = 10.0
# A load heavier than the accelerations were chosen for makes the tool swing after a stop.
SWING_MM, SWING_S, SWING_HZ = 0.2, 0.06, 18.0
FULL_PACE = Pace()
START = ToolPose(250.0, 0.0, 0.0, 0.0)


class Miss(NamedTuple):
    """Why the tool is not where it was sent, in units of the imperfections, so that these can be switched."""

    x: float  # standard normal, as y, z and r
    y: float
    z: float
    r: float
    from_x: float = 0.0  # the way of the last travel: -1, 0 or 1, as in y and r
    from_y: float = 0.0
    from_r: float = 0.0


@dataclass(frozen=True, slots=True)
class Motion:
    """A plan under way or done; `blends` lets the next one begin before it has ended, `sinks` is no motor's doing."""

    plan: Plan
    before: Miss
    after: Miss
    swing: float = 0.0
    blends: bool = False
    from_rest: bool = True
    sinks: bool = False


class Arm:
    """The one arm of the world.

    repeatability_mm and repeatability_deg are 3 sigma per coordinate and may be changed at any time; so may
    hysteresis_mm and hysteresis_deg, the lost motion by which stops of opposite approaches lie apart per coordinate,
    `slip`, by which the tool has moved against the encoders, and payload_kg, what it truly carries.
    """

    def __init__(
        self,
        clock: Clock,
        rng: np.random.Generator,
        *,
        repeatability_mm: float = 0.01,
        repeatability_deg: float = 0.004,
        hysteresis_mm: float = 0.0,
        hysteresis_deg: float = 0.0,
        start: ToolPose = START,
        scara: Scara = YK400XG,
    ) -> None:
        self.scara = scara
        self.repeatability_mm = repeatability_mm
        self.repeatability_deg = repeatability_deg
        self.hysteresis_mm = hysteresis_mm
        self.hysteresis_deg = hysteresis_deg
        self.payload_kg = 0.0
        self.slip = ToolPose(0.0, 0.0, 0.0, 0.0)
        self.powered = False
        self._clock = clock
        self._seed = int(rng.integers(2**62))
        self._stops = 0
        joints = scara.inverse(start, Hand.RIGHTY)
        resting = Plan(joints, (Leg(JointWay(joints, joints), at_rest(), math.inf),), 0.0)
        miss = self._scatter((0.0, 0.0, 0.0))
        self._motions = deque([Motion(resting, miss, miss)])

    # -- where it is -------------------------------------------------------------------------------------

    def tool_at(self, world_s: float) -> ToolPose:
        """The true tool pose, exact for the last 10 s and for the future as far as it is ordered."""
        pose, miss = self.commanded_at(world_s), self._miss_at(world_s)
        linear, back = self.repeatability_mm / 3, self.hysteresis_mm / 2 - self._swing_at(world_s)
        return ToolPose(
            pose.x_mm + miss.x * linear - miss.from_x * back + self.slip.x_mm,
            pose.y_mm + miss.y * linear - miss.from_y * back + self.slip.y_mm,
            pose.z_mm + miss.z * linear + self.slip.z_mm,
            pose.r_deg + miss.r * self.repeatability_deg / 3 - miss.from_r * self.hysteresis_deg / 2 + self.slip.r_deg,
        )

    def second_arm_deg(self, world_s: float) -> float:
        """The true direction of the second arm, which follows from where its end truly is."""
        joints = inverse(self.tool_at(world_s), self.joints_at(world_s).hand)
        return joints.j1_deg + joints.j2_deg

    def commanded_at(self, world_s: float) -> ToolPose:
        """Where the encoders say that the tool is."""
        return forward(self.joints_at(world_s))

    def joints_at(self, world_s: float) -> Joints:
        """What the encoders say."""
        first, *others = self._running_at(world_s)
        if not others:
            return first.plan.joints_at(world_s)
        moved = [leg.moved_at(world_s) for motion in (first, *others) for leg in motion.plan.legs]
        return added(first.plan.start, moved)

    def moving_at(self, world_s: float) -> bool:
        """Whether a motion is under way."""
        return any(motion.plan.begin_s <= world_s < motion.plan.end_s for motion in self._running_at(world_s))

    def driven_at(self, world_s: float) -> bool:
        """Whether its motors move it."""
        return self.moving_at(world_s) and not self._running_at(world_s)[-1].sinks

    def arrives(self, planned: Plan) -> bool:
        """Whether the last motion ends where it was planned to: nothing has stopped it."""
        return math.dist(self.joints_at(planned.end_s), planned.end) < SAME_MM

    # -- what it does ------------------------------------------------------------------------------------

    def start(self, order: Order, pace: Pace = FULL_PACE, *, blends: bool = False, follows: bool = False) -> Plan:
        """Begin now, from standing or out of a motion that blends, and return the plan.

        `follows`: when another motion is under way, begin at its end. Raises Unreachable; RuntimeError when the arm
        moves or has no power.
        """
        now_s = self._clock.now()
        last, moving = self._motions[-1], self.moving_at(now_s)
        joins = moving and last.blends
        if not self.powered or (moving and not joins and not follows):
            raise RuntimeError("the arm is moving" if self.powered else "the arm has no power")
        begins = last.plan.end if moving else self.joints_at(now_s)
        planned = plan(order, begins, self.scara, pace, now_s if joins or not moving else last.plan.end_s)
        if joins:
            planned = replace(planned, not_before_s=last.plan.end_s)
        before = last.after if moving else self._miss_at(now_s)
        self._stops += 1
        after = self._scatter(planned.approach((before.from_x, before.from_y, before.from_r)))
        swing = max(planned.steepness / self.scara.quickness(self.payload_kg) - 1, 0.0)
        self._forget(now_s)
        self._motions.append(Motion(planned, before, after, swing, blends, from_rest=not joins))
        return planned

    def halt(self, at_s: float | None = None, *, hard: bool = False) -> float:
        """Brake at full deceleration (or stop dead, when hard), now or at a time to come.

        Only a hard stop keeps an axis from sinking. Returns the world time of standing.
        """
        from_s = self._clock.now() if at_s is None else at_s
        while self._motions[-1].plan.begin_s > from_s and (hard or not self._motions[-1].sinks):
            self._motions.pop()
        for index, motion in enumerate(self._motions):
            if motion.plan.end_s > from_s and (hard or not motion.sinks):
                stopped = motion.plan.stopped(from_s, hard=hard)
                self._motions[index] = replace(motion, plan=stopped, blends=False)
        return max(from_s, *(motion.plan.end_s for motion in self._motions))

    def sink(self, by_mm: float, mm_per_s: float) -> None:
        """Nothing holds the third axis: from where the arm comes to rest it sinks so far, or to its stroke's end."""
        stands_s = self.halt()
        joints = self.joints_at(stands_s)
        below = joints._replace(z_mm=min(joints.z_mm + by_mm, self.scara.highest.z_mm))
        if below.z_mm - joints.z_mm > SAME_MM:
            planned = plan(Go(below), joints, self.scara, Pace(mm_per_s / self.scara.fastest[2]), stands_s)
            miss = self._miss_at(stands_s)
            self._motions.append(Motion(planned, miss, miss, sinks=True))

    def power(self, on: bool) -> None:
        """Switch the motors; off stops the arm and sets the brakes."""
        if not on:
            self.halt()
        self.powered = on

    # -- its past ----------------------------------------------------------------------------------------

    def _running_at(self, world_s: float) -> list[Motion]:
        """The last motion that had begun from rest, and those that blended into it since."""
        found: list[Motion] = []
        for motion in reversed(self._motions):
            if motion.plan.begin_s <= world_s:
                found.append(motion)
                if motion.from_rest:
                    break
        return found[::-1] or [self._motions[0]]

    def _forget(self, now_s: float) -> None:
        while len(self._motions) > 1 and any(
            motion.from_rest and motion.plan.begin_s < now_s - REMEMBERED_S for motion in list(self._motions)[1:]
        ):
            self._motions.popleft()

    def _miss_at(self, world_s: float) -> Miss:
        first, *others = self._running_at(world_s)
        miss: tuple[float, ...] = between(first.before, first.after, first.plan.progress_at(world_s))
        for motion in others:
            grown = motion.plan.progress_at(world_s)
            miss = tuple(m + (b - a) * grown for m, a, b in zip(miss, motion.before, motion.after, strict=True))
        return Miss(*miss)

    def _swing_at(self, world_s: float) -> float:
        last = self._running_at(world_s)[-1]
        since_s = world_s - last.plan.end_s
        if not last.swing or since_s <= 0:
            return 0.0
        return SWING_MM * last.swing * math.exp(-since_s / SWING_S) * math.sin(math.tau * SWING_HZ * since_s)

    def _scatter(self, came_from: tuple[float, float, float]) -> Miss:
        x, y, z, r = np.random.default_rng((self._seed, self._stops)).standard_normal(4).tolist()
        return Miss(x, y, z, r, *came_from)
