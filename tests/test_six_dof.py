"""AX = XB and CX = XD in six degrees of freedom: against truth, against OpenCV, and what no motion can tell."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cellctl.calibration.errors import DegenerateMotion, PosesDisagree
from cellctl.calibration.six_dof.adjust import Sightings, Sigmas
from cellctl.calibration.six_dof.align import Stream, estimate_delay
from cellctl.calibration.six_dof.closed_form import Solution, closed_form
from cellctl.calibration.six_dof.freedom import amplification, check_freedom
from cellctl.calibration.six_dof.pairs import Kind, Pairs
from cellctl.calibration.six_dof.peers import METHODS, OURS, compare, opencv_camera
from cellctl.calibration.six_dof.report import as_dict, compare_text, report_text
from cellctl.calibration.six_dof.rigid import (
    inverse,
    left_jacobian_inverse,
    quaternion_from_rotation,
    rigid,
    rotation_from_quaternion,
    rotation_from_vector,
    vector_from_rotation,
)
from cellctl.calibration.six_dof.solve import solve
from tests.arm_poses import looks

KINDS: tuple[Kind, Kind] = ("eye_in_hand", "eye_to_hand")
vectors = st.tuples(*[st.floats(-2.2, 2.2)] * 3).map(np.array)


@given(vectors)
@settings(max_examples=60, deadline=None)
def test_rotations_are_scipys_and_come_back(vector):
    turn = rotation_from_vector(vector)
    assert turn == pytest.approx(Rotation.from_rotvec(vector).as_matrix(), abs=1e-12)
    assert rotation_from_vector(vector_from_rotation(turn)) == pytest.approx(turn, abs=1e-9)
    assert rotation_from_quaternion(quaternion_from_rotation(turn)) == pytest.approx(turn, abs=1e-12)


@given(vectors, st.integers(0, 2))
@settings(max_examples=30, deadline=None)
def test_the_derivative_of_a_rotation_vector_is_its_slope(vector, axis):
    step = np.eye(3)[axis] * 1e-6
    there, back = (vector_from_rotation(rotation_from_vector(s * step) @ rotation_from_vector(vector)) for s in (1, -1))
    if np.linalg.norm(vector) < 3.0:
        assert left_jacobian_inverse(vector)[:, axis] == pytest.approx((there - back) / 2e-6, abs=1e-4)


def test_half_a_turn_about_any_axis_is_read():
    for axis in (*np.eye(3), np.array([0.6, -0.8, 0.0])):
        found = vector_from_rotation(rotation_from_vector(axis * np.pi))
        assert np.linalg.norm(found) == pytest.approx(np.pi)
        assert np.abs(found @ axis) == pytest.approx(np.pi)


def off(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Error of a pose along its carrier's axes: mm, rad."""
    return np.concatenate([found[:3, 3] - true[:3, 3], vector_from_rotation(found[:3, :3] @ true[:3, :3].T)])


@pytest.mark.parametrize("kind", KINDS)
def test_without_noise_the_camera_and_the_target_come_back_exactly(kind):
    camera, target, pairs = looks(np.random.default_rng(1), kind, noise=0.0)
    rough, found = closed_form(pairs), solve(pairs)
    assert rough.camera == pytest.approx(camera, abs=1e-6)
    assert found.camera == pytest.approx(camera, abs=1e-6)
    assert found.target == pytest.approx(target, abs=1e-6)
    assert found.left_out == ()


