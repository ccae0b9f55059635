"""The arm itself, a YK400XG: where it can go, how fast, and where its tool truly is at any world time.

Sign conventions: x forward, y left, z DOWN from the top of its stroke, angles counter-clockwise from above.
Joints: j1 and j2 turn the two arms, z is the third axis, j4 turns the tool; r = j1 + j2 + j4.
Motion is closed form in world time, so a fast world loses nothing of it. Every stop misses its target by the
arm's repeatability; the error of stop number k depends on the seed and k alone and grows in along the motion.
"""

import bisect
import math
from collections import deque
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Literal, NamedTuple, Protocol

import numpy as np

from simulators.clock import Clock

ARM_1_MM, ARM_2_MM = 225.0, 175.0
LOWEST = (-140.0, -144.0, 0.0, -360.0)  # j1 deg, j2 deg, z mm, j4 deg
HIGHEST = (140.0, 144.0, 150.0, 360.0)
# 580 and 670 deg/s are 6.1 m/s at the stretched arm. The accelerations make the catalogue's standard cycle
# (there and back: 25 mm up, 300 mm across, 25 mm down, half of each vertical leg under the horizontal one)
# take 0.49 s.
FASTEST = (580.0, 670.0, 1100.0, 1020.0)  # deg/s, deg/s, mm/s, deg/s
STEEPEST = (9200.0, 11000.0, 18000.0, 15000.0)  # the same per second
LINE_MM_PER_S, LINE_MM_PER_S2 = 1000.0, 10000.0
LINE_SAMPLES = 64
REMEMBERED_S = 10.0
SAME_MM = 1e-9


class Hand(IntEnum):
    """The side of the elbow, by the controller's flag. Righty is j2 > 0."""

    RIGHTY = 1
    LEFTY = 2


class ToolPose(NamedTuple):
    """The tool flange in robot coordinates."""

    x_mm: float
    y_mm: float
    z_mm: float
    r_deg: float


class Joints(NamedTuple):
    """The four axes."""

    j1_deg: float
    j2_deg: float
    z_mm: float
    j4_deg: float

    @property
    def hand(self) -> Hand:
        """The side on which the elbow is."""
        return Hand.RIGHTY if self.j2_deg >= 0 else Hand.LEFTY


class Unreachable(Exception):
    """The arm cannot go there: no such position, outside an axis, or out on the way, or the other hand."""

    def __init__(self, kind: Literal["position", "axis", "way", "hand"], detail: str) -> None:
        super().__init__(detail)
        self.kind = kind


def forward(joints: Joints) -> ToolPose:
    """The tool pose of these joints."""
    q1, q12 = math.radians(joints.j1_deg), math.radians(joints.j1_deg + joints.j2_deg)
    x_mm = ARM_1_MM * math.cos(q1) + ARM_2_MM * math.cos(q12)
    y_mm = ARM_1_MM * math.sin(q1) + ARM_2_MM * math.sin(q12)
    return ToolPose(x_mm, y_mm, joints.z_mm, joints.j1_deg + joints.j2_deg + joints.j4_deg)


def inverse(pose: ToolPose, hand: Hand) -> Joints:
    """The joints of this tool pose with the elbow on that side; raises Unreachable outside any limit."""
    reach_mm = math.hypot(pose.x_mm, pose.y_mm)
    cosine = (reach_mm**2 - ARM_1_MM**2 - ARM_2_MM**2) / (2 * ARM_1_MM * ARM_2_MM)
    if abs(cosine) > 1 + SAME_MM:
        raise Unreachable("position", f"{reach_mm:.1f} mm from the column, the arms span 400 mm")
    q2 = math.acos(min(max(cosine, -1.0), 1.0)) * (1 if hand is Hand.RIGHTY else -1)
    elbow = math.atan2(ARM_2_MM * math.sin(q2), ARM_1_MM + ARM_2_MM * cosine)
    q1 = math.remainder(math.atan2(pose.y_mm, pose.x_mm) - elbow, math.tau)
    j1_deg, j2_deg = math.degrees(q1), math.degrees(q2)
    return within(Joints(j1_deg, j2_deg, pose.z_mm, pose.r_deg - j1_deg - j2_deg))


