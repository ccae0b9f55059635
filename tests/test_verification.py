"""Verification and hysteresis on pictures of a known truth: what has moved is found, with an honest uncertainty."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.calibration.errors import DegenerateMotion
from cellctl.calibration.hysteresis import APPROACHES, USED, hysteresis, stops_by_board
from cellctl.calibration.scara import Kind
from cellctl.calibration.verification import verify
from cellctl.geometry import Offset, Pose
from tests.board_scenes import (
    BOARD,
    DOWN,
    FIXED,
    NOISE,
    PICTURE,
    moved_camera,
    poses_of,
    see,
    setup_of,
    stops,
    verified,
)

KINDS = pytest.mark.parametrize("kind", ["eye_in_hand", "eye_to_hand"])


@KINDS
@given(dx=st.floats(-0.2, 0.2), dy=st.floats(-0.2, 0.2), turn_deg=st.floats(-0.3, 0.3))
@settings(max_examples=15, deadline=None)
def test_without_noise_the_movement_is_found(kind: Kind, dx: float, dy: float, turn_deg: float):
    camera = moved_camera(kind, Offset(dx, dy, turn_deg))
    found = verified(kind, see(kind, camera, np.random.default_rng(0), noise=0.0))
    assert (found.dx_um, found.dy_um) == (pytest.approx(dx * 1000, abs=0.2), pytest.approx(dy * 1000, abs=0.2))
    assert found.turn_mdeg == pytest.approx(turn_deg * 1000, abs=0.3)
    assert found.left_um < 0.2


@KINDS
def test_the_uncertainty_is_that_of_the_errors(kind: Kind):
    squares = []
    for seed in range(150):
        found = verified(kind, see(kind, Pose(0, 0, 0), np.random.default_rng(seed)))
        error = np.array([found.dx_um, found.dy_um, found.turn_mdeg])
        squares.append(float(error @ np.linalg.solve(found.covariance, error)) / 3)
    assert 0.6 < np.mean(squares) < 1.15  # the covariance is never made smaller than stated, so a little below 1


def test_a_camera_on_the_robot_is_verified_sharply_and_a_fixed_one_as_well_as_a_new_grip_allows():
    first = verified("eye_in_hand", see("eye_in_hand", Pose(0, 0, 0), np.random.default_rng(1)))
    second = verified("eye_to_hand", see("eye_to_hand", Pose(0, 0, 0), np.random.default_rng(1)))
    assert first.shift_sd_um < 4
    assert first.turn_sd_mdeg < 1
    assert second.shift_sd_um < 6
    assert 10 < second.turn_sd_mdeg < 40  # it shows through the travel alone
    assert f"+-{second.turn_sd_mdeg:.1f}" in second.text(100)


@KINDS
def test_a_good_calibration_holds_and_one_that_is_off_by_50_um_does_not(kind: Kind):
    held = [verified(kind, see(kind, Pose(0, 0, 0), np.random.default_rng(s))).holds(20, 100) for s in range(60)]
    assert all(held)
    camera = moved_camera(kind, Offset(0.04, -0.03, 0.0))
    refused = [not verified(kind, see(kind, camera, np.random.default_rng(s))).holds(20, 100) for s in range(60)]
    assert all(refused)


def test_a_camera_that_has_turned_by_30_mdeg_is_noticed_on_the_robot():
    camera = moved_camera("eye_in_hand", Offset(0.0, 0.0, 0.03))
    found = verified("eye_in_hand", see("eye_in_hand", camera, np.random.default_rng(3)))
    assert not found.holds(20, 100)
    assert found.board_moved is None  # the turn alone is also what a turned board would show


def test_a_board_that_was_pushed_is_told_from_a_camera_that_was():
    pushed = Pose(FIXED.x_mm + 0.15, FIXED.y_mm - 0.1, FIXED.t_deg + 0.02)
    rng = np.random.default_rng(4)
    board = verified("eye_in_hand", see("eye_in_hand", Pose(0, 0, 0), rng, board=pushed))
    camera = verified("eye_in_hand", see("eye_in_hand", moved_camera("eye_in_hand", Offset(0.15, -0.1, 0.02)), rng))
    assert board.board_moved is True
    assert camera.board_moved is False
    assert not board.holds(20, 100)


def test_too_few_or_too_narrow_poses_are_refused():
    kind: Kind = "eye_in_hand"
    poses, dots = poses_of(kind), see(kind, Pose(0, 0, 0), np.random.default_rng(0))
    with pytest.raises(DegenerateMotion, match="3 poses over 32"):
        verify(setup_of(kind), poses[:3], dots[:3], BOARD.points_mm, PICTURE, NOISE)
    narrow = [pose._replace(t_deg=pose.t_deg / 3) for pose in poses]
    with pytest.raises(DegenerateMotion, match=r"5 poses over 20\.0 deg"):
        verify(setup_of(kind), narrow, dots, BOARD.points_mm, PICTURE, NOISE)
    with pytest.raises(ValueError, match="dots must be"):
        verify(setup_of(kind), poses, dots[:, :9], BOARD.points_mm, PICTURE, NOISE)
    with pytest.raises(ValueError, match="finite"):
        verify(setup_of(kind), poses, dots * np.nan, BOARD.points_mm, PICTURE, NOISE)


# -- hysteresis --------------------------------------------------------------------------------------------------


def test_the_lost_motion_of_each_axis_is_found_with_its_uncertainty():
    lag = np.array([0.010, 0.015, 0.005])
    squares = []
    for seed in range(100):
        found = hysteresis(*stops(np.random.default_rng(seed), 4, lag))
        true = (np.array(APPROACHES) - np.array(USED)) * lag * 1000
        squares.append(((found.difference - true)[1:] / found.difference_sd) ** 2)
    assert np.mean(squares) == pytest.approx(24 / 22, abs=0.2)  # Student with 24 degrees of freedom


def test_the_worst_side_and_what_it_costs_at_a_corner_are_named():
    found = hysteresis(*stops(np.random.default_rng(1), 30, np.array([0.02, 0.02, 0.01])))
    approach, worst_um = found.worst(50.0)
    assert approach == (1, 1, 1)
    assert worst_um == pytest.approx(math.hypot(40, 40) + math.radians(0.020) * 50e3, abs=4)
    assert found.worst_sd_um(50.0) < 2
    rows = found.table()
    assert len(rows) == 1 + 8 + 2
    assert rows[1].split() == ["-x", "-y", "-R", "+0.0", "+0.0", "+0.0", "used"]


def test_the_stops_are_where_the_board_says_that_the_tool_was():
    true = Pose(285.012, -19.988, 0.013)
    seen = true.inverse() @ FIXED
    points = np.array([seen.point(*point) for point in BOARD.points_mm.tolist()])
    found = stops_by_board(DOWN, FIXED, DOWN.px_from_mm(points)[None], BOARD.points_mm)
    assert found[0] == pytest.approx(true, abs=1e-6)


def test_approaches_that_were_not_made_equally_often_are_refused():
    order, found = stops(np.random.default_rng(0), 2, np.zeros(3))
    for few in (8, 15):
        with pytest.raises(ValueError, match="equally often"):
            hysteresis(order[:few], found[:few])