@pytest.mark.parametrize("kind", KINDS)
def test_the_jacobian_is_the_derivative(kind):
    camera, target, pairs = looks(np.random.default_rng(2), kind, 5)
    pairs = replace(pairs, swing=np.random.default_rng(3).normal(0, 1, (5, 6)))
    problem = Sightings(pairs, Solution(camera, target), Sigmas(1.0, 2.0, 0.5, 0.2))
    x = np.random.default_rng(4).normal(0, 0.1, 13)
    for column, step in enumerate(np.eye(13) * 1e-6):
        slope = (problem.residuals(x + step) - problem.residuals(x - step)) / 2e-6
        assert problem.jacobian(x)[:, :, column] == pytest.approx(slope, abs=1e-4), column


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_nearer_the_truth_than_all_of_opencvs_methods_and_knows_how_near(kind):
    errors: dict[str, list[float]] = {name: [] for name in (OURS, *METHODS)}
    squares = []
    for seed in range(12):
        camera, _, pairs = looks(np.random.default_rng(seed), kind)
        found = solve(pairs)
        away = off(found.camera, camera)
        squares.append(away @ np.linalg.solve(found.covariance, away) / 6)
        errors[OURS].append(float(np.linalg.norm(away[:3])))
        for name in METHODS:
            errors[name].append(float(np.linalg.norm(off(opencv_camera(name, pairs), camera)[:3])))
    medians = {name: np.median(values) for name, values in errors.items()}
    assert all(medians[OURS] < 0.9 * medians[name] for name in METHODS), medians
    assert 0.5 < np.mean(squares) < 1.9  # chi square of 72: 99.9 % within 0.55 to 1.6, noise is estimated too


def test_wrong_rows_are_left_out_and_named():
    camera, _, pairs = looks(np.random.default_rng(5), "eye_in_hand", 30)
    target = pairs.target.copy()
    target[4, :3, 3] += (0, 1.5, 0)
    target[17, :3, :3] = rotation_from_vector(np.radians([0.0, 3.0, 0.0])) @ target[17, :3, :3]
    target[20] = target[3]
    found = solve(replace(pairs, target=target))
    assert set(found.left_out) >= {"row 5", "row 18", "row 21"}
    assert len(found.left_out) <= 5
    assert np.linalg.norm(off(found.camera, camera)[:3]) < 0.08
    text = report_text(found)
    assert "row 5" in text
    assert as_dict(found)["used"] == len(found.pairs)


def test_an_inverted_pose_is_named_as_the_cause():
    _, _, pairs = looks(np.random.default_rng(6), "eye_in_hand", 20)
    for wrong in (replace(pairs, kind="eye_to_hand"), replace(pairs, target=inverse(pairs.target))):
        with pytest.raises(PosesDisagree, match="check which of robot_from_tool and tool_from_robot"):
            solve(wrong)


def test_poses_that_do_not_belong_together_are_refused():
    _, _, pairs = looks(np.random.default_rng(7), "eye_to_hand", 20)
    with pytest.raises(PosesDisagree, match="no camera explains the poses"):
        solve(replace(pairs, target=pairs.target[::-1].copy()))


# -- what a motion cannot tell -----------------------------------------------------------------------------------------


def scara(count: int = 15, seed: int = 0, axis: tuple[float, float, float] = (0.0, 0.0, 1.0)):
    """A robot that turns about one axis only, its camera, and what they report."""
    rng = np.random.default_rng(seed)
    camera, target = rigid(rotation_from_vector(np.array([3.0, 0.2, 0.1])), [50.0, 10.0, 80.0]), np.eye(4)
    turns = rotation_from_vector(np.linspace(-0.8, 0.8, count)[:, None] * np.array(axis))
    robot = rigid(turns, rng.uniform(-40, 40, (count, 3)))
    seen = inverse(camera) @ inverse(robot) @ target
    return camera, Pairs("eye_in_hand", robot, seen, tuple(map(str, range(count))))


def test_with_one_axis_of_rotation_the_direction_that_stays_unknown_is_named():
    _, pairs = scara()
    with pytest.raises(DegenerateMotion, match="place along the z axis of the tool frame cannot be found") as refused:
        solve(pairs)
    assert refused.value.check == "one axis of rotation"
    assert "--along-axis-mm" in refused.value.detail
    _, slanted = scara(axis=(0.6, 0.0, 0.8))
    with pytest.raises(DegenerateMotion, match=r"the direction \(\+0\.60, [+-]0\.00, \+0\.80\) of the tool frame"):
        check_freedom("eye_in_hand", slanted.robot)


