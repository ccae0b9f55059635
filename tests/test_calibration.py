"""Calibration mathematics against cells whose truth the test knows. The forward model here is written with poses."""

import json
import math
import time
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from cellctl.calibration.board import DotBoard
from cellctl.calibration.bundle import LENS_SD, Bundle, minimise
from cellctl.calibration.errors import CalibrationError, DegenerateMotion, PlanImpossible, PosesDisagree
from cellctl.calibration.hand_eye import HandEye, solve_hand_eye
from cellctl.calibration.motion import check_motion, motion_spread, rotation_spread_deg
from cellctl.calibration.plan import PlanRequest, plan_hand_eye, plan_tool_centre
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.report import Acceptance, coverage, report_picture, report_text, shortcomings, tool_centre_text
from cellctl.calibration.rough import rough_setup, rough_steps
from cellctl.calibration.scara import Kind, Noise, Setup, pose_array
from cellctl.calibration.tool_centre import solve_tool_centre
from cellctl.calibration.view import board_in_view, drawn_setup, pose_seeing, start_pose
from cellctl.geometry import Mm, Pose, Px

BOARD = DotBoard()
PICTURE = (2592, 1944)
CENTRE = np.array([1295.5, 971.5])
PX_PER_MM = 1000 / (2.2 / 0.3)
KINDS: tuple[Kind, Kind] = ("eye_in_hand", "eye_to_hand")
QUIET = Noise(1e-9, 1e-9, 1e-9)
STATED = Noise()


@dataclass(frozen=True, eq=False)
class Cell:
    """A cell as it truly is."""

    kind: Kind
    camera: PlaneMap
    board: Pose
    axis_mm: np.ndarray

    @property
    def setup(self) -> Setup:
        return Setup(self.kind, self.camera, self.board)

    def see(self, poses, rng, noise=STATED) -> np.ndarray:
        """Dots (n, m, 2) px of pictures taken at poses that the robot reaches only to its repeatability."""
        pictures = []
        for pose in poses:
            dx, dy, dt = rng.normal(0, (noise.robot_sd_mm, noise.robot_sd_mm, noise.robot_sd_deg))
            true = Pose(pose.x_mm + dx, pose.y_mm + dy, pose.t_deg + dt)
            plane = true.inverse() @ self.board if self.kind == "eye_in_hand" else true @ self.board
            pictures.append(self.camera.px_from_mm([plane.point(*point) for point in BOARD.points_mm.tolist()]))
        return np.array(pictures) + rng.normal(0, noise.dot_sd_px, (len(pictures), BOARD.count, 2))

    def error_um(self, camera: PlaneMap, offsets_mm) -> np.ndarray:
        """Length of the map's error at points around the camera's axis."""
        points = self.axis_mm + offsets_mm
        return np.hypot(*(camera.mm_from_px(self.camera.px_from_mm(points)) - points).T) * 1000


