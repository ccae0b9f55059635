"""The golden assembly of a recipe: its file, and whether it belongs to the calibrations in use."""

import hashlib
import math
from pathlib import Path
from typing import ClassVar, Literal

from pydantic import BaseModel, Field

from cellctl.assembly.views import Deviation
from cellctl.config import CellConfig
from cellctl.faults import NotCalibrated
from cellctl.geometry import Pose
from cellctl.learnt.calibrations import CameraCalibration, read_calibration
from cellctl.learnt.references import CAMERAS, STRICT, Reference
from cellctl.recipe import Recipe


class TaughtEdge(BaseModel):
    """The second look at the golden base."""

    model_config = STRICT
    stop: Pose  # robot_from_tool
    found: Deviation  # how the second stretch of its edge lies against the first one


class TaughtCorner(BaseModel):
    """The second look at the golden battery."""

    model_config = STRICT
    stop: Pose  # robot_from_tool
    found: Pose  # the battery by its opposite corner, seen from the battery by its first one


class Taught(Reference):
    """The golden assembly of one recipe: every unit is placed by its difference from it."""

    newest_schema: ClassVar[int] = 2
    schema_version: Literal[2] = 2
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
    repeats: int = Field(ge=1)  # of each pair
    pairs: int = Field(ge=1)
    spread_mm: float = Field(ge=0)  # sigma per axis of one repeat: the seat's place in the base, within a pair
    spread_deg: float = Field(ge=0)
    between_mm: float | None = Field(ge=0)  # sigma per axis from pair to pair; None with one pair
    between_deg: float | None = Field(ge=0)
    second_edge: TaughtEdge | None = None  # None when the recipe has no such stretch, or never looks again
    second_corner: TaughtCorner | None = None

    @property
    def uncertainty_mm(self) -> float:
        """Sigma per axis of the taught place itself: repeats and pairs averaged."""
        return _of_the_mean(self.spread_mm, self.between_mm, self.pairs, self.repeats)

    @property
    def uncertainty_deg(self) -> float:
        """Sigma of the taught angle itself."""
        return _of_the_mean(self.spread_deg, self.between_deg, self.pairs, self.repeats)

    @staticmethod
    def path(state: Path, recipe: Recipe) -> Path:
        """Where the file is; recipes that look at the same features share it."""
        return state / "taught" / f"{geometry_of(recipe)}.json"

    def keep(self, state: Path, recipe: Recipe) -> Path:
        """Bring it into use; every one that ever was in use stays in the history."""
        path = Taught.path(state, recipe)
        self.save(path.parent / "history" / f"{self.made_at:%Y%m%d-%H%M%S}-{self.id}.json")
        self.save(path)
        return path


def geometry_of(recipe: Recipe) -> str:
    """Hash of all that decides what the cameras measure and where the robot grips."""
    looked_at = recipe.base.model_dump_json() + recipe.battery.model_dump_json()
    return hashlib.sha256(looked_at.encode()).hexdigest()[:12]


def read_taught(
    config: CellConfig, recipe: Recipe, calibrations: tuple[CameraCalibration, CameraCalibration]
) -> Taught:
    """The taught reference in use. Raises NotCalibrated when it does not belong to recipe and calibrations."""
    remedy = f"teach {recipe.model} with `cellctl teach` (also after any change of its [base] or [battery])"
    path = Taught.path(config.paths.state, recipe)
    taught = Taught.read(path, remedy)
    if taught.geometry != geometry_of(recipe):
        raise NotCalibrated(f"{path} is of other features than the recipe's: {remedy}")
    stale = [
        f"it was taught with calibration {was} of {one.camera}, in use is {one.id} of {one.made}"
        for was, one in zip(taught.calibrations, calibrations, strict=True)
        if was != one.id
    ]
    which = f"the golden assembly of {recipe.model} ({taught.made})"
    if stale:
        raise NotCalibrated(f"{which} is stale: {'; '.join(stale)}: {remedy}")
    if recipe.placement.second_look != "never" and not _looked_twice(taught, recipe):
        raise NotCalibrated(f"{which} was taught without second looks: {remedy}")
    return taught


def taught_in_use(config: CellConfig, recipe: Recipe) -> Taught:
    """The same with the calibrations in use. Raises NotCalibrated for whatever is missing or stale, the first first."""
    first, second = (read_calibration(config, camera) for camera in CAMERAS)
    return read_taught(config, recipe, (first, second))


def _looked_twice(taught: Taught, recipe: Recipe) -> bool:
    """Whether the second looks that the recipe may ask for were taught."""
    has_edge = taught.second_edge is not None or recipe.base.second_edge_mm is None
    return has_edge and taught.second_corner is not None


def _of_the_mean(spread: float, between: float | None, pairs: int, repeats: int) -> float:
    return math.sqrt((between or 0.0) ** 2 / pairs + spread**2 / (pairs * repeats))
