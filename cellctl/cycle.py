"""One battery into one base: the paper's six steps, in order.

Read `assemble` first; every function below it is one of its lines. Nothing here knows a machine state or waits for
an operator. An exception ends the cycle, and faults.py says what follows.

Both pictures are transferred and measured beside the motion, from the end of their exposure on: camera 1's while the
robot fetches the battery, camera 2's while the arm already travels to the seat. Where the budget asks for a second
look, it is part of step 3 or 5. The vacuum is checked at five points, numbered 1 to 5 where they stand.

What a recipe may add to the six steps is a look at the battery in its seat, on the way back: gap.py.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Coroutine, Iterator
from contextlib import asynccontextmanager, contextmanager
from functools import partial
from typing import Any

from cellctl.assembly.budget import Located
from cellctl.assembly.gap import check_gap
from cellctl.assembly.locate import as_text, locate_base, locate_base_again, locate_battery, locate_battery_again
from cellctl.assembly.sight import exposed, never_outliving
from cellctl.assembly.unit import Job, Unit
from cellctl.faults import (
    BaseNotFound,
    BatteryLost,
    CarrierMoved,
    NoParts,
    OffsetTooLarge,
    PlacementUncertain,
    VacuumStuck,
)
from cellctl.geometry import Pose, place_pose
from cellctl.log import bind, step
from drivers.errors import FrameLost, NoAnswer, Refused


async def assemble(job: Job, unit: Unit) -> None:
    """Bring one base and one battery together. Raises what is in faults.py; then the cell decides what follows."""
    with step(1, "bring base"):
        await bring_base(job, unit)
    with step(2, "start signal"):
        check_parts(job)
    with step(3, "look at base"):
        base = await look_at_base(job, unit)
    async with never_outliving(base):
        with step(4, "fetch battery") as line:
            await fetch_battery(job, unit, base)
            line.text = f"base {as_text(unit.base)}"
        with step(5, "look at battery"):
            battery = await look_at_battery(job, unit)
        async with never_outliving(battery):
            with step(6, "place battery") as line:
                await place_battery(job, unit, base.result(), battery)
                line.text = f"battery {as_text(unit.battery)}"
            await check_gap(job, unit, base.result().pose)


# -- steps 1 and 2: parts ----------------------------------------------------------------------------------


async def bring_base(job: Job, unit: Unit) -> None:
    """The PLC runs the conveyor until the photoelectric switch sees a base, and clamps its carrier."""
    plc = job.hand.devices.plc
    try:
        arrival = await plc.bring_base(within_s=job.recipe.timing.arrival_within_s)
    except (NoAnswer, Refused) as error:
        if plc.image.photo_switch:
            raise
        raise NoParts(f"no base arrived ({error.detail})") from error
    unit.carrier_id = arrival.carrier_id
    first, second = job.calibrations
    unit.id = await job.journal.begin_unit(
        recipe=job.name,
        recipe_hash=job.recipe.hash,
        arrival_sequence=arrival.sequence,
        carrier_id=arrival.carrier_id,
        calibration_ids={"camera-1": first.id, "camera-2": second.id, "taught": job.taught.id},
    )
    bind(unit=unit.id)


def check_parts(job: Job) -> None:
    """The start signal holds only while the carrier is clamped, nothing moves and a battery lies ready."""
    image = job.hand.devices.plc.image
    if not image.carrier_clamped or image.conveyor_moving:
        raise NoParts("the carrier is not clamped or the conveyor still moves")
    if not image.battery_on_table:
        raise NoParts("there is no battery on the table")


# -- steps 3 and 5: pictures -------------------------------------------------------------------------------


async def look_at_base(job: Job, unit: Unit) -> asyncio.Task[Located]:
    """Camera 1 over the base, and again over its edge further on if one look cannot be enough."""
    await job.hand.stop_at(job.taught.look_1, job.config.positions.camera_1_z_mm)
    first = await exposed(partial(locate_base, job, unit))
    if not job.budget.needs.base_again:
        return first
    async with never_outliving(first):
        return await look_again_at_base(job, unit, first)


async def look_again_at_base(job: Job, unit: Unit, first: asyncio.Task[Located]) -> asyncio.Task[Located]:
    """Camera 1 over the second stretch of the base's edge."""
    with looking_again(unit, "camera-1"):
        await job.hand.stop_at(job.budget.second_edge.stop, job.config.positions.camera_1_z_mm)
        base = await wait_for_vision(unit, "camera-1", first)
        return await exposed(partial(locate_base_again, job, unit, base))


async def look_at_battery(job: Job, unit: Unit) -> asyncio.Task[Located]:
    """The battery on the cup over camera 2, and again with its opposite corner if one look cannot be enough."""
    await job.hand.stop_at(job.taught.look_2, job.config.positions.camera_2_z_mm)
    job.hand.expect_vacuum(True, 3, BatteryLost, "over camera 2")
    first = await exposed(partial(locate_battery, job, unit))
    if not job.budget.needs.battery_again:
        return first
    async with never_outliving(first):
        return await look_again_at_battery(job, unit, first)


