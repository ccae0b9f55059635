"""One battery into one base: the paper's six steps, in order.

Read `assemble` first; every function below it is one of its lines. Nothing here knows a machine state or waits for
an operator. An exception ends the cycle, and faults.py says what follows.

Two pictures are measured beside the motion: camera 1's while the robot fetches the battery, camera 2's while the arm
already travels to the seat. The vacuum is checked at five points, numbered 1 to 5 where they stand.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

from cellctl import views
from cellctl.config import CellConfig
from cellctl.faults import (
    BaseNotFound,
    BatteryLost,
    BatteryNotFound,
    NoParts,
    OffsetTooLarge,
    PickFailed,
    PlacementUncertain,
    VacuumStuck,
)
from cellctl.geometry import Mm, Offset, Pose, offset_about, place_pose
from cellctl.log import step
from cellctl.pictures import Pictures
from cellctl.placement import Prediction, Source, predict
from cellctl.recipe import Recipe
from cellctl.references import CameraCalibration, Taught
from cellctl.vision import BaseMeasurement, BatteryMeasurement, NotFound, find_base, find_battery
from drivers.camera import Camera, Frame
from drivers.errors import FrameLost, NoAnswer
from drivers.plc import Plc
from drivers.robot import Point, Robot

GRAB_WITHIN_S = 1.0
GRABS = 3  # a picture lost on the wire is asked for again while the robot stands
COMMAND_WITHIN_S = 5.0


@dataclass(frozen=True)
class Devices:
    """The devices of the cell."""

    plc: Plc
    robot: Robot
    camera_1: Camera  # on the tool, looks down
    camera_2: Camera  # on the bench, looks up


@dataclass(frozen=True)
class Job:
    """All that decides how a unit is assembled; it does not change while the unit lives."""

    config: CellConfig
    name: str
    recipe: Recipe
    calibration_1: CameraCalibration
    calibration_2: CameraCalibration
    taught: Taught
    pictures: Pictures


@dataclass
class Unit:
    """What is found out about one unit on its way."""

    id: str
    carrier_id: int = 0
    base: Offset | None = None
    battery: Offset | None = None
    prediction: Prediction | None = None
    seen_base: BaseMeasurement | None = None
    seen_battery: BatteryMeasurement | None = None
    placed_at: Pose | None = None
    waited_for_vision_ms: dict[str, float] = field(default_factory=dict)


async def assemble(cell: Devices, job: Job, unit: Unit) -> None:
    """Bring one base and one battery together. Raises what is in faults.py; then the cell decides what follows."""
    with step(1, "bring base"):
        await bring_base(cell, job, unit)
    with step(2, "start signal"):
        await check_parts(cell, job)
    with step(3, "look at base"):
        base_frame = await look(cell, job, cell.camera_1, job.taught.look_1)
    async with beside(locate_base(job, unit, base_frame)) as base:
        with step(4, "fetch battery"):
            await fetch_battery(cell, job, unit, base)
        with step(5, "look at battery"):
            battery_frame = await look(cell, job, cell.camera_2, job.taught.look_2)
            expect_vacuum(cell, True, 3, BatteryLost, "over camera 2")
        async with beside(locate_battery(job, unit, battery_frame)) as battery:
            with step(6, "place battery"):
                await place_battery(cell, job, unit, base, battery)


# -- steps 1 and 2: parts ----------------------------------------------------------------------------------


async def bring_base(cell: Devices, job: Job, unit: Unit) -> None:
    """The PLC runs the conveyor until the photoelectric switch sees a base, and clamps its carrier."""
    try:
        arrival = await cell.plc.bring_base(within_s=job.recipe.timing.arrival_within_s)
    except NoAnswer as error:
        if not cell.plc.image.photo_switch:
            raise NoParts(
                f"no base arrived within {job.recipe.timing.arrival_within_s:g} s ({error.detail})"
            ) from error
        raise
    unit.carrier_id = arrival.carrier_id


async def check_parts(cell: Devices, job: Job) -> None:
    """The start signal holds only while the carrier is clamped, nothing moves and a battery lies ready."""
    image = cell.plc.image
    if not image.carrier_clamped or image.conveyor_moving:
        raise NoParts("the carrier is not clamped or the conveyor still moves")
    if not image.battery_on_table:
        raise NoParts("there is no battery on the table")


# -- steps 3 and 5: pictures -------------------------------------------------------------------------------


async def look(cell: Devices, job: Job, camera: Camera, stop: Pose) -> Frame:
    """Stand still over (or with the battery above) a camera and take one picture."""
    positions = job.config.positions
    z_mm = positions.camera_1_z_mm if camera is cell.camera_1 else positions.camera_2_z_mm
    await stop_at(cell, job, stop, z_mm)
    await asyncio.sleep(job.recipe.motion.settle_s)
    return await grab(camera)


async def grab(camera: Camera) -> Frame:
    """One whole picture; the robot stands."""
    for _ in range(GRABS - 1):
        try:
            return await camera.grab(within_s=GRAB_WITHIN_S)
        except FrameLost:
            continue
    return await camera.grab(within_s=GRAB_WITHIN_S)


async def locate_base(job: Job, unit: Unit, frame: Frame) -> Pose:
    """robot_from_base out of camera 1's picture; beside the motion."""
    taught, plane = job.taught, job.calibration_1.plane
    expected = views.expect_base(plane, job.recipe.base, taught.look_1.inverse() @ taught.robot_from_base)
    search, limits = views.search_px(plane, job.recipe.base), views.limits_px(plane, job.recipe)
    try:
        seen = await asyncio.to_thread(find_base, frame.pixels, *expected, search, limits)
    except NotFound as error:
        job.pictures.keep(unit.id, "camera-1", frame.pixels, None, expected, f"{unit.id} no base: {error}")
        raise BaseNotFound(f"camera 1: {error}") from error
    robot_from_base = taught.look_1 @ views.base_pose(plane, seen)
    seat = job.recipe.base
    centre = taught.robot_from_base.point(seat.seat_x_mm, seat.seat_y_mm)
    unit.seen_base, unit.base = seen, offset_about(centre, taught.robot_from_base, robot_from_base)
    job.pictures.keep(unit.id, "camera-1", frame.pixels, seen, expected, f"{unit.id} base {as_text(unit.base)}")
    limit = job.recipe.limits
    check_offset("base", unit.base, limit.base_offset_mm, limit.base_offset_deg)
    return robot_from_base


