"""What differs from phone model to phone model: the model of recipes/*.toml. Belongs to the process engineer.

The parts themselves, and the frames of all lengths, are in recipe_parts.py.
"""

import hashlib
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from cellctl.recipe_light import RecipeLight, RecipePictures
from cellctl.recipe_parts import Base, Battery
from cellctl.strict_toml import Contradiction, Settings, SettingsError, load

Speed = Annotated[int, Field(ge=1, le=100)]
Wait = Annotated[float, Field(ge=0, le=5)]
Patience = Annotated[float, Field(ge=0.05, le=30)]
RobotZ = Annotated[float, Field(ge=0, le=400)]


class RecipeLimits(Settings):
    """What is still plausible; a unit beyond is rejected, not placed. And what the assembly must keep."""

    hole_radius_tolerance_mm: float = Field(gt=0, le=1, description="Measured hole radius against hole_radius_mm")
    edge_distance_tolerance_mm: float = Field(gt=0, le=1, description="Measured hole to edge against edge_distance_mm")
    squareness_deg: float = Field(gt=0, le=5, description="Corner of the battery against 90 degrees")
    base_offset_mm: float = Field(gt=0, le=5, description="Base against its taught place in mm")
    base_offset_deg: float = Field(gt=0, le=10, description="Base against its taught place in degrees")
    battery_offset_mm: float = Field(gt=0, le=5, description="Battery in the cup against its taught place in mm")
    battery_offset_deg: float = Field(gt=0, le=10, description="Battery in the cup against its taught place in degrees")
    min_contrast: float = Field(ge=1, le=250, description="Smallest step across an edge in grey levels of 255")
    max_blur_px: float = Field(default=3.0, gt=0.5, le=4, description="Largest blur of an outline (sigma) in pixels")
    min_outline: float = Field(default=0.25, ge=0.1, le=1, description="Part of an outline that must fit its shape")
    max_overexposed: float = Field(default=0.3, ge=0, le=1, description="Part of an outline that may be over-exposed")
    max_rival: float = Field(default=0.75, gt=0.3, lt=1, description="Strength of a second outline beside the first")
    max_angle_sd_deg: float = Field(default=0.02, gt=0, le=1, description="Own error of an edge's angle, 1 sigma, deg")
    placement_mm: float = Field(gt=0, le=1, description="Needed accuracy of every corner of the battery in its seat")
    golden_spread_mm: float = Field(
        default=0.03,
        gt=0,
        le=1,
        description="Golden assemblies, from seating to seating and from pair to pair, 1 sigma",
    )
    golden_spread_deg: float = Field(
        default=0.03, gt=0, le=5, description="The same of their angle, 1 sigma in degrees"
    )
    gap_mm: float = Field(gt=0, le=2, description="Nominal gap between battery and seat on each side in mm")
    part_tolerance_mm: float = Field(ge=0, le=1, description="Tolerance of the parts, plus and minus, in mm")

    def contradictions(self) -> Iterator[Contradiction]:
        """The worst pair of parts must still fit, and the needed accuracy must be less than the gap."""
        if self.part_tolerance_mm >= self.gap_mm:
            yield "part_tolerance_mm", f"must be below gap_mm = {self.gap_mm:g}, else the worst parts do not fit"
        if self.placement_mm >= self.gap_mm:
            yield "placement_mm", f"must be below gap_mm = {self.gap_mm:g}"


class Placement(Settings):
    """How sure a placement is: what no picture tells about the parts, and when they are looked at twice."""

    second_look: Literal["never", "when_needed", "always"] = Field(
        default="never",
        description="Look again at the battery's opposite corner and at the second stretch of the base's edge: "
        "when_needed does so when the planned error is beyond aim_mm otherwise",
    )
    aim_mm: float | None = Field(
        default=None,
        gt=0,
        le=1,
        description="What 99 of 100 units should keep at every corner; without it limits.placement_mm",
    )
    base_form_um: float = Field(default=0.0, ge=0, le=20, description="Straightness of the base's edge, 1 sigma in um")
    battery_form_um: float = Field(
        default=0.0, ge=0, le=20, description="Straightness of the battery's edges, 1 sigma in um"
    )
    form_length_mm: float = Field(
        default=3.0, ge=0.5, le=50, description="Over this distance the correlation of the form error falls to 1/e, mm"
    )
    battery_size_sd_mm: float = Field(
        default=0.0, ge=0, le=0.5, description="Spread of the battery's width and height about the drawing, 1 sigma"
    )


