"""What the arm can be told to do, and how it is planned: one or several legs, each with its way and its time. Pure.

Legs add up: where two run at once (an arch, or a motion that begins before the last has ended) the joints move by the
sum of both. So a plan needs no blending curves and still ends exactly at its target.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import copysign, inf

from simulators.profile import Profile, at_rest, s_curve
from simulators.scara import SAME_MM, Hand, Joints, Scara, ToolPose, Unreachable, forward
from simulators.ways import JointWay, LineWay, Pace, Rates, Way, arc, joint_rates, last_moved, path_rates

SEARCH_S = 1e-6
Z = 2  # index of the vertical axis


@dataclass(frozen=True, slots=True)
class Go:
    """Point to point. A pose keeps the elbow's side unless `hand` says otherwise."""

    to: ToolPose | Joints
    hand: Hand | None = None


@dataclass(frozen=True, slots=True)
class Arch:
    """Point to point over a height; the travel may begin and end this far below it."""

    to: ToolPose | Joints
    height_mm: float
    begin_below_mm: float = 0.0
    end_below_mm: float = 0.0
    hand: Hand | None = None


@dataclass(frozen=True, slots=True)
class Line:
    """The tool on a straight line; it never changes the hand."""

    to: ToolPose | Joints
    hand: Hand | None = None


@dataclass(frozen=True, slots=True)
class Arc:
    """The tool on the arc through a position between; it never changes the hand."""

    via: ToolPose | Joints
    to: ToolPose | Joints
    hand: Hand | None = None


Order = Go | Arch | Line | Arc


@dataclass(frozen=True, slots=True)
class Leg:
    """One piece of a motion: its way in space and in time, and its steepest stop in fractions of it per s^2."""

    way: Way
    profile: Profile
    steepest: float

    def moved_at(self, world_s: float) -> Joints:
        """By how much the joints have moved for it."""
        start, now = self.way.joints_at(0.0), self.way.joints_at(self.profile.done_at(world_s))
        return Joints(*(b - a for a, b in zip(start, now, strict=True)))


@dataclass(frozen=True)
class Plan:
    """A motion that begins at `start` if nothing else runs. `steepness` is the share of the peak acceleration.

    `not_before_s`: the end of a motion that it has blended into; before that it has not arrived either.
    """

    start: Joints
    legs: tuple[Leg, ...]
    steepness: float
    not_before_s: float = -inf

    @cached_property
    def begin_s(self) -> float:
        """World time of the start."""
        return min(leg.profile.begin_s for leg in self.legs)

    @cached_property
    def end_s(self) -> float:
        """World time of the arrival."""
        return max(self.not_before_s, *(leg.profile.end_s for leg in self.legs))

    @cached_property
    def end(self) -> Joints:
        """Where it arrives."""
        return self.joints_at(self.end_s)

    def joints_at(self, world_s: float) -> Joints:
        """Where it has come to by itself; exactly at the last leg's end when all others are done."""
        *others, last = self.legs
        if world_s >= last.profile.begin_s and all(leg.profile.done_at(world_s) == 1 for leg in others):
            return last.way.joints_at(last.profile.done_at(world_s))
        return added(self.start, [leg.moved_at(world_s) for leg in self.legs])

    def progress_at(self, world_s: float) -> float:
        """How much of it is done, 0 to 1, smoothly."""
        done = sum(leg.profile.done_at(world_s) for leg in self.legs) / len(self.legs)
        return done * done * (3 - 2 * done)

    def halfway_s(self, share: float) -> float:
        """World time at which so much of it is done."""
        return _first_s(self, lambda at_s: self.progress_at(at_s) >= share)

    def near_s(self, within: Sequence[float]) -> float:
        """World time from which every axis is this close to its end."""

        def is_near(at_s: float) -> bool:
            return all(abs(a - b) <= near for a, b, near in zip(self.joints_at(at_s), self.end, within, strict=True))

        return max(_first_s(self, is_near), self.not_before_s)

    def sinks_s(self, z_mm: float) -> float | None:
        """World time at which the tool passes this height on its way down, None when it does not."""
        if not self.end.z_mm > z_mm >= self.start.z_mm:
            return None
        return _first_s(self, lambda at_s: self.joints_at(at_s).z_mm >= z_mm)

    def approach(self, before: tuple[float, float, float]) -> tuple[float, float, float]:
        """From which side the stop is reached in x, y and r; what does not move keeps the side of the stop before."""
        for leg in self.legs:
            moved = last_moved(leg.way)
            x, y, r = (copysign(1.0, by) if abs(by) > SAME_MM else old for by, old in zip(moved, before, strict=True))
            before = x, y, r
        return before

    def stopped(self, world_s: float, *, hard: bool) -> "Plan":
        """The same until now; what has begun is braked (or cut off, when hard), what has not begun never does."""

        def stop(leg: Leg) -> Profile:
            if leg.profile.begin_s > world_s:
                return at_rest(0.0, world_s)
            return leg.profile.cut(world_s) if hard else leg.profile.braked(world_s, leg.steepest)

        return Plan(self.start, tuple(replace(leg, profile=stop(leg)) for leg in self.legs), self.steepness)