async def locate_battery(job: Job, unit: Unit, frame: Frame) -> Pose:
    """tool_from_battery out of camera 2's picture; beside the motion."""
    taught, plane = job.taught, job.calibration_2.plane
    expected = views.expect_battery(plane, job.recipe.battery, taught.look_2 @ taught.tool_from_battery)
    search, limits = views.search_px(plane, job.recipe.battery), views.limits_px(plane, job.recipe)
    try:
        seen = await asyncio.to_thread(find_battery, frame.pixels, *expected, search, limits)
    except NotFound as error:
        job.pictures.keep(unit.id, "camera-2", frame.pixels, None, expected, f"{unit.id} no battery: {error}")
        raise BatteryNotFound(f"camera 2: {error}") from error
    tool_from_battery = taught.look_2.inverse() @ views.battery_pose(plane, job.recipe.battery, seen)
    on_table = taught.robot_from_battery_on_table
    unit.seen_battery = seen
    unit.battery = offset_about(Mm(on_table.x_mm, on_table.y_mm), on_table, taught.table_pick @ tool_from_battery)
    job.pictures.keep(unit.id, "camera-2", frame.pixels, seen, expected, f"{unit.id} battery {as_text(unit.battery)}")
    limit = job.recipe.limits
    check_offset("battery", unit.battery, limit.battery_offset_mm, limit.battery_offset_deg)
    return tool_from_battery


def check_offset(part: str, offset: Offset, limit_mm: float, limit_deg: float) -> None:
    """Refuse what lies further from its taught place than the recipe allows."""
    if max(abs(offset.dx_mm), abs(offset.dy_mm)) > limit_mm or abs(offset.dt_deg) > limit_deg:
        raise OffsetTooLarge(f"{part} {as_text(offset)}, allowed are {limit_mm:g} mm and {limit_deg:g} deg")


def as_text(offset: Offset) -> str:
    """As in the paper's Table 2."""
    return f"dX {offset.dx_mm:+.4f} dY {offset.dy_mm:+.4f} mm dT {offset.dt_deg:+.4f} deg"


