"""A unit's ways one after the other, without what is done between them: for predicting and measuring their times."""

from collections.abc import Sequence
from typing import NamedTuple

from cellctl.assembly import ways
from cellctl.assembly.stops import looking_at_base, looking_at_battery
from cellctl.config import CellConfig
from cellctl.geometry import Mm, Pose, place_pose
from cellctl.learnt.taught import Taught
from cellctl.recipe import Recipe
from drivers.motion import Dynamics, through_s
from drivers.rcx import Motion, Position
from drivers.reach import Limits
from drivers.robot import Leg


class Places(NamedTuple):
    """Where the tool stands in a unit's cycle."""

    look_1: Pose
    pick: Pose
    look_2: Pose
    seat: Pose


class Stretch(NamedTuple):
    """One way, as one order to the robot."""

    name: str
    legs: tuple[Leg, ...]


def taught_places(taught: Taught) -> Places:
    """As the golden assembly was."""
    seat = place_pose(taught.robot_from_base, taught.base_from_battery, taught.tool_from_battery)
    return Places(taught.look_1, taught.table_pick, taught.look_2, seat)


def drawn_places(config: CellConfig, recipe: Recipe) -> Places:
    """As the cell was drawn, with a battery gripped in its middle. Raises OutOfReach."""
    at = config.positions
    axis_1 = Mm(at.mount_from_camera_1.x_mm, at.mount_from_camera_1.y_mm)
    station = Pose(at.station.x_mm, at.station.y_mm, at.station.t_deg)
    return Places(
        looking_at_base(config, recipe.base, axis_1),
        Pose(at.table.x_mm, at.table.y_mm, at.table.t_deg),
        looking_at_battery(recipe.battery, Mm(at.camera_2.x_mm, at.camera_2.y_mm)),
        station @ recipe.base.seat,
    )


def stretches(places: Places, config: CellConfig, recipe: Recipe) -> list[Stretch]:
    """All ways of a unit whose looks are not repeated; the first begins where the last has ended, over the seat."""
    at, motion, limits = config.positions, recipe.motion, recipe.limits
    by_base = ways.before(places.look_1, motion)
    by_battery = ways.before(places.look_2, motion)
    by_seat = ways.before(places.seat, motion, limits.battery_offset_mm, limits.battery_offset_deg)
    return [
        *_each("base", ways.stop(by_base, places.look_1, at.camera_1_z_mm, at, motion)),
        Stretch("travel to battery", (ways.across(places.pick, at, motion),)),
        Stretch("down to battery", tuple(ways.down(places.pick, recipe.pick.touch_z_mm, at, motion))),
        Stretch("up with battery", (ways.up(places.pick, at, motion),)),
        *_each("camera 2", ways.stop(by_battery, places.look_2, at.camera_2_z_mm, at, motion)),
        *_each("seat", ways.stop(by_seat, places.seat, None, at, motion)),
        Stretch("down into seat", tuple(ways.down(places.seat, recipe.place.seat_z_mm, at, motion))),
        Stretch("up from seat", (ways.up(places.seat, at, motion),)),
    ]


def predicted_s(
    start: Position, stretch: Stretch, limits: Limits, dynamics: Dynamics, *, exchange_s: float = 0.0
) -> float:
    """How long a stretch takes, with so long an exchange with the controller.

    One exchange passes until the arm moves, one until its place is read back, and one between two legs.
    """
    *passed, last = stretch.legs
    motions = [Motion(leg.to, start.hand, leg.speed_pct, leg.straight, blends=True) for leg in passed]
    motions.append(Motion(last.to, start.hand, last.speed_pct, last.straight))
    return through_s(start, motions, limits, dynamics, turn_s=exchange_s) + 2 * exchange_s


def _each(where: str, legs: Sequence[Leg]) -> list[Stretch]:
    first, *beside, last = legs
    named = [Stretch(f"travel to {where}", (first,)), *(Stretch(f"height beside {where}", (leg,)) for leg in beside)]
    return [*named, Stretch(f"stop at {where}", (last,))]