@cache
def true_cell(kind: Kind, seed: int) -> Cell:
    """Mounts off by 1.5 mm and 3 degrees, a lens within its tolerance."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    turn, tilt_x, tilt_y = np.radians([rng.uniform(-3, 3), *rng.normal(0, 0.4, 2)])
    view = np.diag([1.0, -1.0]) if kind == "eye_in_hand" else np.eye(2)
    tilt = np.array([[math.cos(tilt_x), 0], [math.sin(tilt_x) * math.sin(tilt_y), math.cos(tilt_y)]])
    turned = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    matrix = PX_PER_MM * (1 + rng.normal(0, 5e-4)) * view @ turned @ tilt
    axis = np.array((55.0, 0.0) if kind == "eye_in_hand" else (300.0, -120.0)) + rng.uniform(-1.5, 1.5, 2)
    k1, lens_centre = rng.uniform(-3e-10, 3e-10), CENTRE + rng.normal(0, 60, 2)
    drawn = Pose(340.0, -20.0, 0.0) if kind == "eye_in_hand" else Pose(-4.8, -3.6, 0.0)
    board = Pose(drawn.x_mm + rng.uniform(-1, 1), drawn.y_mm + rng.uniform(-1, 1), rng.uniform(-3, 3))
    return Cell(kind, PlaneMap.from_arrays(matrix, CENTRE - matrix @ axis, k1, lens_centre), board, axis)


def drawn(kind: Kind) -> Setup:
    hand = kind == "eye_in_hand"
    return drawn_setup(
        kind,
        camera=Pose(55, 0, 0) if hand else Pose(300, -120, 0),
        mirrored=hand,
        px_per_mm=PX_PER_MM,
        board=Pose(340, -20, 0) if hand else Pose(-4.8, -3.6, 0),
        picture_px=PICTURE,
    )


def anywhere(pose: Pose) -> bool:
    return True


@cache
def planned(cell: Cell, **wishes) -> tuple[Pose, ...]:
    return plan_hand_eye(cell.setup, BOARD, PICTURE, anywhere, PlanRequest(margin_mm=0.3, **wishes)).poses


def calibrated(cell: Cell, seed: int = 0, noise: Noise = STATED, **wishes) -> HandEye:
    poses = planned(cell, **wishes)
    return solve_hand_eye(cell.kind, poses, cell.see(poses, np.random.default_rng(seed), noise), BOARD.points_mm)


# -- the plane map -----------------------------------------------------------------------------------------------------

finite = {"allow_nan": False, "allow_infinity": False}
maps = st.builds(
    lambda scale, turn, mirrored, squeeze, shear, axis, k1, centre: PlaneMap.from_arrays(
        matrix := scale
        * np.diag([1.0, -1.0 if mirrored else 1.0])
        @ np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
        @ np.array([[1.0, shear], [0.0, squeeze]]),
        CENTRE - matrix @ np.array(axis),
        k1,
        CENTRE + np.array(centre),
    ),
    st.floats(20, 400),
    st.floats(-math.pi, math.pi),
    st.booleans(),
    st.floats(0.95, 1.0),
    st.floats(-0.05, 0.05),
    st.tuples(st.floats(-400, 400), st.floats(-400, 400)),
    st.floats(-2e-9, 2e-9),
    st.tuples(st.floats(-300, 300), st.floats(-300, 300)),
)


@given(maps, st.lists(st.tuples(st.floats(-500, 3100), st.floats(-500, 2500)), min_size=1, max_size=20))
@settings(max_examples=80, deadline=None)
def test_px_to_mm_and_mm_to_px_undo_each_other(camera, points):
    points_px = np.array(points)
    mm = camera.mm_from_px(points_px)
    assert np.abs(camera.px_from_mm(mm) - points_px).max() < 1e-9
    assert np.abs(camera.mm_from_px(camera.px_from_mm(mm)) - mm).max() < 1e-9


@given(maps)
@settings(max_examples=50, deadline=None)
def test_a_map_survives_its_file_to_the_last_digit(camera):
    assert PlaneMap.from_dict(json.loads(json.dumps(camera.as_dict()))) == camera


def test_a_camera_that_looks_down_sees_x_to_the_right_and_y_upwards():
    camera = drawn("eye_in_hand").plane_map
    middle, right, up = camera.px_from_mm([(55, 0), (56, 0), (55, 1)])
    assert np.allclose(right - middle, (PX_PER_MM, 0))
    assert np.allclose(up - middle, (0, -PX_PER_MM))
    assert camera.mirrored()


def test_a_camera_that_looks_up_sees_x_to_the_right_and_y_downwards():
    camera = drawn("eye_to_hand").plane_map
    middle, right, down = camera.px_from_mm([(300, -120), (301, -120), (300, -119)])
    assert np.allclose(right - middle, (PX_PER_MM, 0))
    assert np.allclose(down - middle, (0, PX_PER_MM))
    assert not camera.mirrored()


@pytest.mark.parametrize("mirrored", [True, False])
def test_the_rotation_is_where_the_u_axis_points(mirrored):
    setup = drawn_setup(
        "eye_in_hand", camera=Pose(3, 4, 20), mirrored=mirrored, px_per_mm=100, board=Pose(0, 0, 0), picture_px=PICTURE
    )
    start, end = setup.plane_map.mm_from_px([(1000, 900), (1100, 900)])
    assert math.degrees(math.atan2(*(end - start)[::-1])) == pytest.approx(20)
    assert setup.plane_map.rotation_deg == pytest.approx(20)
    assert setup.plane_map.mm_at(Px(*CENTRE)) == pytest.approx((3, 4))
    assert setup.plane_map.mm_per_px == pytest.approx(0.01)


def test_a_tilt_shows_as_squeeze():
    camera = PlaneMap(((100.0, 0.0), (0.0, 100.0 * math.cos(math.radians(2)))), (0.0, 0.0), 0.0, (0.0, 0.0))
    assert camera.tilt_deg == pytest.approx(2)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"matrix_px_per_mm": ((0.0, 0.0), (0.0, 0.0))}, "scale"),
        ({"matrix_px_per_mm": ((100.0, 100.0), (100.0, 100.0))}, "scale"),
        ({"matrix_px_per_mm": ((100.0, 0.0), (0.0, 60.0))}, "differ"),
        ({"offset_px": (math.nan, 0.0)}, "finite"),
        ({"k1_per_px2": 1e-6}, "k1"),
    ],
)
def test_a_map_that_no_camera_has_is_refused(changed, says):
    good = drawn("eye_in_hand").plane_map
    with pytest.raises(ValueError, match=says):
        replace(good, **changed)


def test_a_point_far_outside_a_barrel_lens_is_refused():
    camera = replace(drawn("eye_to_hand").plane_map, k1_per_px2=-4e-9)
    with pytest.raises(ValueError, match="px from the distortion centre"):
        camera.px_from_mm([(400, 100)])
    with pytest.raises(ValueError, match="px from the distortion centre"):
        camera.mm_from_px([(30000, 0)])


@pytest.mark.parametrize("points", [[1.0, 2.0], [[1.0, 2.0, 3.0]], [[math.inf, 0.0]]])
def test_points_of_the_wrong_shape_are_refused(points):
    with pytest.raises(ValueError, match="points must be"):
        drawn("eye_to_hand").plane_map.px_from_mm(points)


json_like = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-5, 5) | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=6,
)
KEYS = ["matrix_px_per_mm", "offset_px", "k1_per_px2", "distortion_centre_px"]


@given(st.dictionaries(st.sampled_from([*KEYS, "extra"]), json_like))
@example({**drawn("eye_in_hand").plane_map.as_dict(), "k1_per_px2": True})
@example({**drawn("eye_in_hand").plane_map.as_dict(), "extra": 0.0})
@settings(max_examples=60, deadline=None)
def test_a_wrong_table_is_refused_with_a_sentence(table: dict[str, Any]):
    with pytest.raises(ValueError, match="plane map:"):
        PlaneMap.from_dict(table)


# -- what poses must offer ---------------------------------------------------------------------------------------------


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
        check_motion(poses) if dots is None else solve_hand_eye(kind, poses, dots, BOARD.points_mm)
    assert refused.value.check == check
    assert ": " in refused.value.detail  # the remedy


# -- hand-eye ----------------------------------------------------------------------------------------------------------

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
    cell = Cell(kind, setup.plane_map, board, np.array(camera[:2]))
    found = calibrated(cell, noise=QUIET)
    assert found.plane_map.mirrored() == mirrored
    assert found.plane_map.rotation_deg == pytest.approx(camera.t_deg, abs=1e-4)
    assert found.board == pytest.approx(board, abs=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_the_jacobian_is_the_derivative(kind):
    cell = true_cell(kind, 1)
    poses = pose_array(planned(cell, count=6))
    bundle = Bundle(kind, poses, BOARD.points_mm, STATED, cell.axis_mm, CENTRE)
    x = bundle.unknowns(cell.setup)
    x[12:] = np.random.default_rng(0).normal(0, 1, 18)
    shared, by_pose = bundle.jacobian(x)
    for column in range(len(x)):
        step = np.zeros(len(x))
        step[column] = 1e-13 if column == 9 else max(1e-5, 1e-6 * abs(x[column]))
        rise = (bundle.px(x + step) - bundle.px(x - step)) / (2 * step[column])
        analytic = np.zeros_like(rise)
        if column < 12:
            analytic += shared[..., column]
        else:
            pose, correction = divmod(column - 12, 3)
            analytic[pose] = by_pose[pose, ..., correction]
        assert np.abs(rise - analytic).max() < 1e-4 * np.abs(analytic).max() + 1e-5


@pytest.mark.parametrize("kind", KINDS)
def test_scipy_finds_the_same_minimum(kind):
    """A second opinion on our own Levenberg-Marquardt, from residuals written down anew."""
    cell = true_cell(kind, 3)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(6))
    bundle = Bundle(kind, pose_array(poses), BOARD.points_mm, STATED, cell.axis_mm, CENTRE)
    start = bundle.unknowns(cell.setup)
    expected_lens = np.array([0.0, *CENTRE])

    def residuals(x):
        away = (bundle.px(x) - dots) / STATED.dot_sd_px
        return np.concatenate([away.ravel(), x[12:], (x[9:12] - expected_lens) / LENS_SD])

    theirs = least_squares(residuals, start, x_scale="jac", xtol=1e-12, ftol=1e-12)
    ours = minimise(bundle, start, dots)
    assert bundle.cost(ours, dots) == pytest.approx(2 * theirs.cost, rel=1e-5)
    sigma = np.sqrt(np.diag(bundle.normal(ours, dots).covariance()))
    assert np.abs((ours - theirs.x)[:12] / sigma).max() < 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_the_solution_is_the_minimum(kind):
    cell = true_cell(kind, 2)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(5))
    bundle = Bundle(kind, pose_array(poses), BOARD.points_mm, STATED, cell.axis_mm, CENTRE)
    x = minimise(bundle, bundle.unknowns(cell.setup), dots)
    least = bundle.cost(x, dots)
    curvature = np.sqrt(np.concatenate([np.diag(part) for part in (bundle.normal(x, dots).ss, np.eye(45))]))
    for step in np.diag(1e-2 / curvature):
        assert bundle.cost(x + step, dots) > least
        assert bundle.cost(x - step, dots) > least


@pytest.fixture(scope="module", params=KINDS)
def thirty(request) -> list[tuple[Cell, HandEye]]:
    """Fifteen random cells of each mount, calibrated with 15 poses by a robot of 3.3 um and 1.33 mdeg."""
    cells = [true_cell(request.param, seed) for seed in range(15)]
    return [(cell, calibrated(cell, seed)) for seed, cell in enumerate(cells)]


def test_fifteen_poses_give_ten_um_absolute(thirty):
    errors = np.array([np.sqrt((cell.error_um(found.plane_map, GRID_MM) ** 2).mean()) for cell, found in thirty])
    assert np.sqrt((errors**2).mean()) < 8
    assert errors.max() < 16


def test_differences_from_a_taught_part_are_good_to_one_um(thirty):
    rng = np.random.default_rng(4)
    errors = np.array([_differential_um(cell, found.plane_map, rng) for cell, found in thirty])
    assert np.sqrt((errors**2).mean()) < 0.8
    assert np.sqrt((errors**2).mean(1)).max() < 1.6


def _differential_um(cell: Cell, camera: PlaneMap, rng) -> np.ndarray:
    """A feature of a part that moved by +-1 mm and +-1.5 deg, turned back about the tool: error of its travel."""
    taught = cell.axis_mm + np.array([5, 3])
    moves, turns = rng.uniform(-1, 1, (100, 2)), np.radians(rng.uniform(-1.5, 1.5, 100))
    at = camera.mm_from_px(cell.camera.px_from_mm(taught[None]))[0]
    wrong = camera.mm_from_px(cell.camera.px_from_mm(taught + moves)) - (taught + moves)
    c, s = np.cos(turns) - 1, np.sin(turns)
    lever = np.stack([c * wrong[:, 0] - s * wrong[:, 1], s * wrong[:, 0] + c * wrong[:, 1]], -1)
    return np.hypot(*(wrong - (at - taught) + lever).T) * 1000


def test_the_covariance_tells_the_true_error(thirty):
    for place in (Px(1295.5, 971.5), Px(300, 300), Px(2300, 1600)):
        squares = []
        for cell, found in thirty:
            away = np.subtract(found.plane_map.mm_at(place), cell.camera.mm_at(place))
            squares.append(away @ np.linalg.solve(found.covariance_mm2(place), away) / 2)
        assert 0.4 < np.mean(squares) < 2.2  # chi square of 30: 99.9 % within 0.36 to 2.0


def test_predictions_before_and_after_agree_with_each_other(thirty):
    for cell, found in thirty:
        poses = [fit.pose for fit in found.poses]
        plan = plan_hand_eye(cell.setup, BOARD, PICTURE, anywhere, PlanRequest(margin_mm=0.3))
        assert list(plan.poses) == poses
        assert found.predicted.absolute_um == pytest.approx(plan.predicted.absolute_um, rel=0.5)
        assert found.predicted.absolute_um == pytest.approx(found.sd_um(Px(*CENTRE)), rel=1e-6)
        assert 2 < found.hold_out_um < 9


def test_more_rotation_gives_a_better_camera():
    cell = true_cell("eye_to_hand", 2)
    narrow = plan_hand_eye(cell.setup, BOARD, PICTURE, anywhere, PlanRequest(rotation_deg=15.5))
    wide = plan_hand_eye(cell.setup, BOARD, PICTURE, anywhere, PlanRequest(rotation_deg=45, margin_mm=0))
    assert wide.predicted.absolute_um < 0.6 * narrow.predicted.absolute_um


def test_five_poses_suffice_and_say_that_they_are_worse():
    cell = true_cell("eye_in_hand", 5)
    few, many = calibrated(cell, count=5), calibrated(cell)
    assert cell.error_um(few.plane_map, np.zeros((1, 2)))[0] < 4 * few.predicted.absolute_um
    assert few.predicted.absolute_um > 1.3 * many.predicted.absolute_um


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
    solve_hand_eye("eye_in_hand", poses, dots, BOARD.points_mm)
    assert time.thread_time() - started < 1.0


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
        solve_hand_eye(kind, [WRONG[says](pose) for pose in poses], dots, BOARD.points_mm)


@pytest.mark.parametrize("kind", KINDS)
def test_the_wrong_mount_is_found_and_named(kind):
    cell = true_cell(kind, 9)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(1))
    other: Kind = "eye_to_hand" if kind == "eye_in_hand" else "eye_in_hand"
    with pytest.raises(PosesDisagree, match=f"described as {other} but is {kind}"):
        solve_hand_eye(other, poses, dots, BOARD.points_mm)


def test_a_mirrored_board_order_is_found_and_named():
    cell = true_cell("eye_to_hand", 10)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(1)).reshape(15, 7, 9, 2)[:, ::-1].reshape(15, 63, 2)
    with pytest.raises(PosesDisagree, match="mirrored"):
        solve_hand_eye("eye_to_hand", poses, dots, BOARD.points_mm)


@pytest.mark.parametrize("kind", KINDS)
def test_the_wrong_board_is_named_by_its_scale(kind):
    cell = true_cell(kind, 11)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(1))
    with pytest.raises(PosesDisagree, match=r"drawn size is 1\.04"):
        solve_hand_eye(kind, poses, dots, DotBoard(pitch_mm=1.25).points_mm)


@pytest.mark.parametrize(
    ("kind", "index", "shift"),
    [
        ("eye_in_hand", 4, Pose(0.06, 0, 0)),
        ("eye_in_hand", 0, Pose(0, 0.3, 0)),
        ("eye_to_hand", 14, Pose(8, 0, 0)),
        ("eye_to_hand", 9, Pose(0, 0, 0.06)),
    ],
)
def test_one_bad_pose_is_named(kind, index, shift):
    cell = true_cell(kind, 12)
    poses = list(planned(cell))
    dots = cell.see(poses, np.random.default_rng(2))
    bad = poses[index]
    poses[index] = Pose(bad.x_mm + shift.x_mm, bad.y_mm + shift.y_mm, bad.t_deg + shift.t_deg)
    with pytest.raises(PosesDisagree, match=f"pose {index + 1} against the other 14: the board is seen") as refused:
        solve_hand_eye(kind, poses, dots, BOARD.points_mm)
    assert refused.value.poses == (index,)


def test_two_bad_poses_are_both_named():
    cell = true_cell("eye_in_hand", 13)
    poses = list(planned(cell))
    dots = cell.see(poses, np.random.default_rng(2))
    dots[3] += 40
    dots[11] -= (25, -60)
    with pytest.raises(PosesDisagree, match="poses 4, 12 against the other 13"):
        solve_hand_eye("eye_in_hand", poses, dots, BOARD.points_mm)


def test_a_badly_measured_dot_is_named_by_its_pose():
    cell = true_cell("eye_in_hand", 13)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(2))
    dots[5, 20] += 5
    with pytest.raises(PosesDisagree, match=r"pose 6 against the other 14: the dots fit the board to 0\.6"):
        solve_hand_eye("eye_in_hand", poses, dots, BOARD.points_mm)


def test_a_board_that_moves_all_the_time_is_refused_without_blaming_a_pose():
    cell = true_cell("eye_to_hand", 14)
    poses = planned(cell)
    rng = np.random.default_rng(3)
    dots = cell.see(poses, rng) + rng.normal(0, 15, (15, 1, 2))
    with pytest.raises(PosesDisagree, match="poses do not fit one camera") as refused:
        solve_hand_eye("eye_to_hand", poses, dots, BOARD.points_mm)
    assert len(refused.value.poses) > 5


def test_arrays_of_the_wrong_shape_are_refused():
    cell = true_cell("eye_in_hand", 0)
    poses = planned(cell)
    dots = cell.see(poses, np.random.default_rng(0))
    with pytest.raises(ValueError, match=r"dots must be \(15, 63, 2\)"):
        solve_hand_eye("eye_in_hand", poses, dots[:-1], BOARD.points_mm)
    with pytest.raises(ValueError, match="finite"):
        solve_hand_eye("eye_in_hand", poses, dots * np.nan, BOARD.points_mm)
    with pytest.raises(ValueError, match="one line"):
        solve_hand_eye("eye_in_hand", poses, dots, BOARD.points_mm * (1, 0))
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
        solve_hand_eye("eye_in_hand", NONSENSE_POSES, dots * spread, BOARD.points_mm)


# -- the tool's rotation centre ----------------------------------------------------------------------------------------


def turning(cell: Cell) -> tuple[Pose, ...]:
    return plan_tool_centre(cell.setup, BOARD, PICTURE, anywhere)


def test_without_noise_the_rotation_centre_is_where_the_robot_stands():
    cell = true_cell("eye_to_hand", 20)
    poses = turning(cell)
    found = solve_tool_centre(poses, cell.see(poses, np.random.default_rng(0), QUIET), BOARD.points_mm, cell.camera)
    assert found.centre_px == pytest.approx(cell.camera.px_at(Mm(poses[0].x_mm, poses[0].y_mm)), abs=1e-3)
    assert found.board_mm == pytest.approx(cell.board[:2], abs=1e-5)
    assert found.error_um < 0.01
    assert found.run_out_worst_um < 0.01


def test_the_rotation_centre_scatters_as_its_covariance_says():
    cell = true_cell("eye_to_hand", 21)
    poses = turning(cell)
    errors, expected = [], []
    for seed in range(60):
        found = solve_tool_centre(poses, cell.see(poses, np.random.default_rng(seed)), BOARD.points_mm, cell.camera)
        errors.append(found.error_um)
        expected.append(found.sd_um)
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.mean(expected), rel=0.25)
    assert np.mean(expected) < 4


def test_run_out_of_the_axis_is_measured():
    cell = true_cell("eye_to_hand", 22)
    poses = turning(cell)
    wobble = [pose._replace(x_mm=pose.x_mm + 0.02 * math.cos(i * 2.5)) for i, pose in enumerate(poses)]
    found = solve_tool_centre(poses, cell.see(wobble, np.random.default_rng(0), QUIET), BOARD.points_mm, cell.camera)
    assert 8 < found.run_out_rms_um < 15
    assert found.run_out_worst_um < 25


def test_a_hand_eye_map_that_is_off_does_not_agree_with_the_rotation_centre():
    cell = true_cell("eye_to_hand", 23)
    hand_eye = calibrated(cell)
    poses = turning(cell)
    dots = cell.see(poses, np.random.default_rng(9))
    good = solve_tool_centre(poses, dots, BOARD.points_mm, hand_eye.plane_map)
    assert tool_centre_text(good, hand_eye).endswith(": agrees")
    u, v = hand_eye.plane_map.offset_px
    shifted = replace(hand_eye.plane_map, offset_px=(u + 0.05 * PX_PER_MM, v))
    bad = solve_tool_centre(poses, dots, BOARD.points_mm, shifted)
    assert bad.error_um == pytest.approx(50, abs=15)
    assert "DOES NOT AGREE" in tool_centre_text(bad, hand_eye)


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


# -- plans -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
def test_from_a_cell_that_is_off_by_2_mm_and_3_degrees_a_plan_keeps_the_board_in_view(kind, seed):
    cell = true_cell(kind, 40 + seed)
    rng = np.random.default_rng(seed)
    start = start_pose(drawn(kind), BOARD, PICTURE)
    first = cell.see([start], rng)
    steps = rough_steps(drawn(kind), start, first[0], PICTURE)
    rest = cell.see(steps, rng)
    assert np.abs(rest.mean(1) - CENTRE).max(1).max() < np.abs(first.mean(1) - CENTRE).max() + 2.1 * PX_PER_MM
    rough = rough_setup(drawn(kind), [start, *steps], np.concatenate([first, rest]), BOARD, PICTURE)
    assert rough.plane_map.mm_per_px == pytest.approx(cell.camera.mm_per_px, rel=2e-3)
    assert rough.plane_map.rotation_deg == pytest.approx(cell.camera.rotation_deg, abs=0.3)
    plan = plan_hand_eye(rough, BOARD, PICTURE, anywhere)
    seen = cell.see(plan.poses, rng)
    assert seen.min() > 70
    assert np.all(seen.reshape(-1, 2).max(0) < np.array(PICTURE) - 70)
    assert plan.spread.rotation_deg == pytest.approx(50)
    assert plan.spread.across_mm > 2
    found = solve_hand_eye(kind, plan.poses, seen, BOARD.points_mm)
    assert cell.error_um(found.plane_map, np.zeros((1, 2)))[0] < 4 * plan.predicted.absolute_um
    assert plan.predicted.absolute_um < 6


def test_the_rough_look_names_a_robot_axis_with_the_wrong_sign():
    cell = true_cell("eye_to_hand", 50)
    start = start_pose(drawn("eye_to_hand"), BOARD, PICTURE)
    steps = [start._replace(x_mm=start.x_mm + 2), start._replace(y_mm=start.y_mm + 2)]
    backwards = [start, start._replace(x_mm=start.x_mm - 2), steps[1]]
    dots = cell.see(backwards, np.random.default_rng(0))
    with pytest.raises(PosesDisagree, match="signs of the robot's X and Y"):
        rough_setup(drawn("eye_to_hand"), [start, *steps], dots, BOARD, PICTURE)
    with pytest.raises(ValueError, match="three pictures are needed"):
        rough_setup(drawn("eye_to_hand"), [start] * 3, dots, BOARD, PICTURE)


def test_a_turned_picture_more_settles_where_the_camera_is():
    cell = true_cell("eye_in_hand", 51)
    start = start_pose(drawn("eye_in_hand"), BOARD, PICTURE)
    steps = [start, start._replace(x_mm=start.x_mm + 2), start._replace(y_mm=start.y_mm + 2)]
    turned = start_pose(drawn("eye_in_hand"), BOARD, PICTURE, 15.0)
    off = []
    for poses in (steps, [*steps, turned]):
        dots = cell.see(poses, np.random.default_rng(0), QUIET)
        rough = rough_setup(drawn("eye_in_hand"), poses, dots, BOARD, PICTURE)
        off.append(math.dist(rough.plane_map.mm_at(Px(*CENTRE)), cell.camera.mm_at(Px(*CENTRE))))
    assert off[0] > 0.2
    assert off[1] < 0.05


@pytest.mark.parametrize("kind", KINDS)
def test_a_pose_shows_the_point_where_it_should(kind):
    cell = true_cell(kind, 52)
    pose = pose_seeing(cell.setup, Mm(4.8, 3.6), Px(900, 1200), -33)
    seen = cell.see([pose], np.random.default_rng(0), QUIET)[0]
    assert seen[31] == pytest.approx((900, 1200), abs=1e-6)  # dot (4, 3) is the board's middle
    assert pose.t_deg == -33


def test_a_plan_is_the_same_each_time_and_its_way_is_short():
    setup = drawn("eye_in_hand")
    plan = plan_hand_eye(setup, BOARD, PICTURE, anywhere)
    assert plan == plan_hand_eye(setup, BOARD, PICTURE, anywhere)
    way = sum(math.dist(a[:2], b[:2]) for a, b in pairwise(plan.poses))
    order = np.random.default_rng(0).permutation(15)
    other = [plan.poses[i] for i in order]
    assert way < 0.4 * sum(math.dist(a[:2], b[:2]) for a, b in pairwise(other))


def test_a_plan_stays_in_reach():
    setup = drawn("eye_in_hand")
    plan = plan_hand_eye(setup, BOARD, PICTURE, lambda pose: pose.t_deg > -18 and pose.x_mm < 295)
    assert all(pose.t_deg > -18 and pose.x_mm < 295 for pose in plan.poses)
    assert all(board_in_view(setup, pose, BOARD, PICTURE) for pose in plan.poses)


def test_an_impossible_plan_is_refused_with_its_cause():
    setup = drawn("eye_to_hand")
    with pytest.raises(PlanImpossible, match="the robot cannot go there"):
        plan_hand_eye(setup, BOARD, PICTURE, lambda pose: pose.x_mm > 400)
    with pytest.raises(PlanImpossible, match="at least 30 deg"):
        plan_hand_eye(setup, BOARD, PICTURE, lambda pose: abs(pose.t_deg) < 10)
    with pytest.raises(PlanImpossible, match="does not fit into the picture"):
        plan_hand_eye(setup, DotBoard(columns=20), PICTURE, anywhere)
    with pytest.raises(PlanImpossible, match="0 of 9 rotations"):
        plan_tool_centre(setup, BOARD, PICTURE, lambda pose: False)


# -- the report --------------------------------------------------------------------------------------------------------


def test_the_report_has_every_figure_and_says_what_is_not_known(thirty):
    _, found = thirty[0]
    text = report_text(found)
    for figure in (
        f"{found.rms_px:.4f} px rms",
        "rotation spread 50.0 deg",
        f"{found.hold_out_um:.1f} um",
        "mirrored: ",
    ):
        assert figure in text
    assert "z is not observable" in text
    assert "NOT GOOD" not in text
    assert json.loads(json.dumps(found.as_dict()))["note"] == found.note
    assert found.covariance.shape == (12, 12)


def test_the_report_says_what_is_not_good_enough(thirty):
    _, found = thirty[1]
    assert shortcomings(found) == ()
    assert [s.split(" is ")[0] for s in shortcomings(found, Acceptance(rms_px=0.001, hold_out_um=0.1))] == [
        "the dots' residual",
        "the hold-out error",
    ]
    assert "NOT GOOD" in report_text(replace(found, hold_out_um=math.nan))


def test_the_picture_shows_arrows_where_dots_were(thirty):
    _, found = thirty[0]
    picture = report_picture(found)
    assert picture.dtype == np.uint8
    assert picture.shape == (706, 864, 3)
    shaded = np.mean(np.any(picture[:648] != 250, axis=2))
    assert shaded > 0.7 * coverage(found)
    red = np.all(picture == (40, 40, 210), axis=2)
    assert np.argwhere(red).size > 0


@given(st.floats(0.1, 2), st.floats(0.1, 2), st.floats(0.1, 2))
@settings(max_examples=30, deadline=None)
def test_a_board_that_cannot_be_printed_is_refused(dot, origin, pitch):
    assume(not 1.15 * dot <= origin <= 0.85 * pitch)
    with pytest.raises(ValueError, match="dot board"):
        DotBoard(dot_mm=dot, origin_dot_mm=origin, pitch_mm=pitch)
