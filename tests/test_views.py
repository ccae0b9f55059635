"""What a camera should see of a part, and the part's pose out of it, undo each other; each camera's mirror sense."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellctl.assembly import views
from cellctl.calibration.plane_map import PlaneMap
from cellctl.geometry import Mm, Offset, Pose, Px, turned_about, wrap_deg
from cellctl.recipe import Recipe, load_recipe
from cellctl.recipe_parts import Battery
from cellctl.vision import Appearance, BaseMeasurement, BatteryMeasurement, Circle, Edge
from tests.whole_cell import ROOT

RECIPE: Recipe = load_recipe(ROOT / "recipes", "x85")
PX_PER_MM = 136.36
LOOK = Appearance(1.1, 90.0, 2.5, 40.0, 130.0, 0.0)
SURE = ((1e-4, 0.0), (0.0, 1e-4))


def camera(view: float, turn_deg: float) -> PlaneMap:
    """A telecentric camera: view -1 looks down, +1 looks up."""
    c, s = math.cos(math.radians(turn_deg)) * PX_PER_MM, math.sin(math.radians(turn_deg)) * PX_PER_MM
    return PlaneMap(((c, -s), (view * s, view * c)), (1295.5, 971.5), 1e-10, (1300.0, 960.0))


def edge_of(start: Px, end: Px) -> Edge:
    return Edge(start, end, ((1e-4, 0.0), (0.0, 1e-6)), LOOK, 1.0, 0.1)


cameras = st.builds(camera, st.sampled_from([-1.0, 1.0]), st.floats(-180, 180))
poses = st.builds(Pose, st.floats(-2, 2), st.floats(-2, 2), st.floats(-5, 5))
corners = st.sampled_from(["lower_left", "lower_right", "upper_left", "upper_right"])


@given(cameras, poses)
def test_a_base_seen_where_it_should_be_gives_its_pose(plane: PlaneMap, pose: Pose) -> None:
    circle, edge = views.expect_base(plane, RECIPE.base, pose)
    seen = BaseMeasurement(
        Circle(circle.centre, circle.radius_px, SURE, LOOK, 1.0, 0.1), edge_of(edge.start, edge.end), 0.0
    )
    found = views.base_pose(plane, seen)
    assert found[:2] == pytest.approx(pose[:2], abs=1e-9)
    assert wrap_deg(found.t_deg - pose.t_deg) == pytest.approx(0.0, abs=1e-9)


@given(cameras, poses, corners)
def test_a_battery_seen_where_it_should_be_gives_its_pose(plane: PlaneMap, pose: Pose, corner: str) -> None:
    battery = Battery(**(RECIPE.battery.model_dump() | {"corner": corner}))
    mark = views.corner_mm(battery)
    robot_from_battery = pose @ Pose(-mark.x_mm, -mark.y_mm, 0.0)  # its corner is in view
    first, second = views.expect_battery(plane, battery, robot_from_battery)
    seen = BatteryMeasurement(edge_of(*first[:2]), edge_of(*second[:2]), first.start, SURE, 0.0)
    found = views.battery_pose(plane, battery, seen)
    assert found[:2] == pytest.approx(robot_from_battery[:2], abs=1e-8)
    assert wrap_deg(found.t_deg - pose.t_deg) == pytest.approx(0.0, abs=1e-9)


def test_camera_1_sees_the_base_below_its_edge_as_a_person_looking_down() -> None:
    """The base's material is on the right hand walking along +x, on the screen too."""
    circle, edge = views.expect_base(camera(-1.0, 0.0), RECIPE.base, Pose(0, 0, 0))
    assert edge.start.u < edge.end.u
    assert edge.start.v < circle.centre.v  # the edge is above the hole
    assert not edge.bright_left


def test_camera_2_sees_the_battery_mirrored() -> None:
    """Looking up with u along X and v along Y: the battery's inside lies below its lower edge on the screen."""
    mark = views.corner_mm(RECIPE.battery)
    along_x, along_y = views.expect_battery(camera(1.0, 0.0), RECIPE.battery, Pose(-mark.x_mm, -mark.y_mm, 0.0))
    assert along_x.end.u > along_x.start.u
    assert along_y.end.v > along_y.start.v
    assert not along_x.bright_left  # the battery is on the right hand, walking to the right
    assert along_y.bright_left


@given(cameras, st.floats(-1.0, 1.0), st.floats(0.0, 360.0), st.sampled_from([-1.0, 1.0]))
def test_a_base_that_is_turned_about_its_seat_still_has_its_hole_within_the_search(
    plane: PlaneMap, part_of_it: float, way_deg: float, sense: float
) -> None:
    base = RECIPE.base
    seat, way = Mm(base.seat_x_mm, base.seat_y_mm), math.radians(way_deg)
    off_mm = (base.search_mm * part_of_it * f(way) for f in (math.cos, math.sin))
    moved = turned_about(seat, Offset(*off_mm, sense * base.search_deg))
    search = views.search_px(plane, base)
    expected, shown = (views.expect_base(plane, base, pose)[0].centre for pose in (Pose(0.0, 0.0, 0.0), moved))
    assert math.dist(expected, shown) <= search.position_px * (1.0 + 1e-9)