async def look_again_at_battery(job: Job, unit: Unit, first: asyncio.Task[Located]) -> asyncio.Task[Located]:
    """The battery's opposite corner over camera 2."""
    with looking_again(unit, "camera-2"):
        await job.hand.stop_at(job.budget.second_corner.stop, job.config.positions.camera_2_z_mm)
        job.hand.expect_vacuum(True, 3, BatteryLost, "over camera 2 again")
        battery = await wait_for_vision(unit, "camera-2", first)
        return await exposed(partial(locate_battery_again, job, unit, battery))


# -- step 4: fetch -----------------------------------------------------------------------------------------


async def fetch_battery(job: Job, unit: Unit, base: asyncio.Task[Located]) -> None:
    """Take the battery from its table; it goes back there when the base turns out not to be good."""
    hand, pick = job.hand, job.taught.table_pick
    hand.expect_vacuum(False, 1, VacuumStuck, "before the pick")
    async with written(job.journal.step(unit.id, 4, "fetch battery", "intent")):
        await hand.travel(pick)
    await hand.suck(pick, job.recipe.pick.touch_z_mm)
    hand.expect_vacuum(True, 2, BatteryLost, "after the pick")
    try:
        await wait_for_vision(unit, "camera-1", base)
    except (BaseNotFound, OffsetTooLarge, FrameLost):
        await hand.put(pick, job.recipe.pick.touch_z_mm)
        raise


# -- step 6: place -----------------------------------------------------------------------------------------


async def place_battery(job: Job, unit: Unit, base: Located, battery: asyncio.Task[Located]) -> None:
    """Travel towards the seat, compute where the tool must be, lower the battery into its seat, let go."""
    taught, hand, limits = job.taught, job.hand, job.recipe.limits
    base_from_battery = job.watch.corrected(taught.base_from_battery)
    if job.recipe.cameras == "camera_2_only":
        base = base._replace(pose=taught.robot_from_base)
    about = place_pose(base.pose, base_from_battery, taught.tool_from_battery)
    await hand.travel(hand.before(about, limits.battery_offset_mm, limits.battery_offset_deg))
    tool_from_battery = await sure_enough(job, unit, base, battery)
    unit.placed_at = place_pose(base.pose, base_from_battery, tool_from_battery)
    async with written(job.journal.step(unit.id, 6, "place battery", "intent", {"at": list(unit.placed_at)})):
        await hand.arrive(unit.placed_at)
    hand.expect_vacuum(True, 4, BatteryLost, "before placing")
    expect_carrier_at_rest(job)
    await hand.put(unit.placed_at, job.recipe.place.seat_z_mm)
    hand.expect_vacuum(False, 5, VacuumStuck, "after placing")
    await job.journal.step(unit.id, 6, "place battery", "done")


async def sure_enough(job: Job, unit: Unit, base: Located, first: asyncio.Task[Located]) -> Pose:
    """Go, look again, or no-go: tool_from_battery, when the predicted error is small enough.

    Nobody expected that this unit would need a second look, else it would have had one; so the arm goes back for it.
    """
    battery = await wait_for_vision(unit, "camera-2", first)
    unit.prediction = job.budget.placement(base, battery)
    if not unit.prediction.good and job.budget.may_look_again and "camera-2" not in unit.looked_again_ms:
        again = await look_again_at_battery(job, unit, first)
        async with never_outliving(again):
            battery = await wait_for_vision(unit, "camera-2", again)
        unit.prediction = job.budget.placement(base, battery)
    if not unit.prediction.good:
        raise PlacementUncertain(unit.prediction.sentence)
    return battery.pose


def expect_carrier_at_rest(job: Job) -> None:
    """The base still lies where camera 1 saw it: asked right before the battery goes down."""
    image = job.hand.devices.plc.image
    if image.conveyor_moving or not image.carrier_clamped:
        raise CarrierMoved("the conveyor moves" if image.conveyor_moving else "the carrier is not clamped")


# -- beside the motion -------------------------------------------------------------------------------------


@asynccontextmanager
async def written(entry: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """A journal entry that is on disk when the block ends, written beside it."""
    task = asyncio.create_task(entry)
    try:
        yield
    finally:
        await task


@contextmanager
def looking_again(unit: Unit, camera: str) -> Iterator[None]:
    """A second look; what it takes is written down."""
    since_s = time.monotonic()
    yield
    unit.looked_again_ms[camera] = round((time.monotonic() - since_s) * 1000, 3)


async def wait_for_vision(unit: Unit, camera: str, task: asyncio.Task[Located]) -> Located:
    """What was measured; how long the motion had to wait for it is written down."""
    since_s = time.monotonic()
    try:
        return await task
    finally:
        waited_ms = unit.waited_for_vision_ms.get(camera, 0.0) + (time.monotonic() - since_s) * 1000
        unit.waited_for_vision_ms[camera] = round(waited_ms, 3)
