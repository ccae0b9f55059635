"""Teaching by a golden assembly: where a battery that a person has seated well lies in its base, as this cell sees it.

Camera 1 looks at the base, the robot picks the battery out of its seat, camera 2 looks at it: the pick pose is the
true place pose of that pair. Each repeat is seated anew by hand, for only that averages the robot's error at the
pick. Then a reference battery at its nominal place on the table says what "no offset" means.

Units are placed by their difference from this, so the absolute errors of both calibrations cancel.
"""

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from cellctl import views
from cellctl.config import CellConfig, PlaceXyt
from cellctl.events import Event, job_event, progress_event
from cellctl.faults import BatteryLost, CalibrationFailed, CellError
from cellctl.geometry import Pose, mean_pose, wrap_deg
from cellctl.hand import COMMAND_WITHIN_S, Hand, commanded, seeing
from cellctl.log import log
from cellctl.recipe import Recipe
from cellctl.references import CameraCalibration, Taught, geometry_of, now
from cellctl.sight import Sight, grab
from drivers.errors import DeviceError

MOST_SPREAD_MM = 0.030
MOST_SPREAD_DEG = 0.030


@dataclass(frozen=True)
class Golden:
    """What one repeat of the golden assembly gave."""

    robot_from_base: Pose
    base_from_battery: Pose
    tool_from_battery: Pose


