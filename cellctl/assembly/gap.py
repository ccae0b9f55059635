"""The look at the gap: after placing, camera 1 sees how the battery lies in its seat, on the way to the next base.

Gap and offset come out of one picture by its local scale alone, so they are true whatever hand-eye, robot and drift
have done. They decide whether the unit is good, and they are what the drift of the cell is watched by.
"""

import asyncio
import math
from functools import partial

from cellctl.assembly.seating import Seating
from cellctl.assembly.sight import exposed, never_outliving
from cellctl.assembly.stops import looking_at_gap
from cellctl.assembly.unit import Job, Unit
from cellctl.assembly.views import axis_mm, corner_mm
from cellctl.desk.records import number_of
from cellctl.faults import GapNotSeen, GapOutside
from cellctl.geometry import Pose, place_pose, wrap_deg
from cellctl.log import step
from cellctl.monitoring.drift import Observation
from cellctl.recipe import Recipe
from drivers.errors import FrameLost


async def check_gap(job: Job, unit: Unit, robot_from_base: Pose) -> None:
    """Look at the gap of a placed unit if the recipe wants it. Raises GapOutside, GapNotSeen, FrameLost."""
    if not wanted(job.recipe, unit):
        return
    with step(7, "check gap") as line:
        try:
            unit.seating = await _look(job, unit, robot_from_base)
        except (GapNotSeen, FrameLost) as error:
            if job.recipe.gap.unseen == "reject":
                raise
            unit.gap_unseen = line.text = f"accepted without: {error}"
            return
        line.text = unit.seating.sentence
        if job.recipe.cameras == "both":
            unit.observed = observation(job, unit, unit.seating, robot_from_base)
            job.watch.see(unit.observed)
        check_limits(job.recipe, unit.seating)


def wanted(recipe: Recipe, unit: Unit) -> bool:
    """Whether the recipe wants this unit's gap to be looked at."""
    look = recipe.gap
    match look.when:
        case "never":
            return False
        case "every_unit":
            return True
        case "every_nth":
            return number_of(unit.id) % look.every_n == 0
    prediction = unit.prediction
    return prediction is None or prediction.p99_mm > recipe.limits.placement_mm - look.margin_mm


async def _look(job: Job, unit: Unit, robot_from_base: Pose) -> Seating:
    """Stop over the corner; the picture is measured while the arm travels to where the next base is looked at."""
    hand, config = job.hand, job.config
    stop = looking_at_gap(config, job.recipe, robot_from_base, axis_mm(job.sight.plane_1, config.camera_1))
    await hand.stop_at(stop, config.positions.camera_1_z_mm)
    look = await exposed(partial(_measure, job, unit, config.mount_1.frame(stop).inverse() @ robot_from_base))
    async with never_outliving(look):
        await hand.travel(hand.before(job.taught.look_1))
        return await look


async def _measure(job: Job, unit: Unit, mount_from_base: Pose, over: asyncio.Event) -> Seating:
    """How the battery lies in its seat, out of camera 1's picture."""
    base = unit.seen_base
    assert base is not None
    frame = await job.hand.devices.camera_1.grab(exposed=over)
    unit.pictures.append("camera-1-gap")
    blur_px = math.sqrt(base.circle.blur_px * base.edge.blur_px)
    return await job.sight.gap(frame, mount_from_base, blur_px, unit.id)


def observation(job: Job, unit: Unit, seating: Seating, robot_from_base: Pose) -> Observation:
    """What this unit says about the cell: how far its battery is off in its base, and what it was placed with."""
    taught, placed_at, mark = job.taught, unit.placed_at, corner_mm(job.recipe.battery)
    assert placed_at is not None
    base_from_battery = job.watch.corrected(taught.base_from_battery)
    tool_from_battery = placed_at.inverse() @ robot_from_base @ base_from_battery
    golden = place_pose(taught.robot_from_base, taught.base_from_battery, taught.tool_from_battery)
    here, there = tool_from_battery.point(*mark), taught.tool_from_battery.point(*mark)
    dx_mm, dy_mm, dt_deg = seating.against_base
    return Observation(
        dx_um=dx_mm * 1000,
        dy_um=dy_mm * 1000,
        dt_mdeg=dt_deg * 1000,
        turned_deg=wrap_deg(placed_at.t_deg - golden.t_deg),
        offset_x_mm=here.x_mm - there.x_mm,
        offset_y_mm=here.y_mm - there.y_mm,
    )


def check_limits(recipe: Recipe, seating: Seating) -> None:
    """Raises GapOutside when the battery does not lie as it must."""
    look, turned_deg = recipe.gap, seating.offset.dt_deg
    allowed = f"allowed are {look.limit_mm * 1000:g} um and {look.limit_deg * 1000:g} mdeg"
    if seating.worst_mm > look.limit_mm or abs(turned_deg) > look.limit_deg:
        raise GapOutside(f"{seating.sentence}, {allowed}")
