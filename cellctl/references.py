"""What the cell has learnt about itself: calibrations and taught references, one JSON file each in the state folder.

Written whole or not at all (temporary file, fsync, rename), read strictly; a file that does not belong to this
camera, recipe or calibration is refused with a sentence.
"""

import hashlib
import os
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cellctl.calibration.plane_map import PlaneMap
from cellctl.config import CellConfig
from cellctl.faults import NotCalibrated
from cellctl.geometry import Pose
from cellctl.recipe import Recipe

Eye = Literal["camera-1", "camera-2"]


class Reference(BaseModel):
    """A strict, frozen file of learnt values."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    schema_version: Literal[1] = 1
    made_at: datetime

    @property
    def id(self) -> str:
        """Short content hash; unit records name it."""
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()[:12]

    def save(self, path: Path) -> None:
        """Write durably, whole or not at all."""
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        with part.open("w", encoding="utf-8") as file:
            file.write(self.model_dump_json(indent=1))
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        folder = os.open(path.parent, os.O_DIRECTORY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    @classmethod
    def read(cls, path: Path, remedy: str) -> Self:
        """Raises NotCalibrated with the remedy when there is no such file or it cannot be trusted."""
        try:
            return cls.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            raise NotCalibrated(f"{path} does not exist: {remedy}") from None
        except (OSError, ValidationError) as error:
            first = str(error).splitlines()[0]
            raise NotCalibrated(f"{path} cannot be used ({first}): {remedy}") from None


class CameraCalibration(Reference):
    """Where one camera is and what it makes of millimetres."""

    camera: Eye
    serial: str
    plane: PlaneMap  # px <-> mm: tool frame for camera 1, robot frame for camera 2
    target: Pose  # the dot board: in the robot frame for camera 1, in the tool frame for camera 2
    poses: int
    rotation_spread_deg: float
    rms_px: float
    hold_out_um: float
    predicted_sd_um: float
    note: str  # what cannot be observed
    rotation_centre_um: float | None = None  # camera 2: tool rotation centre against this map

    @staticmethod
    def path(state: Path, camera: Eye) -> Path:
        """Where the file of this camera is."""
        return state / "calibration" / f"{camera}.json"


class Taught(Reference):
    """The golden assembly of one recipe: every unit is placed by its difference from it."""

    recipe: str  # the recipe in use when it was taught
    geometry: str  # hash of what was looked at; a changed part must be taught anew
    calibrations: tuple[str, str]
    look_1: Pose  # robot_from_tool when camera 1 looks
    look_2: Pose  # robot_from_tool when camera 2 looks
    robot_from_base: Pose
    base_from_battery: Pose
    tool_from_battery: Pose
    table_pick: Pose  # robot_from_tool when picking from the table
    robot_from_battery_on_table: Pose
    repeats: int = Field(ge=1)
    spread_mm: float  # sigma per axis of the seat's place in the base, over the repeats
    spread_deg: float

    @staticmethod
    def path(state: Path, recipe: Recipe) -> Path:
        """Where the file is; recipes that look at the same features share it."""
        return state / "taught" / f"{geometry_of(recipe)}.json"


def now() -> datetime:
    """Time stamp of a new reference."""
    return datetime.now(UTC)


def geometry_of(recipe: Recipe) -> str:
    """Hash of all that decides what the cameras measure and where the robot grips."""
    looked_at = recipe.base.model_dump_json() + recipe.battery.model_dump_json()
    return hashlib.sha256(looked_at.encode()).hexdigest()[:12]


def read_calibration(config: CellConfig, camera: Eye) -> CameraCalibration:
    """The calibration in force. Raises NotCalibrated when it is missing, foreign or too old."""
    remedy = f"run `cellctl calibrate {camera}`"
    path = CameraCalibration.path(config.paths.state, camera)
    calibration = CameraCalibration.read(path, remedy)
    serial = config.camera_1.serial if camera == "camera-1" else config.camera_2.serial
    if calibration.serial != serial:
        raise NotCalibrated(f"{path} is of camera {calibration.serial}, the cell has {serial}: {remedy}")
    age_days = (now() - calibration.made_at).total_seconds() / 86400
    if not 0 <= age_days <= config.calibration.max_age_days:
        raise NotCalibrated(
            f"{path} is {age_days:.1f} days old, allowed are {config.calibration.max_age_days:g}: {remedy}"
        )
    return calibration


def read_taught(config: CellConfig, recipe: Recipe, calibrations: tuple[str, str]) -> Taught:
    """The taught reference in force. Raises NotCalibrated when it does not belong to recipe and calibrations."""
    remedy = f"teach {recipe.model} with `cellctl recipe teach` (also after any change of its [base] or [battery])"
    path = Taught.path(config.paths.state, recipe)
    taught = Taught.read(path, remedy)
    if taught.geometry != geometry_of(recipe):
        raise NotCalibrated(f"{path} is of other features than the recipe's: {remedy}")
    if taught.calibrations != calibrations:
        raise NotCalibrated(f"{path} was taught before a camera was calibrated anew: {remedy}")
    return taught