def within(joints: Joints) -> Joints:
    """The same joints; raises Unreachable when an axis would leave its range."""
    for axis, (value, low, high) in enumerate(zip(joints, LOWEST, HIGHEST, strict=True), 1):
        if not low - SAME_MM <= value <= high + SAME_MM:
            raise Unreachable("axis", f"axis {axis} would stand at {value:.3f}, outside {low:g} .. {high:g}")
    return joints


class Phase(NamedTuple):
    """From `at_s` on: the fraction of the way done, its rate, and the rate's rate."""

    at_s: float
    done: float
    speed: float
    accel: float


@dataclass(frozen=True, slots=True)
class Profile:
    """How far along its way a motion is, piecewise of constant acceleration, until it rests at `final`."""

    phases: tuple[Phase, ...]
    end_s: float
    final: float = 1.0

    def state_at(self, world_s: float) -> tuple[float, float]:
        """Fraction done and its rate per second."""
        if world_s >= self.end_s:
            return self.final, 0.0
        index = max(bisect.bisect_right(self.phases, world_s, key=lambda phase: phase.at_s) - 1, 0)
        phase = self.phases[index]
        since_s = max(world_s - phase.at_s, 0.0)
        done = phase.done + since_s * (phase.speed + phase.accel * since_s / 2)
        return min(done, self.final), phase.speed + phase.accel * since_s

    def braked(self, world_s: float, decel: float) -> "Profile":
        """The same until now, then a stop."""
        done, speed = self.state_at(world_s)
        before = tuple(phase for phase in self.phases if phase.at_s < world_s)
        final = min(done + speed**2 / (2 * decel), 1.0)
        return Profile((*before, Phase(world_s, done, speed, -decel)), world_s + speed / decel, final)


def trapezoid(start_s: float, speed: float, accel: float, decel: float) -> Profile:
    """The quickest way from 0 to 1 within these rates per second (infinite rates: at once)."""
    if math.isinf(speed) or math.isinf(accel):
        return Profile((Phase(start_s, 1.0, 0.0, 0.0),), start_s)
    top = min(speed, math.sqrt(2 * accel * decel / (accel + decel)))
    rising, falling = top**2 / (2 * accel), top**2 / (2 * decel)
    cruise_s = start_s + top / accel
    brake_s = cruise_s + max(1 - rising - falling, 0.0) / top
    phases = (
        Phase(start_s, 0.0, 0.0, accel),
        Phase(cruise_s, rising, top, 0.0),
        Phase(brake_s, 1 - falling, top, -decel),
    )
    return Profile(phases, brake_s + top / decel)


class Way(Protocol):
    """A curve from fraction 0 to 1."""

    def pose_at(self, done: float) -> ToolPose:
        """The commanded tool pose at this fraction."""

    def joints_at(self, done: float) -> Joints:
        """The joints at this fraction."""


class JointWay(NamedTuple):
    """Point to point: all axes start and arrive together."""

    start: Joints
    end: Joints

    def joints_at(self, done: float) -> Joints:
        """Straight in joint space."""
        return Joints(*_between(self.start, self.end, done))

    def pose_at(self, done: float) -> ToolPose:
        """The tool on its curve."""
        return forward(self.joints_at(done))


class LineWay(NamedTuple):
    """The tool on a straight line, the elbow on one side."""

    start: ToolPose
    end: ToolPose
    hand: Hand

    def pose_at(self, done: float) -> ToolPose:
        """Straight in space."""
        return ToolPose(*_between(self.start, self.end, done))

    def joints_at(self, done: float) -> Joints:
        """Raises Unreachable where the line leaves the arm's range."""
        return inverse(self.pose_at(done), self.hand)


@dataclass(frozen=True, slots=True)
class Miss:
    """Why the tool is not where it was sent, in units of the imperfections, so that these can be switched."""

    scatter: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)  # standard normal per coordinate
    approach: tuple[float, float] = (0.0, 0.0)  # unit vector of the last travel in x and y


