"""Lens calibration beside OpenCV's, on real and on rendered pictures: `python -m tests.benchmarks.bench_lens [sets]`.

Prints one table and writes build/bench-lens.json. OpenCV gets its usual way: findChessboardCorners with cornerSubPix
(half-window 7 px, its best on the real pictures; 5 px, the usual one), then calibrateCamera. lens_error_px is the rms
over the picture of how far the found lens puts points from where the true one does, after turning the camera as well
as can be; on real pictures nobody knows it.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cellctl.calibration.board import DotBoard
from cellctl.calibration.errors import BoardNotFound
from cellctl.calibration.lens.boards import Board, CharucoBoard, Chessboard
from cellctl.calibration.lens.model import Views
from cellctl.calibration.lens.pinhole import Pinhole
from cellctl.calibration.lens.sightings import Sighting, find_board, views_of
from cellctl.calibration.lens.solve import calibrate_lens
from tests.lens_scenes import CAMERA, photograph, some_places
from tests.real_pictures import chessboards

OUT = Path("build/bench-lens.json")
PICTURES = 12
FOLDS = 10
Row = dict[str, Any]
HEAD = ("set", "method", "pictures", "rms_px", "hold_out_px", "fx_px", "lens_error_px", "of_opencv", "ms_per_picture")


def main(sets: int) -> None:
    rows = bench(sets)
    print(table(rows))
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


def bench(sets: int = 3, say: Callable[[str], None] = lambda text: print(text, file=sys.stderr)) -> list[Row]:
    """All rows: the real pictures when they are there, then so many rendered sets of each board."""
    rows: list[Row] = []
    try:
        files = chessboards()
        say(f"{len(files)} real pictures")
        rows += compare("real chessboard", Chessboard(9, 6, 25.0), [cv2.imread(str(path), 0) for path in files], None)
    except pytest.skip.Exception as missing:
        say(str(missing))
    boards: list[Board] = [Chessboard(9, 6, 10.0), CharucoBoard(8, 6, 20.0, 15.0, "4x4_50"), DotBoard(9, 7, 10, 5, 7.5)]
    for board in boards:
        for seed in range(sets):
            name = f"{type(board).__name__} {seed + 1}"
            say(f"rendering {name} of {sets}")
            rng = np.random.default_rng(seed)
            places = some_places(rng, CAMERA, board, PICTURES)
            pictures = [photograph(board, CAMERA, place, rng) for place in places]
            rows += compare(name, board, pictures, CAMERA.truth)
    return rows


def compare(name: str, board: Board, pictures: Sequence[np.ndarray], truth: np.ndarray | None) -> list[Row]:
    """Ours, then OpenCV's way with its usual and its best window."""
    rows = [_row(name, "ours", _ours(board, pictures), truth)]
    for method, finder in _opencv_finders(board):
        rows.append(_row(name, method, _opencv(board, pictures, finder), truth))
    reference = next((row for row in rows[1:] if row["lens_error_px"] is not None), None)
    for row in rows:
        if reference and row["lens_error_px"] is not None:
            row["of_opencv"] = row["lens_error_px"] / reference["lens_error_px"]
    return rows


def _row(name: str, method: str, found: dict[str, Any], truth: np.ndarray | None) -> Row:
    error = None if truth is None else lens_error_px(found["lens"], truth, found["picture_px"])
    return {
        "set": name,
        "method": method,
        "pictures": found["pictures"],
        "rms_px": found["rms_px"],
        "hold_out_px": found["hold_out_px"],
        "fx_px": float(found["lens"][0]),
        "lens_error_px": error,
        "of_opencv": None,
        "ms_per_picture": found["ms"],
    }


def _ours(board: Board, pictures: Sequence[np.ndarray]) -> dict[str, Any]:
    height, width = pictures[0].shape
    start = time.perf_counter()
    sightings = list(_sightings(pictures, lambda pixels: find_board(pixels, board)))
    names = [str(index) for index in range(len(sightings))]
    result = calibrate_lens("pinhole", views_of(sightings, board, (width, height)), names)
    spent = time.perf_counter() - start
    return {
        "pictures": len(result.names),
        "rms_px": result.fit.rms_px,
        "hold_out_px": result.hold_out_px,
        "lens": result.fit.shared,
        "picture_px": (width, height),
        "ms": spent / len(pictures) * 1000,
    }


def _opencv(board: Board, pictures: Sequence[np.ndarray], finder: Callable[[np.ndarray], Sighting]) -> dict[str, Any]:
    height, width = pictures[0].shape
    start = time.perf_counter()
    views = views_of(list(_sightings(pictures, finder)), board, (width, height))
    rms_px, lens = _calibrate_camera(views)
    spent = time.perf_counter() - start
    return {
        "pictures": len(views.seen),
        "rms_px": rms_px,
        "hold_out_px": _opencv_hold_out_px(views),
        "lens": lens,
        "picture_px": (width, height),
        "ms": spent / len(pictures) * 1000,
    }


def _sightings(pictures: Sequence[np.ndarray], finder: Callable[[np.ndarray], Sighting]) -> Iterator[Sighting]:
    for pixels in pictures:
        try:
            yield finder(pixels)
        except BoardNotFound:
            continue


