"""The calibration that the robot runs by itself: rough look, plan, pictures at the planned poses, solve, gate, keep.

Camera 1 looks at the fixed dot board. For camera 2 the robot takes the dot plate out of its nest and shows it, turns
it once about the tool for the rotation centre, and puts it back. What becomes of the result is in gate.py.
"""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cellctl.assembly.hand import Hand, commanded
from cellctl.calibration.hand_eye import HandEye, solve_hand_eye
from cellctl.calibration.plan import PlanRequest, plan_hand_eye, plan_tool_centre
from cellctl.calibration.problem import Looks
from cellctl.calibration.report import tool_centre_line, tool_centre_text
from cellctl.calibration.scara import Setup
from cellctl.calibration.tool_centre import ToolCentre, solve_tool_centre
from cellctl.config import CellConfig
from cellctl.control.events import Event
from cellctl.faults import CalibrationFailed
from cellctl.learnt.calibrations import read_calibration
from cellctl.mount import Stop
from cellctl.procedures.board_looks import BoardLooks, Eye
from cellctl.procedures.gate import judged, off_centre
from cellctl.procedures.jobs import Job, Outcome
from cellctl.procedures.rough_look import RoughLook, as_commanded
from cellctl.recipe import Recipe

What = Literal["camera-1", "camera-2", "tool"]


@dataclass(frozen=True)
class Calibration:
    """Work for Execute in Maintenance."""

    config: CellConfig
    what: What
    recipe: Recipe  # for exposure and motion
    hand: Hand
    publish: Callable[[Event], None]
    ends_with_its_unit = False

    @property
    def text(self) -> str:
        """What it does, for people."""
        return f"calibration of {self.what}"

    async def run(self, keep_on: Callable[[], bool]) -> None:
        """Do it. Raises CalibrationFailed with the check that failed and its figures."""
        await self.job.run(self._calibrate)

    @property
    def job(self) -> Job:
        """The job that is told about."""
        return Job("calibrate", self.recipe, self.hand, self.publish)

    @property
    def looks(self) -> BoardLooks:
        """How the boards are looked at."""
        return BoardLooks(self.config, self.hand, self.job.say)

    async def _calibrate(self) -> Outcome:
        looks = self.looks
        if self.what == "camera-1":
            return await self._judged(looks.camera_1, await self._hand_eye(looks.camera_1, looks.drawn_1()), None)
        async with looks.plate_on_cup():
            if self.what == "tool":
                return await self._tool_alone()
            result = await self._hand_eye(looks.camera_2, looks.drawn_2())
            centre = await self._tool_centre(result.setup)
        return await self._judged(looks.camera_2, result, centre)

    async def _judged(self, eye: Eye, result: HandEye, centre: ToolCentre | None) -> Outcome:
        controller = str(await self.hand.devices.robot.identity())
        return Outcome(await asyncio.to_thread(judged, self.config, eye.name, controller, result, centre))

    # -- hand-eye ----------------------------------------------------------------------------------------------

    async def _hand_eye(self, eye: Eye, drawn: Setup) -> HandEye:
        """Rough look, plan, pictures, solution."""
        looks, settings = self.looks, self.config.calibration
        task = looks.task(eye, await RoughLook(looks, eye, looks.task(eye, drawn)).setup())
        wish = PlanRequest(count=settings.poses, rotation_deg=settings.rotation_deg)
        plan = await asyncio.to_thread(plan_hand_eye, task, wish, looks.noise)
        self.job.say(f"{eye.name}: {len(plan.stops)} poses planned, {plan.text}")
        stops, below_mm = [as_commanded(stop) for stop in plan.stops], eye.heights_mm(len(plan.stops), settings)
        dots = await looks.pictures(eye, stops, below_mm)
        seen = Looks([task.frame(stop) for stop in stops], dots, np.array(below_mm), looks.scatter(eye, stops))
        lens = eye.config.lens
        return await asyncio.to_thread(
            solve_hand_eye, drawn.kind, seen, looks.board.points_mm, looks.noise, eye.picture_px, lens
        )

    # -- the tool's rotation centre ----------------------------------------------------------------------------

    async def _tool_centre(self, setup: Setup) -> ToolCentre:
        """Pure rotations at one place: the centre that they turn about, against the map's."""
        looks, eye = self.looks, self.looks.camera_2
        poses = [commanded(pose) for pose in plan_tool_centre(looks.task(eye, setup))]
        dots = await looks.pictures(eye, [Stop(pose, eye.mount.elbow) for pose in poses])
        return solve_tool_centre(poses, dots, looks.board.points_mm, setup.plane_map, looks.noise)

    async def _tool_alone(self) -> Outcome:
        """The rotation centre against the calibration of camera 2 that is in use."""
        in_use = await asyncio.to_thread(read_calibration, self.config, "camera-2")
        centre = await self._tool_centre(Setup("eye_to_hand", in_use.plane, in_use.target))
        self.job.table(tool_centre_text(centre, in_use.predicted_sd_um).splitlines())
        if objections := off_centre(self.config, centre):
            raise CalibrationFailed(f"tool: {objections[0]}")
        return Outcome(f"tool: {tool_centre_line(centre)}")
