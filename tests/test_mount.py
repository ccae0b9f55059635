"""What carries camera 1, where it looks, and which areas the arm keeps out of."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cellctl.geometry import Mm, Pose
from cellctl.keep_out import Area, touched_at, touched_on_the_way
from cellctl.mount import Elbow, Mount, OutOfReach, Stop
from simulators.scara import Hand, Joints, ToolPose, forward, inverse
from tests.calibration_cells import ARM_2, TOOL

ELBOWS: tuple[Elbow, Elbow] = ("righty", "lefty")
HANDS = {"righty": Hand.RIGHTY, "lefty": Hand.LEFTY}
places = st.builds(
    lambda far, way: Pose(far * math.cos(way), far * math.sin(way), 0.0), st.floats(140, 395), st.floats(-2, 2)
)


@given(places, st.floats(-180, 180), st.sampled_from(ELBOWS))
def test_the_second_arms_frame_is_the_simulated_arms(place, r_deg, elbow):
    tool = place._replace(t_deg=r_deg)
    joints = inverse(ToolPose(*place[:2], 0.0, r_deg), HANDS[elbow])
    frame = ARM_2.frame(tool, elbow)
    assert frame[:2] == tool[:2]
    assert math.remainder(frame.t_deg - joints.j1_deg - joints.j2_deg, 360) == pytest.approx(0, abs=1e-6)
    assert TOOL.frame(tool, elbow) == tool


@given(places, st.floats(-40, 80), st.floats(-40, 40), st.sampled_from(ELBOWS), st.sampled_from([TOOL, ARM_2]))
def test_the_tool_stands_so_that_the_camera_shows_the_point(place, x_mm, y_mm, elbow, mount):
    point, axis = Mm(*place[:2]), Mm(x_mm, y_mm)
    try:
        tool = mount.tool_showing(point, axis, 25.0, elbow)
    except OutOfReach:
        assume(False)
    assert tool.t_deg == 25.0
    assert mount.frame(tool, elbow).point(*axis) == pytest.approx(point, abs=1e-6)


def test_the_second_arm_says_how_far_its_camera_comes():
    with pytest.raises(OutOfReach, match=r"comes 5\.0 to 455\.0 mm far from the first axis, .* is 500\.0 mm away"):
        ARM_2.tool_showing(Mm(500.0, 0.0), Mm(55.0, 0.0), 0.0)


@pytest.mark.parametrize("elbow", ELBOWS)
def test_what_the_robots_scatter_does_to_the_second_arm(elbow):
    rng = np.random.default_rng(0)
    stop = Stop(Pose(260.0, 90.0, 10.0), elbow)
    moved = []
    for dx, dy in rng.normal(0, 0.003, (4000, 2)):
        frame = ARM_2.frame(Pose(260.0 + dx, 90.0 + dy, 10.0), elbow)
        moved.append((dx, dy, math.radians(frame.t_deg - ARM_2.frame(*stop).t_deg)))
    spread = ARM_2.scatter([stop], 0.003, 0.001)[0]
    found = np.cov(np.array(moved).T)
    unit = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    assert spread @ spread.T / unit == pytest.approx(found / unit, abs=0.08)
    assert TOOL.scatter([stop], 0.003, 0.001)[0] == pytest.approx(np.diag([0.003, 0.003, math.radians(0.001)]))


# -- areas -------------------------------------------------------------------------------------------------------------


@given(*[st.floats(-10, 10)] * 4)
def test_a_line_touches_an_area_when_one_of_its_points_lies_inside(x, y, u, v):
    area = Area("box", -2.0, 3.0, -4.0, 1.0)
    way = np.linspace(0, 1, 4001)[:, None] * np.array([u - x, v - y]) + (x, y)
    inside = bool(np.any((way[:, 0] >= -2) & (way[:, 0] <= 3) & (way[:, 1] >= -4) & (way[:, 1] <= 1)))
    if inside:
        assert area.touches(Mm(x, y), Mm(u, v))
    else:
        assert not Area("box", -1.99, 2.99, -3.99, 0.99).touches(Mm(x, y), Mm(u, v))


def test_elbow_and_tool_both_count():
    stop = Stop(Pose(260.0, 90.0, 0.0), "righty")
    elbow, tool = TOOL.elbow_and_tool(*TOOL.axes_deg(stop))
    assert tool == pytest.approx((260.0, 90.0))
    assert forward(Joints(*TOOL.axes_deg(stop), 0.0, 0.0))[:2] == pytest.approx((260.0, 90.0))
    for at in (elbow, tool):
        around = Area("post", at.x_mm - 2, at.x_mm + 2, at.y_mm - 2, at.y_mm + 2)
        assert touched_at(TOOL, stop, [around]) == "post"
    assert touched_at(TOOL, stop, [Area("far", -300.0, -200.0, -300.0, -200.0)]) == ""


def test_the_way_between_two_stops_counts_not_only_its_ends():
    start, end = Stop(Pose(300.0, -150.0, 0.0), "righty"), Stop(Pose(300.0, 150.0, 0.0), "righty")
    between = Area("lamp", 320.0, 345.0, -5.0, 5.0)  # the tool swings on a bow
    assert not touched_at(TOOL, start, [between])
    assert not touched_at(TOOL, end, [between])
    assert touched_on_the_way(TOOL, start, end, [between]) == "lamp"
    stretched = Area("door", 390.0, 399.0, -10.0, 10.0)
    here = Pose(300.0, 0.0, 0.0)
    assert touched_on_the_way(TOOL, Stop(here, "righty"), Stop(here, "lefty"), [stretched]) == "door"
    assert touched_on_the_way(TOOL, start, end, []) == ""


def test_a_mount_knows_the_elbow_of_production():
    lefty = Mount("arm_2", 225.0, 175.0, "lefty")
    at = Pose(260.0, 90.0, 0.0)
    assert lefty.frame(at) == ARM_2.frame(at, "lefty") != ARM_2.frame(at)