def plan(order: Order, start: Joints, scara: Scara, pace: Pace, begin_s: float) -> Plan:
    """How the arm does this from standing (or blending) at `start`; raises Unreachable."""
    if isinstance(order, Arch):
        legs = _arch(order, start, scara, pace, begin_s)
    elif isinstance(order, Go):
        legs = (_joint_leg(JointWay(start, _joints(order.to, order.hand or start.hand, scara)), scara, pace, begin_s),)
    else:
        legs = (_path_leg(order, start, scara, pace, begin_s),)
    return Plan(start, legs, max(pace.accel, pace.decel))


def added(start: Joints, moved: list[Joints]) -> Joints:
    """Joints moved by all of these."""
    return Joints(*(a + sum(by) for a, *by in zip(start, *moved, strict=True)))


def _arch(order: Arch, start: Joints, scara: Scara, pace: Pace, begin_s: float) -> tuple[Leg, ...]:
    end = _joints(order.to, order.hand or start.hand, scara)
    over = scara.within(start._replace(z_mm=order.height_mm))
    if order.height_mm > min(start.z_mm, end.z_mm) + SAME_MM:
        raise Unreachable("arch", f"the arch's height {order.height_mm:.3f} mm lies below its ends")
    up = _joint_leg(JointWay(start, over), scara, pace, begin_s)
    away_s = up.profile.reaches_s(1 - _share(order.begin_below_mm, start.z_mm - order.height_mm))
    travel = _joint_leg(JointWay(over, end._replace(z_mm=order.height_mm)), scara, pace, away_s)
    down = JointWay(end._replace(z_mm=order.height_mm), end)
    trial = _joint_leg(down, scara, pace, 0.0).profile
    early_s = trial.reaches_s(_share(order.end_below_mm, end.z_mm - order.height_mm)) if order.end_below_mm else 0.0
    down_s = max(travel.profile.end_s - early_s, up.profile.end_s)
    return up, travel, _joint_leg(down, scara, pace, down_s)


def _share(part: float, whole: float) -> float:
    return min(max(part / whole, 0.0), 1.0) if whole > SAME_MM else 0.0


def _path_leg(order: Line | Arc, start: Joints, scara: Scara, pace: Pace, begin_s: float) -> Leg:
    hand = order.hand or start.hand
    end = _pose(order.to)
    if hand is not start.hand or (isinstance(order.to, Joints) and order.to.hand is not hand):
        raise Unreachable("hand", f"a curve in space cannot leave {start.hand.name}")
    here = forward(start)
    way = LineWay(here, end, hand) if isinstance(order, Line) else arc(here, _pose(order.via), end, hand)
    rates = path_rates(way, scara, pace.path_mm_per_s)
    return _leg(way, rates, pace._replace(speed=1.0) if pace.path_mm_per_s else pace, begin_s)


def _joint_leg(way: JointWay, scara: Scara, pace: Pace, begin_s: float) -> Leg:
    return _leg(way, joint_rates(way, scara), pace, begin_s)


def _leg(way: Way, rates: Rates, pace: Pace, begin_s: float) -> Leg:
    profile = s_curve(begin_s, rates.speed * pace.speed, rates.steepest * pace.accel, rates.steepest * pace.decel)
    return Leg(way, profile, rates.steepest)


def _joints(to: ToolPose | Joints, hand: Hand, scara: Scara) -> Joints:
    return scara.inverse(to, hand) if isinstance(to, ToolPose) else scara.within(to)


def _pose(to: ToolPose | Joints) -> ToolPose:
    return to if isinstance(to, ToolPose) else forward(to)


def _first_s(motion: Plan, happened: Callable[[float], bool]) -> float:
    """The first world time, to a microsecond, at which something is so that then stays so."""
    early_s, late_s = motion.begin_s, motion.end_s
    while late_s - early_s > SEARCH_S:
        middle_s = (early_s + late_s) / 2
        early_s, late_s = (early_s, middle_s) if happened(middle_s) else (middle_s, late_s)
    return late_s
