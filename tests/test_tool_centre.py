"""The tool's rotation centre and the run-out of what it holds."""

import math
from dataclasses import replace

import numpy as np
import pytest

from cellctl.calibration.errors import DegenerateMotion, PosesDisagree
from cellctl.calibration.plan import plan_tool_centre
from cellctl.calibration.report import tool_centre_text
from cellctl.calibration.tool_centre import solve_tool_centre
from cellctl.geometry import Mm, Pose
from tests.calibration_cells import BOARD, PX_PER_MM, QUIET, Cell, calibrated, task, true_cell


def turning(cell: Cell) -> tuple[Pose, ...]:
    return plan_tool_centre(task(cell.setup))


def test_without_noise_the_rotation_centre_is_where_the_robot_stands():
    cell = true_cell("eye_to_hand", 20)
    poses = turning(cell)
    found = solve_tool_centre(poses, cell.see(poses, np.random.default_rng(0), QUIET), BOARD.points_mm, cell.camera)
    assert found.centre_px == pytest.approx(cell.camera.px_at(Mm(poses[0].x_mm, poses[0].y_mm)), abs=1e-3)
    assert found.board_mm == pytest.approx(cell.board[:2], abs=1e-5)
    assert found.error_um < 0.01
    assert found.wobble_worst_um < 0.01
    middle = cell.board.point(*BOARD.centre_mm.tolist())
    assert found.eccentricity_mm == pytest.approx(middle, abs=1e-5)


def test_the_rotation_centre_scatters_as_its_covariance_says():
    cell = true_cell("eye_to_hand", 21)
    poses = turning(cell)
    errors, expected, run_out = [], [], []
    middle = np.array(cell.board.point(*BOARD.centre_mm.tolist()))
    for seed in range(60):
        found = solve_tool_centre(poses, cell.see(poses, np.random.default_rng(seed)), BOARD.points_mm, cell.camera)
        errors.append(found.error_um)
        expected.append(found.sd_um)
        off_um = (np.array(found.eccentricity_mm) - middle) * 1000
        run_out.append(off_um @ np.linalg.solve(found.eccentricity_covariance_um2, off_um) / 2)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.mean(expected), rel=0.25)
    assert np.mean(expected) < 4
    assert np.mean(run_out) == pytest.approx(1.0, abs=0.4)


def test_the_wobble_of_the_axis_is_measured():
    cell = true_cell("eye_to_hand", 22)
    poses = turning(cell)
    wobble = [pose._replace(x_mm=pose.x_mm + 0.02 * math.cos(i * 2.5)) for i, pose in enumerate(poses)]
    found = solve_tool_centre(poses, cell.see(wobble, np.random.default_rng(0), QUIET), BOARD.points_mm, cell.camera)
    assert 8 < found.wobble_rms_um < 15
    assert found.wobble_worst_um < 25


def test_a_hand_eye_map_that_is_off_does_not_agree_with_the_rotation_centre():
    cell = true_cell("eye_to_hand", 23)
    hand_eye = calibrated(cell)
    poses = turning(cell)
    dots = cell.see(poses, np.random.default_rng(9))
    good = solve_tool_centre(poses, dots, BOARD.points_mm, hand_eye.plane_map)
    known_um = hand_eye.sd_um(good.centre_px)
    assert "expected: agrees" in tool_centre_text(good, known_um)
    assert f"+-{good.eccentricity_sd_um:.1f} um" in tool_centre_text(good, known_um)
    u, v = hand_eye.plane_map.offset_px
    shifted = replace(hand_eye.plane_map, offset_px=(u + 0.05 * PX_PER_MM, v))
    bad = solve_tool_centre(poses, dots, BOARD.points_mm, shifted)
    assert bad.error_um == pytest.approx(50, abs=15)
    assert "DOES NOT AGREE" in tool_centre_text(bad, known_um)


def test_rotations_that_are_none_are_refused():
    cell = true_cell("eye_to_hand", 24)
    poses = turning(cell)
    dots = cell.see(poses, np.random.default_rng(0))
    turned = [pose._replace(t_deg=-pose.t_deg) for pose in poses]
    with pytest.raises(PosesDisagree, match="sign of R"):
        solve_tool_centre(turned, dots, BOARD.points_mm, cell.camera)
    with pytest.raises(DegenerateMotion, match=r"2 rotations over 15\.0 deg"):
        solve_tool_centre(poses[:2], dots[:2], BOARD.points_mm, cell.camera)
    moved = [poses[0]._replace(x_mm=0), *poses[1:]]
    with pytest.raises(DegenerateMotion, match="turn it at one X, Y"):
        solve_tool_centre(moved, dots, BOARD.points_mm, cell.camera)
    with pytest.raises(ValueError, match="dots must be"):
        solve_tool_centre(poses, dots[:, :5], BOARD.points_mm, cell.camera)
