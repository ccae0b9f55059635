"""Where the robot goes to calibrate: in view, in reach, and as good as it can be, known beforehand."""

import math
from itertools import pairwise

import numpy as np
import pytest

from cellctl.calibration.board import DotBoard
from cellctl.calibration.errors import PlanImpossible, PosesDisagree
from cellctl.calibration.plan import plan_hand_eye, plan_tool_centre, predict_plan
from cellctl.calibration.rough import back_into_view, rough_setup, rough_steps
from cellctl.calibration.view import board_in_view, pose_seeing, start_pose
from cellctl.geometry import Mm, Px
from cellctl.keep_out import Area, touched_at, touched_on_the_way
from cellctl.mount import Stop
from tests.calibration_cells import (
    ARM_2,
    BOARD,
    CASES,
    CENTRE,
    KINDS,
    PICTURE,
    PX_PER_MM,
    QUIET,
    TOOL,
    drawn,
    plan,
    solved,
    task,
    true_cell,
)


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
    found = plan_hand_eye(task(rough))
    seen = cell.see(found.poses, rng)
    assert seen.min() > 70
    assert np.all(seen.reshape(-1, 2).max(0) < np.array(PICTURE) - 70)
    assert 40 < found.spread.rotation_deg <= 50
    assert found.spread.across_mm > 2
    camera = solved(kind, found.poses, seen).plane_map
    assert cell.error_um(camera, np.zeros((1, 2)))[0] < 4 * found.predicted.absolute_um
    assert found.predicted.absolute_um < 6


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


@pytest.mark.parametrize("case", CASES)
def test_a_plan_is_the_same_each_time_and_its_way_is_short(case):
    setup, mount = drawn(case), ARM_2 if case == "arm_2" else TOOL
    found = plan_hand_eye(task(setup, mount))
    assert found == plan_hand_eye(task(setup, mount))
    order = np.random.default_rng(0).permutation(15)
    assert _way_mm(found.stops) < 0.6 * _way_mm([found.stops[i] for i in order])
    assert "um absolute" in found.text


def _way_mm(stops):
    return sum(
        math.dist(a.tool[:2], b.tool[:2]) + abs(a.tool.t_deg - b.tool.t_deg) / 2 + 200 * (a.elbow != b.elbow)
        for a, b in pairwise(stops)
    )


def test_no_exchange_of_one_pose_for_another_makes_a_plan_much_better():
    setup = drawn("eye_in_hand")
    found = plan_hand_eye(task(setup))
    best = found.predicted.absolute_um
    for stop in found.stops[::4]:
        for turn_deg in (-25.0, 0.0, 25.0):
            other = Stop(pose_seeing(setup, Mm(4.8, 3.6), Px(*CENTRE), turn_deg), "righty")
            stops = [other if one == stop else one for one in found.stops]
            assert predict_plan(task(setup), stops).absolute_um > 0.9 * best


def test_turning_further_and_on_both_sides_tells_more():
    cell = true_cell("eye_to_hand", 2)
    wide, narrow = plan(cell, rotation_deg=90), plan(cell, rotation_deg=30)
    assert wide.predicted.absolute_um < 0.6 * narrow.predicted.absolute_um
    turns = sorted(stop.tool.t_deg for stop in wide.stops)
    assert turns[0] == -turns[-1] == -90
    assert max(turns.count(turn) for turn in turns) <= 3


def test_a_camera_on_the_second_arm_is_turned_by_changing_the_elbows_side():
    found = plan(true_cell("arm_2", 3))
    elbows = [stop.elbow for stop in found.stops]
    assert set(elbows) == {"righty", "lefty"}
    assert sum(a != b for a, b in pairwise(elbows)) == 1
    assert elbows[-1] == ARM_2.elbow  # where production has it
    assert found.spread.rotation_deg > 75
    with pytest.raises(PlanImpossible, match=r"the tool turns by .* at least 30 deg"):
        plan_hand_eye(task(drawn("arm_2"), ARM_2, reaches=lambda stop: stop.elbow == "righty"))


def test_a_plan_stays_in_reach():
    setup = drawn("eye_in_hand")
    found = plan_hand_eye(task(setup, reaches=lambda stop: stop.tool.t_deg > -18 and stop.tool.x_mm < 295))
    assert all(pose.t_deg > -18 and pose.x_mm < 295 for pose in found.poses)
    assert all(board_in_view(setup, pose, BOARD, PICTURE) for pose in found.poses)


def test_a_plan_keeps_out_of_an_area_and_says_when_it_cannot():
    setup = drawn("eye_in_hand")
    free = plan_hand_eye(task(setup))
    aside = Area("post", 295.5, 330.0, -42.0, -37.0)
    kept = plan_hand_eye(task(setup, areas=[aside]))
    assert any(touched_at(TOOL, stop, [aside]) for stop in free.stops)
    assert not any(touched_at(TOOL, stop, [aside]) for stop in kept.stops)
    assert not any(touched_on_the_way(TOOL, a, b, [aside]) for a, b in pairwise(kept.stops))
    with pytest.raises(PlanImpossible, match="keep-out areas"):
        plan_hand_eye(task(setup, areas=[Area("wall", -400.0, 400.0, -400.0, 400.0)]))


def test_an_elbow_that_cannot_change_sides_is_said_so_before_anything_moves():
    in_front = Area("camera post", 385.0, 399.0, -60.0, 20.0)  # nothing but the swing over the stretched arm comes here
    setup = drawn("arm_2")
    assert not any(touched_at(ARM_2, stop, [in_front]) for stop in plan_hand_eye(task(setup, ARM_2)).stops)
    with pytest.raises(PlanImpossible, match="where the elbow changes sides, the arm would come through 'camera post'"):
        plan_hand_eye(task(setup, ARM_2, areas=[in_front]))


def test_an_impossible_plan_is_refused_with_its_cause():
    setup = drawn("eye_to_hand")
    with pytest.raises(PlanImpossible, match="the robot cannot go to"):
        plan_hand_eye(task(setup, reaches=lambda stop: stop.tool.x_mm > 400))
    with pytest.raises(PlanImpossible, match="at least 30 deg"):
        plan_hand_eye(task(setup, reaches=lambda stop: abs(stop.tool.t_deg) < 10))
    with pytest.raises(PlanImpossible, match="does not fit into the picture"):
        plan_hand_eye(task(setup, board=DotBoard(columns=20)))
    with pytest.raises(PlanImpossible, match="0 of 9 rotations"):
        plan_tool_centre(task(setup, reaches=lambda stop: False))


def test_a_board_that_leaves_the_picture_is_brought_back():
    at = back_into_view(Px(1300, 970), ("left", "bottom"), PICTURE)
    assert at.u > 1300
    assert at.v < 970
