"""The hysteresis test: one stop approached from eight sides, and what camera 1 sees of the difference."""

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cellctl.assembly.hand import Hand, commanded
from cellctl.calibration.hysteresis import APPROACHES, USED, Hysteresis, hysteresis, stops_by_board
from cellctl.calibration.scara import Setup
from cellctl.calibration.view import start_pose
from cellctl.config import CellConfig
from cellctl.control.events import Event
from cellctl.faults import NotReady
from cellctl.learnt.calibrations import CameraCalibration, read_calibration
from cellctl.learnt.references import now, write_whole
from cellctl.procedures.board_looks import BoardLooks
from cellctl.procedures.jobs import Job, Outcome
from cellctl.recipe import Recipe

SURE = 3.0  # sigmas from which on a difference is believed; it is the largest of seven
LEAST_BACK_MM, LEAST_BACK_DEG = 0.5, 0.2  # a test from nearer would not take up the lost motion


@dataclass(frozen=True)
class HysteresisTest:
    """Work for Execute in Maintenance."""

    config: CellConfig
    recipe: Recipe  # for exposure and motion, and the battery whose far corner counts
    hand: Hand
    repeats: int  # of every approach
    publish: Callable[[Event], None]
    ends_with_its_unit = False

    @property
    def text(self) -> str:
        """What it does, for people."""
        return "hysteresis test"

    async def run(self, keep_on: Callable[[], bool]) -> None:
        """Do it; nothing is judged."""
        await self.job.run(self._test)

    @property
    def job(self) -> Job:
        """The job that is told about."""
        return Job("hysteresis", self.recipe, self.hand, self.publish)

    async def _test(self) -> Outcome:
        if self.config.camera_1.mount != "tool":
            raise NotReady("the hysteresis test needs camera 1 on the tool: from elsewhere it does not see R")
        calibration = await asyncio.to_thread(read_calibration, self.config, "camera-1")
        found = await self._measured(calibration)
        rows = found.table()
        self.job.table(rows)
        text = self._verdict(found)
        path = self.config.paths.state / "calibration" / f"hysteresis-{now():%Y%m%d-%H%M%S}.txt"
        await asyncio.to_thread(write_whole, path, "\n".join([*rows, text, ""]).encode())
        lever_mm = self._lever_mm
        return Outcome(text, {"file": str(path), "worst_um": found.worst(lever_mm)[1]})

    async def _measured(self, calibration: CameraCalibration) -> Hysteresis:
        looks, motion = BoardLooks(self.config, self.hand, self.job.say), self.recipe.motion
        eye = looks.camera_1
        setup = Setup("eye_in_hand", calibration.plane, calibration.target)
        at = commanded(start_pose(setup, looks.board, eye.picture_px))
        back = max(motion.approach_mm, LEAST_BACK_MM), max(motion.approach_deg, LEAST_BACK_DEG)
        order = [approach for _ in range(self.repeats) for approach in APPROACHES]
        dots = []
        for number, approach in enumerate(order, 1):
            await self.hand.stop_from(commanded(approach.start(at, *back)), at, eye.z_mm)
            dots.append(await looks.dots_here(eye, f"stop {number} of {len(order)}, from {approach.text}"))
        stops = stops_by_board(calibration.plane, calibration.target, np.stack(dots), looks.board.points_mm)
        return hysteresis(order, stops)

    @property
    def _lever_mm(self) -> float:
        """From the tool's axis, which grips the battery in its middle, to a corner."""
        return math.hypot(self.recipe.battery.width_mm, self.recipe.battery.height_mm) / 2

    def _verdict(self, found: Hysteresis) -> str:
        approach, worst_um = found.worst(self._lever_mm)
        sides = f"a stop approached from {approach.text} instead of {USED.text}"
        sd_um = found.worst_sd_um(self._lever_mm)
        by = f"{worst_um:.1f} um +-{sd_um:.1f}"
        if worst_um <= SURE * sd_um:
            corners = f"at the corners of {self.recipe.model}'s battery"
            return f"no lost motion that this test can tell from the robot's scatter: at most {by} {corners}"
        return (
            f"{sides} moves the corners of {self.recipe.model}'s battery by {by}: so much would stops from any side "
            "cost; all measuring stops come from the same one"
        )
