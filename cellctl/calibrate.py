"""The calibration that the robot runs by itself: rough look, plan, pictures at the planned poses, solve, gate, save.

Camera 1 looks at the fixed dot board. For camera 2 the robot takes the dot plate out of its nest and shows it, turns
it once about the tool for the rotation centre, and puts it back. Nothing is saved that has not passed the gate.
"""

import asyncio
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from cellctl.calibration.board import DotBoard
from cellctl.calibration.dots import find_dots
from cellctl.calibration.errors import CalibrationError
from cellctl.calibration.hand_eye import HandEye, solve_hand_eye
from cellctl.calibration.plan import PlanRequest, plan_hand_eye, plan_tool_centre
from cellctl.calibration.report import Acceptance, report_picture, report_text, shortcomings, tool_centre_text
from cellctl.calibration.rough import rough_setup, rough_steps
from cellctl.calibration.scara import FloatArray, Noise, Setup
from cellctl.calibration.tool_centre import ToolCentre, solve_tool_centre
from cellctl.calibration.view import drawn_setup, start_pose
from cellctl.config import CameraConfig, CellConfig
from cellctl.events import Event, job_event, progress_event
from cellctl.faults import BatteryLost, CalibrationFailed, CellError
from cellctl.geometry import Pose
from cellctl.hand import Hand, commanded, seeing
from cellctl.log import log
from cellctl.recipe import Recipe
from cellctl.references import CameraCalibration, now, read_calibration
from cellctl.sight import grab
from drivers.camera import Camera
from drivers.errors import DeviceError

What = Literal["camera-1", "camera-2", "tool"]