def test_the_one_missing_number_completes_a_scaras_camera():
    camera, pairs = scara()
    found = solve(pairs, along_axis_mm=80.0)
    assert found.camera == pytest.approx(camera, abs=1e-3)
    assert "80 mm that were given" in report_text(found)
    _, still = scara()
    turning = replace(still, robot=rigid(still.robot[:, :3, :3], np.zeros((15, 3))))
    with pytest.raises(DegenerateMotion, match="how the camera is turned about that axis cannot be found"):
        solve(turning, along_axis_mm=80.0)


def test_without_rotation_nothing_but_the_direction_can_be_found():
    robot = rigid(np.broadcast_to(np.eye(3), (8, 3, 3)), np.random.default_rng(0).uniform(-50, 50, (8, 3)))
    with pytest.raises(DegenerateMotion, match="the camera's place cannot be found in any direction"):
        check_freedom("eye_to_hand", robot)
    with pytest.raises(DegenerateMotion, match="2 poses are given"):
        check_freedom("eye_to_hand", robot[:2])


@pytest.mark.parametrize("kind", KINDS)
def test_what_noise_does_is_known_before_any_picture(kind):
    """The prediction from the robot's poses alone against the scatter of solutions."""
    camera, target, pairs = looks(np.random.default_rng(8), kind, noise=0.0)
    places, sd_mm = [], 0.05
    for seed in range(40):
        seen = pairs.target.copy()
        seen[:, :3, 3] += np.random.default_rng(seed).normal(0, sd_mm, (15, 3))
        problem = Sightings(replace(pairs, target=seen), Solution(camera, target), Sigmas(sd_mm, sd_mm, 1e-6, 1e-6))
        normal = problem.normal(problem.start)
        places.append((camera[:3, :3] @ normal.step(0.0)[:3]) @ check_freedom(kind, pairs.robot).directions.T)
    assert np.std(places, axis=0) == pytest.approx(amplification(kind, pairs.robot) * sd_mm, rel=0.4)


def test_opencvs_methods_are_shown_beside_ours_also_when_they_fail():
    _, pairs = scara()
    judged = compare(pairs, Sigmas(0.01, 0.01, 0.01, 0.01))
    assert [one.name for one in judged] == [OURS, *METHODS]
    assert OURS in compare_text(judged)


# -- two clocks --------------------------------------------------------------------------------------------------------


@given(st.floats(-1.5, 1.5), st.integers(0, 100))
@settings(max_examples=8, deadline=None)
def test_the_delay_between_two_streams_is_found_from_how_they_turn(delay_s, seed):
    rng = np.random.default_rng(seed)
    knots = rotation_from_vector(np.cumsum(rng.normal(0, 0.15, (40, 3)), axis=0))
    arm = Stream(np.arange(40) * 0.5, rigid(knots, rng.uniform(-100, 100, (40, 3))))
    robot_s, camera_s = np.arange(3, 17, 0.02), np.arange(3.2, 16.5, 0.033)
    robot = Stream(robot_s, arm.at(robot_s))
    camera = Stream(camera_s, arm.at(camera_s + delay_s))
    assert estimate_delay(robot, camera).robot_ahead_s == pytest.approx(delay_s, abs=0.01)


def test_streams_of_different_runs_are_refused():
    rng = np.random.default_rng(0)
    times = np.arange(0, 15, 0.03)
    steps = (rng.normal(0, 0.05, (len(times), 3)) for _ in range(2))
    turns = [rotation_from_vector(np.cumsum(each, axis=0)) for each in steps]
    one, other = (Stream(times, rigid(turn, np.zeros((len(times), 3)))) for turn in turns)
    with pytest.raises(PosesDisagree, match="do not turn alike"):
        estimate_delay(one, other)
