"""How the robot handles parts: travel, exact stops, sucking and letting go. Every verb leaves the arm at travel height.

The vacuum checks of the cycle are numbered where they stand; the switch is read fresh for each of them.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass

from cellctl.assembly import ways
from cellctl.config import Positions
from cellctl.faults import PickFailed, VacuumStuck
from cellctl.geometry import Pose
from cellctl.mount import FLAGS, Elbow
from cellctl.recipe import Motion, Pick, PlaceStep, Recipe
from drivers.camera import Camera
from drivers.errors import DeviceError, NoAnswer
from drivers.plc import Plc
from drivers.robot import Leg, Robot
from drivers.robot_ports import Valve

COMMAND_WITHIN_S = 5.0
FREEING_SPEED_PCT = 20


@dataclass(frozen=True)
class Devices:
    """The devices of the cell."""

    plc: Plc
    robot: Robot
    camera_1: Camera  # on the tool, looks down
    camera_2: Camera  # on the bench, looks up
    valve: Valve | None = None  # of the vacuum, when it is the robot's and not the PLC's


@dataclass(frozen=True)
class Hand:
    """Robot and vacuum cup, with the heights of the cell and the manners of the recipe."""

    devices: Devices
    positions: Positions
    motion: Motion
    pick: Pick
    place: PlaceStep

    async def travel(self, to: Pose, elbow: Elbow | None = None) -> None:
        """Across, at travel height; with the elbow on that side, else on that of production."""
        await self._go([ways.across(to, self.positions, self.motion)], elbow)

    async def stop_at(self, at: Pose, z_mm: float | None = None, elbow: Elbow | None = None) -> None:
        """Stop exactly, approached from the same side every time, so that hysteresis cancels between stops."""
        await self.stop_from(self.before(at), at, z_mm, elbow)

    async def stop_from(self, start: Pose, at: Pose, z_mm: float | None = None, elbow: Elbow | None = None) -> None:
        """Stop exactly, approached from a given side."""
        for leg in ways.stop(start, at, z_mm, self.positions, self.motion):
            await self._go([leg], elbow)
        await asyncio.sleep(self.motion.settle_s)

    async def arrive(self, at: Pose) -> None:
        """At travel height, the last, slow stretch from `before` a stop to the stop, and stand still."""
        await self._go([ways.gently(at, self.positions.safe_z_mm, self.motion)])
        await asyncio.sleep(self.motion.settle_s)

    def before(self, at: Pose, uncertain_mm: float = 0.0, uncertain_deg: float = 0.0) -> Pose:
        """Where the one-sided approach in X, Y and R begins to a stop that is known to so many mm and degrees."""
        return ways.before(at, self.motion, uncertain_mm, uncertain_deg)

    async def suck(self, at: Pose, z_mm: float) -> None:
        """Touch, suck, lift; touch again as often as the recipe allows. Raises PickFailed."""
        for attempt in range(self.pick.retries + 1):
            await self.lower(at, z_mm)
            failed = await self._seal()
            await self.lift(at)
            if failed is None:
                return
            if attempt == self.pick.retries:
                raise failed

    async def _seal(self) -> PickFailed | None:
        plc, within_s = self.devices.plc, self.pick.vacuum_within_s
        try:
            await self._vacuum(True, within_s)
        except NoAnswer as error:
            pressure_kpa = plc.image.vacuum_kpa  # raises what is wrong with the link, if that is the reason
            await self._vacuum(False, within_s)
            failed = PickFailed(f"no vacuum at the cup within {within_s:g} s, only {pressure_kpa:.1f} kPa")
            failed.__cause__ = error
            return failed
        await asyncio.sleep(self.pick.dwell_s)
        return None

    async def put(self, at: Pose, z_mm: float) -> None:
        """Lower what the cup holds, let go, lift. Raises VacuumStuck when it does not let go."""
        await self.lower(at, z_mm)
        await asyncio.sleep(self.place.dwell_s)
        await self.let_go()
        await self.lift(at)

    async def let_go(self) -> None:
        """Vacuum off, helped by a blow-off pulse."""
        plc, within_s = self.devices.plc, self.place.vacuum_gone_within_s
        await plc.blow_off(self.place.blow_off_s > 0)
        pulse_ends_s = time.monotonic() + self.place.blow_off_s
        try:
            await self._vacuum(False, within_s)
            await asyncio.sleep(pulse_ends_s - time.monotonic())
        except NoAnswer as error:
            pressure_kpa = plc.image.vacuum_kpa
            raise VacuumStuck(
                f"{within_s:g} s after the valve closed the cup still has {pressure_kpa:.1f} kPa"
            ) from error
        finally:
            await plc.blow_off(False)

    async def _vacuum(self, on: bool, within_s: float) -> None:
        """Switch the valve and wait until the vacuum switch agrees."""
        if self.devices.valve is None:
            await self.devices.plc.vacuum(on, within_s=within_s)
            return
        await self.devices.valve.switch(on)
        await self.devices.plc.vacuum_seen(on, within_s=within_s)

    async def lower(self, at: Pose, z_mm: float) -> None:
        """Straight down onto something."""
        await self._go(ways.down(at, z_mm, self.positions, self.motion))

    async def lift(self, at: Pose) -> None:
        """Straight up to the travel height."""
        await self._go([ways.up(at, self.positions, self.motion)])

    def expect_vacuum(self, on: bool, number: int, fault: type[Exception], when: str) -> None:
        """One of the five vacuum checks of a cycle."""
        image = self.devices.plc.image
        if image.vacuum_reached is not on:
            state = "on" if image.vacuum_reached else "off"
            raise fault(f"vacuum check {number}: the switch is {state} {when} ({image.vacuum_kpa:.1f} kPa)")

    async def put_away(self) -> None:
        """A part that hangs on the cup goes to the reject tray."""
        if self.devices.plc.image.vacuum_reached:
            tray = Pose(self.positions.reject.x_mm, self.positions.reject.y_mm, 0.0)
            await self.travel(tray)
            await self.put(tray, self.positions.reject_z_mm)

    async def clear_away(self) -> None:
        """Nothing hangs on the cup, and what stands at the station from before is rejected."""
        await lift_free(self.devices.robot, self.positions.safe_z_mm)
        await self.put_away()
        plc = self.devices.plc
        if plc.image.carrier_clamped and plc.image.carrier_id:
            await plc.release(plc.image.carrier_id, good=False, within_s=COMMAND_WITHIN_S)

    async def _go(self, legs: Sequence[Leg], elbow: Elbow | None = None) -> None:
        await self.devices.robot.move_through(legs, hand=FLAGS[elbow] if elbow else None)


async def lift_free(robot: Robot, safe_z_mm: float) -> None:
    """Straight up to the travel height from wherever the arm stands."""
    here, hand = await robot.posture()
    if here.z_mm > safe_z_mm:
        await robot.move(here._replace(z_mm=safe_z_mm), speed_pct=FREEING_SPEED_PCT, hand=hand or None)


@asynccontextmanager
async def seeing(devices: Devices, recipe: Recipe) -> AsyncIterator[None]:
    """Exposures as in the recipe, and both lights on as long as there is work."""
    for camera, part in ((devices.camera_1, recipe.base), (devices.camera_2, recipe.battery)):
        await camera.configure(exposure_us=part.exposure_us, gain_db=part.gain_db)
    await devices.plc.light(1, True)
    await devices.plc.light(2, True)
    try:
        yield
    finally:
        with suppress(DeviceError):  # a dead link must not hide why the work ended
            await devices.plc.light(1, False)
            await devices.plc.light(2, False)


def commanded(pose: Pose) -> Pose:
    """The pose as a controller of either generation can be told it exactly: to 0.01 mm and 0.01 degrees."""
    return Pose(*(round(number, 2) for number in pose))
