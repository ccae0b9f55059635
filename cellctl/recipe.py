"""What differs from phone model to phone model: the model of recipes/*.toml. Belongs to the process engineer.

Frames (mm, degrees counter-clockwise seen from above):
base     origin in the centre of the camera hole, x along the reference edge, the edge at y = +edge_distance_mm
seat     origin in the middle of the pocket that takes the battery
battery  origin in the middle of the battery, x along its width, y along its height; at rest parallel to the seat
"""

import hashlib
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from cellctl.strict_toml import Contradiction, Settings, SettingsError, load

VIEW_WIDTH_MM = 19.0
VIEW_HEIGHT_MM = 14.25

Exposure = Annotated[float, Field(ge=20, le=100_000, description="Exposure time of the picture in microseconds")]
Gain = Annotated[float, Field(ge=0, le=24, description="Gain of the camera in dB; noise grows with it")]
Speed = Annotated[int, Field(ge=1, le=100)]
Wait = Annotated[float, Field(ge=0, le=5)]
Patience = Annotated[float, Field(ge=0.05, le=30)]
RobotZ = Annotated[float, Field(ge=0, le=400)]
SearchDistance = Annotated[float, Field(gt=0, le=6)]
SearchAngle = Annotated[float, Field(gt=0, le=10)]


class Base(Settings):
    """The cellphone base and how camera 1 looks at it. All lengths are in the base frame."""

    hole_radius_mm: float = Field(ge=0.3, le=6, description="Radius of the camera hole in mm")
    hole: Literal["dark", "bright"] = Field(description="Is the hole darker or brighter than the base around it")
    edge_distance_mm: float = Field(ge=0.5, le=13, description="Hole centre to reference edge in mm")
    edge_from_mm: float = Field(ge=-19, le=19, description="Where the used stretch of the edge begins, x in mm")
    edge_to_mm: float = Field(ge=-19, le=19, description="Where the used stretch of the edge ends, x in mm")
    edge_bright_side: Literal["base", "outside"] = Field(description="Which side of the edge is the brighter one")
    view_x_mm: float = Field(ge=-15, le=15, description="Point that camera 1 centres on, x in mm")
    view_y_mm: float = Field(ge=-15, le=15, description="Point that camera 1 centres on, y in mm")
    seat_x_mm: float = Field(ge=-200, le=200, description="Middle of the seat, x in mm")
    seat_y_mm: float = Field(ge=-200, le=200, description="Middle of the seat, y in mm")
    seat_t_deg: float = Field(ge=-180, le=180, description="Direction of the seat against the base in degrees")
    search_mm: SearchDistance = Field(description="How far the base may lie from its taught place in mm")
    search_deg: SearchAngle = Field(description="How far the base may be turned from its taught place in degrees")
    exposure_us: Exposure
    gain_db: Gain

    def contradictions(self) -> Iterator[Contradiction]:
        """The used stretch has a length, and all that camera 1 measures stays in its view."""
        if self.edge_to_mm - self.edge_from_mm < 2:
            yield "edge_to_mm", f"must be at least 2 mm above edge_from_mm = {self.edge_from_mm:g}"
        margin = _Margin(self.search_mm, self.search_deg)
        x_mm, y_mm = -self.view_x_mm, -self.view_y_mm
        edge_y_mm = y_mm + self.edge_distance_mm
        yield from margin.leaves_view("hole_radius_mm", x_mm, y_mm, self.hole_radius_mm, what="the hole")
        for key in ("edge_from_mm", "edge_to_mm"):
            end_x_mm = x_mm + float(getattr(self, key))
            yield from margin.leaves_view(key, end_x_mm, edge_y_mm, what="this end of the edge")