class GapLook(Settings):
    """After placing, camera 1 looks at the measured corner of the battery in its seat."""

    when: Literal["never", "every_unit", "every_nth", "low_margin"] = Field(
        default="never",
        description="Which units are looked at; low_margin: those whose predicted p99 comes near limits.placement_mm",
    )
    every_n: int = Field(default=10, ge=2, le=10_000, description="every_nth: one of so many units is looked at")
    margin_mm: float = Field(default=0.01, ge=0, le=1, description="low_margin: as near as this to placement_mm, in mm")
    search_mm: float = Field(
        default=0.3, ge=0.05, le=1, description="How far the seat's corner may be from where base and robot put it, mm"
    )
    limit_mm: float = Field(
        default=0.08, gt=0, le=1, description="A unit is rejected when a corner of its battery is further off, mm"
    )
    limit_deg: float = Field(
        default=0.05, gt=0, le=1, description="A unit is rejected when its battery is turned further, degrees"
    )
    unseen: Literal["reject", "accept"] = Field(
        default="reject", description="What becomes of a unit whose gap was to be looked at and could not be measured"
    )


class DriftWatch(Settings):
    """What is done about a slow change of the cell, which the gaps of many units show."""

    correct_up_to_um: float = Field(
        default=0.0,
        ge=0,
        le=100,
        description="A shift is taken off the next units as long as no corner moves further than this in all, um; "
        "0: it is only reported",
    )


class Motion(Settings):
    """How the robot moves for this part."""

    travel_speed_pct: Speed = Field(description="Speed of free travel in percent of the robot's maximum")
    touch_speed_pct: Speed = Field(description="Speed of the last stretch onto table and seat in percent")
    touch_mm: float | None = Field(
        default=None,
        ge=2,
        le=100,
        description="Length of that last stretch, more than the seat is deep; above it the arm goes down at travel "
        "speed. Without it the whole way down is slow",
    )
    settle_s: float = Field(ge=0, le=2, description="Standing still before each picture and before placing, s")
    approach_mm: float = Field(ge=0, le=10, description="The measuring stops are approached over this last distance")
    approach_deg: float = Field(
        default=0.5, ge=0, le=5, description="... and over this last angle, so that R has no lost motion between stops"
    )

    def contradictions(self) -> Iterator[Contradiction]:
        """Touching is not faster than travelling."""
        if self.touch_speed_pct > self.travel_speed_pct:
            yield "touch_speed_pct", f"must not be above travel_speed_pct = {self.travel_speed_pct}"


class Pick(Settings):
    """Sucking the battery up."""

    touch_z_mm: RobotZ = Field(description="Robot Z where the cup touches the battery on the table (positive down)")
    dwell_s: Wait = Field(description="Standing on the battery with suction on before it is lifted, s")
    vacuum_within_s: Patience = Field(description="The vacuum switch must confirm within this time, s")
    retries: int = Field(ge=0, le=5, description="How often to touch again before the pick has failed")


class PlaceStep(Settings):
    """Putting the battery into its seat."""

    seat_z_mm: RobotZ = Field(description="Robot Z where the battery lies in its seat (positive down)")
    dwell_s: Wait = Field(description="Standing on the seat before the cup lets go, s")
    blow_off_s: float = Field(ge=0, le=2, description="Length of the blow-off pulse, s; 0 = none")
    vacuum_gone_within_s: Patience = Field(description="The vacuum must be gone within this time, s")


class Timing(Settings):
    """How long the cell waits."""

    arrival_within_s: float = Field(ge=0.1, le=3600, description="A base must arrive within this time, s")
    unit_within_s: float = Field(ge=1, le=600, description="One unit must be finished within this time, s")


