"""Hand-eye of a SCARA for every mount, against cells whose truth the test knows."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from cellctl.assembly.map_error import MapError
from cellctl.calibration.accuracy import Mark, pose_jacobian
from cellctl.calibration.adjustment import minimise
from cellctl.calibration.bundle import Bundle, Shots
from cellctl.calibration.hand_eye import HandEye, solve_hand_eye
from cellctl.calibration.parameters import SHARED, prior_sd
from cellctl.calibration.plane_map import Lens, PlaneMap
from cellctl.calibration.problem import Looks, tool_scatter
from cellctl.calibration.scara import Noise, Setup, pose_array
from cellctl.calibration.view import drawn_setup
from cellctl.geometry import Mm, Pose, Px
from tests.calibration_cells import (
    BOARD,
    CASES,
    CENTRE,
    KINDS,
    PICTURE,
    PX_PER_MM,
    QUIET,
    STATED,
    Cell,
    calibrated,
    differential_um,
    plan,
    planned,
    solved,
    true_cell,
)

IN_DEG = np.diag([1.0, 1.0, math.degrees(1.0)])
GRID_MM = np.stack(np.meshgrid(np.linspace(-8, 8, 9), np.linspace(-6, 6, 7)), -1).reshape(-1, 2)


@pytest.mark.parametrize("kind", KINDS)
def test_without_noise_camera_and_board_come_back_exactly(kind):
    cell = true_cell(kind, 3)
    found = calibrated(cell, noise=QUIET)
    assert cell.error_um(found.plane_map, GRID_MM).max() < 0.1  # the lens' centre is drawn to the picture's a little
    assert found.board == pytest.approx(cell.board, abs=1e-4)
    assert found.rms_px < 1e-3
    assert found.plane_map.mirrored() == (kind == "eye_in_hand")
    assert found.board_scale == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("mirrored", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_mirroring_and_any_rotation_of_camera_and_board_are_found(kind, mirrored):
    camera = Pose(55, 0, 117) if kind == "eye_in_hand" else Pose(300, -120, -63)
    board = Pose(340, -20, -140) if kind == "eye_in_hand" else Pose(5, -6, 75)
    setup = drawn_setup(kind, camera=camera, mirrored=mirrored, px_per_mm=110, board=board, picture_px=PICTURE)
    cell = Cell(kind, setup.plane_map, board, np.array(camera[:2]), np.zeros(2))
    found = calibrated(cell, noise=QUIET)
    assert found.plane_map.mirrored() == mirrored
    assert found.plane_map.rotation_deg == pytest.approx(camera.t_deg, abs=1e-4)
    assert found.board == pytest.approx(board, abs=1e-4)


TILTED = PlaneMap(
    ((110.0, 0.5), (-0.8, -109.0)), (-4700.0, 960.0), 2e-8, (1300.0, 970.0), (4e-4, -3e-4), -1e-15, 1e-22, 2e-7, -1e-7
)


def bundle_of(cell: Cell, lens: Lens, count: int = 15) -> tuple[Bundle, np.ndarray]:
    poses = pose_array(planned(cell, count=count))
    dots = cell.see(planned(cell, count=count), np.random.default_rng(6))
    shots = Shots(poses, dots, np.linspace(-0.5, 0.5, len(poses)), tool_scatter(STATED, len(poses)))
    believed = prior_sd(lens, PICTURE, PX_PER_MM)
    bundle = Bundle(cell.kind, shots, BOARD.points_mm, STATED.dot_sd_px, cell.axis_mm, CENTRE, believed)
    return bundle, bundle.unknowns(cell.setup)


@pytest.mark.parametrize("camera", [None, TILTED])
@pytest.mark.parametrize("kind", KINDS)
def test_the_jacobian_is_the_derivative(kind, camera):
    cell = true_cell(kind, 1)
    bundle, x = bundle_of(cell, "pinhole", 6)
    if camera is not None:
        x = replace(bundle, pivot_mm=np.array([52.0, 0.5])).unknowns(Setup(kind, camera, cell.board))
        bundle = replace(bundle, pivot_mm=np.array([52.0, 0.5]))
    x[18:21] = 3.0, -2.0, 0.004
    x[SHARED:] = np.random.default_rng(0).normal(0, 1, 18)
    shared, by_pose = bundle.jacobian(x)
    steps = {9: 1e-13, 12: 1e-19, 13: 1e-25, 14: 1e-11, 15: 1e-11, 16: 1e-8, 17: 1e-8, 20: 1e-7}
    for column in range(len(x)):
        step = np.zeros(len(x))
        step[column] = steps.get(column, max(1e-5, 1e-6 * abs(x[column])))
        rise = (bundle.px(x + step) - bundle.px(x - step)) / (2 * step[column])
        analytic = np.zeros_like(rise)
        if column < SHARED:
            analytic += shared[..., column]
        else:
            pose, correction = divmod(column - SHARED, 3)
            analytic[pose] = by_pose[pose, ..., correction]
        assert np.abs(rise - analytic).max() < 1e-4 * np.abs(analytic).max() + 1e-5, column


@pytest.mark.parametrize(
    ("kind", "lens"), [("eye_in_hand", "telecentric"), ("eye_to_hand", "telecentric"), ("eye_in_hand", "pinhole")]
)
def test_scipy_finds_the_same_minimum(kind, lens):
    """A second opinion on our own Levenberg-Marquardt, from residuals written down anew."""
    bundle, start = bundle_of(true_cell(kind, 3), lens)

    def residuals(x):
        away = (bundle.px(x) - bundle.shots.dots_px) / STATED.dot_sd_px
        believed = (x[9:SHARED] - [0.0, *CENTRE, *np.zeros(9)]) / bundle.believed_sd
        return np.concatenate([away.ravel(), x[SHARED:], believed])

    ours = minimise(bundle, start)
    theirs = least_squares(residuals, start, x_scale="jac", xtol=1e-12, ftol=1e-12)
    assert bundle.cost(ours) == pytest.approx(2 * theirs.cost, rel=1e-4)
    assert bundle.cost(ours) <= 2 * theirs.cost * (1 + 1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_the_solution_is_the_minimum(kind):
    bundle, start = bundle_of(true_cell(kind, 2), "telecentric")
    x = minimise(bundle, start)
    least = bundle.cost(x)
    curvature = np.sqrt(np.concatenate([np.diag(part) for part in (bundle.normal(x).ss, np.eye(45))]))
    for step in np.diag(1e-2 / curvature):
        assert bundle.cost(x + step) > least
        assert bundle.cost(x - step) > least


@pytest.fixture(scope="module", params=CASES)
def six(request) -> list[tuple[Cell, HandEye]]:
    """Six random cells of each case, calibrated with 15 poses by a robot of 3.3 um and 1.33 mdeg."""
    cells = [true_cell(request.param, seed) for seed in range(6)]
    return [(cell, calibrated(cell, seed)) for seed, cell in enumerate(cells)]


def test_fifteen_poses_give_ten_um_absolute(six):
    errors = np.array([np.sqrt((cell.error_um(found.plane_map, GRID_MM) ** 2).mean()) for cell, found in six])
    assert np.sqrt((errors**2).mean()) < 8
    assert errors.max() < 16


def test_differences_from_a_taught_part_are_good_to_one_um(six):
    rng = np.random.default_rng(4)
    errors = np.array([differential_um(cell, found.plane_map, rng) for cell, found in six])
    assert np.sqrt((errors**2).mean()) < 0.8
    assert np.sqrt((errors**2).mean(1)).max() < 1.6


def test_the_covariance_tells_the_true_error(six):
    for place in (Px(1295.5, 971.5), Px(300, 300), Px(2300, 1600)):
        squares = []
        for cell, found in six:
            away = np.subtract(found.plane_map.mm_at(place), cell.camera.mm_at(place))
            squares.append(away @ np.linalg.solve(found.covariance_mm2(place), away) / 2)
        assert 0.15 < np.mean(squares) < 2.8  # chi square of 12: 99.9 % within 0.18 to 2.74


def test_predictions_before_and_after_agree_with_each_other(six):
    for cell, found in six:
        assert found.predicted.absolute_um == pytest.approx(plan(cell).predicted.absolute_um, rel=0.5)
        assert found.predicted.absolute_um == pytest.approx(found.sd_um(Px(*CENTRE)), rel=1e-6)
        assert 2 < found.hold_out_um < 9


def test_more_rotation_gives_a_better_camera():
    cell = true_cell("eye_to_hand", 2)
    narrow, wide = plan(cell, rotation_deg=15.5), plan(cell, rotation_deg=90)
    assert wide.predicted.absolute_um < 0.4 * narrow.predicted.absolute_um
    errors = [cell.error_um(calibrated(cell, 1, rotation_deg=turn).plane_map, GRID_MM).mean() for turn in (15.5, 90)]
    assert errors[1] < errors[0]


def test_five_poses_suffice_and_say_that_they_are_worse():
    cell = true_cell("eye_in_hand", 5)
    few, many = calibrated(cell, count=5), calibrated(cell)
    assert cell.error_um(few.plane_map, np.zeros((1, 2)))[0] < 4 * few.predicted.absolute_um
    assert few.predicted.absolute_um > 1.2 * many.predicted.absolute_um


def test_a_robot_that_scatters_more_than_stated_is_noticed_and_counted_in():
    cell = true_cell("eye_to_hand", 6)
    found = calibrated(cell, noise=Noise(0.0066, 0.00266, 0.03))
    assert 1.5 < found.robot_factor < 2.6
    assert found.predicted.absolute_um > 1.5 * calibrated(cell).predicted.absolute_um


def test_fifteen_poses_solve_within_a_second():
    cell = true_cell("eye_in_hand", 7)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(0))
    started = time.thread_time()
    solved("eye_in_hand", poses, dots)
    assert time.thread_time() - started < 1.0


@pytest.mark.parametrize("case", CASES)
def test_pictures_at_several_heights_tell_how_the_picture_shifts_with_height(case):
    cell = true_cell(case, 4)
    found, rng = plan(cell), np.random.default_rng(1)
    below = np.resize([0.0, 0.5, -0.5], len(found.stops))
    scatter = cell.mount.scatter(found.stops, STATED.robot_sd_mm, STATED.robot_sd_deg)
    looks = Looks(found.poses, cell.see(found.stops, rng, below_mm=below), below, scatter)
    result = solve_hand_eye(cell.kind, looks, BOARD.points_mm)
    assert result.slope_known
    assert "um" in result.note.split("a mm of robot Z")[1]
    sd = np.sqrt(np.diag(result.covariance)[18:20])
    assert np.all(np.abs(result.slope_px_per_mm - cell.slope_px_per_mm) < 4 * sd)
    assert np.all(sd < 0.6)  # 4 um per mm
    assert cell.error_um(result.plane_map, GRID_MM).max() < 25
    deeper = result.plane_at(2.0)
    assert np.subtract(deeper.offset_px, result.plane_map.offset_px) == pytest.approx(2 * cell.slope_px_per_mm, abs=2)
    expected_um = np.linalg.solve(cell.camera.matrix, cell.slope_px_per_mm) * 1000
    assert result.slope_um_per_mm == pytest.approx(expected_um, abs=6)


def test_at_one_height_the_slope_is_said_to_be_unknown():
    result = calibrated(true_cell("eye_in_hand", 4))
    assert not result.slope_known
    assert "nor is its slope" in result.note
    assert result.slope_px_per_mm == pytest.approx((0, 0), abs=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_an_ordinary_lens_over_a_plane_is_calibrated_as_well(kind):
    cell = true_cell(kind, 5)
    x, y = cell.axis_mm.tolist()
    tilt = np.array([3e-4, -2e-4])
    depth = 1 + float(tilt @ (x, y))
    matrix = (cell.camera.matrix + np.outer(CENTRE, tilt) / depth) * depth
    offset = CENTRE * depth - matrix @ (x, y)
    pinhole = PlaneMap(
        tuple(map(tuple, matrix.tolist())), tuple(offset.tolist()), -2.5e-8, tuple(CENTRE + 20), tuple(tilt.tolist())
    )
    seen = replace(cell, camera=pinhole)
    poses = planned(cell)
    dots = seen.see(poses, np.random.default_rng(0))
    found = solve_hand_eye(kind, Looks(poses, dots), BOARD.points_mm, lens="pinhole")
    assert found.rms_px < 0.035
    assert found.plane_map.k1_per_px2 == pytest.approx(-2.5e-8, rel=0.1)
    assert np.sqrt((seen.error_um(found.plane_map, GRID_MM * 0.6) ** 2).mean()) < 12


def test_the_uncertainty_of_a_difference_is_that_of_the_differences(six):
    """Errors of a part's pose against its taught pose, both measured through the map, over their covariance."""
    mark = Mark(Mm(1.0, -2.0), (Mm(-6.0, 3.0), Mm(7.0, 3.0)))
    squares, absolute, angles = [], [], []
    for seed, (cell, found) in enumerate(six):
        rng = np.random.default_rng(seed)
        x, y = cell.axis_mm.tolist()
        taught = Pose(x, y, 20.0)
        moved = taught @ Pose(*rng.uniform(-1, 1, 2).tolist(), float(rng.uniform(-1.5, 1.5)))
        at, there = (_measured(cell, found, pose, mark) for pose in (taught, moved))
        away = _error(moved, there) - _error(taught, at)  # each in its own frame, as a placement has them
        spread = MapError.of("map", found.plane_map, found.covariance, taught, mark).at(moved).covariance
        spread = IN_DEG @ spread @ IN_DEG
        squares.append(away @ np.linalg.solve(spread, away) / 3)
        alone, by_map = _error(moved, there), pose_jacobian(found.plane_map, moved, mark)
        alone_spread = by_map @ found.covariance @ by_map.T
        absolute.append(alone @ np.linalg.solve(alone_spread, alone) / 3)
        angles.append(math.sqrt(spread[2, 2]))
    assert 0.2 < np.mean(squares) < 2.4  # chi square of 18: 99.9 % within 0.27 to 2.35
    assert 0.2 < np.mean(absolute) < 2.4
    assert max(angles) < 0.001  # 1 mdeg: what a camera's own direction costs cancels


def _measured(cell: Cell, found: HandEye, pose: Pose, mark: Mark) -> Pose:
    seen = cell.camera.px_from_mm([pose.point(*point) for point in (mark.point, *mark.line)])
    point, start, end = found.plane_map.mm_from_px(seen)
    way, drawn_way = end - start, np.subtract(mark.line[1], mark.line[0])
    t_deg = math.degrees(math.atan2(way[1], way[0]) - math.atan2(drawn_way[1], drawn_way[0]))
    turned = Pose(0.0, 0.0, t_deg).point(*mark.point)
    return Pose(point[0] - turned.x_mm, point[1] - turned.y_mm, t_deg)


def _error(true: Pose, found: Pose) -> np.ndarray:
    return np.array(true.inverse() @ found)