# -- step 4: fetch -----------------------------------------------------------------------------------------


async def fetch_battery(cell: Devices, job: Job, unit: Unit, base: asyncio.Task[Pose]) -> None:
    """Take the battery from its table. A base that was not found ends the unit before anything hangs on the cup."""
    expect_vacuum(cell, False, 1, VacuumStuck, "before the pick")
    await travel(cell, job, job.taught.table_pick)
    await wait_for_vision(unit, "camera-1", base)
    await suck(cell, job, job.taught.table_pick, job.recipe.pick.touch_z_mm)
    expect_vacuum(cell, True, 2, BatteryLost, "after the pick")


async def suck(cell: Devices, job: Job, at: Pose, z_mm: float) -> None:
    """Touch, suck, lift; touch again as often as the recipe allows. Raises PickFailed."""
    pick = job.recipe.pick
    for _ in range(pick.retries + 1):
        await lower(cell, job, at, z_mm)
        try:
            await cell.plc.vacuum(True, within_s=pick.vacuum_within_s)
        except NoAnswer as error:
            failed = PickFailed(f"no vacuum within {pick.vacuum_within_s:g} s ({error.detail})")
            await cell.plc.vacuum(False, within_s=pick.vacuum_within_s)
            await lift(cell, job, at)
            continue
        await asyncio.sleep(pick.dwell_s)
        await lift(cell, job, at)
        return
    raise failed


# -- step 6: place -----------------------------------------------------------------------------------------


async def place_battery(
    cell: Devices, job: Job, unit: Unit, base: asyncio.Task[Pose], battery: asyncio.Task[Pose]
) -> None:
    """Compute where the tool must be, lower the battery into its seat, let go."""
    taught = job.taught
    robot_from_base = await base if job.recipe.cameras == "both" else taught.robot_from_base
    seat = place_pose(robot_from_base, taught.base_from_battery, taught.tool_from_battery)
    await travel(cell, job, before(job, seat))  # where the seat is to within a millimetre: camera 2 is still measured
    tool_from_battery = await wait_for_vision(unit, "camera-2", battery)
    unit.prediction = predict_placement(job, unit)
    if unit.prediction.p99_mm > job.recipe.limits.placement_mm:
        raise PlacementUncertain(f"{unit.prediction.sentence}, allowed are {job.recipe.limits.placement_mm:g} mm")
    unit.placed_at = place_pose(robot_from_base, taught.base_from_battery, tool_from_battery)
    expect_vacuum(cell, True, 4, BatteryLost, "before placing")
    await stop_at(cell, job, unit.placed_at, job.config.positions.safe_z_mm)
    await put(cell, job, unit.placed_at, job.recipe.place.seat_z_mm)


async def put(cell: Devices, job: Job, at: Pose, z_mm: float) -> None:
    """Lower what the cup holds, let go, lift. Raises VacuumStuck when it does not let go."""
    place = job.recipe.place
    await lower(cell, job, at, z_mm)
    await asyncio.sleep(place.dwell_s)
    await let_go(cell, job)
    await lift(cell, job, at)
    expect_vacuum(cell, False, 5, VacuumStuck, "after placing")


async def let_go(cell: Devices, job: Job) -> None:
    """Vacuum off, helped by a blow-off pulse."""
    place = job.recipe.place
    await cell.plc.blow_off(place.blow_off_s > 0)
    try:
        await cell.plc.vacuum(False, within_s=place.vacuum_gone_within_s)
    except NoAnswer as error:
        raise VacuumStuck(f"the vacuum is not gone {place.vacuum_gone_within_s:g} s after the valve closed") from error
    finally:
        await cell.plc.blow_off(False)


