"""What each camera should see of a part, and where the part is by what the camera saw. Pure.

A `PlaneMap` takes pixels straight to millimetres: camera 1's map to the tool frame (it travels with the tool),
camera 2's map to the robot frame (it is bolted to the bench). So `tool_from_base` and `robot_from_battery` come
out of one picture each, without a camera frame in millimetres in between.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellctl.calibration.plane_map import PlaneMap
from cellctl.config_camera import CameraConfig
from cellctl.geometry import Mm, Pose, Px, direction_deg
from cellctl.placement import straight_fit
from cellctl.recipe import Recipe
from cellctl.recipe_parts import Base, Battery
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
    hole = to_px(plane, [tool_from_base.point(0.0, 0.0)])[0]
    circle = ExpectedCircle(hole, base.hole_radius_mm / plane.mm_per_px, base.hole == "dark")
    return circle, expect_edge(plane, base, tool_from_base)


def expect_edge(plane: PlaneMap, base: Base, tool_from_base: Pose) -> ExpectedEdge:
    """Where the used stretch of the reference edge should appear."""
    y_mm = base.edge_distance_mm
    inside = Mm((base.edge_from_mm + base.edge_to_mm) / 2, y_mm - 1.0)
    points = (Mm(base.edge_from_mm, y_mm), Mm(base.edge_to_mm, y_mm), inside)
    start, end, inner = to_px(plane, [tool_from_base.point(*point) for point in points])
    base_is_left = is_left(start, end, inner)
    return ExpectedEdge(start, end, base_is_left == (base.edge_bright_side == "base"))


def base_pose(plane: PlaneMap, seen: BaseMeasurement) -> Pose:
    """tool_from_base: origin in the hole, x along the reference edge."""
    hole, start, end = to_mm(plane, [seen.circle.centre, seen.edge.start, seen.edge.end])
    return Pose(hole.x_mm, hole.y_mm, direction_deg(start, end))


class Deviation(NamedTuple):
    """How one stretch of an edge lies against the line of another: along its normal, and turned."""

    offset_mm: float
    turn_rad: float


def second_edge(
    plane: PlaneMap, base: Base, robot_from_base: Pose, edges: tuple[Edge, Edge], mounts: tuple[Pose, Pose]
) -> Deviation:
    """How the second stretch of the reference edge, at its middle, deviates from the line of the first one.

    `edges` are the two stretches as measured, `mounts` where the frame of camera 1's map was at each look
    (robot_from_mount); `robot_from_base` is what the first look gave.
    """
    (_, height_mm), _ = _edge_from(robot_from_base, plane, edges[0], mounts[0])
    (x_mm, y_mm), (end_x_mm, end_y_mm) = _edge_from(robot_from_base, plane, edges[1], mounts[1])
    slope = (end_y_mm - y_mm) / (end_x_mm - x_mm)
    middle_mm = base.second_view.view_x_mm
    return Deviation(y_mm + slope * (middle_mm - x_mm) - height_mm, math.atan(slope))


def _edge_from(robot_from_base: Pose, plane: PlaneMap, edge: Edge, robot_from_mount: Pose) -> tuple[Mm, Mm]:
    """Both ends of a measured edge in the frame of the base."""
    base_from_mount = robot_from_base.inverse() @ robot_from_mount
    start, end = (base_from_mount.point(*point) for point in to_mm(plane, [edge.start, edge.end]))
    return start, end


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
        ExpectedEdge(start, end_x, is_left(start, end_x, inner) == is_bright),
        ExpectedEdge(start, end_y, is_left(start, end_y, inner) == is_bright),
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
    """How far from its expected place a part's mark is looked for: the hole of a base, the corner of a battery.

    A base is judged where its seat is, and a turn about the seat moves the hole.
    """
    lever_mm = math.hypot(part.seat_x_mm, part.seat_y_mm) if isinstance(part, Base) else 0.0
    reach_mm = part.search_mm + lever_mm * math.sin(math.radians(part.search_deg))
    return Search(reach_mm / plane.mm_per_px, part.search_deg)


def limits_px(plane: PlaneMap, recipe: Recipe) -> Limits:
    """The recipe's plausibility limits in pixels."""
    limits, px_per_mm = recipe.limits, 1.0 / plane.mm_per_px
    form_mm, form_deg = _form(recipe)
    return Limits(
        max_residual_px=math.hypot(Limits.max_residual_px, 3.0 * form_mm * px_per_mm),
        max_angle_sd_deg=math.hypot(limits.max_angle_sd_deg, 3.0 * form_deg),
        radius_px=limits.hole_radius_tolerance_mm * px_per_mm,
        hole_to_edge_px=recipe.base.edge_distance_mm * px_per_mm,
        hole_to_edge_tolerance_px=limits.edge_distance_tolerance_mm * px_per_mm,
        squareness_deg=limits.squareness_deg,
        min_contrast=limits.min_contrast,
        max_blur_px=limits.max_blur_px,
        min_inliers=limits.min_outline,
        max_saturated=limits.max_overexposed,
        max_rival=limits.max_rival,
        corner_skip_px=recipe.battery.edge_skip_mm * px_per_mm,
    )


def _form(recipe: Recipe) -> tuple[float, float]:
    """One sigma of the stated form error of edges, mm, and of what it turns the shortest one by, deg."""
    stated, battery, base = recipe.placement, recipe.battery, recipe.base
    form_mm = max(stated.base_form_um, stated.battery_form_um) / 1000
    shortest_mm = min(battery.edge_x_mm, battery.edge_y_mm, base.edge_to_mm - base.edge_from_mm)
    return form_mm, math.degrees(math.sqrt(straight_fit(shortest_mm, form_mm, stated.form_length_mm)[1, 1]))


def is_left(start: Px, end: Px, point: Px) -> bool:
    """Whether a point is on the left hand of somebody walking start -> end on the screen (v runs down)."""
    return (end.u - start.u) * (point.v - start.v) - (end.v - start.v) * (point.u - start.u) < 0
