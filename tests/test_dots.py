"""The dot board finder: on plates painted here dot by dot, and on pictures of the simulated cameras."""

import math
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cellctl.calibration.board import DotBoard
from cellctl.calibration.dots import find_dots
from cellctl.calibration.errors import BoardNotFound
from cellctl.calibration.hand_eye import solve_hand_eye
from cellctl.calibration.lattice import find_lattice
from cellctl.calibration.problem import Looks
from cellctl.geometry import Pose
from simulators.layout import build_layout
from simulators.optics import Optics
from simulators.parts import dot_plate, scene
from simulators.place import Place
from simulators.render import render

BOARD = DotBoard()
SMALL = (1240, 1030)  # width, height of the plates painted here
PX_PER_MM = 76.0
STEPS = np.linspace(-5, 5, 20001)
ERF = (STEPS, np.array([math.erf(step) for step in STEPS]))


def places(turn_deg: float = 0.0, at=(620.0, 515.0), *, mirrored: bool = True, board: DotBoard = BOARD) -> np.ndarray:
    """Where the dots of a board in the middle of a small picture are, in board order."""
    turn = math.radians(turn_deg)
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    view = np.diag([1.0, -1.0 if mirrored else 1.0])
    return (board.points_mm - board.centre_mm) @ (PX_PER_MM * view @ rotation).T + np.array(at)


