"""What a unit is assembled with, and what is found out about it on its way."""

import asyncio
from dataclasses import dataclass, field
from functools import cached_property

from cellctl.assembly.budget import Budget
from cellctl.assembly.hand import Hand
from cellctl.assembly.seating import Seating
from cellctl.assembly.sight import Sight
from cellctl.config import CellConfig
from cellctl.geometry import Offset, Pose
from cellctl.journal import Journal
from cellctl.learnt.calibrations import CameraCalibration
from cellctl.learnt.taught import Taught
from cellctl.monitoring.drift import Observation
from cellctl.monitoring.light_watch import LightWatch
from cellctl.monitoring.watch import Watch
from cellctl.placement import Prediction
from cellctl.recipe import Recipe
from cellctl.vision import BaseMeasurement, BatteryMeasurement


@dataclass(frozen=True)
class Job:
    """All that decides how a unit is assembled; it does not change while the unit lives."""

    config: CellConfig
    name: str
    recipe: Recipe
    calibrations: tuple[CameraCalibration, CameraCalibration]
    taught: Taught
    hand: Hand
    sight: Sight
    journal: Journal
    watch: Watch
    light: LightWatch

    @cached_property
    def budget(self) -> Budget:
        """How sure poses and placement are."""
        return Budget(self.config, self.recipe, self.calibrations, self.taught)


@dataclass
class Unit:
    """What is found out about one unit on its way."""

    id: str = ""  # given when its base has arrived
    carrier_id: int = 0
    good: bool = False
    recording: asyncio.Task[None] | None = None  # of its one final record
    base: Offset | None = None
    battery: Offset | None = None
    seen_base: BaseMeasurement | None = None
    seen_battery: BatteryMeasurement | None = None
    prediction: Prediction | None = None
    placed_at: Pose | None = None
    seating: Seating | None = None  # how the battery lies, by the look at the gap
    gap_unseen: str | None = None  # why it could not be measured, when the unit was accepted all the same
    observed: Observation | None = None  # what the gap says about the cell
    pictures: list[str] = field(default_factory=list)  # of which cameras, in order: "camera-1-again" is a second look
    waited_for_vision_ms: dict[str, float] = field(default_factory=dict)
    looked_again_ms: dict[str, float] = field(default_factory=dict)  # what the second looks took, by camera
