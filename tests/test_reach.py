"""Our own model of where the arm can go, along which way, and in which pulses."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.rcx import LEFTY, RIGHTY, Arch, Point, Position, Pulses
from drivers.reach import Limits, PulseLimits


@pytest.mark.parametrize(
    ("target", "complaint"),
    [
        (Point(400, 0, 0, 0), "reach 400.000 mm is outside 133 .. 399.5 mm"),
        (Point(100, 0, 0, 0), "reach 100.000 mm"),
        (Point(300, 0, 151, 0), "z 151.000 mm"),
        (Point(300, 0, -1, 0), "z -1.000 mm"),
        (Point(300, 0, 0, 361), "r 361.000 deg"),
        (Point(-300, 0, 0, 0), "axis 1"),
        (Point(250, 0, 0, -330), "axis 4"),
        (Point(float("nan"), 0, 0, 0), "no position"),
    ],
)
def test_a_target_out_of_bounds_is_named_with_its_numbers(target, complaint):
    assert complaint in Limits().objection(target, hand=RIGHTY)


@pytest.mark.parametrize(
    "target", [Point(282, 120, 100, 0), Point(200, -220, 110, 0), Point(150, 250, 105, 0), Point(300, -120, 80, 90)]
)
def test_the_cells_places_are_within_bounds(target):
    assert Limits().objection(target, hand=RIGHTY) == ""


def along(start, to, hand=RIGHTY):
    return Limits().objection_to_line(Position(start, hand), to, hand=hand)


def test_a_line_past_the_column_is_out_of_bounds():
    assert "passes 0.0 mm from the column" in along(Point(200, 0, 0, 0), Point(-200, 0, 0, 0))
    assert along(Point(200, -200, 0, 0), Point(200, 200, 0, 0)) == ""
    assert along(Point(200, 0, 0, 0), Point(200, 0, 50, 0)) == ""


def test_a_line_along_which_an_axis_leaves_its_range_is_out_of_bounds_also_with_both_ends_inside():
    start, to = Point(309.5, 49.9, 0, 0), Point(-193.7, 321.6, 0, 0)
    assert [Limits().objection(end, hand=LEFTY) for end in (start, to)] == ["", ""]
    assert "axis 1" in along(start, to, LEFTY)


def test_a_line_through_stretched_arms_is_refused():
    assert "the arms are stretched (axis 2 at " in along(Point(300, 0, 0, 0), Point(399.6, 0, 0, 0))


@pytest.mark.parametrize(("hand", "from_to"), [(LEFTY, "from lefty to righty")])
def test_a_straight_line_and_an_arch_cannot_change_the_elbow(hand, from_to):
    start, to = Position(Point(300, 0, 20, 0), hand), Point(310, 0, 20, 0)
    assert from_to in Limits().objection_to_line(start, to, hand=RIGHTY)
    assert from_to in Limits().objection_to_arch(start, to, Arch(0), hand=RIGHTY)


@pytest.mark.parametrize(
    ("arch", "complaint"),
    [
        (Arch(0), ""),
        (Arch(10, 10, 40), ""),
        (Arch(-1), "top at z -1.000 mm"),
        (Arch(21), "its start at z 20.000 mm"),
        (Arch(10, 11, 0), "its start at z 20.000 mm"),
        (Arch(10, 0, 41), "its target at z 50.000 mm"),
        (Arch(10, -1, 0), "lengths, 0 or more"),
        (Arch(float("nan")), "is no arch"),
    ],
)
def test_an_arch_is_above_both_its_ends(arch, complaint):
    start, to = Position(Point(300, 0, 20, 0), RIGHTY), Point(250, 100, 50, 0)
    objection = Limits().objection_to_arch(start, to, arch, hand=RIGHTY)
    assert (complaint in objection) if complaint else objection == ""


PULSES = PulseLimits(
    (2912.711, 2912.711, 1638.4, 682.6667),
    Pulses(-385506, -437972, -1707, -245760),
    Pulses(380555, 439198, 250000, 245760),
)


@given(
    st.floats(135, 399), st.floats(-120, 120), st.floats(0, 150), st.floats(-90, 90), st.sampled_from([RIGHTY, LEFTY])
)
def test_a_place_in_pulses_and_back_is_the_same_place(reach_mm, direction_deg, z_mm, r_deg, hand):
    limits = Limits(pulses=PULSES)
    direction = math.radians(direction_deg)
    place = Point(reach_mm * math.cos(direction), reach_mm * math.sin(direction), z_mm, r_deg)

    back = limits.from_pulses(limits.in_pulses(place, hand=hand))

    assert back.point == pytest.approx(place, abs=0.02)
    assert back.hand == hand


def test_the_controllers_own_soft_limits_are_kept_where_they_are_known():
    place = Point(250, 0, 0, 0)
    narrow = PULSES._replace(high=PULSES.high._replace(axis_1=0))

    assert Limits(pulses=PULSES).objection(place, hand=LEFTY) == ""
    assert "pulses is outside -385506 .. 0 pulses" in Limits(pulses=narrow).objection(place, hand=LEFTY)
    assert Limits(pulses=narrow).objection(place, hand=RIGHTY) == ""


def test_pulses_that_are_not_configured_are_not_guessed():
    with pytest.raises(ValueError, match="not configured"):
        Limits().in_pulses(Point(250, 0, 0, 0), hand=RIGHTY)