def paint(
    centres: np.ndarray,
    *,
    board: DotBoard = BOARD,
    blur_px: float = 1.1,
    bright: float = 180.0,
    dark: float = 50.0,
    slope: float = 0.0,
    noise: float = 2.5,
    seed: int = 0,
) -> np.ndarray:
    """A plate with blurred dots, light that changes from left to right, and noise."""
    width, height = SMALL
    v, u = np.mgrid[:height, :width]
    covered = np.zeros((height, width))
    for index, (x, y) in enumerate(centres):
        radius = (board.dot_mm if index else board.origin_dot_mm) / 2 * PX_PER_MM
        reach = math.ceil(radius + 6)
        rows = slice(max(0, round(y) - reach), max(0, round(y) + reach))
        columns = slice(max(0, round(x) - reach), max(0, round(x) + reach))
        depth = (radius - np.hypot(u[rows, columns] - x, v[rows, columns] - y)) / (blur_px * math.sqrt(2))
        covered[rows, columns] += 0.5 * (1 + np.interp(depth, *ERF))
    light = 1 + slope * (u / width - 0.5)
    grey = (bright + (dark - bright) * covered) * light + np.random.default_rng(seed).normal(0, noise, covered.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def plate() -> np.ndarray:
    return paint(places(7.0))


@pytest.mark.parametrize("mirrored", [True, False])
@pytest.mark.parametrize("turn_deg", [0, 33, 90, -45, 134, 180, -101])
def test_every_dot_is_found_at_any_rotation_in_board_order(turn_deg, mirrored):
    truth = places(turn_deg, (623.3, 512.8), mirrored=mirrored)
    found = find_dots(paint(truth, seed=turn_deg + 500), BOARD, mirrored=mirrored)
    away = found.centres_px - truth
    assert np.sqrt((away**2).mean()) < 0.015
    assert np.abs(away).max() < 0.05
    assert found.residual_rms_px < 0.015
    assert found.px_per_mm == pytest.approx(PX_PER_MM, rel=1e-4)


def test_without_noise_a_dot_is_found_to_a_few_thousandths():
    truth = places(12.3)
    found = find_dots(paint(truth, noise=0.0), BOARD, mirrored=True)
    assert np.abs(found.centres_px - truth).max() < 0.012  # 8 bits


def test_light_that_falls_off_by_a_quarter_shifts_nothing_that_counts():
    truth = places(-20)
    found = find_dots(paint(truth, slope=0.25, blur_px=1.6), BOARD, mirrored=True)
    away = found.centres_px - truth
    assert np.abs(away.mean(0)).max() < 0.03
    assert np.sqrt((away**2).mean()) < 0.03


def test_a_picture_out_of_focus_is_still_measured_without_bias():
    truth = places(-20)
    found = find_dots(paint(truth, blur_px=4.0), BOARD, mirrored=True)
    away = found.centres_px - truth
    assert np.abs(away.mean(0)).max() < 0.01
    assert np.sqrt((away**2).mean()) < 0.04


def test_a_square_board_is_read_along_the_side_that_the_camera_allows():
    board = DotBoard(columns=7, rows=7)
    for mirrored in (True, False):
        truth = places(15, mirrored=mirrored, board=board)
        found = find_dots(paint(truth), board, mirrored=mirrored)
        assert np.abs(found.centres_px - truth).max() < 0.1


def test_the_plate_need_not_fill_the_picture():
    picture = paint(places())
    for column in (0, 1):
        picture[:, slice(0, 150) if column == 0 else slice(1090, None)] = 30
    assert len(find_dots(picture, BOARD, mirrored=True).centres_px) == 63


def test_dust_beside_the_dots_does_no_harm(plate):
    truth, picture = places(7.0), plate.copy()
    rng = np.random.default_rng(1)
    for _ in range(40):
        u, v = rng.uniform((20, 20), (1220, 1010))
        if np.hypot(*(truth - (u, v)).T).min() > 0.42 * 1.2 * PX_PER_MM:
            cv2.circle(picture, (round(u), round(v)), int(rng.integers(1, 4)), 60, -1)
    found = find_dots(picture, BOARD, mirrored=True)
    assert np.abs(found.centres_px - truth).max() < 0.08


def test_a_read_only_picture_will_do(plate):
    picture = plate.copy()
    picture.flags.writeable = False
    assert len(find_dots(picture, mirrored=True).centres_px) == 63


@pytest.mark.parametrize(
    ("at", "side"), [((150, 515), "left"), ((1090, 515), "right"), ((620, 120), "top"), ((620, 900), "bottom")]
)
def test_a_board_that_leaves_the_picture_is_refused_with_the_side(at, side):
    with pytest.raises(BoardNotFound, match=f"leaves the picture at the {side}") as refused:
        find_dots(paint(places(0, at)), BOARD, mirrored=True)
    assert refused.value.sides == (side,)
    assert 20 < refused.value.seen < refused.value.wanted == 63


def test_a_board_that_leaves_at_a_corner_names_both_sides():
    with pytest.raises(BoardNotFound) as refused:
        find_dots(paint(places(0, (1060, 150))), BOARD, mirrored=True)
    assert refused.value.sides == ("right", "top")


def test_a_covered_dot_is_refused_with_the_count(plate):
    picture = plate.copy()
    u, v = np.rint(places(7.0)[31]).astype(int)
    picture[v - 40 : v + 40, u - 40 : u + 40] = 180
    with pytest.raises(BoardNotFound, match="62 of 63 dots seen") as refused:
        find_dots(picture, BOARD, mirrored=True)
    assert refused.value.sides == ()


@pytest.mark.parametrize("part", [0.35, 0.6])
def test_dirt_on_the_rim_of_a_dot_is_refused_or_named(plate, part):
    picture = plate.copy()
    u, v = np.rint(places(7.0)[31]).astype(int)
    cv2.circle(picture, (u + 23, v), round(part * 23), 50, -1)
    with pytest.raises(BoardNotFound, match=r"dot \(4, 3\) is|62 of 63"):
        find_dots(picture, BOARD, mirrored=True)


def test_a_plate_seen_from_the_wrong_side_is_refused(plate):
    with pytest.raises(BoardNotFound, match="upside down") as refused:
        find_dots(plate, BOARD, mirrored=False)
    assert refused.value.check == "mirrored"
    with pytest.raises(BoardNotFound, match="upside down"):
        find_dots(np.ascontiguousarray(plate[:, ::-1]), BOARD, mirrored=True)


def test_a_board_without_its_larger_dot_is_refused():
    picture = paint(places(), board=DotBoard(dot_mm=0.6, origin_dot_mm=0.7))
    with pytest.raises(BoardNotFound, match=r"largest dot is 1\.\d+ times"):
        find_dots(picture, BOARD, mirrored=True)


def test_a_board_with_other_counts_is_refused():
    board = DotBoard(columns=8, rows=7)
    with pytest.raises(BoardNotFound, match="56 of 63 dots seen"):
        find_dots(paint(places(board=board), board=board), BOARD, mirrored=True)
    with pytest.raises(BoardNotFound, match="63 of 56 dots seen"):
        find_dots(paint(places()), board, mirrored=True)


def test_too_dark_too_bright_and_too_flat_pictures_are_named():
    with pytest.raises(BoardNotFound, match="too dark"):
        find_dots(paint(places(), bright=25, dark=8), BOARD, mirrored=True)
    with pytest.raises(BoardNotFound, match="saturated"):
        find_dots(paint(places(), bright=300), BOARD, mirrored=True)
    with pytest.raises(BoardNotFound, match="saturated"):
        find_dots(np.full((800, 1000), 255, np.uint8), BOARD, mirrored=True)
    with pytest.raises(BoardNotFound, match="contrast"):
        find_dots(paint(places(), bright=120, dark=90), BOARD, mirrored=True)
    with pytest.raises(BoardNotFound, match="contrast"):
        find_dots(np.full((800, 1000), 120, np.uint8), BOARD, mirrored=True)


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((800, 1000), np.float32),
        np.zeros((800, 1000, 3), np.uint8),
        np.zeros((40, 1000), np.uint8),
        np.zeros(0, np.uint8),
    ],
)
def test_what_is_no_picture_is_refused(picture):
    with pytest.raises(ValueError, match="must be"):
        find_dots(picture, BOARD, mirrored=True)


