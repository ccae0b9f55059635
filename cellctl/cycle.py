"""One battery into one base: the paper's six steps, in order.

Read `assemble` first; every function below it is one of its lines. Nothing here knows a machine state or waits for
an operator. An exception ends the cycle, and faults.py says what follows.

Both pictures are transferred and measured beside the motion, from the end of their exposure on: camera 1's while the
robot fetches the battery, camera 2's while the arm already travels to the seat. The vacuum is checked at five points,
numbered 1 to 5 where they stand.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from cellctl import views
from cellctl.config import CellConfig
from cellctl.faults import (
    BaseNotFound,
    BatteryLost,
    FormulasDisagree,
    NoParts,
    OffsetTooLarge,
    PlacementUncertain,
    VacuumStuck,
)
from cellctl.geometry import Mm, Offset, Pose, disagreement_mm, offset_about, place_pose
from cellctl.hand import Hand
from cellctl.journal import Journal
from cellctl.log import bind, step
from cellctl.placement import Prediction, Source, predict
from cellctl.recipe import Recipe
from cellctl.references import CameraCalibration, Taught
from cellctl.sight import Sight, exposed
from cellctl.vision import BaseMeasurement, BatteryMeasurement
from drivers.errors import FrameLost, NoAnswer, Refused

SAME_MM = 1e-6


@dataclass(frozen=True)
class Job:
    """All that decides how a unit is assembled; it does not change while the unit lives."""

    config: CellConfig
    name: str
    recipe: Recipe
    calibrations: tuple[CameraCalibration, CameraCalibration]
    taught: Taught
    hand: Hand
    sight: Sight
    journal: Journal


@dataclass
class Unit:
    """What is found out about one unit on its way."""

    id: str = ""  # given when its base has arrived
    carrier_id: int = 0
    good: bool = False
    recorded: bool = False
    base: Offset | None = None
    battery: Offset | None = None
    seen_base: BaseMeasurement | None = None
    seen_battery: BatteryMeasurement | None = None
    prediction: Prediction | None = None
    placed_at: Pose | None = None
    waited_for_vision_ms: dict[str, float] = field(default_factory=dict)


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


async def look_at_base(job: Job, unit: Unit) -> asyncio.Task[Pose]:
    """Camera 1, travelling with the tool, over the base; measured while the arm moves on."""
    await job.hand.stop_at(job.taught.look_1, job.config.positions.camera_1_z_mm)
    return await exposed(partial(locate_base, job, unit))


async def look_at_battery(job: Job, unit: Unit) -> asyncio.Task[Pose]:
    """The battery on the cup, over camera 2; measured while the arm moves on."""
    await job.hand.stop_at(job.taught.look_2, job.config.positions.camera_2_z_mm)
    job.hand.expect_vacuum(True, 3, BatteryLost, "over camera 2")
    return await exposed(partial(locate_battery, job, unit))


async def locate_base(job: Job, unit: Unit, over: asyncio.Event) -> Pose:
    """robot_from_base out of camera 1's picture."""
    taught, seat, limits = job.taught, job.recipe.base, job.recipe.limits
    frame = await job.hand.devices.camera_1.grab(exposed=over)
    unit.seen_base, tool_from_base = await job.sight.base(
        frame, taught.look_1.inverse() @ taught.robot_from_base, unit.id
    )
    robot_from_base = taught.look_1 @ tool_from_base
    centre = taught.robot_from_base.point(seat.seat_x_mm, seat.seat_y_mm)
    unit.base = checked_offset("base", centre, taught.robot_from_base, robot_from_base)
    check_offset("base", unit.base, limits.base_offset_mm, limits.base_offset_deg)
    return robot_from_base


async def locate_battery(job: Job, unit: Unit, over: asyncio.Event) -> Pose:
    """tool_from_battery out of camera 2's picture."""
    taught, limits = job.taught, job.recipe.limits
    frame = await job.hand.devices.camera_2.grab(exposed=over)
    unit.seen_battery, robot_from_battery = await job.sight.battery(
        frame, taught.look_2 @ taught.tool_from_battery, unit.id
    )
    tool_from_battery = taught.look_2.inverse() @ robot_from_battery
    on_table = taught.robot_from_battery_on_table
    centre = Mm(on_table.x_mm, on_table.y_mm)
    unit.battery = checked_offset("battery", centre, on_table, taught.table_pick @ tool_from_battery)
    check_offset("battery", unit.battery, limits.battery_offset_mm, limits.battery_offset_deg)
    return tool_from_battery


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


