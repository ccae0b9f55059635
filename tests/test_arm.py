"""The arm's physics, judged by geometry and by differences in time."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulators.arm import Arm
from simulators.clock import Clock
from simulators.moves import Arc, Arch, Go, Line
from simulators.scara import YK400XE, YK400XG, Hand, Joints, ToolPose, Unreachable, forward
from simulators.ways import Pace

LOWEST, HIGHEST, FASTEST, STEEPEST = YK400XG.lowest, YK400XG.highest, YK400XG.fastest, YK400XG.steepest
inverse = YK400XG.inverse


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


FULL = Pace()


def go(clock, arm, *pose, order=Go, pace=FULL, **how):
    """Move there, let the time pass, return the duration."""
    began_s = clock.at_s
    clock.at_s = sent(arm, *pose, order=order, pace=pace, **how)
    return clock.at_s - began_s


def sent(arm, *pose, order=Go, pace=FULL, blends=False, **how):
    """Begin to move there, return the time of the arrival."""
    return arm.start(order(to=ToolPose(*pose), **how), pace, blends=blends).end_s


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
        sent(arm, *pose)

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
    half_s = go(clock, arm, 250, 200, 0, 0, pace=Pace(speed=0.5))

    assert full_s < half_s < 2 * full_s


def test_the_arm_arrives_exactly_where_it_was_sent(clock):
    arm = arm_on(clock)
    arrival_s = sent(arm, 300, 100, 50, 30)

    assert arm.moving_at(arrival_s - 1e-6)
    assert not arm.moving_at(arrival_s)
    assert arm.commanded_at(arrival_s) == pytest.approx((300, 100, 50, 30), abs=1e-9)
    assert arm.commanded_at(arrival_s + 100) == pytest.approx((300, 100, 50, 30), abs=1e-9)


def test_the_true_tool_never_jumps(clock):
    arm = arm_on(clock, repeatability_mm=0.5, repeatability_deg=0.5, hysteresis_mm=0.5)
    for k, pose in enumerate([(300, 100, 50, 30), (200, -220, 20, 0), (200, -220, 100, 0), (300, 0, 20, 90)]):
        go(clock, arm, *pose, order=Line if k == 2 else Go)
        clock.at_s += 0.05

    times = np.arange(0.0, clock.at_s, 1e-4)
    steps = np.abs(np.diff([arm.tool_at(t) for t in times], axis=0))

    assert (steps <= np.array([0.7, 0.7, 0.13, 0.2])).all()


def test_a_straight_motion_stays_on_its_line(clock):
    arm = arm_on(clock, repeatability_mm=0)
    go(clock, arm, 300, -150, 10, 0)
    began_s = clock.at_s
    end_s = began_s + go(clock, arm, 200, 250, 60, 45, order=Line)

    start, end = np.array([300, -150, 10]), np.array([200, 250, 60])
    unit = (end - start) / np.linalg.norm(end - start)
    for t in np.linspace(began_s, end_s, 200):
        offset = np.array(arm.tool_at(t)[:3]) - start
        assert np.linalg.norm(offset - unit * (offset @ unit)) < 1e-9


def test_a_line_through_the_dead_zone_is_refused(clock):
    arm = arm_on(clock)
    go(clock, arm, 0, -200, 0, 0)

    with pytest.raises(Unreachable) as refused:
        sent(arm, 0, 200, 0, 0, order=Line)

    assert refused.value.kind == "way"


def test_a_line_does_not_change_hands(clock):
    arm = arm_on(clock)

    with pytest.raises(Unreachable) as refused:
        sent(arm, 300, 0, 0, 0, order=Line, hand=Hand.LEFTY)

    assert refused.value.kind == "hand"


def test_a_halt_brakes_on_the_way_and_stands(clock):
    arm = arm_on(clock, repeatability_mm=0)
    begin, end = arm.joints_at(0.0), inverse(ToolPose(250, 200, 0, 0), Hand.RIGHTY)
    arrival_s = sent(arm, 250, 200, 0, 0)
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
    sent(arm, 250, 200, 0, 0)
    clock.at_s = 0.05
    clock.at_s = arm.halt()
    before = arm.tool_at(clock.at_s)

    sent(arm, 250, 200, 0, 0)

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
    go(clock, arm, 300, 0, 0, 0, order=Line)
    from_left = arm.tool_at(clock.at_s)
    go(clock, arm, 300, -100, 0, 0)
    go(clock, arm, 300, 0, 0, 0, order=Line)
    from_right = arm.tool_at(clock.at_s)

    assert from_left.y_mm - from_right.y_mm == pytest.approx(0.02, abs=1e-6)


def test_the_recent_past_stays_as_it_was(clock):
    arm = arm_on(clock)
    seen = {}
    for k in range(12):
        arrival_s = sent(arm, 250 + 5 * k, 100, 10, k)
        while clock.at_s < arrival_s:
            clock.at_s = min(clock.at_s + 0.01, arrival_s)
            seen[clock.at_s] = arm.tool_at(clock.at_s)

    assert all(arm.tool_at(t) == pose for t, pose in seen.items() if t > clock.at_s - 5)


def test_an_arm_without_power_does_not_start_and_a_moving_one_not_again(clock):
    arm = Arm(clock, np.random.default_rng(1))
    with pytest.raises(RuntimeError, match="no power"):
        sent(arm, 300, 0, 0, 0)
    arm.power(True)
    sent(arm, 300, 0, 0, 0)
    with pytest.raises(RuntimeError, match="moving"):
        sent(arm, 300, 0, 0, 0)


def test_power_off_brakes_the_arm(clock):
    arm = arm_on(clock)
    arrival_s = sent(arm, 250, 200, 0, 0)
    clock.at_s = arrival_s / 3
    arm.power(False)

    assert not arm.moving_at(arrival_s)
    assert math.dist(arm.commanded_at(arrival_s)[:2], (250, 200)) > 10
    assert not arm.powered


def test_no_way_takes_no_time(clock):
    arm = arm_on(clock)

    assert sent(arm, *arm.commanded_at(0.0)) == pytest.approx(0.0, abs=1e-6)


# -- ramps, arches, arcs, blends ------------------------------------------------------------------------------


def series(arm, begin_s, end_s, count=4001):
    times = np.linspace(begin_s, end_s, count)
    return times, np.array([arm.joints_at(t) for t in times])


def test_acceleration_builds_up_and_never_jumps(clock):
    arm = arm_on(clock)
    end_s = go(clock, arm, 250, 200, 60, 45)
    times, joints = series(arm, 0.0, end_s)
    step_s = times[1] - times[0]
    accel = np.diff(joints, 2, axis=0) / step_s**2
    jumps = np.abs(np.diff(accel, axis=0)).max(axis=0)

    assert (jumps < 0.02 * np.array(STEEPEST)).all()
    assert (np.abs(accel).max(axis=0) / STEEPEST).max() > 0.99


@given(st.floats(0.05, 1), st.floats(0.05, 1), st.floats(0.05, 1))
def test_however_it_is_paced_a_motion_ends_at_rest_exactly_at_its_end(speed, accel, decel):
    arm = arm_on(SteppedClock())
    plan = arm.start(Go(ToolPose(300, -100, 80, 120)), Pace(speed, accel, decel))
    profile = plan.legs[0].profile

    assert profile.phases[-1].state_at(profile.end_s) == pytest.approx((1, 0, 0), abs=1e-6)
    assert [phase.state_at(after.at_s)[:2] for phase, after in pairwise(profile.phases)] == [
        pytest.approx(after[1:3], abs=1e-9) for after in profile.phases[1:]
    ]


@settings(max_examples=30, deadline=None)
@given(st.floats(0.001, 0.999), st.floats(0.1, 1))
def test_a_halt_at_any_time_brakes_smoothly_within_what_the_arm_can(share, decel):
    clock = SteppedClock()
    arm = arm_on(clock)
    arrival_s = sent(arm, 250, 200, 100, 90, pace=Pace(decel=decel))
    clock.at_s = share * arrival_s

    standing_s = arm.halt()

    assert standing_s <= arrival_s
    times, joints = series(arm, 0.0, standing_s + 0.02, 601)
    speed = np.diff(joints, axis=0) / (times[1] - times[0])
    accel = np.diff(speed, axis=0) / (times[1] - times[0])
    assert (np.abs(accel) <= np.array(STEEPEST) * 1.02).all()
    assert np.abs(speed[-5:]).max() < 1e-6
    travelled = (joints - joints[0]) @ (joints[-1] - joints[0])
    assert (np.diff(travelled) >= -1e-9).all(), "never back"


def test_an_arm_that_hits_something_stands_at_once(clock):
    arm = arm_on(clock)
    arrival_s = sent(arm, 250, 0, 100, 0)
    clock.at_s = arrival_s / 2
    before = arm.joints_at(clock.at_s)

    assert arm.halt(hard=True) == clock.at_s
    assert arm.joints_at(arrival_s) == pytest.approx(before)


def test_an_arch_rises_travels_and_descends_and_saves_time_where_the_legs_overlap(clock):
    arm = arm_on(clock, repeatability_mm=0)
    go(clock, arm, 250, -100, 80, 0)
    square_s = go(clock, arm, 250, 100, 90, 30, order=Arch, height_mm=20.0)
    go(clock, arm, 250, -100, 80, 0)
    began_s = clock.at_s
    arch_s = go(clock, arm, 250, 100, 90, 30, order=Arch, height_mm=20.0, begin_below_mm=30.0, end_below_mm=25.0)

    assert arch_s < square_s - 0.03
    assert arm.commanded_at(clock.at_s) == pytest.approx((250, 100, 90, 30), abs=1e-9)
    poses = [arm.commanded_at(t) for t in np.linspace(began_s, clock.at_s, 500)]
    assert min(pose.z_mm for pose in poses) == pytest.approx(20)
    assert all(pose.z_mm < 50 + 1e-3 for pose in poses if pose.y_mm > -99.9 and pose.y_mm < 0)
    assert all(pose.z_mm < 45 + 1e-3 for pose in poses if 0 <= pose.y_mm < 99.9)
    _, joints = series(arm, began_s, clock.at_s, 1001)
    assert np.abs(np.diff(joints, axis=0)).max() < 3, "continuous"


def test_an_arch_that_is_stopped_while_it_rises_never_travels(clock):
    arm = arm_on(clock, repeatability_mm=0.3)
    go(clock, arm, 250, -100, 80, 0)
    arrival_s = sent(arm, 250, 100, 90, 30, order=Arch, height_mm=20.0)
    clock.at_s += 0.03
    before = arm.tool_at(clock.at_s)

    standing_s = arm.halt()

    assert arm.tool_at(clock.at_s) == pytest.approx(before, abs=1e-9), "the true tool does not jump either"
    assert arm.commanded_at(arrival_s)[:2] == pytest.approx((250, -100))
    assert 20 < arm.commanded_at(arrival_s).z_mm < 80
    assert not arm.moving_at(standing_s)


def test_an_arch_below_its_ends_is_refused(clock):
    arm = arm_on(clock)
    with pytest.raises(Unreachable) as refused:
        sent(arm, 250, 100, 90, 30, order=Arch, height_mm=20.0)
    assert refused.value.kind == "arch"


def test_an_arc_keeps_its_radius_and_ends_where_it_shall(clock):
    arm = arm_on(clock, repeatability_mm=0)
    go(clock, arm, 300, 0, 0, 0)
    began_s = clock.at_s
    arc = Arc(ToolPose(320, 20, 0, 0), ToolPose(300, 40, 10, 20))
    clock.at_s = arm.start(arc, Pace(path_mm_per_s=100)).end_s

    poses = [arm.commanded_at(t) for t in np.linspace(began_s, clock.at_s, 100)]
    assert [math.dist(pose[:2], (300, 20)) for pose in poses] == pytest.approx([20] * 100)
    assert poses[-1] == pytest.approx((300, 40, 10, 20), abs=1e-6)
    length_mm = math.hypot(20 * math.pi, 10)
    assert clock.at_s - began_s == pytest.approx(length_mm / 100, rel=0.1)


@pytest.mark.parametrize(("via", "kind"), [((300, 0, 0, 0), "same"), ((300, 20, 0, 0), "line")])
def test_three_positions_that_are_no_circle_are_refused(clock, via, kind):
    arm = arm_on(clock)
    go(clock, arm, 300, 0, 0, 0)
    with pytest.raises(Unreachable) as refused:
        arm.start(Arc(ToolPose(*via), ToolPose(300, 40, 0, 0)))
    assert refused.value.kind == kind


def test_a_motion_may_begin_before_one_that_blends_has_ended_and_saves_its_ramps(clock):
    arm, alone = arm_on(clock, repeatability_mm=0.3), arm_on(SteppedClock())
    apart_s = sum(go(alone._clock, alone, *pose) for pose in ((300, 100, 0, 0), (200, 200, 0, 0)))
    first = arm.start(Go(ToolPose(300, 100, 0, 0)), blends=True)
    clock.at_s = first.near_s((3.0, 3.0, 3.0, 3.0))
    assert clock.at_s < first.end_s
    before = arm.tool_at(clock.at_s), arm.joints_at(clock.at_s)

    end_s = sent(arm, 200, 200, 0, 0)

    assert (arm.tool_at(clock.at_s), arm.joints_at(clock.at_s)) == (pytest.approx(before[0]), pytest.approx(before[1]))
    assert end_s < apart_s - 0.01
    assert arm.commanded_at(end_s) == pytest.approx((200, 200, 0, 0), abs=1e-9)
    _, joints = series(arm, 0.0, end_s + 0.01)
    assert np.abs(np.diff(joints, axis=0)).max() < 0.2, "no jump where they meet"
    closest_mm = min(math.dist(arm.commanded_at(t)[:2], (300, 100)) for t in np.linspace(0, end_s, 2000))
    assert 0.1 < closest_mm < 20, "the corner is cut"
    clock.at_s = end_s - 0.01
    with pytest.raises(RuntimeError, match="moving"):
        sent(arm, 300, 100, 0, 0)


def test_a_motion_that_blends_into_a_slower_one_ends_with_it(clock):
    arm = arm_on(clock)
    slow = arm.start(Go(ToolPose(300, 100, 0, 0)), Pace(0.05), blends=True)
    clock.at_s = slow.end_s / 2

    end_s = sent(arm, 300, 100, 20, 0)

    assert end_s == slow.end_s
    assert arm.moving_at(end_s - 0.001)
    assert arm.commanded_at(end_s) == pytest.approx((300, 100, 20, 0), abs=1e-9)


def test_a_heavier_load_is_accelerated_more_gently_and_a_lighter_one_not_quicker():
    assert YK400XG.quickness(0.0) == YK400XG.quickness(2.0) == 1.0
    assert YK400XG.quickness(5.0) == pytest.approx(0.625)


def test_the_newer_arm_has_its_own_ranges_and_is_quicker(clock):
    newer = Arm(clock, np.random.default_rng(1), scara=YK400XE)
    newer.power(True)
    go(clock, newer, 250, -150, 25, 0)
    up_s = go(clock, newer, 250, -150, 0, 0)
    across_s = go(clock, newer, 250, 150, 0, 0)

    assert 2 * (up_s + across_s) == pytest.approx(0.41, abs=0.02), "there and back, vertical legs half hidden"
    assert newer.scara.highest.j2_deg == pytest.approx(150.8, abs=0.1)
    assert newer.scara.lowest.j1_deg == pytest.approx(-132.35, abs=0.1)
    inside = newer.scara.inverse(ToolPose(115, 0, 0, 0), Hand.RIGHTY)
    assert inside.j2_deg > 144


def test_what_lies_on_the_way_is_found_by_its_time(clock):
    arm = arm_on(clock)
    plan = arm.start(Line(ToolPose(250, 0, 100, 0)))

    assert arm.commanded_at(plan.sinks_s(62.5)).z_mm == pytest.approx(62.5, abs=0.01)
    assert plan.sinks_s(101) is None
    assert plan.halfway_s(0.5) == pytest.approx(plan.end_s / 2, abs=0.002)


def test_a_load_that_nobody_told_the_controller_of_makes_the_tool_swing_and_settle(clock):
    arm = arm_on(clock, repeatability_mm=0)
    arm.payload_kg = 5.0
    go(clock, arm, 250, 100, 0, 0)

    swings = [arm.tool_at(clock.at_s + k / 500).y_mm - 100 for k in range(200)]
    assert max(map(abs, swings)) > 0.05
    assert min(swings) < 0 < max(swings)
    assert abs(swings[-1]) < 0.002
    assert swings[0] == pytest.approx(0)


def test_hysteresis_is_lost_motion_of_each_coordinate(clock):
    arm = arm_on(clock, repeatability_mm=0, repeatability_deg=0, hysteresis_mm=0.02, hysteresis_deg=0.01)
    go(clock, arm, 300, -50, 0, 20, order=Line)
    go(clock, arm, 250, 0, 0, 10, order=Line)

    missed = np.subtract(arm.tool_at(clock.at_s), (250, 0, 0, 10))
    assert missed == pytest.approx((0.01, -0.01, 0, 0.005), abs=1e-6)
