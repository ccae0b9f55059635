"""The parts of a phone model as a recipe describes them: what the cameras see of them, and what stays in view.

Frames (mm, degrees counter-clockwise seen from above):
base     origin in the centre of the camera hole, x along the reference edge, the edge at y = +edge_distance_mm
seat     origin in the middle of the pocket that takes the battery
battery  origin in the middle of the battery, x along its width, y along its height; at rest parallel to the seat
"""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from cellctl.geometry import Pose
from cellctl.strict_toml import Contradiction, Settings

VIEW_WIDTH_MM = 19.0
VIEW_HEIGHT_MM = 14.25
LEAST_BASELINE_MM = 15.0  # below, a second look knows the angle no better than the first
OPPOSITE = {
    "lower_left": "upper_right",
    "lower_right": "upper_left",
    "upper_left": "lower_right",
    "upper_right": "lower_left",
}

Exposure = Annotated[float, Field(ge=20, le=100_000, description="Exposure time of the picture in microseconds")]
Gain = Annotated[float, Field(ge=0, le=24, description="Gain of the camera in dB; noise grows with it")]
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
    second_edge_from_mm: float | None = Field(
        default=None, ge=-200, le=200, description="Second look: where another stretch of the same edge begins, x in mm"
    )
    second_edge_to_mm: float | None = Field(
        default=None, ge=-200, le=200, description="Second look: where another stretch of the same edge ends, x in mm"
    )
    view_x_mm: float = Field(ge=-15, le=15, description="Point that camera 1 centres on, x in mm")
    view_y_mm: float = Field(ge=-15, le=15, description="Point that camera 1 centres on, y in mm")
    seat_x_mm: float = Field(ge=-200, le=200, description="Middle of the seat, x in mm")
    seat_y_mm: float = Field(ge=-200, le=200, description="Middle of the seat, y in mm")
    seat_t_deg: float = Field(ge=-180, le=180, description="Direction of the seat against the base in degrees")
    search_mm: SearchDistance = Field(description="How far the base may lie from its taught place in mm")
    search_deg: SearchAngle = Field(description="How far the base may be turned from its taught place in degrees")
    exposure_us: Exposure
    gain_db: Gain

    @property
    def seat(self) -> Pose:
        """base_from_seat."""
        return Pose(self.seat_x_mm, self.seat_y_mm, self.seat_t_deg)

    def contradictions(self) -> Iterator[Contradiction]:
        """The used stretch has a length, and all that camera 1 measures stays in its view."""
        if self.edge_to_mm - self.edge_from_mm < 2:
            yield "edge_to_mm", f"must be at least 2 mm above edge_from_mm = {self.edge_from_mm:g}"
        margin = Margin(self.search_mm, self.search_deg)
        x_mm, y_mm = -self.view_x_mm, -self.view_y_mm
        edge_y_mm = y_mm + self.edge_distance_mm
        yield from margin.leaves_view("hole_radius_mm", x_mm, y_mm, self.hole_radius_mm, what="the hole")
        for key in ("edge_from_mm", "edge_to_mm"):
            end_x_mm = x_mm + float(getattr(self, key))
            yield from margin.leaves_view(key, end_x_mm, edge_y_mm, what="this end of the edge")
        yield from self._second_stretch(margin)

    @property
    def second_edge_mm(self) -> tuple[float, float] | None:
        """Where the second stretch of the reference edge begins and ends, x in mm; None when there is none."""
        if self.second_edge_from_mm is None or self.second_edge_to_mm is None:
            return None
        return self.second_edge_from_mm, self.second_edge_to_mm

    @property
    def second_view(self) -> "Base":
        """The base as the second look sees it: centred on the second stretch, as far inside the edge as the first."""
        if self.second_edge_mm is None:
            raise ValueError("the base has no second stretch of edge")
        start_mm, end_mm = self.second_edge_mm
        return self.model_copy(
            update={"edge_from_mm": start_mm, "edge_to_mm": end_mm, "view_x_mm": (start_mm + end_mm) / 2}
        )

    def _second_stretch(self, margin: "Margin") -> Iterator[Contradiction]:
        if self.second_edge_mm is None:
            for key in ("second_edge_from_mm", "second_edge_to_mm"):
                if getattr(self, key) is not None:
                    yield key, "a second stretch needs both second_edge_from_mm and second_edge_to_mm"
            return
        start_mm, end_mm = self.second_edge_mm
        if end_mm - start_mm < 2:
            yield "second_edge_to_mm", f"must be at least 2 mm above second_edge_from_mm = {start_mm:g}"
        apart_mm = abs((start_mm + end_mm) - (self.edge_from_mm + self.edge_to_mm)) / 2
        if apart_mm < LEAST_BASELINE_MM:
            far = f"its middle is {apart_mm:g} mm from that of the first stretch"
            yield "second_edge_from_mm", f"{far}, a second look is worth it from {LEAST_BASELINE_MM:g} mm on"
        half_mm, edge_y_mm = (end_mm - start_mm) / 2, self.edge_distance_mm - self.view_y_mm
        yield from margin.leaves_view("second_edge_to_mm", half_mm, edge_y_mm, what="an end of the second stretch")


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

    @property
    def diagonal(self) -> "Battery":
        """The battery as the second look sees it: by its opposite corner, in the same way."""
        return self.model_copy(update={"corner": OPPOSITE[self.corner]})

    def contradictions(self) -> Iterator[Contradiction]:
        """The used stretches lie on the battery, and all that camera 2 measures stays in its view."""
        margin = Margin(self.search_mm, self.search_deg)
        x_mm, y_mm = -self.view_x_mm, -self.view_y_mm
        end_x_mm, end_y_mm = self.edge_skip_mm + self.edge_x_mm, self.edge_skip_mm + self.edge_y_mm
        yield from margin.leaves_view("view_x_mm", x_mm, y_mm, what="the corner")
        yield from margin.leaves_view("edge_x_mm", x_mm + end_x_mm, y_mm, what="the end of this edge")
        yield from margin.leaves_view("edge_y_mm", x_mm, y_mm + end_y_mm, what="the end of this edge")
        if end_x_mm > self.width_mm:
            yield "edge_x_mm", f"skip and edge make {end_x_mm:g} mm, more than width_mm = {self.width_mm:g}"
        if end_y_mm > self.height_mm:
            yield "edge_y_mm", f"skip and edge make {end_y_mm:g} mm, more than height_mm = {self.height_mm:g}"


class Margin:
    """How far a feature may wander in the picture while it is still within the search."""

    def __init__(self, search_mm: float, search_deg: float) -> None:
        self.search_mm = search_mm
        self.sine = math.sin(math.radians(search_deg))

    def keeps(self, x_mm: float, y_mm: float) -> bool:
        """Whether a feature at (x, y) from the middle of the view stays in it within the search."""
        return not any(self.leaves_view("", x_mm, y_mm, what=""))

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
