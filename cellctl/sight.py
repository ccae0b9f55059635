"""Looking: one picture at a stop, and a part's pose out of it, with the annotated picture kept beside the work."""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any

from cellctl import views
from cellctl.calibration.plane_map import PlaneMap
from cellctl.faults import BaseNotFound, BatteryNotFound
from cellctl.geometry import Pose
from cellctl.pictures import Pictures
from cellctl.recipe import Recipe
from cellctl.vision import BaseMeasurement, BatteryMeasurement, NotFound, find_base, find_battery
from drivers.camera import Camera, Frame
from drivers.errors import FrameLost

GRAB_WITHIN_S = 1.0
GRABS = 3  # a picture lost on the wire is asked for again while the robot stands


async def grab(camera: Camera) -> Frame:
    """One whole picture; the robot stands."""
    for _ in range(GRABS - 1):
        try:
            return await camera.grab(within_s=GRAB_WITHIN_S)
        except FrameLost:
            continue
    return await camera.grab(within_s=GRAB_WITHIN_S)


async def exposed(look: Callable[[asyncio.Event], Coroutine[Any, Any, Pose]]) -> asyncio.Task[Pose]:
    """Begin to look, and return as soon as the exposure is over: the arm may move while the picture is measured."""
    over = asyncio.Event()
    looking = asyncio.create_task(look(over))
    waiting = asyncio.create_task(over.wait())
    try:
        await asyncio.wait({looking, waiting}, return_when=asyncio.FIRST_COMPLETED)
    except asyncio.CancelledError:
        looking.cancel()
        await asyncio.wait([looking])
        raise
    finally:
        waiting.cancel()
    if looking.done():
        looking.result()  # failed before it had exposed
    return looking


@dataclass(frozen=True)
class Sight:
    """Both cameras' maps, and what the recipe says about the parts. Measuring runs in a thread."""

    plane_1: PlaneMap
    plane_2: PlaneMap
    recipe: Recipe
    pictures: Pictures

    async def base(self, frame: Frame, tool_from_base: Pose, name: str) -> tuple[BaseMeasurement, Pose]:
        """The base near its expected pose in the tool frame. Raises BaseNotFound."""
        plane, part = self.plane_1, self.recipe.base
        expected = views.expect_base(plane, part, tool_from_base)
        search, limits = views.search_px(plane, part), views.limits_px(plane, self.recipe)
        try:
            seen = await asyncio.to_thread(find_base, frame.pixels, *expected, search, limits)
        except NotFound as error:
            picture = self.pictures.keep(name, "camera-1", frame.pixels, None, expected, f"{name} no base: {error}")
            raise BaseNotFound(f"camera 1: {error}, see {picture}") from error
        self.pictures.keep(name, "camera-1", frame.pixels, seen, expected, f"{name} base")
        return seen, views.base_pose(plane, seen)

    async def battery(self, frame: Frame, robot_from_battery: Pose, name: str) -> tuple[BatteryMeasurement, Pose]:
        """The battery near its expected pose in the robot frame. Raises BatteryNotFound."""
        plane, part = self.plane_2, self.recipe.battery
        expected = views.expect_battery(plane, part, robot_from_battery)
        search, limits = views.search_px(plane, part), views.limits_px(plane, self.recipe)
        try:
            seen = await asyncio.to_thread(find_battery, frame.pixels, *expected, search, limits)
        except NotFound as error:
            picture = self.pictures.keep(name, "camera-2", frame.pixels, None, expected, f"{name} no battery: {error}")
            raise BatteryNotFound(f"camera 2: {error}, see {picture}") from error
        self.pictures.keep(name, "camera-2", frame.pixels, seen, expected, f"{name} battery")
        return seen, views.battery_pose(plane, part, seen)
