"""The stretches of a unit on the simulated arm, and how long it moves for each: its own time, not that of the line."""

from itertools import pairwise

from cellctl.arm import limits_of
from cellctl.assembly.stretches import drawn_places, predicted_s, stretches
from cellctl.desk.robot_time import measured
from drivers.motion import timing
from drivers.rcx import RIGHTY, Motion, Position


def ways_of(config, recipe):
    """As the cell was drawn."""
    return stretches(drawn_places(config, recipe), config, recipe)


def from_where(ways):
    """Each stretch with where it begins."""
    at = Position(ways[-1].legs[-1].to, RIGHTY)
    for way in ways:
        yield at, way
        at = Position(way.legs[-1].to, RIGHTY)


def predicted(config, ways):
    """The arm's own time for each, s."""
    limits, dynamics = limits_of(config.robot), config.robot.speeds.dynamics
    return [predicted_s(at, way, limits, dynamics) for at, way in from_where(ways)]


async def moved(config, ways, log):
    """What `cellctl robot time` measures, and the arm's own time for each by the simulated controller's log, s."""
    times = await measured(config, ways)
    moves = log.of("moves")[-sum(len(way.legs) for way in ways) :]
    found = []
    for at, way in from_where(ways):
        done, moves = moves[: len(way.legs)], moves[len(way.legs) :]
        found.append(done[-1].ends_s - done[0].begins_s - _late_s(config, at, way, done))
    return times, found


def _late_s(config, at, way, done):
    """How much later than it might the second of two legs began, because its command had to come over the line."""
    if len(way.legs) == 1:
        return 0.0
    first = way.legs[0]
    motion = Motion(first.to, RIGHTY, first.speed_pct, blends=True)
    may_follow_s = timing(at, motion, limits_of(config.robot), config.robot.speeds.dynamics).may_follow_s
    return sum(after.begins_s - before.begins_s for before, after in pairwise(done)) - may_follow_s
