"""Teaching by a golden assembly: where a battery that a person has seated well lies in its base, as this cell sees it.

Camera 1 looks at the base, the robot picks the battery out of its seat, camera 2 looks at it: the pick pose is the
true place pose of that pair. Each repeat is seated anew by hand, for only that averages the robot's error at the
pick; several pairs of base and battery average what the parts differ by. Then a reference battery at its nominal
place on the table says what "no offset" means.

Units are placed by their difference from this, so the absolute errors of both calibrations cancel.
"""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path

from cellctl.assembly import views
from cellctl.assembly.hand import COMMAND_WITHIN_S, Hand, commanded
from cellctl.assembly.sight import Sight, grab
from cellctl.assembly.stops import looking_at_base, looking_at_battery, out_of_reach
from cellctl.assembly.views import Deviation
from cellctl.config import CellConfig, PlaceXyt
from cellctl.control.events import Event
from cellctl.faults import BatteryLost, CalibrationFailed
from cellctl.geometry import Mm, Pose, mean_pose
from cellctl.learnt.calibrations import CameraCalibration
from cellctl.learnt.references import now
from cellctl.learnt.taught import Taught, TaughtCorner, TaughtEdge, geometry_of
from cellctl.procedures.golden import Assemblies, Golden, Spread
from cellctl.procedures.jobs import Job, Outcome
from cellctl.recipe import Recipe