class Battery(Settings):
    """The battery and how camera 2 looks at one of its corners."""

    width_mm: float = Field(ge=10, le=200, description="Width of the battery in mm (x of the battery frame)")
    height_mm: float = Field(ge=10, le=200, description="Height of the battery in mm (y of the battery frame)")
    corner: Literal["lower_left", "lower_right", "upper_left", "upper_right"] = Field(
        description="The corner that camera 2 measures, as seen in the battery frame from above"
    )
    edge_skip_mm: float = Field(ge=0, le=8, description="Rounded corner that is left out, mm from the corner")
    edge_x_mm: float = Field(ge=2, le=19, description="Used length of the edge along the width in mm, after the skip")
    edge_y_mm: float = Field(ge=2, le=19, description="Used length of the edge along the height in mm, after the skip")
    bright: Literal["battery", "background"] = Field(description="Which of the two is brighter in the picture")
    view_x_mm: float = Field(ge=-9, le=9, description="How far inside the corner camera 2 looks, along the width, mm")
    view_y_mm: float = Field(ge=-7, le=7, description="How far inside the corner camera 2 looks, along the height, mm")
    search_mm: SearchDistance = Field(description="How far the corner may be from its expected place in mm")
    search_deg: SearchAngle = Field(description="How far the battery may be turned in degrees")
    exposure_us: Exposure
    gain_db: Gain

    def contradictions(self) -> Iterator[Contradiction]:
        """The used stretches lie on the battery, and all that camera 2 measures stays in its view."""
        margin = _Margin(self.search_mm, self.search_deg)
        x_mm, y_mm = -self.view_x_mm, -self.view_y_mm
        end_x_mm, end_y_mm = self.edge_skip_mm + self.edge_x_mm, self.edge_skip_mm + self.edge_y_mm
        yield from margin.leaves_view("view_x_mm", x_mm, y_mm, what="the corner")
        yield from margin.leaves_view("edge_x_mm", x_mm + end_x_mm, y_mm, what="the end of this edge")
        yield from margin.leaves_view("edge_y_mm", x_mm, y_mm + end_y_mm, what="the end of this edge")
        if end_x_mm > self.width_mm:
            yield "edge_x_mm", f"skip and edge make {end_x_mm:g} mm, more than width_mm = {self.width_mm:g}"
        if end_y_mm > self.height_mm:
            yield "edge_y_mm", f"skip and edge make {end_y_mm:g} mm, more than height_mm = {self.height_mm:g}"


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
    placement_mm: float = Field(gt=0, le=1, description="Needed accuracy of every corner of the battery in its seat")
    gap_mm: float = Field(gt=0, le=2, description="Nominal gap between battery and seat on each side in mm")
    part_tolerance_mm: float = Field(ge=0, le=1, description="Tolerance of the parts, plus and minus, in mm")

    def contradictions(self) -> Iterator[Contradiction]:
        """The worst pair of parts must still fit, and the needed accuracy must be less than the gap."""
        if self.part_tolerance_mm >= self.gap_mm:
            yield "part_tolerance_mm", f"must be below gap_mm = {self.gap_mm:g}, else the worst parts do not fit"
        if self.placement_mm >= self.gap_mm:
            yield "placement_mm", f"must be below gap_mm = {self.gap_mm:g}"


class Motion(Settings):
    """How the robot moves for this part."""

    travel_speed_pct: Speed = Field(description="Speed of free travel in percent of the robot's maximum")
    touch_speed_pct: Speed = Field(description="Speed of the last stretch onto table and seat in percent")
    settle_s: float = Field(ge=0, le=2, description="Standing still before each picture and before placing, s")
    approach_mm: float = Field(ge=0, le=10, description="The measuring stops are approached over this last distance")

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
    motion: Motion
    pick: Pick
    place: PlaceStep
    timing: Timing

    @property
    def hash(self) -> str:
        """SHA-256 of the content, independent of comments, order and layout of the file."""
        canonical = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(canonical.encode()).hexdigest()

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


class _Margin:
    """How far a feature may wander in the picture while it is still within the search."""

    def __init__(self, search_mm: float, search_deg: float) -> None:
        self.search_mm = search_mm
        self.sine = math.sin(math.radians(search_deg))

    def leaves_view(
        self, key: str, x_mm: float, y_mm: float, radius_mm: float = 0.0, *, what: str
    ) -> Iterator[Contradiction]:
        """Say so when a feature at (x, y) from the middle of the view can leave it within the search."""
        reach_x_mm = abs(x_mm) + abs(y_mm) * self.sine + radius_mm + self.search_mm
        reach_y_mm = abs(y_mm) + abs(x_mm) * self.sine + radius_mm + self.search_mm
        for axis, reach_mm, half_mm in (("x", reach_x_mm, VIEW_WIDTH_MM / 2), ("y", reach_y_mm, VIEW_HEIGHT_MM / 2)):
            if reach_mm > half_mm:
                far = f"with the search it reaches {reach_mm:.2f} mm in {axis} from its middle, {half_mm:g} mm is seen"
                yield key, f"{what} can leave the camera's view: {far}"


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
