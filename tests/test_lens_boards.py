"""Boards: how they are written, and how they are found in pictures taken askew."""

import cv2
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cellctl.calibration.board import DotBoard
from cellctl.calibration.disks import disk_centres
from cellctl.calibration.dots import find_dots
from cellctl.calibration.errors import BoardNotFound
from cellctl.calibration.homography import homography, local_steps, mapped
from cellctl.calibration.lens.boards import DICTIONARIES, CharucoBoard, Chessboard, board_text, parse_board
from cellctl.calibration.lens.chessboard import find_chessboard
from cellctl.calibration.lens.corners import refine_corners
from cellctl.calibration.lens.sightings import find_board, seen_instead
from tests.lens_scenes import CAMERA, photograph, some_places

CHESS = Chessboard(9, 6, 10.0)
CHARUCO = CharucoBoard(7, 5, 20.0, 15.0, "4x4_50")
DOTS = DotBoard(9, 7, 10.0, 5.0, 7.5)


# -- written down ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("chessboard:9x6:25mm", Chessboard(9, 6, 25.0)),
        ("chessboard:9x6:1", Chessboard(9, 6, 1.0)),
        ("chessboard:9x6:1in", Chessboard(9, 6, 25.4)),
        ("chessboard:9x6:.5cm", Chessboard(9, 6, 5.0)),
        ("dots:9x7:1.2mm:0.6mm:900um", DotBoard(9, 7, 1.2, 0.6, 0.9)),
        ("charuco:8x6:20mm:15mm:DICT_4X4_50", CharucoBoard(8, 6, 20.0, 15.0, "4x4_50")),
    ],
)
def test_a_board_is_read_as_it_is_written(text, board):
    assert parse_board(text) == board


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("checkerboard:9x6:1", "no such board"),
        ("chessboard:9x6", "2 fields COLUMNSxROWS:SQUARE"),
        ("chessboard:9*6:1", "like 9x6"),
        ("chessboard:2x6:1", "3 to 99"),
        ("chessboard:9x6:25miles", "a length like 25mm"),
        ("chessboard:9x6:-1", "a length like 25mm"),
        ("chessboard:9x6:0", "0.001 to 10000 mm"),
        ("dots:9x7:1.2mm:1.1mm:1.2mm", "origin dot must be"),
        ("dots:9x7:1.2mm", "4 fields"),
        ("charuco:8x6:20mm:25mm:4x4_50", "smaller than the square"),
        ("charuco:8x6:20mm:15mm:8x8_50", "no dictionary '8x8_50'"),
    ],
)
def test_a_board_written_wrongly_is_refused_with_what_is_wrong_and_a_right_one(text, says):
    with pytest.raises(ValueError, match=says) as refused:
        parse_board(text)
    assert "chessboard:9x6:25mm" in str(refused.value)


part = st.sampled_from(
    ["chessboard", "dots", "charuco", "9x6", "25mm", "1", "nan", "1e9", "4x4_50", "", "0x0", "٣x٣", "x"]
)


@given(st.one_of(st.text(max_size=40), st.lists(part, max_size=7).map(":".join)))
@example("chessboard:9x6:" + "9" * 400)
@settings(max_examples=150, deadline=None)
def test_any_text_is_a_board_or_a_sentence(text):
    try:
        said = board_text(parse_board(text))
    except ValueError as error:
        said = str(error).removeprefix("board ")
    assert said.startswith(("a chessboard", "a board", "a ChArUco", repr(text)))


def test_every_dictionary_of_opencv_can_be_named():
    assert len(DICTIONARIES) >= 20
    assert {"4x4_50", "6x6_250", "apriltag_36h11"} <= set(DICTIONARIES)


# -- plane maps --------------------------------------------------------------------------------------------------------


@given(st.integers(0, 10**6))
@settings(max_examples=30, deadline=None)
def test_a_homography_is_recovered_with_its_local_steps(seed):
    rng = np.random.default_rng(seed)
    true = np.array([[30.0, 2.0, 300.0], [-3.0, 28.0, 200.0], [0.0, 0.0, 1.0]]) + rng.normal(0, 1, (3, 3)) * [1, 1, 9]
    true[2] = (*rng.normal(0, 0.005, 2), 1.0)
    points = CHESS.points_mm / 10
    found = homography(points, mapped(true, points))
    assert np.abs(mapped(found, points) - mapped(true, points)).max() < 1e-8
    step = np.array([1e-6, 0.0])
    by_difference = (mapped(true, points + step) - mapped(true, points - step)) / 2e-6
    assert np.abs(local_steps(found, points)[:, :, 0] - by_difference).max() < 1e-4


# -- found in pictures -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pictures() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """One picture of each board, tilted, with the place that it was taken from."""
    taken = {}
    for name, board in (("chess", CHESS), ("charuco", CHARUCO), ("dots", DOTS)):
        rng = np.random.default_rng(4)
        place = some_places(rng, CAMERA, board, 1, tilt_deg=40)[0]
        taken[name] = photograph(board, CAMERA, place, rng), place
    return taken