@dataclass(frozen=True)
class Eye:
    """One camera to calibrate: how it is mounted, the device, and the height at which it is in focus."""

    name: Literal["camera-1", "camera-2"]
    camera: Camera
    config: CameraConfig
    mirrored: bool  # it looks down at the plane
    z_mm: float

    @property
    def picture_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.config.view_width_px, self.config.view_height_px


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
        try:
            async with seeing(self.hand.devices, self.recipe):
                await self.hand.clear_away()
                text = await self._run()
        except CalibrationError as error:
            self.publish(job_event("calibrate", False, str(error)))
            raise CalibrationFailed(f"{self.what}: {error}") from error
        except (CellError, DeviceError) as error:
            self.publish(job_event("calibrate", False, str(error)))
            raise
        log.info(text)
        self.publish(job_event("calibrate", True, text))

    async def _run(self) -> str:
        if self.what == "camera-1":
            return await self._passed(self.camera_1, await self._hand_eye(self.camera_1, self._drawn_1()))
        await self._take_plate()
        try:
            return await self._with_plate()
        finally:
            await self._return_plate()

    async def _with_plate(self) -> str:
        """Camera 2 and the rotation centre, or the rotation centre alone against the calibration in force."""
        if self.what == "tool":
            inforce = read_calibration(self.config, "camera-2")
            centre = await self._tool_centre(Setup("eye_to_hand", inforce.plane, inforce.target))
            return f"tool: {_centre_text(centre)}"
        result = await self._hand_eye(self.camera_2, self._drawn_2())
        return await self._passed(self.camera_2, result, await self._tool_centre(result.setup))

    # -- the two cameras as drawn ------------------------------------------------------------------------------

    @property
    def board(self) -> DotBoard:
        """The dot board of both cameras."""
        board = self.config.board
        return DotBoard(board.columns, board.rows, board.pitch_mm, board.dot_mm, board.origin_dot_mm)

    @property
    def camera_1(self) -> Eye:
        """On the tool, looking down."""
        config = self.config
        return Eye("camera-1", self.hand.devices.camera_1, config.camera_1, True, config.positions.camera_1_z_mm)

    @property
    def camera_2(self) -> Eye:
        """On the bench, looking up."""
        config = self.config
        return Eye("camera-2", self.hand.devices.camera_2, config.camera_2, False, config.positions.camera_2_z_mm)

    def _drawn_1(self) -> Setup:
        at, board = self.config.positions.tool_from_camera_1, self.config.positions.board
        return drawn_setup(
            "eye_in_hand",
            camera=Pose(at.x_mm, at.y_mm, 0.0),
            mirrored=True,
            px_per_mm=1.0 / self.config.camera_1.mm_per_px,
            board=Pose(board.x_mm, board.y_mm, board.t_deg),
            picture_px=self.camera_1.picture_px,
        )

    def _drawn_2(self) -> Setup:
        at, (x_mm, y_mm) = self.config.positions.camera_2, self.board.centre_mm.tolist()
        return drawn_setup(
            "eye_to_hand",
            camera=Pose(at.x_mm, at.y_mm, 0.0),
            mirrored=False,
            px_per_mm=1.0 / self.config.camera_2.mm_per_px,
            board=Pose(-x_mm, -y_mm, 0.0),
            picture_px=self.camera_2.picture_px,
        )

    # -- hand-eye ----------------------------------------------------------------------------------------------

    async def _hand_eye(self, eye: Eye, drawn: Setup) -> HandEye:
        """Rough look, plan, pictures, solution."""
        start = commanded(start_pose(drawn, self.board, eye.picture_px))
        first = await self._dots(eye, start, "rough look")
        steps = [commanded(step) for step in rough_steps(drawn, start, first, eye.picture_px)]
        rest = [await self._dots(eye, step, "rough look") for step in steps]
        rough = rough_setup(drawn, [start, *steps], np.stack([first, *rest]), self.board, eye.picture_px)
        wish = PlanRequest(count=self.config.calibration.poses, rotation_deg=self.config.calibration.rotation_deg)
        plan = plan_hand_eye(rough, self.board, eye.picture_px, self._reaches, wish, self.noise)
        self._say(f"{eye.name}: {len(plan.poses)} poses planned, {plan.predicted.absolute_um:.1f} um expected")
        poses = [commanded(pose) for pose in plan.poses]
        dots = await self._pictures(eye, poses)
        return await asyncio.to_thread(
            solve_hand_eye, drawn.kind, poses, dots, self.board.points_mm, self.noise, eye.picture_px
        )

    async def _pictures(self, eye: Eye, poses: Sequence[Pose]) -> FloatArray:
        """The board's dots (poses, dots, 2) in px."""
        count = len(poses)
        return np.stack(
            [await self._dots(eye, pose, f"pose {number} of {count}") for number, pose in enumerate(poses, 1)]
        )

    async def _dots(self, eye: Eye, pose: Pose, text: str) -> FloatArray:
        await self.hand.stop_at(pose, eye.z_mm)
        frame = await grab(eye.camera)
        self._say(f"{eye.name}: {text}")
        found = await asyncio.to_thread(find_dots, frame.pixels, self.board, mirrored=eye.mirrored)
        return found.centres_px

    async def _passed(self, eye: Eye, result: HandEye, centre: ToolCentre | None = None) -> str:
        """Save what has passed the gate, with its report. Raises CalibrationFailed."""
        limits = Acceptance(hold_out_um=self.config.calibration.max_hold_out_um)
        if objections := shortcomings(result, limits):
            raise CalibrationFailed(f"{eye.name}: {'; '.join(objections)}")
        calibration = CameraCalibration(
            made_at=now(),
            camera=eye.name,
            serial=eye.config.serial,
            plane=result.plane_map,
            target=result.board,
            poses=len(result.poses),
            rotation_spread_deg=result.spread.rotation_deg,
            rms_px=result.rms_px,
            hold_out_um=result.hold_out_um,
            predicted_sd_um=result.predicted.absolute_um,
            note=result.note,
            rotation_centre_um=math.hypot(centre.map_dx_um, centre.map_dy_um) if centre else None,
        )
        path = CameraCalibration.path(self.config.paths.state, eye.name)
        await asyncio.to_thread(_save, calibration, path, result, centre)
        brief = f"{eye.name}: rms {result.rms_px:.3f} px, hold-out {result.hold_out_um:.1f} um"
        return f"{brief}, {_centre_text(centre)}" if centre else brief

    # -- the dot plate and the tool's rotation centre ----------------------------------------------------------

    async def _take_plate(self) -> None:
        await self.hand.stop_at(self._grip)
        await self.hand.suck(self._grip, self.config.positions.nest_z_mm)
        self.hand.expect_vacuum(True, 2, BatteryLost, "after the dot plate was picked")

    async def _return_plate(self) -> None:
        if self.hand.devices.plc.image.vacuum_reached:
            await self.hand.stop_at(self._grip)
            await self.hand.put(self._grip, self.config.positions.nest_z_mm)

    @property
    def _grip(self) -> Pose:
        """Where the tool takes the plate: its middle."""
        nest, (x_mm, y_mm) = self.config.positions.nest, self.board.centre_mm.tolist()
        return commanded(Pose(nest.x_mm, nest.y_mm, nest.t_deg) @ Pose(x_mm, y_mm, 0.0))

    async def _tool_centre(self, setup: Setup) -> ToolCentre:
        """Pure rotations at one place: the centre that they turn about, against the map's."""
        eye = self.camera_2
        poses = [commanded(pose) for pose in plan_tool_centre(setup, self.board, eye.picture_px, self._reaches)]
        dots = await self._pictures(eye, poses)
        return solve_tool_centre(poses, dots, self.board.points_mm, setup.plane_map, self.noise)

    # -- small things ------------------------------------------------------------------------------------------

    @property
    def noise(self) -> Noise:
        """What the robot's data sheet says, as one sigma."""
        robot = self.config.robot
        return Noise(robot.repeatability_mm / 3, robot.repeatability_deg / 3)

    def _reaches(self, pose: Pose) -> bool:
        robot = self.config.robot
        return robot.reaches(pose.x_mm, pose.y_mm) and robot.r_min_deg <= pose.t_deg <= robot.r_max_deg

    def _say(self, text: str) -> None:
        self.publish(progress_event("calibrate", text))


def _centre_text(centre: ToolCentre) -> str:
    away_um = math.hypot(centre.map_dx_um, centre.map_dy_um)
    return f"rotation centre {away_um:.1f} um from the map's (+-{centre.sd_um:.1f} um)"


def _save(calibration: CameraCalibration, path: Path, result: HandEye, centre: ToolCentre | None) -> None:
    """The calibration, and beside it its report for people."""
    calibration.save(path)
    report = report_text(result) + (f"\n{tool_centre_text(centre, result)}" if centre else "")
    path.with_suffix(".txt").write_text(report + "\n", encoding="utf-8")
    cv2.imwrite(str(path.with_suffix(".png")), report_picture(result))