def _points(views: Views) -> tuple[list[np.ndarray], list[np.ndarray]]:
    board = np.column_stack([views.board_mm, np.zeros(len(views.board_mm))]).astype(np.float32)
    pairs = list(zip(views.points_px, views.seen, strict=True))
    return [board[seen] for _, seen in pairs], [px[seen].astype(np.float32) for px, seen in pairs]


def _calibrate_camera(views: Views) -> tuple[float, np.ndarray]:
    """OpenCV's rms and its lens in our order."""
    rms, matrix, lens, _, _ = cv2.calibrateCamera(*_points(views), views.picture_px, None, None)
    k1, k2, p1, p2, k3 = lens.ravel()[:5].tolist()
    return float(rms), np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], k1, k2, k3, p1, p2])


def _opencv_hold_out_px(views: Views) -> float:
    """The same way as ours: lens from the other pictures, board placed in those left out."""
    count, square, points = len(views.seen), 0.0, 0
    for fold in range(min(FOLDS, count)):
        left_out = list(range(fold, count, FOLDS))
        _, lens = _calibrate_camera(views.only([index for index in range(count) if index not in left_out]))
        fx, fy, cx, cy, k1, k2, k3, p1, p2 = lens.tolist()
        matrix, order = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]), np.array([k1, k2, p1, p2, k3])
        for board, seen in zip(*_points(views.only(left_out)), strict=True):
            _, turn, place = cv2.solvePnP(board, seen, matrix, order)
            turn, place = cv2.solvePnPRefineLM(board, seen, matrix, order, turn, place)
            off = cv2.projectPoints(board, turn, place, matrix, order)[0].reshape(-1, 2) - seen
            square, points = square + float((off**2).sum()), points + len(off)
    return float(np.sqrt(square / points))


def _opencv_finders(board: Board) -> list[tuple[str, Callable[[np.ndarray], Sighting]]]:
    if isinstance(board, Chessboard):
        size = (board.columns, board.rows)
        return [(f"OpenCV, window {half}", lambda pixels, h=half: _subpix(pixels, size, h)) for half in (5, 7)]
    if isinstance(board, CharucoBoard):
        return [("OpenCV ChArUco", lambda pixels: _charuco(pixels, board))]
    return [("OpenCV circles", lambda pixels: _circles(pixels, board))]


def _subpix(pixels: np.ndarray, size: tuple[int, int], half: int) -> Sighting:
    found, corners = cv2.findChessboardCorners(pixels, size)
    if not found:
        raise BoardNotFound("not found", "by OpenCV")
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 100, 1e-4)
    exact = cv2.cornerSubPix(pixels, corners, (half, half), (-1, -1), criteria).reshape(-1, 2)
    return Sighting(exact.astype(float), np.ones(len(exact), bool))


def _charuco(pixels: np.ndarray, board: CharucoBoard) -> Sighting:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    drawn = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_mm, board.marker_mm, dictionary)
    corners, numbers, _, _ = cv2.aruco.CharucoDetector(drawn).detectBoard(pixels)
    if numbers is None or len(numbers) < 8:
        raise BoardNotFound("not found", "by OpenCV")
    points, seen = np.zeros((len(board.points_mm), 2)), np.zeros(len(board.points_mm), bool)
    points[numbers.ravel()], seen[numbers.ravel()] = corners.reshape(-1, 2), True
    return Sighting(points, seen)


def _circles(pixels: np.ndarray, board: DotBoard) -> Sighting:
    found, centres = cv2.findCirclesGrid(pixels, (board.columns, board.rows), flags=cv2.CALIB_CB_SYMMETRIC_GRID)
    if not found:
        raise BoardNotFound("not found", "by OpenCV")
    return Sighting(centres.reshape(-1, 2).astype(float), np.ones(len(centres), bool))


def lens_error_px(lens: np.ndarray, truth: np.ndarray, picture_px: tuple[int, int]) -> float:
    """How far a lens puts points of the picture (a rim left out) from the true one, turned as well as can be."""
    width, height = picture_px
    u, v = np.meshgrid(np.linspace(0.05, 0.95, 19) * width, np.linspace(0.05, 0.95, 15) * height)
    points = np.column_stack([u.ravel(), v.ravel()])
    model, order = Pinhole(), np.array([truth[4], truth[5], truth[7], truth[8], truth[6]])
    fx, fy, cx, cy = truth[:4].tolist()
    criteria = (cv2.TERM_CRITERIA_COUNT, 100, 1e-12)
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    rays = cv2.undistortPointsIter(points.reshape(-1, 1, 2), matrix, order, None, None, criteria).reshape(-1, 2)
    ahead = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    off = model.see(lens, ahead, rays)[0] - points
    free = model.at_pixels(truth, points)[1].reshape(-1, 3)
    left = off.ravel() - free @ np.linalg.lstsq(free, off.ravel(), rcond=None)[0]
    return float(np.sqrt((left**2).sum() / len(points)))


def table(rows: Sequence[Row]) -> str:
    """The rows for people."""
    texts = [HEAD, *(tuple(_text(row[key]) for key in HEAD) for row in rows)]
    widths = [max(len(text[column]) for text in texts) for column in range(len(HEAD))]
    return "\n".join("  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)) for line in texts)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
