"""Looking: one picture at a stop, and a part's pose out of it, with the annotated picture kept beside the work."""

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from cellctl import views
from cellctl.calibration.plane_map import PlaneMap
from cellctl.faults import BaseNotFound, BatteryNotFound, CellError
from cellctl.geometry import Pose
from cellctl.pictures import Expected, Pictures
from cellctl.recipe import Recipe
from cellctl.vision import BaseMeasurement, BatteryMeasurement, NotFound, find_base, find_battery
from drivers.camera import Camera, Frame
from drivers.errors import FrameLost

M = TypeVar("M", BaseMeasurement, BatteryMeasurement)
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
        look = partial(find_base, frame.pixels, *expected, search, limits)
        seen = await self._found(look, frame, expected, (1, f"{name} base", BaseNotFound), name)
        return seen, views.base_pose(plane, seen)

    async def battery(self, frame: Frame, robot_from_battery: Pose, name: str) -> tuple[BatteryMeasurement, Pose]:
        """The battery near its expected pose in the robot frame. Raises BatteryNotFound."""
        plane, part = self.plane_2, self.recipe.battery
        expected = views.expect_battery(plane, part, robot_from_battery)
        search, limits = views.search_px(plane, part), views.limits_px(plane, self.recipe)
        look = partial(find_battery, frame.pixels, *expected, search, limits)
        seen = await self._found(look, frame, expected, (2, f"{name} battery", BatteryNotFound), name)
        return seen, views.battery_pose(plane, part, seen)

    async def _found(
        self, look: Callable[[], M], frame: Frame, expected: Expected, what: tuple[int, str, type[CellError]], name: str
    ) -> M:
        """Measure in a thread and keep the annotated picture, also of what was not found."""
        camera, caption, missing = what
        keep = partial(self.pictures.keep, name, f"camera-{camera}", frame.pixels)
        try:
            seen = await asyncio.to_thread(look)
        except NotFound as error:
            picture = keep(None, expected, f"{caption} not found: {error}")
            raise missing(f"camera {camera}: {error}, see {picture}") from error
        keep(seen, expected, caption)
        return seen
