"""Where the parts of a unit are: a picture, what is measured in it, the pose that follows, and whether it is plausible.

These run beside the motion; `over` is set as soon as the exposure is, and from then on the arm may move.
"""

import asyncio

from cellctl.assembly import views
from cellctl.assembly.budget import CornerAgain, EdgeAgain, Located
from cellctl.assembly.unit import Job, Unit
from cellctl.faults import FormulasDisagree, OffsetTooLarge
from cellctl.geometry import Mm, Offset, Pose, disagreement_mm, offset_about

SAME_MM = 1e-6


async def locate_base(job: Job, unit: Unit, over: asyncio.Event) -> Located:
    """The base out of camera 1's picture."""
    taught, mount = job.taught, job.config.mount_1.frame(job.taught.look_1)
    frame = await job.hand.devices.camera_1.grab(exposed=over)
    unit.pictures.append("camera-1")
    unit.seen_base, mount_from_base = await job.sight.base(frame, mount.inverse() @ taught.robot_from_base, unit.id)
    job.light.see("camera-1", unit.seen_base.appearances)
    return _plausible_base(job, unit, job.budget.base(unit.seen_base, mount @ mount_from_base))


async def locate_base_again(job: Job, unit: Unit, first: Located, over: asyncio.Event) -> Located:
    """The same base, with what the second stretch of its edge says."""
    seen, stops = unit.seen_base, (job.taught.look_1, job.budget.second_edge.stop)
    assert seen is not None
    mounts = job.config.mount_1.frame(stops[0]), job.config.mount_1.frame(stops[1])
    frame = await job.hand.devices.camera_1.grab(exposed=over)
    unit.pictures.append("camera-1-again")
    edge = await job.sight.second_edge(frame, mounts[1].inverse() @ first.pose, unit.id)
    found = views.second_edge(job.sight.plane_1, job.recipe.base, first.pose, (seen.edge, edge), mounts)
    return _plausible_base(job, unit, job.budget.base(seen, first.pose, EdgeAgain(edge, found)))


async def locate_battery(job: Job, unit: Unit, over: asyncio.Event) -> Located:
    """The battery in the cup out of camera 2's picture."""
    taught = job.taught
    frame = await job.hand.devices.camera_2.grab(exposed=over)
    unit.pictures.append("camera-2")
    unit.seen_battery, robot_from_battery = await job.sight.battery(
        frame, taught.look_2 @ taught.tool_from_battery, unit.id
    )
    tool_from_battery = taught.look_2.inverse() @ robot_from_battery
    job.light.see("camera-2", unit.seen_battery.appearances)
    return _plausible_battery(job, unit, job.budget.battery(unit.seen_battery, tool_from_battery))


async def locate_battery_again(job: Job, unit: Unit, first: Located, over: asyncio.Event) -> Located:
    """The same battery, with what its opposite corner says."""
    taught = job.budget.second_corner
    assert unit.seen_battery is not None
    frame = await job.hand.devices.camera_2.grab(exposed=over)
    unit.pictures.append("camera-2-again")
    seen, robot_from_battery = await job.sight.battery(
        frame, taught.stop @ first.pose @ taught.found, unit.id, opposite=True
    )
    corner = CornerAgain(seen, taught.stop.inverse() @ robot_from_battery)
    return _plausible_battery(job, unit, job.budget.battery(unit.seen_battery, first.pose, corner))


def _plausible_base(job: Job, unit: Unit, base: Located) -> Located:
    """Raises OffsetTooLarge."""
    taught, seat, limits = job.taught, job.recipe.base, job.recipe.limits
    centre = taught.robot_from_base.point(seat.seat_x_mm, seat.seat_y_mm)
    unit.base = checked_offset("base", centre, taught.robot_from_base, base.pose)
    check_offset("base", unit.base, limits.base_offset_mm, limits.base_offset_deg)
    return base


def _plausible_battery(job: Job, unit: Unit, battery: Located) -> Located:
    """Raises OffsetTooLarge."""
    on_table, limits = job.taught.robot_from_battery_on_table, job.recipe.limits
    centre = Mm(on_table.x_mm, on_table.y_mm)
    unit.battery = checked_offset("battery", centre, on_table, job.taught.table_pick @ battery.pose)
    check_offset("battery", unit.battery, limits.battery_offset_mm, limits.battery_offset_deg)
    return battery


def checked_offset(part: str, centre: Mm, taught: Pose, found: Pose) -> Offset:
    """The offset about the rotation centre, computed as poses and proven by eq. 12-16."""
    away_mm = disagreement_mm(centre, taught, found)
    if not away_mm < SAME_MM:
        raise FormulasDisagree(f"{part}: the pose form and eq. 12-16 differ by {away_mm:g} mm")
    return offset_about(centre, taught, found)


def check_offset(part: str, offset: Offset, limit_mm: float, limit_deg: float) -> None:
    """Refuse what lies further from its taught place than the recipe allows."""
    if max(abs(offset.dx_mm), abs(offset.dy_mm)) > limit_mm or abs(offset.dt_deg) > limit_deg:
        raise OffsetTooLarge(f"{part} {as_text(offset)}, allowed are {limit_mm:g} mm and {limit_deg:g} deg")


def as_text(offset: Offset | None) -> str:
    """As in the paper's Table 2."""
    if offset is None:
        return "not measured"
    return f"dX {offset.dx_mm:+.4f} dY {offset.dy_mm:+.4f} mm dT {offset.dt_deg:+.4f} deg"
