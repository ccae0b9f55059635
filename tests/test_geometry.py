"""Poses compose, and the corrected equations 12-16 of the paper say the same as poses do."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellctl.geometry import (
    Mm,
    Offset,
    Pose,
    compensation,
    direction_deg,
    disagreement_mm,
    mean_pose,
    offset_about,
    place_pose,
    turned_about,
    wrap_deg,
)

lengths = st.floats(-500, 500)
angles = st.floats(-180, 180)
poses = st.builds(Pose, lengths, lengths, angles)
points = st.builds(Mm, lengths, lengths)


def same(a: Pose, b: Pose, tolerance: float = 1e-8) -> bool:
    return math.hypot(a.x_mm - b.x_mm, a.y_mm - b.y_mm) < tolerance and abs(wrap_deg(a.t_deg - b.t_deg)) < tolerance


@given(poses)
def test_a_pose_and_its_inverse_cancel(pose: Pose) -> None:
    assert same(pose @ pose.inverse(), Pose(0, 0, 0))
    assert same(pose.inverse() @ pose, Pose(0, 0, 0))


@given(poses, poses, points)
def test_composing_poses_is_applying_one_after_the_other(a: Pose, b: Pose, p: Mm) -> None:
    one = (a @ b).point(*p)
    two = a.point(*b.point(*p))
    assert math.hypot(one.x_mm - two.x_mm, one.y_mm - two.y_mm) < 1e-8


def test_a_quarter_turn_is_counter_clockwise() -> None:
    x, y = Pose(10, 20, 90).point(1, 0)
    assert (x, y) == pytest.approx((10, 21))


@given(points, poses, st.builds(Offset, st.floats(-2, 2), st.floats(-2, 2), st.floats(-5, 5)))
def test_an_offset_put_in_is_the_offset_found(centre: Mm, taught: Pose, offset: Offset) -> None:
    found = turned_about(centre, offset) @ taught
    assert offset_about(centre, taught, found) == pytest.approx(offset, abs=1e-8)


@given(points, poses, poses)
def test_the_corrected_equations_12_to_16_agree_with_the_pose_form(centre: Mm, taught: Pose, found: Pose) -> None:
    """Mark = origin of the part frame, line = its x axis; both forms bring the part to its taught pose."""
    correction = compensation(centre, Mm(*taught[:2]), taught.t_deg, Mm(*found[:2]), found.t_deg)
    assert same(turned_about(centre, correction) @ found, taught, 1e-7)


@given(points, poses, poses)
def test_the_two_forms_of_the_correction_never_disagree(centre: Mm, taught: Pose, found: Pose) -> None:
    assert disagreement_mm(centre, taught, found) < 1e-7


@given(points, st.builds(Offset, st.floats(-2, 2), st.floats(-2, 2), st.floats(-5, 5)), poses)
def test_the_correction_undoes_the_offset(centre: Mm, offset: Offset, taught: Pose) -> None:
    found = turned_about(centre, offset) @ taught
    correction = compensation(centre, Mm(*taught[:2]), taught.t_deg, Mm(*found[:2]), found.t_deg)
    both = turned_about(centre, correction) @ turned_about(centre, offset)
    assert same(both, Pose(0, 0, 0), 1e-7)


@given(poses, poses, poses)
def test_the_held_battery_comes_to_its_taught_place_in_the_base(base: Pose, seat: Pose, held: Pose) -> None:
    robot_from_tool = place_pose(base, seat, held)
    assert same(robot_from_tool @ held, base @ seat, 1e-7)


def test_a_line_along_an_axis_has_a_direction() -> None:
    assert direction_deg(Mm(3, 4), Mm(3, 9)) == 90
    assert direction_deg(Mm(3, 4), Mm(-5, 4)) == 180
    assert direction_deg(Mm(3, 4), Mm(4, 3)) == pytest.approx(-45)


def test_the_mean_of_poses_does_not_tear_at_180_degrees() -> None:
    mean = mean_pose([Pose(0, 0, 179.0), Pose(2, 4, -179.0)])
    assert same(mean, Pose(1, 2, 180))
