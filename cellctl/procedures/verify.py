"""The fast verification of a calibration: a few poses, and the answer whether the camera still stands where it stood.

It clears the mark that a collision or an abort in motion has left. What does not hold is used no more.
"""

import asyncio
import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial

from cellctl.assembly.hand import Hand
from cellctl.calibration.plan import PlanRequest, plan_hand_eye
from cellctl.calibration.scara import Kind, Setup
from cellctl.calibration.verification import Verification, verify
from cellctl.config import CellConfig
from cellctl.control.events import Event
from cellctl.faults import CalibrationFailed
from cellctl.learnt.calibrations import CameraCalibration, read_doubtful
from cellctl.learnt.doubts import raise_doubt, settle_doubt
from cellctl.learnt.references import Eye
from cellctl.procedures.board_looks import BoardLooks
from cellctl.procedures.jobs import Job, Outcome
from cellctl.procedures.rough_look import as_commanded
from cellctl.recipe import Recipe

REQUESTS: dict[Eye, PlanRequest] = {
    "camera-1": PlanRequest(count=5, rotation_deg=30.0),
    # the plate's place on the cup is unknown: more rotation tells it from the camera's, more travel shows a turn
    "camera-2": PlanRequest(count=9, rotation_deg=50.0, travel_mm=5.0, margin_mm=0.3),
}


@dataclass(frozen=True)
class VerificationWork:
    """Work for Execute in Maintenance."""

    config: CellConfig
    camera: Eye
    recipe: Recipe  # for exposure and motion, and the battery whose far corner counts
    hand: Hand
    publish: Callable[[Event], None]
    ends_with_its_unit = False

    @property
    def text(self) -> str:
        """What it does, for people."""
        return f"verification of {self.camera}"

    async def run(self, keep_on: Callable[[], bool]) -> None:
        """Do it. Raises CalibrationFailed when the calibration does not hold."""
        await self.job.run(self._verify)

    @property
    def job(self) -> Job:
        """The job that is told about."""
        return Job("verify", self.recipe, self.hand, self.publish)

    async def _verify(self) -> Outcome:
        calibration = await asyncio.to_thread(read_doubtful, self.config, self.camera)
        looks = BoardLooks(self.config, self.hand, self.job.say)
        async with nullcontext() if self.camera == "camera-1" else looks.plate_on_cup():
            found = await self._look(looks, calibration)
        lever_mm = math.hypot(self.recipe.battery.width_mm, self.recipe.battery.height_mm)
        text = f"{self.camera} has {found.text(lever_mm)} since {calibration.made}"
        self.job.say(f"board seen {found.seen_off_um:.1f} um rms from its place, {found.left_um:.1f} without movement")
        state = self.config.paths.state
        if found.holds(self.config.calibration.max_verify_um, lever_mm):
            await asyncio.to_thread(settle_doubt, state, self.camera, calibration)
            return Outcome(f"{text}: it holds")
        failed = f"{text}, {self.config.calibration.max_verify_um:g} um are allowed"
        await asyncio.to_thread(partial(raise_doubt, state, failed, grave=True, cameras=(self.camera,)))
        raise CalibrationFailed(f"{failed}: {self._remedy(found)}")

    async def _look(self, looks: BoardLooks, calibration: CameraCalibration) -> Verification:
        eye = looks.eye(self.camera)
        kind: Kind = "eye_in_hand" if self.camera == "camera-1" else "eye_to_hand"
        setup = Setup(kind, calibration.plane, calibration.target)
        task = looks.task(eye, setup)
        plan = await asyncio.to_thread(plan_hand_eye, task, REQUESTS[self.camera], looks.noise)
        stops = [as_commanded(stop) for stop in plan.stops]
        dots = await looks.pictures(eye, stops)
        poses = [task.frame(stop) for stop in stops]
        return verify(setup, poses, dots, looks.board.points_mm, eye.picture_px, looks.noise)

    def _remedy(self, found: Verification) -> str:
        if found.board_moved:
            return "the dot board rather than the camera has moved; fix it, then calibrate camera-1 anew"
        return f"look for what has come loose, then calibrate {self.camera} anew and teach"
