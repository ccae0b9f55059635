"""Looking at the dot boards: camera 1 at the one on the bench, camera 2 at the plate that the robot has from its nest.

Calibration, verification and the hysteresis test all consist of such looks; every stop is approached as the cycle
approaches its own.
"""

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace

import numpy as np

from cellctl.assembly.hand import Hand, commanded
from cellctl.assembly.sight import grab
from cellctl.calibration.board import DotBoard
from cellctl.calibration.dots import find_dots
from cellctl.calibration.errors import CalibrationError
from cellctl.calibration.plan import Task
from cellctl.calibration.scara import FloatArray, Noise, Setup
from cellctl.calibration.view import drawn_setup
from cellctl.config import CalibrationConfig, CellConfig
from cellctl.config_camera import CameraConfig
from cellctl.faults import BatteryLost, CellError
from cellctl.geometry import Pose
from cellctl.learnt.references import Eye as EyeName
from cellctl.mount import FLAGS, Mount, Stop
from drivers.camera import Camera
from drivers.errors import FrameLost
from drivers.robot import Point


@dataclass(frozen=True)
class Eye:
    """One camera: the device, its settings, and the height at which it is in focus."""

    name: EyeName
    camera: Camera
    config: CameraConfig
    mirrored: bool  # it looks down at the plane
    z_mm: float
    mount: Mount  # what moves it against its board, or its board against it

    @property
    def picture_px(self) -> tuple[int, int]:
        """Width and height."""
        return self.config.view_width_px, self.config.view_height_px

    def heights_mm(self, count: int, settings: CalibrationConfig) -> list[float]:
        """How far below its height each of so many pictures is taken; a camera on the second arm has one height."""
        if self.mount.part == "arm_2":
            return [0.0] * count
        half_mm = round(settings.height_span_mm / 2, 3)
        return [(0.0, half_mm, -half_mm)[number % 3] for number in range(count)]