def predict_placement(job: Job, unit: Unit) -> Prediction:
    """Both pictures, three robot stops and the teaching, carried to the corners of the battery."""
    recipe, taught, robot = job.recipe, job.taught, job.config.robot
    corner, tool = views.corner_mm(recipe.battery), Mm(0.0, 0.0)
    hole = taught.base_from_battery.inverse().point(0.0, 0.0)
    stop_mm, stop_deg = robot.repeatability_mm / 3, robot.repeatability_deg / 3
    assert unit.seen_base is not None and unit.seen_battery is not None  # both pictures were waited for
    edge = views.direction_edge(recipe.battery, unit.seen_battery)
    px_1, px_2 = job.calibration_1.plane.mm_per_px, job.calibration_2.plane.mm_per_px
    sources = [
        Source("camera 1", unit.seen_base.circle.sd_px * px_1, unit.seen_base.edge.angle_sd_deg, hole),
        Source("camera 2", unit.seen_battery.corner_sd_px * px_2, edge.angle_sd_deg, corner),
        Source("stop at camera 1", stop_mm, stop_deg, hole),
        Source("stop at camera 2", stop_mm, stop_deg, corner),
        Source("stop at the seat", stop_mm, stop_deg, tool),
        Source("teaching", taught.spread_mm / taught.repeats**0.5, taught.spread_deg / taught.repeats**0.5, tool),
    ]
    w, h = recipe.battery.width_mm / 2, recipe.battery.height_mm / 2
    return predict(sources, [Mm(-w, -h), Mm(w, -h), Mm(w, h), Mm(-w, h)])


# -- motion and vacuum -------------------------------------------------------------------------------------


async def travel(cell: Devices, job: Job, to: Pose) -> None:
    """To above a place, at the travel height: up first, then across."""
    safe_z_mm = job.config.positions.safe_z_mm
    await cell.robot.move(point(to, safe_z_mm), speed_pct=job.recipe.motion.travel_speed_pct)


async def stop_at(cell: Devices, job: Job, at: Pose, z_mm: float) -> None:
    """Stop exactly: always approached from the same side, so that hysteresis is the same at all measuring stops."""
    await travel(cell, job, before(job, at))
    motion, safe_z_mm = job.recipe.motion, job.config.positions.safe_z_mm
    if z_mm != safe_z_mm:
        await cell.robot.move(point(before(job, at), z_mm), speed_pct=motion.touch_speed_pct)
    await cell.robot.move(point(at, z_mm), speed_pct=motion.touch_speed_pct)


def before(job: Job, at: Pose) -> Pose:
    """Where the one-sided approach to a stop begins."""
    approach_mm = job.recipe.motion.approach_mm
    return Pose(at.x_mm - approach_mm, at.y_mm - approach_mm, at.t_deg)


async def lower(cell: Devices, job: Job, at: Pose, z_mm: float) -> None:
    """Straight down onto something."""
    await cell.robot.move(point(at, z_mm), speed_pct=job.recipe.motion.touch_speed_pct)


async def lift(cell: Devices, job: Job, at: Pose) -> None:
    """Straight up to the travel height."""
    await cell.robot.move(point(at, job.config.positions.safe_z_mm), speed_pct=job.recipe.motion.travel_speed_pct)


def point(pose: Pose, z_mm: float) -> Point:
    """A pose of the tool as the robot is told it."""
    return Point(pose.x_mm, pose.y_mm, z_mm, pose.t_deg)


def expect_vacuum(cell: Devices, on: bool, number: int, fault: type[Exception], when: str) -> None:
    """One of the five vacuum checks."""
    image = cell.plc.image
    if image.vacuum_reached is not on:
        state = "on" if image.vacuum_reached else "off"
        raise fault(f"vacuum check {number}: the switch is {state} {when} ({image.vacuum_kpa:.1f} kPa)")


# -- beside the motion -------------------------------------------------------------------------------------


@asynccontextmanager
async def beside(work: Coroutine[Any, Any, Pose]) -> AsyncIterator[asyncio.Task[Pose]]:
    """Run work beside the block; it never outlives the block."""
    task = asyncio.create_task(work)
    try:
        yield task
    finally:
        task.cancel()
        await asyncio.wait([task])
        if not task.cancelled():
            task.exception()  # it was raised where it was waited for, or the block failed before that


async def wait_for_vision(
    unit: Unit, camera: str, task: Awaitable[Pose], clock: Callable[[], float] = time.monotonic
) -> Pose:
    """The measured pose, and how long the motion had to wait for it."""
    since_s = clock()
    try:
        return await task
    finally:
        unit.waited_for_vision_ms[camera] = round((clock() - since_s) * 1000, 3)