@dataclass(frozen=True, slots=True)
class Motion:
    """One motion: its way in space, its way in time, and how the error of its stop grows in."""

    way: Way
    profile: Profile
    decel: float  # the steepest stop, fractions of the way per s^2
    before: Miss
    after: Miss

    def miss_at(self, world_s: float) -> Miss:
        """Blended smoothly from the last stop's error to this one's."""
        done = self.profile.state_at(world_s)[0]
        share = done * done * (3 - 2 * done)
        scatter = _between(self.before.scatter, self.after.scatter, share)
        ax, ay = _between(self.before.approach, self.after.approach, share)
        return Miss(scatter, (ax, ay))


class Arm:
    """The one arm of the world.

    repeatability_mm and repeatability_deg are 3 sigma per coordinate and may be changed at any time; so may
    hysteresis_mm, by which the stops of opposite approaches lie apart.
    """

    def __init__(
        self,
        clock: Clock,
        rng: np.random.Generator,
        *,
        repeatability_mm: float = 0.01,
        repeatability_deg: float = 0.004,
        hysteresis_mm: float = 0.0,
        start: ToolPose = ToolPose(250.0, 0.0, 0.0, 0.0),  # noqa: B008 (immutable)
    ) -> None:
        self.repeatability_mm = repeatability_mm
        self.repeatability_deg = repeatability_deg
        self.hysteresis_mm = hysteresis_mm
        self.powered = False
        self._clock = clock
        self._seed = int(rng.integers(2**62))
        self._stops = 0
        joints = inverse(start, Hand.RIGHTY)
        rest = Profile((Phase(0.0, 1.0, 0.0, 0.0),), -math.inf)
        miss = Miss(self._scatter())
        self._motions = deque([Motion(JointWay(joints, joints), rest, math.inf, miss, miss)])

    def tool_at(self, world_s: float) -> ToolPose:
        """The true tool pose, exact for the last 10 s and for the future as far as it is ordered."""
        motion = self._motion_at(world_s)
        pose = motion.way.pose_at(motion.profile.state_at(world_s)[0])
        miss = motion.miss_at(world_s)
        dx, dy, dz, dr = miss.scatter
        linear, lag = self.repeatability_mm / 3, self.hysteresis_mm / 2
        return ToolPose(
            pose.x_mm + dx * linear - miss.approach[0] * lag,
            pose.y_mm + dy * linear - miss.approach[1] * lag,
            pose.z_mm + dz * linear,
            pose.r_deg + dr * self.repeatability_deg / 3,
        )

    def commanded_at(self, world_s: float) -> ToolPose:
        """Where the encoders say that the tool is."""
        motion = self._motion_at(world_s)
        return motion.way.pose_at(motion.profile.state_at(world_s)[0])

    def joints_at(self, world_s: float) -> Joints:
        """What the encoders say."""
        motion = self._motion_at(world_s)
        return motion.way.joints_at(motion.profile.state_at(world_s)[0])

    def moving_at(self, world_s: float) -> bool:
        """Whether a motion is under way."""
        profile = self._motion_at(world_s).profile
        return profile.phases[0].at_s <= world_s < profile.end_s

    def start(
        self,
        to: ToolPose | Joints,
        *,
        hand: Hand | None = None,
        straight: bool = False,
        speed: float = 1.0,
        accel: float = 1.0,
        decel: float = 1.0,
    ) -> float:
        """Begin to move now, from standing, and return the world time of the arrival.

        speed, accel, decel are fractions above 0 to 1 of the arm's own. A pose keeps the elbow's side unless
        `hand` says otherwise. Raises Unreachable; RuntimeError when the arm moves or has no power.
        """
        now_s = self._clock.now()
        if not self.powered or self.moving_at(now_s):
            raise RuntimeError("the arm is moving" if self.powered else "the arm has no power")
        way, rate, steepness = self._plan(now_s, to, hand, straight)
        profile = trapezoid(now_s, rate * speed, steepness * accel, steepness * decel)
        before = self._motions[-1].miss_at(now_s)
        self._stops += 1
        after = Miss(self._scatter(), _direction(way) or before.approach)
        while len(self._motions) > 1 and self._motions[1].profile.phases[0].at_s < now_s - REMEMBERED_S:
            self._motions.popleft()
        self._motions.append(Motion(way, profile, steepness, before, after))
        return profile.end_s

    def halt(self) -> float:
        """Brake on the way at full deceleration; returns the world time of standing."""
        now_s = self._clock.now()
        motion = self._motions[-1]
        if motion.profile.end_s <= now_s:
            return now_s
        self._motions[-1] = replace(motion, profile=motion.profile.braked(now_s, motion.decel))
        return self._motions[-1].profile.end_s

    def power(self, on: bool) -> None:
        """Switch the motors; off stops the arm and sets the brakes."""
        if not on:
            self.halt()
        self.powered = on

    def _plan(self, now_s: float, to: ToolPose | Joints, hand: Hand | None, straight: bool) -> tuple[Way, float, float]:
        here = self.joints_at(now_s)
        hand = hand or here.hand
        if not straight:
            way = JointWay(here, inverse(to, hand) if isinstance(to, ToolPose) else within(to))
            slopes = tuple(abs(b - a) for a, b in zip(way.start, way.end, strict=True))
            return way, _rate(FASTEST, slopes), _rate(STEEPEST, slopes)
        target = to if isinstance(to, ToolPose) else forward(within(to))
        if hand is not here.hand:
            raise Unreachable("hand", f"a straight motion cannot change from {here.hand.name} to {hand.name}")
        line = LineWay(self.commanded_at(now_s), target, hand)
        length_mm = math.dist(line.start[:3], line.end[:3])
        slopes = _steepest_joints(line)
        rate = _rate((*FASTEST, LINE_MM_PER_S), (*slopes, length_mm))
        return line, rate, _rate((*STEEPEST, LINE_MM_PER_S2), (*slopes, length_mm))

    def _motion_at(self, world_s: float) -> Motion:
        for motion in reversed(self._motions):
            if motion.profile.phases[0].at_s <= world_s:
                return motion
        return self._motions[0]

    def _scatter(self) -> tuple[float, ...]:
        return tuple(np.random.default_rng((self._seed, self._stops)).standard_normal(4).tolist())


