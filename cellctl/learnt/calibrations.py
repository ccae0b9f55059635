"""The calibration of one camera: its file, and whether it may be used here and now."""

from pathlib import Path
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, model_validator

from cellctl.calibration.plane_map import PlaneMap
from cellctl.config import CellConfig
from cellctl.config_camera import CameraConfig
from cellctl.faults import NotCalibrated
from cellctl.geometry import Pose, Px
from cellctl.learnt.doubts import doubt_about, temperature_now
from cellctl.learnt.references import STRICT, Eye, Reference, now
from drivers.camera import Region

Square = tuple[tuple[float, ...], ...]
ASYMMETRY = 1e-6  # of a correlation, from rounding
CLOCK_SLACK_DAYS = 1 / 1440  # a clock that was set back by a minute is no reason to stand still


class ToolFigures(BaseModel):
    """The tool's rotation centre and the run-out of what it holds, from pure rotations over camera 2."""

    model_config = STRICT
    centre_px: Px
    map_dx_um: float  # centre by the hand-eye map minus the robot's X, Y
    map_dy_um: float
    centre_covariance_um2: Square
    eccentricity_mm: tuple[float, float]  # middle of the held plate about the R axis, tool frame at R = 0
    eccentricity_covariance_um2: Square
    wobble_rms_um: float  # distance of the plate's middle from its circle
    wobble_worst_um: float


class CameraCalibration(Reference):
    """Where one camera is, what it makes of millimetres, and how well that is known."""

    newest_schema: ClassVar[int] = 3
    schema_version: Literal[3] = 3
    camera: Eye
    serial: str
    view: tuple[int, int, int, int]  # left, top, width and height of the picture on the sensor, px
    mount: Literal["tool", "arm_2", "bench"]
    robot_serial: str  # as in cell.toml
    robot_controller: str  # what the controller said of itself
    plane: PlaneMap  # px <-> mm: frame of the mount for camera 1, robot frame for camera 2
    target: Pose  # the dot board: in the robot frame for camera 1, in the tool frame for camera 2
    poses: int
    rotation_spread_deg: float
    rms_px: float
    hold_out_um: float
    predicted_sd_um: float  # absolute, at the picture's middle
    predicted_differential_um: float  # of differences from a taught part
    slope_px_per_mm: tuple[float, float]  # shift of the picture per mm of robot Z
    robot_factor: float  # scatter of the robot over what its data sheet says
    note: str  # what cannot be observed
    parameters: tuple[str, ...]
    covariance: Square  # of the parameters
    temperature_c: float | None = None
    tool: ToolFigures | None = None  # camera 2
    objections: tuple[str, ...] = ()  # why it did not pass the gate

    @model_validator(mode="after")
    def _covariance_is_one(self) -> Self:
        count = len(self.parameters)
        if len(self.covariance) != count or any(len(row) != count for row in self.covariance):
            raise ValueError(f"covariance must be {count} x {count}, one row per parameter")
        matrix, variances = self.covariance_array, np.diag(self.covariance_array)
        sd = np.sqrt(np.maximum(variances, 0.0))
        if (variances < 0).any() or (np.abs(matrix - matrix.T) > ASYMMETRY * np.outer(sd, sd)).any():
            raise ValueError("covariance must be symmetric with variances that are not negative")
        return self

    @property
    def covariance_array(self) -> NDArray[np.float64]:
        """Covariance of `parameters`."""
        return np.array(self.covariance, dtype=np.float64)

    @staticmethod
    def path(state: Path, camera: Eye) -> Path:
        """Where the file in use of this camera is."""
        return state / "calibration" / f"{camera}.json"


def read_calibration(config: CellConfig, camera: Eye) -> CameraCalibration:
    """The calibration in use. Raises NotCalibrated when it is missing or may not be used here and now."""
    calibration = read_doubtful(config, camera)
    for objection in (_expired(config, calibration), _doubted(config, calibration)):
        if objection:
            raise NotCalibrated(objection)
    return calibration


def read_doubtful(config: CellConfig, camera: Eye) -> CameraCalibration:
    """The same, expired and doubted or not: what a verification looks at. Raises NotCalibrated."""
    path = CameraCalibration.path(config.paths.state, camera)
    calibration = CameraCalibration.read(path, f"run `cellctl calibrate {camera}`")
    if calibration.camera != camera:
        raise NotCalibrated(f"{path} is of {calibration.camera}: run `cellctl calibrate {camera}`")
    if objection := _foreign(config, calibration):
        raise NotCalibrated(objection)
    return calibration


def camera_config(config: CellConfig, camera: Eye) -> CameraConfig:
    """The camera's table in cell.toml."""
    return config.camera_1 if camera == "camera-1" else config.camera_2


def mount_of(config: CellConfig, camera: Eye) -> Literal["tool", "arm_2", "bench"]:
    """What the camera is fixed to, by cell.toml."""
    return config.camera_1.mount if camera == "camera-1" else "bench"


def caution(config: CellConfig, calibration: CameraCalibration) -> str | None:
    """An event that does not keep a calibration from being used but should be verified. Raises NotCalibrated."""
    doubt = doubt_about(config.paths.state, calibration.camera)
    return doubt.sentence(calibration.camera) if doubt is not None and doubt.about(calibration) else None


def _foreign(config: CellConfig, calibration: CameraCalibration) -> str | None:
    """Not of this camera, robot or mount, or never accepted."""
    camera = calibration.camera
    remedy = f"run `cellctl calibrate {camera}`"
    pairs = (
        ("camera", calibration.serial, camera_config(config, camera).serial),
        ("picture", Region(*calibration.view), camera_config(config, camera).region),
        ("robot", calibration.robot_serial, config.robot.serial),
        ("mount", calibration.mount, mount_of(config, camera)),
    )
    for what, was, now_is in pairs:
        if was != now_is:
            return f"{camera}'s calibration {calibration.id} is of {what} {was}, the cell has {now_is}: {remedy}"
    if calibration.objections:
        return f"{camera}'s calibration {calibration.id} was refused ({calibration.objections[0]}): {remedy}"
    return None


def _expired(config: CellConfig, calibration: CameraCalibration) -> str | None:
    """Too old, of the future, or made at another temperature."""
    settings, camera = config.calibration, calibration.camera
    which, remedy = f"{camera}'s calibration {calibration.id}", f"run `cellctl calibrate {camera}`"
    age_days = (now() - calibration.made_at).total_seconds() / 86400
    if age_days < -CLOCK_SLACK_DAYS:
        return f"{which} is of {calibration.made}, in the future: set the clock right, or {remedy}"
    if age_days > settings.max_age_days:
        return f"{which} is {age_days:.1f} days old, allowed are {settings.max_age_days:g}: {remedy}"
    current_c = temperature_now(config.paths.state, settings.temperature_valid_h)
    if current_c is None or calibration.temperature_c is None:
        return None
    change_k = current_c - calibration.temperature_c
    if abs(change_k) > settings.max_temperature_change_k:
        return (
            f"{which} was made at {calibration.temperature_c:g} C, it is {current_c:g} C now, "
            f"{settings.max_temperature_change_k:g} K of change are allowed: {remedy}"
        )
    return None


def _doubted(config: CellConfig, calibration: CameraCalibration) -> str | None:
    """An event that must be verified first."""
    doubt = doubt_about(config.paths.state, calibration.camera)
    if doubt is None or not (doubt.grave or config.calibration.after_abort == "verify"):
        return None
    return caution(config, calibration)