@st.composite
def junk(draw) -> np.ndarray:
    """Noise, stripes, checks, blobs and lattices of other things, of odd sizes."""
    height, width = draw(st.integers(64, 400)), draw(st.integers(64, 400))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    kind = draw(st.sampled_from(["noise", "coarse", "stripes", "check", "disks"]))
    if kind == "noise":
        return rng.integers(0, 256, (height, width), np.uint8)
    if kind == "coarse":
        coarse = rng.integers(0, 256, (8, 8), np.uint8)
        return cv2.resize(coarse, (width, height), interpolation=draw(st.sampled_from([0, 1, 2])))
    v, u = np.mgrid[:height, :width]
    step = draw(st.integers(2, 60))
    if kind == "stripes":
        return np.where(u // step % 2 == 0, 30, 220).astype(np.uint8)
    if kind == "check":
        return np.where((u // step + v // step) % 2 == 0, 30, 220).astype(np.uint8)
    picture = np.full((height, width), 200, np.uint8)
    for _ in range(draw(st.integers(0, 70))):
        cv2.circle(picture, tuple(int(i) for i in rng.integers(0, 400, 2)), int(rng.integers(2, 40)), 40, -1)
    return picture


@given(junk(), st.booleans())
@example(np.zeros((64, 64), np.uint8), True)
@example(np.full((64, 64), 255, np.uint8), False)
@settings(max_examples=80, deadline=None)
def test_junk_is_never_taken_for_a_board(picture, mirrored):
    with pytest.raises(BoardNotFound) as refused:
        find_dots(picture, BOARD, mirrored=mirrored)
    assert refused.value.detail


@given(st.lists(st.tuples(st.floats(0, 500), st.floats(0, 500)), max_size=30))
@example([(5.0, 5.0)] * 8)
@settings(max_examples=80, deadline=None)
def test_a_lattice_gives_each_point_one_place_and_each_place_one_point(points):
    lattice = find_lattice(np.array(points, float).reshape(-1, 2))
    if lattice is not None:
        assert len(set(lattice.members.tolist())) == len(lattice.members)
        assert len({tuple(place) for place in lattice.places.tolist()}) == len(lattice.members)
        assert lattice.places.min() == 0


# -- the simulated cameras ---------------------------------------------------------------------------------------------


def seen(optics: Optics, board: Pose) -> np.ndarray:
    """Where a true camera shows the dots of a plate lying so in its plane."""
    plane = np.array([board.point(*point) for point in BOARD.points_mm.tolist()])
    flat = plane @ optics.matrix.T + optics.offset_px
    away = flat - optics.centre_px
    return np.asarray(flat + away * optics.k1 * (away**2).sum(1, keepdims=True))


def photograph(optics: Optics, board: Pose, rng: np.random.Generator) -> np.ndarray:
    return render(scene((dot_plate(), Place(*board))), optics, rng)


@pytest.mark.parametrize("looks", ["down", "up"])
def test_in_a_five_megapixel_picture_the_error_is_a_hundredth_of_a_pixel(looks):
    rng = np.random.default_rng(5)
    optics = replace(Optics.aimed((0, 0), looks=looks, turn_deg=-2), k1=3e-10, blur_px=1.1, noise=2.5)
    errors, spent_s = [], []
    for turn_deg in (0, 25, 160):
        board = Pose(0.3, -0.2, turn_deg) @ Pose(-4.8, -3.6, 0)
        picture = photograph(optics, board, rng)
        started = time.thread_time()
        found = find_dots(picture, BOARD, mirrored=looks == "down")
        spent_s.append(time.thread_time() - started)
        errors.append(found.centres_px - seen(optics, board))
    assert np.sqrt(np.mean(np.square(errors))) < 0.012
    assert np.abs(errors).max() < 0.04
    assert min(spent_s) < 0.040


@pytest.mark.parametrize("kind", ["eye_in_hand", "eye_to_hand"])
def test_from_pictures_to_the_camera(kind):
    """Nine pictures of a cell as it truly stands, with the robot's scatter, to a map good to some um."""
    rng = np.random.default_rng(8)
    layout = build_layout(rng)
    optics = layout.camera_1 if kind == "eye_in_hand" else layout.camera_2
    axis = np.linalg.solve(optics.matrix, np.array([1295.5, 971.5]) - optics.offset_px)
    board = Pose(*layout.board) if kind == "eye_in_hand" else Pose(-4.6, -3.9, 1.0)
    poses, dots = [], []
    for index, turn_deg in enumerate((-24, 24, -20, 20, -12, 12, -5, 5, 0)):
        offset = (1.2 * math.cos(2.4 * index), 0.6 * math.sin(2.4 * index))
        pose = _pose_over(kind, board, axis, turn_deg, offset)
        true = Pose(*(np.array(pose) + rng.normal(0, (0.0033, 0.0033, 0.00133))))
        in_plane = true.inverse() @ board if kind == "eye_in_hand" else true @ board
        picture = photograph(optics, in_plane, rng)
        poses.append(pose)
        dots.append(find_dots(picture, BOARD, mirrored=kind == "eye_in_hand").centres_px)
    found = solve_hand_eye(kind, Looks(poses, np.array(dots)), BOARD.points_mm)
    grid = axis + np.stack(np.meshgrid(np.linspace(-7, 7, 5), np.linspace(-5, 5, 5)), -1).reshape(-1, 2)
    flat = grid @ optics.matrix.T + optics.offset_px
    away = flat - optics.centre_px
    pixels = flat + away * optics.k1 * (away**2).sum(1, keepdims=True)
    error_um = np.hypot(*(found.plane_map.mm_from_px(pixels) - grid).T) * 1000
    assert np.sqrt((error_um**2).mean()) < 4 * found.predicted.absolute_um < 40
    assert found.rms_px < 0.02
    assert found.board == pytest.approx(board, abs=0.05)


def _pose_over(kind: str, board: Pose, axis: np.ndarray, turn_deg: float, offset: tuple[float, float]) -> Pose:
    """The pose at which the middle of the board is near the camera's axis."""
    middle = np.array(board.point(*BOARD.centre_mm.tolist()))
    turn = Pose(0, 0, turn_deg)
    if kind == "eye_in_hand":
        at = middle - np.array(turn.point(*axis.tolist()))
    else:
        at = axis - np.array(turn.point(*middle.tolist()))
    return Pose(float(at[0]) + offset[0], float(at[1]) + offset[1], turn_deg)