def _between(start: tuple[float, ...], end: tuple[float, ...], share: float) -> tuple[float, ...]:
    return tuple(a + (b - a) * share for a, b in zip(start, end, strict=True)) if share != 1 else tuple(end)


def _rate(limits: tuple[float, ...], slopes: tuple[float, ...]) -> float:
    """The highest rate of the whole way at which no axis passes its limit."""
    rates = (limit / slope for limit, slope in zip(limits, slopes, strict=True) if slope > SAME_MM)
    return min(rates, default=math.inf)


def _steepest_joints(line: LineWay) -> tuple[float, ...]:
    """Each axis's largest change per fraction of the line; raises Unreachable when it leaves the range."""
    line.joints_at(1.0)
    try:
        joints = np.array([line.joints_at(k / LINE_SAMPLES) for k in range(LINE_SAMPLES + 1)])
    except Unreachable as outside:
        raise Unreachable("way", f"on the way: {outside}") from outside
    return tuple((np.abs(np.diff(joints, axis=0)).max(axis=0) * LINE_SAMPLES).tolist())


def _direction(way: Way) -> tuple[float, float] | None:
    """The unit vector of the last travel in the plane, None when the tool does not travel there."""
    x_mm, y_mm, *_ = way.pose_at(0.99)
    end = way.pose_at(1.0)
    length_mm = math.hypot(end.x_mm - x_mm, end.y_mm - y_mm)
    if length_mm < SAME_MM:
        return None
    return (end.x_mm - x_mm) / length_mm, (end.y_mm - y_mm) / length_mm