# -- step 4: fetch -----------------------------------------------------------------------------------------


async def fetch_battery(job: Job, unit: Unit, base: asyncio.Task[Pose]) -> None:
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


async def place_battery(job: Job, unit: Unit, robot_from_base: Pose, battery: asyncio.Task[Pose]) -> None:
    """Travel towards the seat, compute where the tool must be, lower the battery into its seat, let go."""
    taught, hand = job.taught, job.hand
    if job.recipe.cameras == "camera_2_only":
        robot_from_base = taught.robot_from_base
    about = place_pose(robot_from_base, taught.base_from_battery, taught.tool_from_battery)
    await hand.travel(hand.before(about, job.recipe.limits.battery_offset_mm))
    tool_from_battery = await wait_for_vision(unit, "camera-2", battery)
    unit.prediction = predict_placement(job, unit)
    if unit.prediction.p99_mm > job.recipe.limits.placement_mm:
        raise PlacementUncertain(f"{unit.prediction.sentence}, allowed are {job.recipe.limits.placement_mm:g} mm")
    unit.placed_at = place_pose(robot_from_base, taught.base_from_battery, tool_from_battery)
    async with written(job.journal.step(unit.id, 6, "place battery", "intent", {"at": list(unit.placed_at)})):
        await hand.arrive(unit.placed_at)
    hand.expect_vacuum(True, 4, BatteryLost, "before placing")
    await hand.put(unit.placed_at, job.recipe.place.seat_z_mm)
    hand.expect_vacuum(False, 5, VacuumStuck, "after placing")
    await job.journal.step(unit.id, 6, "place battery", "done")


def predict_placement(job: Job, unit: Unit) -> Prediction:
    """Both pictures, three robot stops and the teaching, carried to the corners of the battery."""
    battery, taught, robot = job.recipe.battery, job.taught, job.config.robot
    base, held = unit.seen_base, unit.seen_battery
    if base is None or held is None:
        raise ValueError("a placement is predicted from both pictures")
    edge = views.direction_edge(battery, held)
    mm_1, mm_2 = job.sight.plane_1.mm_per_px, job.sight.plane_2.mm_per_px
    stop_mm, stop_deg = robot.repeatability_mm / 3, robot.repeatability_deg / 3
    averaged = taught.repeats**0.5
    corner, tool = views.corner_mm(battery), Mm(0.0, 0.0)
    hole = taught.base_from_battery.inverse().point(0.0, 0.0)
    sources = [
        Source("camera 1", base.circle.sd_px * mm_1, base.edge.angle_sd_deg, hole),
        Source("camera 2", held.corner_sd_px * mm_2, edge.angle_sd_deg, corner),
        Source("stop at camera 1", stop_mm, stop_deg, hole),
        Source("stop at camera 2", stop_mm, stop_deg, corner),
        Source("stop at the seat", stop_mm, stop_deg, tool),
        Source("teaching", taught.spread_mm / averaged, taught.spread_deg / averaged, tool),
    ]
    w, h = battery.width_mm / 2, battery.height_mm / 2
    return predict(sources, [Mm(-w, -h), Mm(w, -h), Mm(w, h), Mm(-w, h)])


# -- beside the motion -------------------------------------------------------------------------------------


@asynccontextmanager
async def never_outliving(task: asyncio.Task[Pose]) -> AsyncIterator[None]:
    """A measurement ends with the block at the latest."""
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait([task])
        if not task.cancelled():
            task.exception()  # was raised where it was waited for, or the block failed before that


@asynccontextmanager
async def written(entry: Coroutine[Any, Any, None]) -> AsyncIterator[None]:
    """A journal entry that is on disk when the block ends, written beside it."""
    task = asyncio.create_task(entry)
    try:
        yield
    finally:
        await task


async def wait_for_vision(unit: Unit, camera: str, task: asyncio.Task[Pose]) -> Pose:
    """The measured pose; how long the motion had to wait for it is written down."""
    since_s = time.monotonic()
    try:
        return await task
    finally:
        unit.waited_for_vision_ms[camera] = round((time.monotonic() - since_s) * 1000, 3)
