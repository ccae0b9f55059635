"""Looking: one picture at a stop, and a part's pose out of it, with the annotated picture kept beside the work."""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from cellctl.assembly import views
from cellctl.assembly.seating import Seating, expect_gap, seating
from cellctl.calibration.plane_map import PlaneMap
from cellctl.faults import BaseNotFound, BatteryNotFound, CellError, GapNotSeen
from cellctl.geometry import Pose
from cellctl.pictures.writer import Expected, Pictures
from cellctl.recipe import Recipe
from cellctl.vision import (
    BaseMeasurement,
    BatteryMeasurement,
    Edge,
    NotFound,
    Search,
    find_base,
    find_battery,
    find_edge,
)
from cellctl.vision.gap import GapMeasurement, find_gap
from drivers.camera import Camera, Frame
from drivers.errors import FrameLost

T = TypeVar("T")
M = TypeVar("M", BaseMeasurement, BatteryMeasurement, Edge, GapMeasurement)
KNOWN_MM, KNOWN_DEG = 0.3, 0.3  # so well the first look tells where the second stretch of an edge is
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


async def exposed(look: Callable[[asyncio.Event], Coroutine[Any, Any, T]]) -> asyncio.Task[T]:
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


@asynccontextmanager
async def never_outliving(task: asyncio.Task[T]) -> AsyncIterator[None]:
    """A measurement ends with the block at the latest."""
    try:
        yield
    finally:
        task.cancel()
        await asyncio.wait([task])
        if not task.cancelled():
            task.exception()  # was raised where it was waited for, or the block failed before that


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
        seen = await self._found(look, frame, expected, ("camera-1", f"{name} base", BaseNotFound), name)
        return seen, views.base_pose(plane, seen)

    async def second_edge(self, frame: Frame, tool_from_base: Pose, name: str) -> Edge:
        """The second stretch of the base's edge, near where the first look at the base puts it. Raises BaseNotFound."""
        plane = self.plane_1
        expected = (views.expect_edge(plane, self.recipe.base.second_view, tool_from_base),)
        search, limits = Search(KNOWN_MM / plane.mm_per_px, KNOWN_DEG), views.limits_px(plane, self.recipe)
        look = partial(find_edge, frame.pixels, *expected, search, limits)
        return await self._found(look, frame, expected, ("camera-1-again", f"{name} base", BaseNotFound), name)

    async def battery(
        self, frame: Frame, robot_from_battery: Pose, name: str, *, opposite: bool = False
    ) -> tuple[BatteryMeasurement, Pose]:
        """The battery, by its corner or the opposite one, near its expected pose in the robot frame.

        Raises BatteryNotFound.
        """
        plane, part = self.plane_2, self.recipe.battery.diagonal if opposite else self.recipe.battery
        expected = views.expect_battery(plane, part, robot_from_battery)
        search, limits = views.search_px(plane, part), views.limits_px(plane, self.recipe)
        look = partial(find_battery, frame.pixels, *expected, search, limits)
        label = "camera-2-again" if opposite else "camera-2"
        seen = await self._found(look, frame, expected, (label, f"{name} battery", BatteryNotFound), name)
        return seen, views.battery_pose(plane, part, seen)

    async def gap(self, frame: Frame, mount_from_base: Pose, blur_px: float, name: str) -> Seating:
        """How the battery lies in the seat of a base that stands like this under camera 1. Raises GapNotSeen."""
        plane, look = self.plane_1, self.recipe.gap
        expected = expect_gap(plane, self.recipe, mount_from_base, blur_px)
        search = Search(look.search_mm / plane.mm_per_px, max(KNOWN_DEG, 2 * look.limit_deg))
        measure = partial(find_gap, frame.pixels, expected, search, views.limits_px(plane, self.recipe))
        shown = expected.edge_1, expected.edge_2
        seen = await self._found(measure, frame, shown, ("camera-1-gap", f"{name} gap", GapNotSeen), name)
        return seating(plane, self.recipe, seen, mount_from_base)

    async def _found(
        self, look: Callable[[], M], frame: Frame, expected: Expected, what: tuple[str, str, type[CellError]], name: str
    ) -> M:
        """Measure in a thread and keep the annotated picture, also of what was not found."""
        label, caption, missing = what
        keep = partial(self.pictures.keep, name, label, frame.pixels)
        try:
            seen = await asyncio.to_thread(look)
        except NotFound as error:
            picture = keep(None, expected, f"{caption} not found: {error}")
            raise missing(f"{label.replace('-', ' ')}: {error}, see {picture}") from error
        keep(seen, expected, caption)
        return seen