@dataclass(frozen=True)
class Teaching:
    """Teaches one recipe; work for Execute in Maintenance. `ask(what, text)` returns when a person has done it."""

    config: CellConfig
    name: str
    recipe: Recipe
    calibrations: tuple[CameraCalibration, CameraCalibration]
    hand: Hand
    sight: Sight
    repeats: int
    ask: Callable[[str, str], Awaitable[None]]
    publish: Callable[[Event], None]
    ends_with_its_unit = False

    @property
    def text(self) -> str:
        """What it does, for people."""
        return f"teaching of {self.name}"

    @property
    def look_1(self) -> Pose:
        """Where the tool stands when the middle of camera 1's picture shows the recipe's view point of the base."""
        axis = views.axis_mm(self.calibrations[0].plane, self.config.camera_1)
        view = _pose(self.config.positions.station).point(self.recipe.base.view_x_mm, self.recipe.base.view_y_mm)
        return commanded(Pose(view.x_mm - axis.x_mm, view.y_mm - axis.y_mm, 0.0))

    @property
    def look_2(self) -> Pose:
        """Where the tool stands when a battery gripped in its middle shows its corner to camera 2."""
        axis = views.axis_mm(self.calibrations[1].plane, self.config.camera_2)
        view = views.battery_view_mm(self.recipe.battery)
        return commanded(Pose(axis.x_mm - view.x_mm, axis.y_mm - view.y_mm, 0.0))

    @property
    def table(self) -> Pose:
        """Where the tool stands when it takes a battery from its nominal place on the table."""
        return commanded(_pose(self.config.positions.table))

    async def run(self, keep_on: Callable[[], bool]) -> None:
        """All repeats, then the file. Raises CalibrationFailed when the repeats do not agree."""
        try:
            async with seeing(self.hand.devices, self.recipe):
                taught = await self._teach()
        except (CellError, DeviceError) as error:
            self.publish(job_event("teach", False, str(error)))
            raise
        path = Taught.path(self.config.paths.state, self.recipe)
        await asyncio.to_thread(taught.save, path)
        text = (
            f"{self.name} taught from {taught.repeats} golden assemblies, "
            f"spread {taught.spread_mm * 1000:.1f} um {taught.spread_deg * 1000:.1f} mdeg (1 sigma of one repeat)"
        )
        log.info(text)
        self.publish(job_event("teach", True, text, {"file": str(path), "spread_mm": taught.spread_mm}))

    async def _teach(self) -> Taught:
        golden = [await self._golden(number) for number in range(1, self.repeats + 1)]
        on_table = [await self._reference(number) for number in range(1, self.repeats + 1)]
        await self.ask("clear-station", "take the golden base and the reference battery out of the cell")
        seats = [sample.base_from_battery for sample in golden]
        spread_mm, spread_deg = spread(seats)
        if spread_mm > MOST_SPREAD_MM or spread_deg > MOST_SPREAD_DEG:
            raise CalibrationFailed(
                f"the repeats differ by {spread_mm * 1000:.0f} um and {spread_deg * 1000:.0f} mdeg (1 sigma), "
                f"allowed are {MOST_SPREAD_MM * 1000:.0f} um and {MOST_SPREAD_DEG * 1000:.0f} mdeg"
            )
        first, second = self.calibrations
        return Taught(
            made_at=now(),
            recipe=self.name,
            geometry=geometry_of(self.recipe),
            calibrations=(first.id, second.id),
            look_1=self.look_1,
            look_2=self.look_2,
            robot_from_base=mean_pose(sample.robot_from_base for sample in golden),
            base_from_battery=mean_pose(seats),
            tool_from_battery=mean_pose(sample.tool_from_battery for sample in golden),
            table_pick=self.table,
            robot_from_battery_on_table=mean_pose(on_table),
            repeats=self.repeats,
            spread_mm=spread_mm,
            spread_deg=spread_deg,
        )

    async def _golden(self, number: int) -> Golden:
        """One golden assembly: look, pick it out of its seat, look, put it back."""
        hand, base, name = self.hand, self.recipe.base, f"teach-{self.name}-golden-{number}"
        await self.ask(
            "seat-golden-assembly",
            f"{number} of {self.repeats}: seat the golden battery by hand in the golden base at the station",
        )
        await hand.devices.plc.base_at_station(within_s=COMMAND_WITHIN_S)
        await hand.stop_at(self.look_1, self.config.positions.camera_1_z_mm)
        expected = self.look_1.inverse() @ _pose(self.config.positions.station)
        frame = await grab(hand.devices.camera_1)
        _, tool_from_base = await self.sight.base(frame, expected, name)
        robot_from_base = self.look_1 @ tool_from_base
        seat = commanded(robot_from_base @ Pose(base.seat_x_mm, base.seat_y_mm, base.seat_t_deg))
        await hand.stop_at(seat)
        await hand.suck(seat, self.recipe.place.seat_z_mm)
        tool_from_battery = await self._look_at_held(name)
        await hand.stop_at(seat)
        await hand.put(seat, self.recipe.place.seat_z_mm)
        self._say(f"golden assembly {number} of {self.repeats}")
        return Golden(robot_from_base, robot_from_base.inverse() @ seat @ tool_from_battery, tool_from_battery)

    async def _reference(self, number: int) -> Pose:
        """robot_from_battery of the reference battery at its nominal place on the table."""
        hand = self.hand
        await self.ask(
            "lay-reference-battery",
            f"{number} of {self.repeats}: lay the reference battery at its nominal place on the table",
        )
        await hand.stop_at(self.table)
        await hand.suck(self.table, self.recipe.pick.touch_z_mm)
        tool_from_battery = await self._look_at_held(f"teach-{self.name}-table-{number}")
        await hand.stop_at(self.table)
        await hand.put(self.table, self.recipe.pick.touch_z_mm)
        self._say(f"reference battery {number} of {self.repeats}")
        return self.table @ tool_from_battery

    async def _look_at_held(self, name: str) -> Pose:
        """tool_from_battery of what hangs on the cup."""
        await self.hand.stop_at(self.look_2, self.config.positions.camera_2_z_mm)
        self.hand.expect_vacuum(True, 3, BatteryLost, "over camera 2")
        frame = await grab(self.hand.devices.camera_2)
        _, robot_from_battery = await self.sight.battery(frame, self.look_2, name)
        return self.look_2.inverse() @ robot_from_battery

    def _say(self, text: str) -> None:
        log.info(f"teach: {text}")
        self.publish(progress_event("teach", text))


def spread(poses: list[Pose]) -> tuple[float, float]:
    """Standard deviation per axis in mm and of the angle in degrees."""
    if len(poses) < 2:
        return 0.0, 0.0
    mean, free = mean_pose(poses), len(poses) - 1
    squares_mm2 = sum((p.x_mm - mean.x_mm) ** 2 + (p.y_mm - mean.y_mm) ** 2 for p in poses)
    squares_deg2 = sum(wrap_deg(p.t_deg - mean.t_deg) ** 2 for p in poses)
    return math.sqrt(squares_mm2 / (2 * free)), math.sqrt(squares_deg2 / free)


def _pose(place: PlaceXyt) -> Pose:
    return Pose(place.x_mm, place.y_mm, place.t_deg)
