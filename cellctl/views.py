"""What each camera should see of a part, and where the part is by what the camera saw. Pure.

A `PlaneMap` takes pixels straight to millimetres: camera 1's map to the tool frame (it travels with the tool),
camera 2's map to the robot frame (it is bolted to the bench). So `tool_from_base` and `robot_from_battery` come
out of one picture each, without a camera frame in millimetres in between.
"""

from collections.abc import Sequence

import numpy as np

from cellctl.calibration.plane_map import PlaneMap
from cellctl.config import CameraConfig
from cellctl.geometry import Mm, Pose, Px, direction_deg
from cellctl.recipe import Base, Battery, Recipe
from cellctl.vision.features import (
    BaseMeasurement,
    BatteryMeasurement,
    Edge,
    ExpectedCircle,
    ExpectedEdge,
    Limits,
    Search,
)

CORNER_SIGNS = {  # of the corner's x and y in the battery frame
    "lower_left": (-1, -1),
    "lower_right": (1, -1),
    "upper_left": (-1, 1),
    "upper_right": (1, 1),
}


def axis_mm(plane: PlaneMap, camera: CameraConfig) -> Mm:
    """The point of the plane that the middle of the picture shows."""
    middle = Px((camera.view_width_px - 1) / 2, (camera.view_height_px - 1) / 2)
    return to_mm(plane, [middle])[0]


def to_px(plane: PlaneMap, points: Sequence[Mm]) -> list[Px]:
    """Where points of the plane appear."""
    return [Px(float(u), float(v)) for u, v in plane.px_from_mm(np.asarray(points, dtype=np.float64))]


def to_mm(plane: PlaneMap, points: Sequence[Px]) -> list[Mm]:
    """Which points of the plane these pixels show."""
    return [Mm(float(x), float(y)) for x, y in plane.mm_from_px(np.asarray(points, dtype=np.float64))]


# -- camera 1: the base -----------------------------------------------------------------------------------


def expect_base(plane: PlaneMap, base: Base, tool_from_base: Pose) -> tuple[ExpectedCircle, ExpectedEdge]:
    """Where hole and reference edge should appear when the base lies like this under the tool."""
    y_mm = base.edge_distance_mm
    inside = Mm((base.edge_from_mm + base.edge_to_mm) / 2, y_mm - 1.0)
    hole, start, end, inner = to_px(
        plane,
        [
            tool_from_base.point(0.0, 0.0),
            tool_from_base.point(base.edge_from_mm, y_mm),
            tool_from_base.point(base.edge_to_mm, y_mm),
            tool_from_base.point(*inside),
        ],
    )
    circle = ExpectedCircle(hole, base.hole_radius_mm / plane.mm_per_px, base.hole == "dark")
    base_is_left = _is_left(start, end, inner)
    edge = ExpectedEdge(start, end, base_is_left == (base.edge_bright_side == "base"))
    return circle, edge


def base_pose(plane: PlaneMap, seen: BaseMeasurement) -> Pose:
    """tool_from_base: origin in the hole, x along the reference edge."""
    hole, start, end = to_mm(plane, [seen.circle.centre, seen.edge.start, seen.edge.end])
    return Pose(hole.x_mm, hole.y_mm, direction_deg(start, end))


# -- camera 2: the battery --------------------------------------------------------------------------------


def corner_mm(battery: Battery) -> Mm:
    """The measured corner in the battery frame."""
    sx, sy = CORNER_SIGNS[battery.corner]
    return Mm(sx * battery.width_mm / 2, sy * battery.height_mm / 2)


def battery_view_mm(battery: Battery) -> Mm:
    """The point of the battery frame that camera 2 centres on."""
    (sx, sy), corner = CORNER_SIGNS[battery.corner], corner_mm(battery)
    return Mm(corner.x_mm - sx * battery.view_x_mm, corner.y_mm - sy * battery.view_y_mm)


def expect_battery(plane: PlaneMap, battery: Battery, robot_from_battery: Pose) -> tuple[ExpectedEdge, ExpectedEdge]:
    """Where the two edges should appear: both start at the corner, the first runs along the width."""
    (sx, sy), corner = CORNER_SIGNS[battery.corner], corner_mm(battery)
    along_x = Mm(corner.x_mm - sx * (battery.edge_skip_mm + battery.edge_x_mm), corner.y_mm)
    along_y = Mm(corner.x_mm, corner.y_mm - sy * (battery.edge_skip_mm + battery.edge_y_mm))
    inside = battery_view_mm(battery)
    start, end_x, end_y, inner = to_px(
        plane, [robot_from_battery.point(*point) for point in (corner, along_x, along_y, inside)]
    )
    is_bright = battery.bright == "battery"
    return (
        ExpectedEdge(start, end_x, _is_left(start, end_x, inner) == is_bright),
        ExpectedEdge(start, end_y, _is_left(start, end_y, inner) == is_bright),
    )


def battery_pose(plane: PlaneMap, battery: Battery, seen: BatteryMeasurement) -> Pose:
    """robot_from_battery: the corner as mark, the longer of the two used edges for the direction.

    One edge alone gives the direction, so that a battery which is not quite square keeps its place against it.
    """
    sx, sy = CORNER_SIGNS[battery.corner]
    edge = direction_edge(battery, seen)
    corner, start, end = to_mm(plane, [seen.corner, edge.start, edge.end])
    along_x = edge is seen.edge_1
    runs_deg = (0.0 if sx < 0 else 180.0) if along_x else (90.0 if sy < 0 else -90.0)
    robot_from_corner = Pose(corner.x_mm, corner.y_mm, direction_deg(start, end) - runs_deg)
    mark = corner_mm(battery)
    return robot_from_corner @ Pose(-mark.x_mm, -mark.y_mm, 0.0)


def direction_edge(battery: Battery, seen: BatteryMeasurement) -> Edge:
    """The edge that gives the battery's direction."""
    return seen.edge_1 if battery.edge_x_mm >= battery.edge_y_mm else seen.edge_2


# -- limits -----------------------------------------------------------------------------------------------


def search_px(plane: PlaneMap, part: Base | Battery) -> Search:
    """How far from its expected place a part is looked for."""
    return Search(part.search_mm / plane.mm_per_px, part.search_deg)


def limits_px(plane: PlaneMap, recipe: Recipe) -> Limits:
    """The recipe's plausibility limits in pixels."""
    limits, px_per_mm = recipe.limits, 1.0 / plane.mm_per_px
    return Limits(
        radius_px=limits.hole_radius_tolerance_mm * px_per_mm,
        hole_to_edge_px=recipe.base.edge_distance_mm * px_per_mm,
        hole_to_edge_tolerance_px=limits.edge_distance_tolerance_mm * px_per_mm,
        squareness_deg=limits.squareness_deg,
        min_contrast=limits.min_contrast,
        corner_skip_px=recipe.battery.edge_skip_mm * px_per_mm,
    )


def _is_left(start: Px, end: Px, point: Px) -> bool:
    """Whether a point is on the left hand of somebody walking start -> end on the screen (v runs down)."""
    return (end.u - start.u) * (point.v - start.v) - (end.v - start.v) * (point.u - start.u) < 0