def error_px(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Away from truth, with the board read from either end."""
    return min((found - true, found - true[::-1]), key=lambda away: float(np.abs(away).max()))


def test_chessboard_corners_are_measured_better_than_by_cornersubpix(pictures):
    picture, place = pictures["chess"]
    true = CAMERA.see(place, CHESS.points_mm)
    found = find_board(picture, CHESS)
    ours = error_px(found.points_px, true)
    assert found.seen.all()
    assert np.sqrt((ours**2).mean()) < 0.01
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    for half in (5, 7, 11):
        theirs = cv2.cornerSubPix(picture, true.astype(np.float32).reshape(-1, 1, 2), (half, half), (-1, -1), criteria)
        assert np.sqrt((ours**2).mean()) < 0.7 * np.sqrt(((theirs.reshape(-1, 2) - true) ** 2).mean())


def test_charuco_corners_are_measured_and_a_covered_part_is_left_out(pictures):
    picture, place = pictures["charuco"]
    true = CAMERA.see(place, CHARUCO.points_mm)
    whole = find_board(picture, CHARUCO)
    assert whole.seen.all()
    assert np.sqrt(((whole.points_px - true) ** 2).mean()) < 0.01
    covered = picture.copy()
    u, v = np.rint(true[0]).astype(int)
    covered[v - 90 : v + 40, u - 90 : u + 40] = 128
    partly = find_board(covered, CHARUCO)
    assert not partly.seen[0]
    assert 12 < partly.seen.sum() < 24
    assert np.abs((partly.points_px - true)[partly.seen]).max() < 0.05


def test_dots_are_measured_where_the_middles_of_their_disks_are(pictures):
    picture, place = pictures["dots"]
    sizes = np.full(63, DOTS.dot_mm)
    sizes[0] = DOTS.origin_dot_mm
    middles = disk_centres(lambda points: CAMERA.see(place, points), DOTS.points_mm, sizes)
    beside = middles - CAMERA.see(place, DOTS.points_mm)
    found = find_board(picture, DOTS)
    assert np.sqrt(((found.points_px - middles) ** 2).mean()) < 0.015
    assert np.sqrt((beside**2).mean()) > 0.025  # what would be wrong without


def test_small_dots_are_found_in_a_small_picture(pictures):
    picture, place = pictures["dots"]
    small = cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    found = find_dots(small, DOTS, mirrored=None)
    true = (CAMERA.see(place, DOTS.points_mm) + 0.5) / 2 - 0.5
    assert np.abs(found.centres_px - true).max() < 0.2


def test_a_mirrored_picture_of_dots_is_read_when_either_will_do(pictures):
    picture, place = pictures["dots"]
    found = find_dots(np.ascontiguousarray(picture[:, ::-1]), DOTS, mirrored=None)
    true = CAMERA.see(place, DOTS.points_mm) * (-1, 1) + (picture.shape[1] - 1, 0)
    assert np.abs(found.centres_px - true).max() < 0.3


@pytest.mark.parametrize(("board", "name"), [(CHESS, "dots"), (DOTS, "chess"), (CHARUCO, "chess"), (DOTS, "charuco")])
def test_another_board_is_refused_with_a_sentence(pictures, board, name):
    with pytest.raises(BoardNotFound) as refused:
        find_board(pictures[name][0], board)
    assert refused.value.detail


def test_what_is_there_instead_is_named(pictures):
    assert seen_instead([pictures["chess"][0]], Chessboard(8, 5, 1.0)) == (
        "something like a chessboard of 9x6 inner corners in 1 of 1"
    )
    other = CharucoBoard(7, 5, 20.0, 15.0, "5x5_50")
    assert seen_instead([pictures["charuco"][0]], other).startswith("markers of 4x4_")
    assert seen_instead([pictures["dots"][0]], CHESS) == ""


def test_a_corner_hidden_by_glare_is_marked(pictures):
    picture, place = pictures["chess"]
    true = CAMERA.see(place, CHESS.points_mm)
    glare = picture.copy()
    cv2.circle(glare, tuple(np.rint(true[22]).astype(int).tolist()), 14, 255, -1)
    steps = local_steps(homography(CHESS.points_mm / 10, true), CHESS.points_mm / 10)
    _, good = refine_corners(glare, true, steps)
    assert np.flatnonzero(~good).tolist() == [22]


@given(st.integers(0, 10**6), st.sampled_from([(1, 1), (3, 200), (64, 64), (120, 90)]))
@settings(max_examples=12, deadline=None)
def test_noise_holds_no_board(seed, shape):
    noise = np.random.default_rng(seed).integers(0, 256, shape, np.uint8)
    for board in (CHESS, CHARUCO, DOTS):
        with pytest.raises(BoardNotFound):
            find_board(noise, board)


def test_a_large_picture_is_searched_in_a_smaller_one(pictures):
    picture, place = pictures["chess"]
    large = cv2.resize(picture, None, fx=2.5, fy=2.5, interpolation=cv2.INTER_CUBIC)
    points, good = find_chessboard(large, CHESS)
    true = (CAMERA.see(place, CHESS.points_mm) + 0.5) * 2.5 - 0.5
    assert good.all()
    assert np.abs(error_px(points, true)).max() < 0.15