@dataclass(frozen=True)
class Teaching:
    """Teaches one recipe; work for Execute in Maintenance. `ask(what, text)` returns when a person has done it."""

    config: CellConfig
    name: str
    recipe: Recipe
    calibrations: tuple[CameraCalibration, CameraCalibration]
    hand: Hand
    sight: Sight
    repeats: int  # of each pair
    pairs: int
    ask: Callable[[str, str], Awaitable[None]]
    publish: Callable[[Event], None]
    ends_with_its_unit = False

    @property
    def text(self) -> str:
        """What it does, for people."""
        return f"teaching of {self.name}"

    @property
    def job(self) -> Job:
        """The job that is told about."""
        return Job("teach", self.recipe, self.hand, self.publish, empties_first=False)

    @property
    def look_1(self) -> Pose:
        """Where the tool stands when camera 1 looks at the base."""
        return looking_at_base(self.config, self.recipe.base, self._axis_1)

    @property
    def look_2(self) -> Pose:
        """Where the tool stands when a battery gripped in its middle shows its corner to camera 2."""
        return looking_at_battery(self.recipe.battery, self._axis_2)

    @property
    def again_1(self) -> Pose | None:
        """Where the tool stands for the second look at the base; None when there is none."""
        if self.recipe.placement.second_look == "never" or self.recipe.base.second_edge_mm is None:
            return None
        return looking_at_base(self.config, self.recipe.base.second_view, self._axis_1)

    @property
    def again_2(self) -> Pose | None:
        """Where the tool stands for the second look at the battery; None when there is none."""
        if self.recipe.placement.second_look == "never":
            return None
        return looking_at_battery(self.recipe.battery.diagonal, self._axis_2)

    @property
    def _axis_1(self) -> Mm:
        return views.axis_mm(self.calibrations[0].plane, self.config.camera_1)

    @property
    def _axis_2(self) -> Mm:
        return views.axis_mm(self.calibrations[1].plane, self.config.camera_2)

    @property
    def table(self) -> Pose:
        """Where the tool stands when it takes a battery from its nominal place on the table."""
        return commanded(_pose(self.config.positions.table))

    async def run(self, keep_on: Callable[[], bool]) -> None:
        """All pairs and repeats, then the file. Raises CalibrationFailed when they do not agree."""
        await self.job.run(self._teach)

    async def _teach(self) -> Outcome:
        for text in out_of_reach(self.config, self.recipe):
            raise CalibrationFailed(text)
        golden = Assemblies(tuple([await self._golden(*which) for which in self._seatings()]))
        self.job.table(golden.table())
        self._check(golden)
        on_table = [await self._reference(number) for number in range(1, self.repeats + 1)]
        await self.ask("clear-station", "take the golden base and the reference battery out of the cell")
        taught = self._taught(golden, mean_pose(on_table))
        path = await asyncio.to_thread(taught.keep, self.config.paths.state, self.recipe)
        return _outcome(self.name, taught, path)

    def _seatings(self) -> list[tuple[int, int]]:
        """Pair and repeat of every golden assembly, in order."""
        return [(pair, repeat) for pair in range(1, self.pairs + 1) for repeat in range(1, self.repeats + 1)]

    def _taught(self, golden: Assemblies, robot_from_battery_on_table: Pose) -> Taught:
        first, second = self.calibrations
        repeat, pair = golden.repeat_spread, golden.pair_spread
        return Taught(
            made_at=now(),
            recipe=self.name,
            geometry=geometry_of(self.recipe),
            calibrations=(first.id, second.id),
            look_1=self.look_1,
            look_2=self.look_2,
            robot_from_base=mean_pose(sample.robot_from_base for sample in golden.samples),
            base_from_battery=golden.mean,
            tool_from_battery=mean_pose(sample.tool_from_battery for sample in golden.samples),
            table_pick=self.table,
            robot_from_battery_on_table=robot_from_battery_on_table,
            repeats=self.repeats,
            pairs=self.pairs,
            spread_mm=repeat.xy_mm,
            spread_deg=repeat.t_deg,
            between_mm=pair.xy_mm if pair else None,
            between_deg=pair.t_deg if pair else None,
            second_edge=self._taught_edge(golden.second_edge),
            second_corner=self._taught_corner(golden.second_corner),
        )

    def _taught_edge(self, found: Deviation | None) -> TaughtEdge | None:
        return TaughtEdge(stop=self.again_1, found=found) if self.again_1 and found else None

    def _taught_corner(self, found: Pose | None) -> TaughtCorner | None:
        return TaughtCorner(stop=self.again_2, found=found) if self.again_2 and found else None

    def _check(self, golden: Assemblies) -> None:
        """Raise CalibrationFailed when one seating differs too much from the next, or one pair from the others."""
        self._check_spread(
            golden.repeat_spread,
            "one seating differs from the next",
            "seat the battery against the same sides each time, look for dirt in the seat, and for play of the arm "
            "with `cellctl calibrate hysteresis`",
        )
        if (between := golden.pair_spread) is not None:
            self._check_spread(
                between,
                "one golden pair differs from the next",
                "measure the golden parts, leave out the one that stands apart in the table, and teach again",
            )

    def _check_spread(self, spread: Spread, what: str, remedy: str) -> None:
        limits = self.recipe.limits
        if not spread.within(limits.golden_spread_mm, limits.golden_spread_deg):
            allowed = f"{limits.golden_spread_mm * 1000:g} um and {limits.golden_spread_deg * 1000:g} mdeg"
            raise CalibrationFailed(f"{what} by {spread.text}, allowed are {allowed}: {remedy}")

    async def _golden(self, pair: int, repeat: int) -> Golden:
        """One golden assembly: look, pick it out of its seat, look, put it back."""
        hand, name = self.hand, f"teach-{self.name}-pair-{pair}-golden-{repeat}"
        await self._ask_for_golden(pair, repeat)
        await hand.devices.plc.base_at_station(within_s=COMMAND_WITHIN_S)
        robot_from_base, second_edge = await self._look_at_base(name)
        seat = commanded(robot_from_base @ self.recipe.base.seat)
        await hand.stop_at(seat)
        await hand.suck(seat, self.recipe.place.seat_z_mm)
        tool_from_battery = await self._look_at_held(name)
        second_corner = await self._look_again_at_held(name, tool_from_battery)
        await hand.stop_at(seat)
        await hand.put(seat, self.recipe.place.seat_z_mm)
        self.job.say(f"golden assembly {repeat} of {self.repeats}{self._of_pair(pair)}")
        base_from_battery = robot_from_base.inverse() @ seat @ tool_from_battery
        return Golden(pair, robot_from_base, base_from_battery, tool_from_battery, second_edge, second_corner)

    async def _ask_for_golden(self, pair: int, repeat: int) -> None:
        """A person puts in the pair's base and seats its battery; for a new pair first the parts are changed."""
        if pair > 1 and repeat == 1:
            await self.ask("put-in-golden-pair", f"take the golden base and battery out, put in pair {pair}")
        await self.ask(
            "seat-golden-assembly",
            f"{repeat} of {self.repeats}{self._of_pair(pair)}: seat the golden battery by hand in the golden base at "
            "the station",
        )

    def _of_pair(self, pair: int) -> str:
        return f", pair {pair} of {self.pairs}" if self.pairs > 1 else ""

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
        self.job.say(f"reference battery {number} of {self.repeats}")
        return self.table @ tool_from_battery

    async def _look_at_held(self, name: str) -> Pose:
        """tool_from_battery of what hangs on the cup."""
        await self.hand.stop_at(self.look_2, self.config.positions.camera_2_z_mm)
        self.hand.expect_vacuum(True, 3, BatteryLost, "over camera 2")
        frame = await grab(self.hand.devices.camera_2)
        _, robot_from_battery = await self.sight.battery(frame, self.look_2, name)
        return self.look_2.inverse() @ robot_from_battery

    async def _look_at_base(self, name: str) -> tuple[Pose, Deviation | None]:
        """robot_from_base, and what the second look at it gave when there is one."""
        mount = self.config.mount_1.frame(self.look_1)
        await self.hand.stop_at(self.look_1, self.config.positions.camera_1_z_mm)
        frame = await grab(self.hand.devices.camera_1)
        expected = mount.inverse() @ _pose(self.config.positions.station)
        seen, mount_from_base = await self.sight.base(frame, expected, name)
        robot_from_base, again = mount @ mount_from_base, self.again_1
        if again is None:
            return robot_from_base, None
        mounts = mount, self.config.mount_1.frame(again)
        await self.hand.stop_at(again, self.config.positions.camera_1_z_mm)
        frame = await grab(self.hand.devices.camera_1)
        edge = await self.sight.second_edge(frame, mounts[1].inverse() @ robot_from_base, name)
        plane, base = self.sight.plane_1, self.recipe.base
        return robot_from_base, views.second_edge(plane, base, robot_from_base, (seen.edge, edge), mounts)

    async def _look_again_at_held(self, name: str, tool_from_battery: Pose) -> Pose | None:
        """The battery by its opposite corner, from the battery by its first one; None without a second look."""
        again = self.again_2
        if again is None:
            return None
        await self.hand.stop_at(again, self.config.positions.camera_2_z_mm)
        self.hand.expect_vacuum(True, 3, BatteryLost, "over camera 2 again")
        frame = await grab(self.hand.devices.camera_2)
        _, robot_from_battery = await self.sight.battery(frame, again @ tool_from_battery, name, opposite=True)
        return tool_from_battery.inverse() @ again.inverse() @ robot_from_battery


def _outcome(name: str, taught: Taught, path: Path) -> Outcome:
    pairs = f"{taught.pairs} pairs with {taught.repeats}" if taught.pairs > 1 else f"{taught.repeats}"
    between = ""
    if taught.between_mm is not None and taught.between_deg is not None:
        between = f", {taught.between_mm * 1000:.1f} um {taught.between_deg * 1000:.1f} mdeg from pair to pair"
    text = (
        f"{name} taught from {pairs} golden assemblies, spread {taught.spread_mm * 1000:.1f} um "
        f"{taught.spread_deg * 1000:.1f} mdeg (1 sigma of one repeat){between}; taught place known to "
        f"{taught.uncertainty_mm * 1000:.1f} um {taught.uncertainty_deg * 1000:.1f} mdeg"
    )
    figures = {"spread_mm": taught.spread_mm, "spread_deg": taught.spread_deg, "between_mm": taught.between_mm}
    return Outcome(text, {"file": str(path), **figures, "uncertainty_mm": taught.uncertainty_mm})


def _pose(place: PlaceXyt) -> Pose:
    return Pose(place.x_mm, place.y_mm, place.t_deg)
