"""How long motions are predicted to take: against the simulated arm, which has its own figures and its own curves."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from drivers.motion import YK400XG, duration_s, through_s, timing
from drivers.rcx import LEFTY, RIGHTY, Arch, Motion, Point, Position, Ramps
from drivers.reach import Limits
from simulators import moves
from simulators.scara import YK400XG as ARM
from simulators.scara import Hand, ToolPose, Unreachable
from simulators.ways import Pace

LIMITS = Limits()
NEAR = 0.01  # of the time


@st.composite
def places(draw):
    away_mm, turn = draw(st.floats(150, 390)), math.radians(draw(st.floats(-60, 60)))
    numbers = away_mm * math.cos(turn), away_mm * math.sin(turn), draw(st.floats(0, 140)), draw(st.floats(-90, 90))
    return Point(*(round(number, 3) for number in numbers))


HANDS = st.sampled_from([RIGHTY, LEFTY])
RAMPS = st.builds(Ramps, st.integers(5, 100), st.integers(5, 100))


def simulated(start, motion, order):
    """The plan of the simulated arm for the same."""
    begins = ARM.inverse(ToolPose(*start.point), Hand(start.hand))
    pace = Pace(motion.speed_pct / 100, motion.ramps.accel_pct / 100, motion.ramps.decel_pct / 100)
    try:
        return moves.plan(order(ToolPose(*motion.to), Hand(motion.hand)), begins, ARM, pace, 0.0)
    except Unreachable:
        assume(False)


def predicted_s(start, motion):
    return duration_s(start, motion, LIMITS, YK400XG)


@given(places(), places(), HANDS, HANDS, st.integers(1, 100), RAMPS)
def test_a_motion_point_to_point_takes_as_long_as_predicted(start, to, before, hand, speed_pct, ramps):
    begin, motion = Position(start, before), Motion(to, hand, speed_pct, ramps=ramps)
    plan = simulated(begin, motion, moves.Go)
    assert predicted_s(begin, motion) == pytest.approx(plan.end_s, rel=NEAR, abs=1e-3)


@given(places(), places(), HANDS, st.integers(1, 100), RAMPS)
def test_a_straight_line_takes_as_long_as_predicted(start, to, hand, speed_pct, ramps):
    begin, motion = Position(start, hand), Motion(to, hand, speed_pct, straight=True, ramps=ramps)
    plan = simulated(begin, motion, moves.Line)
    assert predicted_s(begin, motion) == pytest.approx(plan.end_s, rel=0.05, abs=1e-3)


@given(places(), places(), HANDS, st.integers(5, 100), st.floats(0, 40), st.floats(0, 40), st.floats(0, 1))
def test_an_arch_takes_as_long_as_predicted(start, to, hand, speed_pct, rise_mm, sink_mm, height):
    top_mm = min(start.z_mm, to.z_mm) * height
    begin, motion = Position(start, hand), Motion(to, hand, speed_pct, arch=Arch(top_mm, rise_mm, sink_mm))
    plan = simulated(begin, motion, lambda to, hand: moves.Arch(to, top_mm, rise_mm, sink_mm, hand))
    assert predicted_s(begin, motion) == pytest.approx(plan.end_s, rel=NEAR, abs=2e-3)


@given(places(), places(), HANDS, st.integers(5, 100))
def test_the_next_motion_may_follow_when_every_axis_is_near_its_end(start, to, hand, speed_pct):
    begin, motion = Position(start, hand), Motion(to, hand, speed_pct, blends=True)
    plan = simulated(begin, motion, moves.Go)
    near_s = plan.near_s([2000 / pulses for pulses in ARM.pulses])
    assert timing(begin, motion, LIMITS, YK400XG).may_follow_s == pytest.approx(near_s, rel=NEAR, abs=1e-3)


@given(places(), places(), st.floats(2, 5))
def test_a_heavier_load_takes_as_much_longer_as_the_arm_needs(start, to, payload_kg):
    begin, motion = Position(start, RIGHTY), Motion(to, RIGHTY, 100)
    quick = ARM.quickness(payload_kg)
    plan = moves.plan(
        moves.Go(ToolPose(*to), Hand.RIGHTY),
        ARM.inverse(ToolPose(*start), Hand.RIGHTY),
        ARM,
        Pace(1.0, quick, quick),
        0.0,
    )
    takes_s = duration_s(begin, motion, LIMITS, YK400XG.at_payload(payload_kg))
    assert takes_s == pytest.approx(plan.end_s, rel=NEAR, abs=1e-3)


def test_the_catalogue_s_standard_cycle_takes_what_the_catalogue_says():
    low, far = Point(250.0, 150.0, 25.0, 0.0), Point(250.0, -150.0, 25.0, 0.0)
    arch = Arch(0.0, 12.5, 12.5)
    there = duration_s(Position(low, RIGHTY), Motion(far, RIGHTY, 100, arch=arch), LIMITS, YK400XG)
    back = duration_s(Position(far, RIGHTY), Motion(low, RIGHTY, 100, arch=arch), LIMITS, YK400XG)
    assert there + back == pytest.approx(0.49, abs=0.02)


def test_motions_that_blend_take_less_than_the_same_one_by_one():
    start = Position(Point(200.0, -220.0, 60.0, 0.0), RIGHTY)
    places = Point(300.0, -120.0, 60.0, 0.0), Point(320.0, -90.0, 60.0, 10.0)
    apart = [Motion(place, RIGHTY, speed_pct) for place, speed_pct in zip(places, (100, 20), strict=True)]
    blended = [Motion(places[0], RIGHTY, 100, blends=True), apart[1]]
    one_by_one = through_s(start, apart, LIMITS, YK400XG)
    alone = duration_s(start, apart[0], LIMITS, YK400XG)
    assert alone < through_s(start, blended, LIMITS, YK400XG) < one_by_one
    assert one_by_one == pytest.approx(alone + duration_s(Position(places[0], RIGHTY), apart[1], LIMITS, YK400XG))
    assert through_s(start, apart, LIMITS, YK400XG, turn_s=0.1) == pytest.approx(one_by_one + 0.1)


def test_a_motion_to_where_the_arm_stands_takes_no_time():
    start = Position(Point(250.0, 0.0, 10.0, 0.0), RIGHTY)
    for straight in (False, True):
        assert duration_s(start, Motion(start.point, RIGHTY, 10, straight=straight), LIMITS, YK400XG) == 0