class Recipe(Settings):
    """One phone model."""

    schema_version: Literal[1] = Field(description="Version of this file's layout: 1")
    model: str = Field(min_length=1, max_length=40, description="Name of the phone model for records and operators")
    description: str = Field(max_length=200, description="One line for the list of recipes")
    cameras: Literal["both", "camera_2_only"] = Field(
        default="both", description="camera_2_only takes the base as taught, for the paper's comparison only"
    )
    base: Base
    battery: Battery
    limits: RecipeLimits
    placement: Placement = Placement()
    gap: GapLook = GapLook()
    drift: DriftWatch = DriftWatch()
    motion: Motion
    pick: Pick
    place: PlaceStep
    timing: Timing
    light: RecipeLight | None = None
    pictures: RecipePictures | None = None

    @property
    def hash(self) -> str:
        """SHA-256 of the content, independent of comments, order and layout of the file."""
        canonical = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(canonical.encode()).hexdigest()

    @property
    def aim_mm(self) -> float:
        """What the looks are planned for: 99 of 100 units keep it at every corner."""
        return self.placement.aim_mm or self.limits.placement_mm

    @property
    def seat_width_mm(self) -> float:
        """Nominal width of the seat: the battery and a gap on each side."""
        return self.battery.width_mm + 2 * self.limits.gap_mm

    @property
    def seat_height_mm(self) -> float:
        """Nominal height of the seat: the battery and a gap on each side."""
        return self.battery.height_mm + 2 * self.limits.gap_mm

    def contradictions(self) -> Iterator[Contradiction]:
        """Seat and features of the base do not overlap; what is accepted is also searched for."""
        yield from self._seat_covers_features()
        if self.aim_mm > self.limits.placement_mm:
            yield "placement.aim_mm", f"must not be above limits.placement_mm = {self.limits.placement_mm:g}"
        if self.gap.when != "never" and self.gap.limit_mm > self.limits.gap_mm:
            yield "gap.limit_mm", f"must not be above limits.gap_mm = {self.limits.gap_mm:g}: there is no more room"
        if self.gap.when == "never" and self.drift.correct_up_to_um > 0:
            yield "drift.correct_up_to_um", 'needs gaps that are looked at, but gap.when = "never"'
        for part, table in (("base", self.base), ("battery", self.battery)):
            for unit in ("mm", "deg"):
                accepted = float(getattr(self.limits, f"{part}_offset_{unit}"))
                searched = float(getattr(table, f"search_{unit}"))
                if accepted > searched:
                    yield f"limits.{part}_offset_{unit}", f"must not be above {part}.search_{unit} = {searched:g}"

    def _seat_covers_features(self) -> Iterator[Contradiction]:
        base, t_rad = self.base, math.radians(self.base.seat_t_deg)
        c, s = math.cos(t_rad), math.sin(t_rad)
        half_x_mm, half_y_mm = self.seat_width_mm / 2, self.seat_height_mm / 2
        hole_x_mm = abs(c * base.seat_x_mm + s * base.seat_y_mm)
        hole_y_mm = abs(c * base.seat_y_mm - s * base.seat_x_mm)
        clear_mm = math.hypot(max(0.0, hole_x_mm - half_x_mm), max(0.0, hole_y_mm - half_y_mm))
        if clear_mm < base.hole_radius_mm:
            yield "base.seat_y_mm", "here the seat covers the camera hole"
        top_mm = base.seat_y_mm + abs(s) * half_x_mm + abs(c) * half_y_mm
        if top_mm > base.edge_distance_mm:
            yield "base.seat_y_mm", f"here the seat reaches y = {top_mm:.2f} mm, beyond the reference edge"


NAME = re.compile(r"[a-z0-9-]+")


def load_recipe(folder: Path, name: str) -> Recipe:
    """The recipe `name` (the file's name without .toml) of a folder. Raises SettingsError."""
    if not NAME.fullmatch(name):
        rule = "must consist of a-z, 0-9 and - only, and is the file's name without .toml"
        raise SettingsError([f"{folder}: recipe name {name!r:.60} {rule}"])
    return load(folder / f"{name}.toml", Recipe)


def list_recipes(folder: Path) -> list[str]:
    """The names of all .toml files of a folder, sorted. A name or a file may still be refused by load_recipe.

    Raises SettingsError when the folder cannot be read.
    """
    try:
        return sorted(entry.stem for entry in folder.iterdir() if entry.suffix == ".toml")
    except OSError as error:
        raise SettingsError([f"{folder}: the folder of recipes cannot be read: {error.strerror}"]) from error
