"""What is true of one cell, whatever it assembles: the model of cell.toml. Belongs to the integrator.

Robot frame: X and Y in mm, Z in mm positive down, angles in degrees counter-clockwise seen from above.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from cellctl.config_arm import ArmSpeeds
from cellctl.config_camera import CameraConfig, RobotCameraConfig
from cellctl.config_plc import PlcConfig
from cellctl.config_pulses import PulseConfig
from cellctl.config_values import FilePath, Serial, ipv4
from cellctl.geometry import Mm
from cellctl.keep_out import Area
from cellctl.mount import Elbow, Mount, OutOfReach
from cellctl.strict_toml import Contradiction, Settings, load
from drivers.link_address import TcpAddress, parse_address

LONGEST_SOCKET_PATH = 107


def _link(text: str) -> str:
    address = parse_address(text)
    if isinstance(address, TcpAddress):
        ipv4(address.host)
    return text


def _fits_a_socket(path: Path) -> Path:
    if len(str(path).encode()) > LONGEST_SOCKET_PATH:
        raise ValueError(f"the path of a socket may have {LONGEST_SOCKET_PATH} bytes at most, this one is {path}")
    return path


PlaneMm = Annotated[float, Field(ge=-1500, le=1500)]
HeightMm = Annotated[float, Field(ge=0, le=400)]
TurnDeg = Annotated[float, Field(ge=-180, le=180)]


def _output(number: int) -> int:
    port, bit = divmod(number, 10)
    if not (2 <= port <= 27 and bit <= 7):
        raise ValueError("must be an output as the pendant names it: 20 to 27, 30 to 37, ... 270 to 277")
    return number


class Paths(Settings):
    """Where files are. Relative paths count from the folder of cell.toml."""

    recipes: FilePath = Field(description="Folder of the recipes")
    state: FilePath = Field(description="Folder of the journal, the unit records and the calibration")
    control_socket: Annotated[FilePath, AfterValidator(_fits_a_socket)] = Field(description="Socket of the commands")
    log: FilePath = Field(description="Folder of the log files")


class KeepOut(Settings):
    """A rectangle of the robot frame that neither arms nor tool may enter on the way through calibration poses."""

    name: str = Field(min_length=1, max_length=60, description="What stands there")
    x_min_mm: PlaneMm = Field(description="Smallest X in mm, half the arm's width included")
    x_max_mm: PlaneMm = Field(description="Largest X in mm")
    y_min_mm: PlaneMm = Field(description="Smallest Y in mm")
    y_max_mm: PlaneMm = Field(description="Largest Y in mm")

    def contradictions(self) -> Iterator[Contradiction]:
        """Limits are in order."""
        for axis in "xy":
            high = getattr(self, f"{axis}_max_mm")
            if getattr(self, f"{axis}_min_mm") >= high:
                yield f"{axis}_min_mm", f"must be below {axis}_max_mm = {high:g}"

    @property
    def area(self) -> Area:
        """The same without its settings."""
        return Area(self.name, self.x_min_mm, self.x_max_mm, self.y_min_mm, self.y_max_mm)


class RobotConfig(Settings):
    """The robot and what it can reach."""

    address: Annotated[str, AfterValidator(_link)] = Field(description="tcp://IPV4:PORT or serial:/dev/NAME")
    dialect: Literal["rcx3", "rcx2"] = Field(
        default="rcx3", description="Generation of the controller: rcx3 (RCX340, RCX320) or rcx2 (RCX240, 14x, 22x)"
    )
    payload_kg: float | None = Field(
        default=None, ge=0, le=20, description="What the arm carries, told to the controller; as it is set without"
    )
    serial: Serial = Field(description="Serial number of the robot, as on its label; another arm is calibrated anew")
    vacuum_output: Annotated[int, AfterValidator(_output)] | None = Field(
        default=None, description="Vacuum valve on this output of the robot (20 is DO20) instead of the PLC's"
    )
    hand: Literal["righty", "lefty"] = Field(description="Hand system that the cell works in")
    arm_1_mm: float = Field(ge=50, le=1000, description="Length of the first arm in mm")
    arm_2_mm: float = Field(ge=50, le=1000, description="Length of the second arm in mm")
    reach_inner_mm: float = Field(ge=0, le=2000, description="Smallest distance of the tool from the first axis in mm")
    reach_outer_mm: float = Field(ge=10, le=2000, description="Largest distance of the tool from the first axis in mm")
    z_min_mm: float = Field(ge=-10, le=400, description="Upper soft limit of Z (positive down) in mm")
    z_max_mm: float = Field(ge=0, le=400, description="Lower soft limit of Z (positive down) in mm")
    r_min_deg: float = Field(ge=-720, le=0, description="Soft limit of R in degrees")
    r_max_deg: float = Field(ge=0, le=720, description="Soft limit of R in degrees")
    repeatability_mm: float = Field(gt=0, le=1, description="Repeatability in X and Y, 3 sigma, in mm")
    repeatability_deg: float = Field(gt=0, le=1, description="Repeatability in R, 3 sigma, in degrees")
    keep_out: list[KeepOut] = Field(default_factory=list, description="Areas where the robot must not calibrate")
    pulses: PulseConfig | None = Field(default=None, description="The controller's pulses, when they are known")
    speeds: ArmSpeeds = Field(default=ArmSpeeds(), description="How quick the arm is, for predicting times")

    def contradictions(self) -> Iterator[Contradiction]:
        """Limits are in order, and the reach is one that these arms can have."""
        for low, high in (("z_min_mm", "z_max_mm"), ("reach_inner_mm", "reach_outer_mm")):
            if getattr(self, low) >= getattr(self, high):
                yield low, f"must be below {high} = {getattr(self, high):g}"
        if self.reach_outer_mm > self.arm_1_mm + self.arm_2_mm:
            yield "reach_outer_mm", f"both arms together are only {self.arm_1_mm + self.arm_2_mm:g} mm long"
        if self.reach_inner_mm < abs(self.arm_1_mm - self.arm_2_mm):
            yield "reach_inner_mm", f"folded arms still reach {abs(self.arm_1_mm - self.arm_2_mm):g} mm"

    @property
    def step(self) -> float:
        """How coarsely, in mm and degrees, a place is told; 0.001 of the newer generation counts as nothing."""
        return 0.01 if self.dialect == "rcx2" else 0.0

    def reaches(self, x_mm: float, y_mm: float) -> bool:
        """Whether the tool can stand at X, Y."""
        return self.reach_inner_mm <= math.hypot(x_mm, y_mm) <= self.reach_outer_mm


class PointXy(Settings):
    """A point in the plane of the robot frame, or of another frame where the key says so."""

    x_mm: PlaneMm = Field(description="X in mm")
    y_mm: PlaneMm = Field(description="Y in mm")


class PlaceXyt(PointXy):
    """A point and a direction."""

    t_deg: TurnDeg = Field(description="Direction in degrees, counter-clockwise from above")


class Positions(Settings):
    """Nominal places, as the cell was built; calibration and teaching refine them."""

    safe_z_mm: HeightMm = Field(description="Robot Z of all travel (positive down)")
    station: PlaceXyt = Field(description="Base frame of a base that lies as drawn")
    mount_from_camera_1: PlaceXyt = Field(
        description="Axis and picture's u direction of camera 1 in the frame of its mount: origin on the tool's axis, "
        "x along the second arm (arm_2) or along the tool at R = 0"
    )
    camera_1_z_mm: HeightMm = Field(description="Robot Z at which camera 1 is in focus")
    camera_2: PointXy = Field(description="Axis of camera 2 in the robot frame")
    camera_2_z_mm: HeightMm = Field(description="Robot Z at which a held battery is in focus of camera 2")
    table: PlaceXyt = Field(description="Battery frame of a battery that lies on the table as drawn")
    board: PlaceXyt = Field(description="Frame of the fixed dot board for camera 1 (origin = large dot)")
    nest: PlaceXyt = Field(description="Frame of the dot plate for camera 2 while it lies in its nest")
    nest_z_mm: HeightMm = Field(description="Robot Z where the cup touches the dot plate in its nest")
    reject: PointXy = Field(description="Where rejected batteries are dropped")
    reject_z_mm: HeightMm = Field(description="Robot Z where a rejected battery is let go")

    def contradictions(self) -> Iterator[Contradiction]:
        """Travel is above every place where the arm works."""
        for key in ("camera_1_z_mm", "camera_2_z_mm", "nest_z_mm", "reject_z_mm"):
            if getattr(self, key) < self.safe_z_mm:
                yield key, f"lies above safe_z_mm = {self.safe_z_mm:g} (Z is positive down)"


class Board(Settings):
    """The dot boards of both cameras: dark dots on bright ground, one corner dot larger."""

    columns: int = Field(ge=3, le=100, description="Dots along x")
    rows: int = Field(ge=3, le=100, description="Dots along y")
    pitch_mm: float = Field(ge=0.2, le=20, description="Distance of neighbouring dots in mm")
    dot_mm: float = Field(ge=0.05, le=19, description="Diameter of a dot in mm")
    origin_dot_mm: float = Field(ge=0.05, le=19, description="Diameter of the larger dot (0, 0) in mm")

    def contradictions(self) -> Iterator[Contradiction]:
        """The origin dot is larger than the others, and neighbours do not touch."""
        if self.origin_dot_mm < 1.2 * self.dot_mm:
            yield "origin_dot_mm", f"must be at least 1.2 x dot_mm = {1.2 * self.dot_mm:g} to be told apart"
        if (self.origin_dot_mm + self.dot_mm) / 2 >= self.pitch_mm:
            yield "pitch_mm", "the large dot and its neighbour touch"


class CalibrationConfig(Settings):
    """How the cameras are calibrated and how good that must be."""

    poses: int = Field(ge=6, le=200, description="Robot poses per camera")
    rotation_deg: float = Field(ge=5, le=170, description="Poses turn R by up to so much to either side, degrees")
    height_span_mm: float = Field(
        ge=0,
        le=4,
        description="Pictures cover so much of robot Z about focus, so that a tilt shows; 0 = one Z",
    )
    max_age_days: float = Field(gt=0, le=3650, description="An older calibration is refused")
    max_hold_out_um: float = Field(gt=0, le=1000, description="Largest error at poses left out of the fit, in um")
    max_rms_px: float = Field(gt=0, le=2, description="Largest residual of the dots, rms in px")
    max_absolute_um: float = Field(gt=0, le=1000, description="Largest predicted absolute error, 1 sigma in um")
    max_differential_um: float = Field(
        gt=0, le=100, description="Largest predicted error of differences, 1 sigma in um"
    )
    max_robot_factor: float = Field(ge=1, le=10, description="Largest scatter of the robot over its repeatability")
    max_tool_centre_um: float = Field(gt=0, le=1000, description="Tool's rotation centre, by turning against by map")
    max_verify_um: float = Field(gt=0, le=1000, description="A verified camera may have moved a part by so much, in um")
    max_temperature_change_k: float = Field(
        gt=0, le=50, description="Change since the calibration that is allowed, in K"
    )
    temperature_valid_h: float = Field(gt=0, le=168, description="An entered temperature is believed for so many hours")
    after_abort: Literal["warn", "verify"] = Field(
        description="After an abort in motion: say that the calibrations are to be verified, or insist on it"
    )


class WatchdogConfig(Settings):
    """When systemd is told that the daemon is alive."""

    progress_within_s: float = Field(
        ge=0.1, le=1.5, description="Every critical task must move on within this time; below the unit's WatchdogSec"
    )


class LogConfig(Settings):
    """What is written to the log."""

    level: Literal["debug", "info", "warning", "error"] = Field(description="Least weight that is logged")
    rotate_mb: float = Field(ge=0.1, le=1000, description="A log file is put aside at this size in MB")
    keep: int = Field(ge=1, le=1000, description="How many old log files are kept")


class CellConfig(Settings):
    """One cell."""

    schema_version: Literal[1] = Field(description="Version of this file's layout: 1")
    name: str = Field(min_length=1, max_length=60, description="Name of the cell for operators and records")
    paths: Paths
    plc: PlcConfig
    robot: RobotConfig
    camera_1: RobotCameraConfig
    camera_2: CameraConfig
    positions: Positions
    board: Board
    calibration: CalibrationConfig
    watchdog: WatchdogConfig
    log: LogConfig

    @property
    def addresses(self) -> list[str]:
        """The IPv4 addresses that the cell talks to; what is on a serial port, or no network camera, has none."""
        robot = parse_address(self.robot.address)
        cameras = [camera.address for camera in (self.camera_1, self.camera_2) if camera.driver == "gige"]
        hosts = [self.plc.host, *cameras]
        return hosts + ([robot.host] if isinstance(robot, TcpAddress) else [])

    def contradictions(self) -> Iterator[Contradiction]:
        """The robot reaches every place, the cameras differ, and the dot board fits into both views."""
        yield from self._out_of_reach()
        for key in ("address", "serial"):
            if getattr(self.camera_1, key) == getattr(self.camera_2, key):
                yield f"camera_2.{key}", f"is also the {key} of camera_1"
        for camera in ("camera_1", "camera_2"):
            yield from self._board_leaves_view(camera)

    @property
    def mount_1(self) -> Mount:
        """What carries camera 1."""
        robot = self.robot
        return Mount(self.camera_1.mount, robot.arm_1_mm, robot.arm_2_mm, robot.hand)

    def _out_of_reach(self) -> Iterator[Contradiction]:
        robot, at = self.robot, self.positions
        for key in ("station", "board"):
            yield from self._camera_1_over(key)
        for key in ("camera_2", "table", "nest", "reject"):
            yield from self._tool_at(key, getattr(at, key).x_mm, getattr(at, key).y_mm)
        if self.camera_1.mount == "arm_2" and at.camera_1_z_mm != at.safe_z_mm:
            yield (
                "positions.camera_1_z_mm",
                f"camera 1 on the second arm needs no own Z: use safe_z_mm = {at.safe_z_mm:g}",
            )
        for key in ("safe_z_mm", "camera_1_z_mm", "camera_2_z_mm", "nest_z_mm", "reject_z_mm"):
            if not robot.z_min_mm <= getattr(at, key) <= robot.z_max_mm:
                yield f"positions.{key}", f"the robot's Z goes from {robot.z_min_mm:g} to {robot.z_max_mm:g} mm"

    def _camera_1_over(self, key: str) -> Iterator[Contradiction]:
        """On the second arm it must come over its board with the elbow on either side: nothing else turns it."""
        at, axis = getattr(self.positions, key), self.positions.mount_from_camera_1
        both: tuple[Elbow, ...] = ("righty", "lefty")
        for elbow in both if (self.camera_1.mount, key) == ("arm_2", "board") else (self.robot.hand,):
            try:
                tool = self.mount_1.tool_showing(Mm(at.x_mm, at.y_mm), Mm(axis.x_mm, axis.y_mm), 0.0, elbow)
            except OutOfReach as error:
                yield f"positions.{key}", str(error)
                return
            yield from self._tool_at(key, tool.x_mm, tool.y_mm)

    def _tool_at(self, key: str, x_mm: float, y_mm: float) -> Iterator[Contradiction]:
        if not self.robot.reaches(x_mm, y_mm):
            span = f"{self.robot.reach_inner_mm:g} to {self.robot.reach_outer_mm:g} mm"
            far_mm = math.hypot(x_mm, y_mm)
            yield (
                f"positions.{key}",
                f"the tool would be {far_mm:.1f} mm from the first axis, the robot reaches {span}",
            )

    def _board_leaves_view(self, name: str) -> Iterator[Contradiction]:
        camera: CameraConfig = getattr(self, name)
        for count, pixels in (("columns", camera.view_width_px), ("rows", camera.view_height_px)):
            board_mm = (getattr(self.board, count) - 1) * self.board.pitch_mm + self.board.origin_dot_mm
            view_mm = pixels * camera.mm_per_px
            if board_mm > view_mm:
                yield f"board.{count}", f"the board is {board_mm:g} mm long, {name} sees {view_mm:.2f} mm"


def load_config(path: Path) -> CellConfig:
    """Read cell.toml; its relative paths are made absolute. Raises SettingsError."""
    return load(path, CellConfig)
