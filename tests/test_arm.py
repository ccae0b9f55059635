"""The arm's physics, judged by geometry and by differences in time."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.arm import (
    FASTEST,
    HIGHEST,
    LOWEST,
    STEEPEST,
    Arm,
    Hand,
    Joints,
    ToolPose,
    Unreachable,
    forward,
    inverse,
)
from simulators.clock import Clock


class SteppedClock(Clock):
    """World time that the test sets."""

    def __init__(self):
        super().__init__()
        self.at_s = 0.0

    def now(self):
        return self.at_s


@pytest.fixture
def clock():
    return SteppedClock()


def arm_on(clock, seed=1, **imperfections):
    arm = Arm(clock, np.random.default_rng(seed), **imperfections)
    arm.power(True)
    return arm


def go(clock, arm, *pose, **how):
    """Move there, let the time pass, return the duration."""
    began_s = clock.at_s
    clock.at_s = arm.start(ToolPose(*pose), **how)
    return clock.at_s - began_s


joints_in_range = st.builds(
    Joints, *(st.floats(low + 0.01, high - 0.01) for low, high in zip(LOWEST, HIGHEST, strict=True))
)


@given(joints_in_range)
def test_inverse_undoes_forward_on_either_hand(joints):
    pose = forward(joints)

    back = inverse(pose, joints.hand)

    assert forward(back) == pytest.approx(pose, abs=1e-6)
    if abs(joints.j2_deg) > 0.01:
        assert back == pytest.approx(joints, abs=1e-4)


def test_a_righty_elbow_lies_to_the_right_of_the_line_to_the_tool():
    joints = inverse(ToolPose(300, 0, 0, 0), Hand.RIGHTY)

    assert joints.j1_deg < 0 < joints.j2_deg
    assert inverse(ToolPose(300, 0, 0, 0), Hand.LEFTY).j1_deg > 0


@pytest.mark.parametrize(
    ("pose", "kind"),
    [
        ((400.1, 0, 0, 0), "position"),
        ((10, 0, 0, 0), "position"),
        ((132.0, 0, 0, 0), "axis"),
        ((300, 0, 150.1, 0), "axis"),
        ((300, 0, -0.1, 0), "axis"),
        ((300, 0, 0, 500), "axis"),
        ((-300, 0, 0, 0), "axis"),
    ],
)
def test_what_lies_outside_is_refused_before_anything_moves(clock, pose, kind):
    arm = arm_on(clock)

    with pytest.raises(Unreachable) as refused:
        arm.start(ToolPose(*pose))

    assert refused.value.kind == kind
    assert not arm.moving_at(clock.now())


def test_the_dead_zone_ends_at_132_mm(clock):
    with pytest.raises(Unreachable):
        inverse(ToolPose(132.3, 0, 0, 0), Hand.RIGHTY)
    inverse(ToolPose(132.5, 0, 0, 0), Hand.RIGHTY)


def test_no_axis_is_faster_or_steeper_than_the_arm_can(clock):
    arm = arm_on(clock)
    go(clock, arm, 150, -250, 0, -90)
    began_s = clock.at_s
    duration_s = go(clock, arm, 100, 300, 140, 170, hand=Hand.LEFTY)

    times = np.linspace(began_s, began_s + duration_s, 2001)
    joints = np.array([arm.joints_at(t) for t in times])
    speed = np.diff(joints, axis=0) / np.diff(times)[:, None]
    accel = np.diff(speed, axis=0) / np.diff(times)[1:, None]

    assert (np.abs(speed) <= np.array(FASTEST) * 1.001).all()
    assert (np.abs(accel) <= np.array(STEEPEST) * 1.01).all()
    assert (np.abs(speed).max(axis=0) / FASTEST).max() > 0.999
    moving = np.abs(speed[2:-2]) > 1e-6
    assert moving.all(), "all axes start and arrive together"


def test_the_standard_cycle_takes_half_a_second(clock):
    """There and back, 25 mm up, 300 across, 25 down; half of each vertical leg runs under the horizontal one."""
    arm = arm_on(clock)
    go(clock, arm, 250, -150, 25, 0)
    up_s = go(clock, arm, 250, -150, 0, 0)
    across_s = go(clock, arm, 250, 150, 0, 0)
    down_s = go(clock, arm, 250, 150, 25, 0)

    assert up_s == pytest.approx(down_s)
    assert 2 * (up_s / 2 + across_s + down_s / 2) == pytest.approx(0.49, abs=0.02)


def test_half_the_speed_takes_longer_by_the_cruise_alone(clock):
    arm = arm_on(clock)
    full_s = go(clock, arm, 250, 200, 0, 0)
    go(clock, arm, 250, 0, 0, 0)
    half_s = go(clock, arm, 250, 200, 0, 0, speed=0.5)

    assert full_s < half_s < 2 * full_s


def test_the_arm_arrives_exactly_where_it_was_sent(clock):
    arm = arm_on(clock)
    arrival_s = arm.start(ToolPose(300, 100, 50, 30))

    assert arm.moving_at(arrival_s - 1e-6)
    assert not arm.moving_at(arrival_s)
    assert arm.commanded_at(arrival_s) == pytest.approx((300, 100, 50, 30), abs=1e-9)
    assert arm.commanded_at(arrival_s + 100) == pytest.approx((300, 100, 50, 30), abs=1e-9)


def test_the_true_tool_never_jumps(clock):
    arm = arm_on(clock, repeatability_mm=0.5, repeatability_deg=0.5, hysteresis_mm=0.5)
    for k, pose in enumerate([(300, 100, 50, 30), (200, -220, 20, 0), (200, -220, 100, 0), (300, 0, 20, 90)]):
        go(clock, arm, *pose, straight=k == 2)
        clock.at_s += 0.05

    times = np.arange(0.0, clock.at_s, 1e-4)
    steps = np.abs(np.diff([arm.tool_at(t) for t in times], axis=0))

    assert (steps <= np.array([0.7, 0.7, 0.13, 0.2])).all()


def test_a_straight_motion_stays_on_its_line(clock):
    arm = arm_on(clock, repeatability_mm=0)
    go(clock, arm, 300, -150, 10, 0)
    began_s = clock.at_s
    end_s = began_s + go(clock, arm, 200, 250, 60, 45, straight=True)

    start, end = np.array([300, -150, 10]), np.array([200, 250, 60])
    unit = (end - start) / np.linalg.norm(end - start)
    for t in np.linspace(began_s, end_s, 200):
        offset = np.array(arm.tool_at(t)[:3]) - start
        assert np.linalg.norm(offset - unit * (offset @ unit)) < 1e-9


def test_a_line_through_the_dead_zone_is_refused(clock):
    arm = arm_on(clock)
    go(clock, arm, 0, -200, 0, 0)

    with pytest.raises(Unreachable) as refused:
        arm.start(ToolPose(0, 200, 0, 0), straight=True)

    assert refused.value.kind == "way"


def test_a_line_does_not_change_hands(clock):
    arm = arm_on(clock)

    with pytest.raises(Unreachable) as refused:
        arm.start(ToolPose(300, 0, 0, 0), straight=True, hand=Hand.LEFTY)

    assert refused.value.kind == "hand"


def test_a_halt_brakes_on_the_way_and_stands(clock):
    arm = arm_on(clock, repeatability_mm=0)
    begin, end = arm.joints_at(0.0), inverse(ToolPose(250, 200, 0, 0), Hand.RIGHTY)
    arrival_s = arm.start(ToolPose(250, 200, 0, 0))
    clock.at_s = arrival_s / 2

    standing_s = arm.halt()

    assert clock.at_s < standing_s < arrival_s
    joints = arm.joints_at(standing_s)
    shares = [(j - b) / (e - b) for j, b, e in zip(joints, begin, end, strict=True) if abs(e - b) > 1e-9]
    assert shares == pytest.approx([shares[0]] * len(shares))
    assert 0.5 < shares[0] < 1
    assert not arm.moving_at(standing_s)
    assert arm.joints_at(standing_s + 5) == joints
    speeds = np.diff([arm.joints_at(t) for t in np.linspace(0, standing_s, 1001)], axis=0) / (standing_s / 1000)
    accels = np.diff(speeds, axis=0) / (standing_s / 1000)
    assert (np.abs(accels) <= np.array(STEEPEST) * 1.01).all()


def test_after_a_halt_the_arm_goes_on_from_where_it_stands(clock):
    arm = arm_on(clock)
    arm.start(ToolPose(250, 200, 0, 0))
    clock.at_s = 0.05
    clock.at_s = arm.halt()
    before = arm.tool_at(clock.at_s)

    arm.start(ToolPose(250, 200, 0, 0))

    assert arm.tool_at(clock.at_s) == pytest.approx(before, abs=1e-9)


def test_a_halt_while_standing_changes_nothing(clock):
    arm = arm_on(clock)
    clock.at_s = 3.0

    assert arm.halt() == 3.0
    assert arm.commanded_at(3.0) == pytest.approx((250, 0, 0, 0), abs=1e-9)


def misses(clock, arm, stops, x_mm=300.0):
    found = []
    for k in range(stops):
        go(clock, arm, x_mm + k % 2, 50, 20, 0)
        found.append(np.subtract(arm.tool_at(clock.at_s), arm.commanded_at(clock.at_s)))
    return np.array(found)


def test_scatter_depends_on_the_seed_and_the_number_of_the_stop_alone(clock):
    other_clock = SteppedClock()
    one, other = arm_on(clock, seed=7), arm_on(other_clock, seed=7)
    go(other_clock, other, 200, 200, 100, 90)
    go(clock, one, 200, -200, 0, 0)

    assert misses(clock, one, 5) == pytest.approx(misses(other_clock, other, 5, x_mm=250.0), abs=1e-9)


def test_other_seeds_scatter_otherwise(clock):
    assert not np.allclose(misses(clock, arm_on(clock, seed=1), 3), misses(clock, arm_on(clock, seed=2), 3))


def test_scatter_is_the_repeatability_at_three_sigma(clock):
    found = misses(clock, arm_on(clock), 600)

    assert found.std(axis=0) * 3 == pytest.approx([0.01, 0.01, 0.01, 0.004], rel=0.12)
    assert np.abs(found.mean(axis=0)).max() < 0.001


def test_scatter_can_be_switched_off_at_any_time(clock):
    arm = arm_on(clock)
    go(clock, arm, 300, 50, 0, 0)
    assert arm.tool_at(clock.at_s) != arm.commanded_at(clock.at_s)

    arm.repeatability_mm = arm.repeatability_deg = 0.0

    assert arm.tool_at(clock.at_s) == pytest.approx(arm.commanded_at(clock.at_s), abs=1e-12)


def test_hysteresis_parts_stops_from_opposite_sides(clock):
    arm = arm_on(clock, repeatability_mm=0, hysteresis_mm=0.02)
    go(clock, arm, 300, 100, 0, 0)
    go(clock, arm, 300, 0, 0, 0, straight=True)
    from_left = arm.tool_at(clock.at_s)
    go(clock, arm, 300, -100, 0, 0)
    go(clock, arm, 300, 0, 0, 0, straight=True)
    from_right = arm.tool_at(clock.at_s)

    assert from_left.y_mm - from_right.y_mm == pytest.approx(0.02, abs=1e-6)


def test_the_recent_past_stays_as_it_was(clock):
    arm = arm_on(clock)
    seen = {}
    for k in range(12):
        arrival_s = arm.start(ToolPose(250 + 5 * k, 100, 10, k))
        while clock.at_s < arrival_s:
            clock.at_s = min(clock.at_s + 0.01, arrival_s)
            seen[clock.at_s] = arm.tool_at(clock.at_s)

    assert all(arm.tool_at(t) == pose for t, pose in seen.items() if t > clock.at_s - 5)


def test_an_arm_without_power_does_not_start_and_a_moving_one_not_again(clock):
    arm = Arm(clock, np.random.default_rng(1))
    with pytest.raises(RuntimeError, match="no power"):
        arm.start(ToolPose(300, 0, 0, 0))
    arm.power(True)
    arm.start(ToolPose(300, 0, 0, 0))
    with pytest.raises(RuntimeError, match="moving"):
        arm.start(ToolPose(300, 0, 0, 0))


def test_power_off_brakes_the_arm(clock):
    arm = arm_on(clock)
    arrival_s = arm.start(ToolPose(250, 200, 0, 0))
    clock.at_s = arrival_s / 3
    arm.power(False)

    assert not arm.moving_at(arrival_s)
    assert math.dist(arm.commanded_at(arrival_s)[:2], (250, 200)) > 10
    assert not arm.powered


def test_no_way_takes_no_time(clock):
    arm = arm_on(clock)

    assert arm.start(ToolPose(*arm.commanded_at(0.0))) == pytest.approx(0.0, abs=1e-6)
