"""Poses and pictures from which no camera can be told are refused, and what is wrong is named."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cellctl.calibration.board import DotBoard
from cellctl.calibration.errors import CalibrationError, DegenerateMotion, PosesDisagree
from cellctl.calibration.motion import check_motion, motion_spread, rotation_spread_deg
from cellctl.calibration.scara import Kind, Noise
from cellctl.geometry import Pose
from tests.calibration_cells import BOARD, KINDS, planned, solved, true_cell


@given(
    st.lists(st.floats(-170, 170), min_size=5, max_size=15),
    st.tuples(st.floats(-80, 80), st.floats(-80, 80)),
    st.tuples(st.floats(-400, 400), st.floats(-400, 400)),
)
@settings(max_examples=50, deadline=None)
def test_turning_about_any_point_of_the_tool_is_no_travel(turns, arm, place):
    poses = [Pose(*place, turn) @ Pose(-arm[0], -arm[1], 0) for turn in turns]
    spread = motion_spread(poses)
    assert spread.travel_mm < 1e-6


def test_the_rotation_spread_goes_across_180_degrees():
    assert rotation_spread_deg([170, -175, 179]) == pytest.approx(15)
    assert rotation_spread_deg([-90, 0, 90, 150]) == pytest.approx(240)


DEGENERATE = [
    ("pose count", [Pose(0, 0, 0), Pose(2, 0, 20), Pose(0, 2, -20), Pose(1, 1, 10)], "4 poses are given, at least 5"),
    (
        "rotation spread",
        [Pose(2 * math.cos(i), 2 * math.sin(2 * i), 2.5 * i) for i in range(10)],
        "22.5 deg in all, at least 30 deg",
    ),
    ("travel", [Pose(0.1 * (i % 2), 0.1 * (i % 3), 5.0 * i) for i in range(10)], "mm in all, at least 1 mm"),
    ("travel on a line", [Pose(0.5 * (i * i % 7), 0, 5.0 * i) for i in range(10)], "along one line"),
    ("travel", [Pose(300, 50, 10 * i - 50) @ Pose(-55, 0, 0) for i in range(10)], "mm in all, at least 1 mm"),
]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("check", "poses", "says"), DEGENERATE)
def test_a_degenerate_motion_is_refused_with_figures_and_remedy(kind, check, poses, says):
    dots = true_cell(kind, 0).see(poses, np.random.default_rng(0)) if kind == "eye_in_hand" else None
    with pytest.raises(DegenerateMotion, match=says) as refused:
        check_motion(poses) if dots is None else solved(kind, poses, dots)
    assert refused.value.check == check
    assert ": " in refused.value.detail  # the remedy


WRONG = {
    "the sign of the robot's R": lambda pose: Pose(pose.x_mm, pose.y_mm, -pose.t_deg),
    "X or Y is wrong": lambda pose: Pose(-pose.x_mm, pose.y_mm, pose.t_deg),
    "or X and Y are swapped": lambda pose: Pose(pose.y_mm, pose.x_mm, pose.t_deg),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("says", WRONG)
def test_a_wrong_sign_is_found_and_named(kind, says):
    cell = true_cell(kind, 8)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(1))
    with pytest.raises(PosesDisagree, match=says):
        solved(kind, [WRONG[says](pose) for pose in poses], dots)


@pytest.mark.parametrize("kind", KINDS)
def test_the_wrong_mount_is_found_and_named(kind):
    cell = true_cell(kind, 9)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(1))
    other: Kind = "eye_to_hand" if kind == "eye_in_hand" else "eye_in_hand"
    with pytest.raises(PosesDisagree, match=f"described as {other} but is {kind}"):
        solved(other, poses, dots)


def test_a_mirrored_board_order_is_found_and_named():
    cell = true_cell("eye_to_hand", 10)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(1)).reshape(15, 7, 9, 2)[:, ::-1].reshape(15, 63, 2)
    with pytest.raises(PosesDisagree, match="mirrored"):
        solved("eye_to_hand", poses, dots)


@pytest.mark.parametrize("kind", KINDS)
def test_the_wrong_board_is_named_by_its_scale(kind):
    cell = true_cell(kind, 11)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(1))
    with pytest.raises(PosesDisagree, match=r"drawn size is 1\.04"):
        solved(kind, poses, dots, DotBoard(pitch_mm=1.25).points_mm)


@pytest.mark.parametrize(
    ("kind", "index", "shift"),
    [
        ("eye_in_hand", 4, Pose(0.06, 0, 0)),
        ("eye_in_hand", 0, Pose(0, 0.3, 0)),
        ("eye_to_hand", 14, Pose(8, 0, 0)),
        ("eye_to_hand", 9, Pose(0, 0, 0.06)),
    ],
)
def test_one_bad_pose_is_left_out_and_named(kind, index, shift):
    cell = true_cell(kind, 12)
    poses = list(planned(cell))
    dots = cell.see(poses, np.random.default_rng(2))
    bad = poses[index]
    poses[index] = Pose(bad.x_mm + shift.x_mm, bad.y_mm + shift.y_mm, bad.t_deg + shift.t_deg)
    found = solved(kind, poses, dots)
    ((number, why),) = found.left_out
    assert number == index + 1
    assert "the board is seen" in why
    assert index + 1 not in [fit.number for fit in found.poses]
    assert len(found.poses) == len(found.dots_px) == 14
    assert cell.error_um(found.plane_map, np.zeros((1, 2)))[0] < 4 * found.predicted.absolute_um


def test_two_bad_poses_of_fifteen_are_too_many_and_both_named():
    cell = true_cell("eye_in_hand", 13)
    poses = list(planned(cell))
    dots = cell.see(poses, np.random.default_rng(2))
    dots[3] += 40
    dots[11] -= (25, -60)
    with pytest.raises(PosesDisagree, match="poses 4, 12 against the other 13") as refused:
        solved("eye_in_hand", poses, dots)
    assert refused.value.poses == (3, 11)


def test_single_dots_with_dirt_on_them_are_left_out_and_counted():
    cell = true_cell("eye_in_hand", 13)
    poses = planned(cell)
    clean = cell.see(poses, np.random.default_rng(2))
    dirty = clean.copy()
    dirty[5, 20] += 5
    dirty[5, 21] -= 300
    dirty[9, 3] += (0.4, 0)
    found, good = solved("eye_in_hand", poses, dirty), solved("eye_in_hand", poses, clean)
    assert found.dots_left_out == 3
    assert found.left_out == ()
    assert found.rms_px == pytest.approx(good.rms_px, rel=0.02)
    assert found.plane_map.offset_px == pytest.approx(good.plane_map.offset_px, abs=0.05)


def test_a_picture_of_which_half_the_dots_are_wrong_is_left_out():
    cell = true_cell("eye_in_hand", 13)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(2))
    dots[5, 20:50] += np.random.default_rng(3).normal(0, 3, (30, 2))
    found = solved("eye_in_hand", poses, dots)
    assert [one.number for one in found.left_out] == [6]
    assert "px rms only" in found.left_out[0].why


def test_a_board_that_moves_all_the_time_is_refused_without_blaming_a_pose():
    cell = true_cell("eye_to_hand", 14)
    poses = planned(cell)
    rng = np.random.default_rng(3)
    dots = cell.see(poses, rng) + rng.normal(0, 15, (15, 1, 2))
    with pytest.raises(PosesDisagree, match="poses do not fit one camera") as refused:
        solved("eye_to_hand", poses, dots)
    assert len(refused.value.poses) > 5


def test_arrays_of_the_wrong_shape_are_refused():
    cell = true_cell("eye_in_hand", 0)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"dots must be \(15, 63, 2\)"):
        solved("eye_in_hand", poses, dots[:-1])
    with pytest.raises(ValueError, match="finite"):
        solved("eye_in_hand", poses, dots * np.nan)
    with pytest.raises(ValueError, match="one line"):
        solved("eye_in_hand", poses, dots, BOARD.points_mm * (1, 0))
    with pytest.raises(ValueError, match="above 0"):
        Noise(robot_sd_mm=0)


NONSENSE_POSES = planned(true_cell("eye_in_hand", 0), count=6)


@given(seed=st.integers(0, 10**6), flat=st.booleans(), spread=st.floats(0, 1e5))
@example(seed=0, flat=True, spread=0.0)
@example(seed=0, flat=False, spread=0.0)
@settings(max_examples=12, deadline=None)
def test_nonsense_dots_never_give_a_camera(seed, flat, spread):
    rng = np.random.default_rng(seed)
    dots = rng.uniform(-1, 1, (6, 63, 2))
    if flat:
        dots = BOARD.points_mm @ rng.uniform(-1, 1, (6, 2, 2)) + rng.uniform(-1, 1, (6, 1, 2))
    with pytest.raises(CalibrationError, match="check"):
        solved("eye_in_hand", NONSENSE_POSES, dots * spread)
