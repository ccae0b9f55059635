"""Where the tool stands for each look at a part, and whether the robot can get there."""

from collections.abc import Iterator
from functools import partial

from cellctl.assembly.hand import commanded
from cellctl.assembly.seating import view_mm
from cellctl.assembly.views import battery_view_mm
from cellctl.config import CellConfig
from cellctl.geometry import Mm, Pose
from cellctl.mount import OutOfReach
from cellctl.recipe import Recipe
from cellctl.recipe_parts import Base, Battery


def looking_at_base(config: CellConfig, base: Base, axis: Mm) -> Pose:
    """robot_from_tool with the recipe's view point of a base, as drawn, under camera 1's axis (in its mount's frame).

    Raises OutOfReach.
    """
    at = config.positions.station
    view = Pose(at.x_mm, at.y_mm, at.t_deg).point(base.view_x_mm, base.view_y_mm)
    return commanded(config.mount_1.tool_showing(view, axis, 0.0))


def looking_at_battery(battery: Battery, axis: Mm) -> Pose:
    """robot_from_tool with the corner of a battery that is gripped in its middle over camera 2's axis."""
    view = battery_view_mm(battery)
    return commanded(Pose(axis.x_mm - view.x_mm, axis.y_mm - view.y_mm, 0.0))


def looking_at_gap(config: CellConfig, recipe: Recipe, robot_from_base: Pose, axis: Mm) -> Pose:
    """robot_from_tool with a corner of a base's seat under camera 1's axis (in its mount's frame).

    Turned as for the look at the base, so that an error of the camera's place is the same at both. Raises OutOfReach.
    """
    view = robot_from_base.point(*view_mm(recipe))
    return commanded(config.mount_1.tool_showing(view, axis, 0.0))


def out_of_reach(config: CellConfig, recipe: Recipe) -> Iterator[str]:
    """One sentence per look that the recipe may ask for and the robot, as the cell was drawn, cannot take."""
    at, twice = config.positions, recipe.placement.second_look != "never"
    axis_1 = Mm(at.mount_from_camera_1.x_mm, at.mount_from_camera_1.y_mm)
    axis_2 = Mm(at.camera_2.x_mm, at.camera_2.y_mm)
    bases = {"the base": recipe.base}
    batteries = {"the battery": recipe.battery}
    if twice and recipe.base.second_edge_mm is not None:
        bases["the second stretch of the base's edge"] = recipe.base.second_view
    if twice:
        batteries["the battery's opposite corner"] = recipe.battery.diagonal
    looks = {what: partial(looking_at_base, config, base, axis_1) for what, base in bases.items()}
    if recipe.gap.when != "never":
        drawn = Pose(at.station.x_mm, at.station.y_mm, at.station.t_deg)
        looks["the gap between battery and seat"] = partial(looking_at_gap, config, recipe, drawn, axis_1)
    for what, look in looks.items():
        try:
            yield from _beyond(config, what, look())
        except OutOfReach as error:
            yield f"camera 1 cannot look at {what}: {error}"
    for what, battery in batteries.items():
        yield from _beyond(config, what, looking_at_battery(battery, axis_2))


def _beyond(config: CellConfig, what: str, stop: Pose) -> Iterator[str]:
    robot = config.robot
    if not robot.reaches(stop.x_mm, stop.y_mm):
        span = f"{robot.reach_inner_mm:g} to {robot.reach_outer_mm:g} mm from its first axis"
        yield f"to look at {what} the tool must be at ({stop.x_mm:.1f}, {stop.y_mm:.1f}) mm, the robot reaches {span}"