@dataclass(frozen=True)
class BoardLooks:
    """Both cameras, their boards, and the arm that moves one against the other."""

    config: CellConfig
    hand: Hand
    say: Callable[[str], None]

    @property
    def board(self) -> DotBoard:
        """The dot board of both cameras."""
        board = self.config.board
        return DotBoard(board.columns, board.rows, board.pitch_mm, board.dot_mm, board.origin_dot_mm)

    @property
    def noise(self) -> Noise:
        """What the robot's data sheet says, as one sigma."""
        robot = self.config.robot
        return Noise(robot.repeatability_mm / 3, robot.repeatability_deg / 3)

    def scatter(self, eye: Eye, stops: Sequence[Stop]) -> FloatArray:
        """What the robot's standard errors do to what moves the camera or its board, (n, 3, 3)."""
        return eye.mount.scatter(stops, self.noise.robot_sd_mm, self.noise.robot_sd_deg)

    def reaches(self, stop: Stop) -> bool:
        """Whether the robot may stop there, coming from the side from which it always comes."""
        limits, flag = self.hand.devices.robot.limits, FLAGS[stop.elbow]
        both = stop.tool, self.hand.before(stop.tool)
        points = [Point(at.x_mm, at.y_mm, self.config.positions.safe_z_mm, at.t_deg) for at in both]
        return not any(limits.objection(point, hand=flag) for point in points)

    def task(self, eye: Eye, setup: Setup) -> Task:
        """What a plan is made for: this camera as it is believed to stand."""
        areas = [one.area for one in self.config.robot.keep_out]
        return Task(setup, self.board, eye.picture_px, eye.mount, self.reaches, areas, eye.config.lens)

    # -- the two cameras as drawn ------------------------------------------------------------------------------

    def eye(self, name: EyeName) -> Eye:
        """The camera of this name."""
        return self.camera_1 if name == "camera-1" else self.camera_2

    @property
    def camera_1(self) -> Eye:
        """On the robot, looking down."""
        config = self.config
        at_z_mm, mount = config.positions.camera_1_z_mm, config.mount_1
        return Eye("camera-1", self.hand.devices.camera_1, config.camera_1, True, at_z_mm, mount)

    @property
    def camera_2(self) -> Eye:
        """On the bench, looking up."""
        config = self.config
        at_z_mm, mount = config.positions.camera_2_z_mm, replace(config.mount_1, part="tool")
        return Eye("camera-2", self.hand.devices.camera_2, config.camera_2, False, at_z_mm, mount)

    def drawn_1(self) -> Setup:
        """Camera 1 and its board as the cell was drawn."""
        at, board = self.config.positions.mount_from_camera_1, self.config.positions.board
        return drawn_setup(
            "eye_in_hand",
            camera=Pose(at.x_mm, at.y_mm, at.t_deg),
            mirrored=True,
            px_per_mm=1.0 / self.config.camera_1.mm_per_px,
            board=Pose(board.x_mm, board.y_mm, board.t_deg),
            picture_px=self.camera_1.picture_px,
        )

    def drawn_2(self) -> Setup:
        """Camera 2 and a plate that is gripped in its middle, as the cell was drawn."""
        at, (x_mm, y_mm) = self.config.positions.camera_2, self.board.centre_mm.tolist()
        return drawn_setup(
            "eye_to_hand",
            camera=Pose(at.x_mm, at.y_mm, 0.0),
            mirrored=False,
            px_per_mm=1.0 / self.config.camera_2.mm_per_px,
            board=Pose(-x_mm, -y_mm, 0.0),
            picture_px=self.camera_2.picture_px,
        )

    # -- looking -----------------------------------------------------------------------------------------------

    async def pictures(self, eye: Eye, stops: Sequence[Stop], below_mm: Sequence[float] | None = None) -> FloatArray:
        """The board's dots (stops, dots, 2) in px, each so far below the camera's height. Raises BoardNotFound."""
        count, below = len(stops), [0.0] * len(stops) if below_mm is None else below_mm
        return np.stack(
            [
                await self.dots(eye, stop, f"pose {number} of {count}", deeper_mm)
                for number, (stop, deeper_mm) in enumerate(zip(stops, below, strict=True), 1)
            ]
        )

    async def dots(self, eye: Eye, stop: Stop, text: str, below_mm: float = 0.0) -> FloatArray:
        """Stop and look: the board's dots (dots, 2) in px. Raises BoardNotFound."""
        await self.hand.stop_at(stop.tool, eye.z_mm + below_mm, stop.elbow)
        return await self.dots_here(eye, text)

    async def dots_here(self, eye: Eye, text: str) -> FloatArray:
        """Look from where the arm stands."""
        frame = await grab(eye.camera)
        self.say(f"{eye.name}: {text}")
        found = await asyncio.to_thread(find_dots, frame.pixels, self.board, mirrored=eye.mirrored)
        return found.centres_px

    # -- the dot plate -----------------------------------------------------------------------------------------

    @asynccontextmanager
    async def plate_on_cup(self) -> AsyncIterator[None]:
        """The robot holds the dot plate; it goes back into its nest unless the arm must stand: abort, device fault."""
        at = self._grip
        await self.hand.stop_at(at)
        await self.hand.suck(at, self.config.positions.nest_z_mm)
        self.hand.expect_vacuum(True, 2, BatteryLost, "after the dot plate was picked")
        try:
            yield
        except (CalibrationError, CellError, FrameLost):
            await self._put_plate_back(at)
            raise
        await self._put_plate_back(at)

    async def _put_plate_back(self, at: Pose) -> None:
        if self.hand.devices.plc.image.vacuum_reached:
            await self.hand.stop_at(at)
            await self.hand.put(at, self.config.positions.nest_z_mm)

    @property
    def _grip(self) -> Pose:
        """Where the tool takes the plate: its middle."""
        nest, (x_mm, y_mm) = self.config.positions.nest, self.board.centre_mm.tolist()
        return commanded(Pose(nest.x_mm, nest.y_mm, nest.t_deg) @ Pose(x_mm, y_mm, 0.0))
