"""The ways of the arm in a cycle, stretch by stretch, as the robot is told them. Pure.

Only a stretch that ends nowhere in particular is left before its end (`down`): the stops for pictures and for placing
must be reached from one side, so nothing blends into their approach.
"""

from cellctl.config import Positions
from cellctl.geometry import Pose
from cellctl.recipe import Motion
from drivers.robot import Leg, Point


def point(at: Pose, z_mm: float) -> Point:
    """A place of the cell at a height."""
    return Point(at.x_mm, at.y_mm, z_mm, at.t_deg)


def across(to: Pose, positions: Positions, motion: Motion) -> Leg:
    """Travel, at travel height."""
    return Leg(point(to, positions.safe_z_mm), motion.travel_speed_pct)


def before(at: Pose, motion: Motion, uncertain_mm: float = 0.0, uncertain_deg: float = 0.0) -> Pose:
    """Where the one-sided approach in X, Y and R begins to a stop that is known to so many mm and degrees."""
    back_mm, back_deg = motion.approach_mm + uncertain_mm, motion.approach_deg + uncertain_deg
    return Pose(at.x_mm - back_mm, at.y_mm - back_mm, at.t_deg - back_deg)


def gently(to: Pose, z_mm: float, motion: Motion) -> Leg:
    """Slowly: the approach to a stop, and a change of height beside one."""
    return Leg(point(to, z_mm), motion.touch_speed_pct)


def stop(start: Pose, at: Pose, z_mm: float | None, positions: Positions, motion: Motion) -> list[Leg]:
    """To an exact stop at a height (None: travel height), approached from `start`; each stretch ends exactly."""
    height_mm = positions.safe_z_mm if z_mm is None else z_mm
    sideways = [] if height_mm == positions.safe_z_mm else [gently(start, height_mm, motion)]
    return [across(start, positions, motion), *sideways, gently(at, height_mm, motion)]


def down(at: Pose, z_mm: float, positions: Positions, motion: Motion) -> list[Leg]:
    """Straight down onto something from travel height: as quick as travel, and slow over the last stretch."""
    touch = gently(at, z_mm, motion)
    if motion.touch_mm is None or z_mm - motion.touch_mm <= positions.safe_z_mm:
        return [touch]
    return [Leg(point(at, z_mm - motion.touch_mm), motion.travel_speed_pct), touch]


def up(at: Pose, positions: Positions, motion: Motion) -> Leg:
    """Straight up to travel height."""
    return across(at, positions, motion)
