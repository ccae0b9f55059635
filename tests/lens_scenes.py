"""Pictures of flat boards through an ordinary lens, with known truth: rays by OpenCV, pixels by supersampling."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from cellctl.calibration.board import DotBoard
from cellctl.calibration.lens.boards import DICTIONARIES, Board, CharucoBoard, Chessboard

FINE = 4  # samples per pixel and axis
STEP_PX = 2
MARGIN_PX = 10
TEXTURE_PX = 200  # per square
Ink = Callable[[np.ndarray], np.ndarray]  # board points (..., 2) mm -> 0 (paper) to 1 (ink)


class Camera(NamedTuple):
    """A true camera: fx, fy, cx, cy px; k1, k2, p1, p2, k3 as OpenCV orders them; width and height px."""

    intrinsics: tuple[float, float, float, float]
    distortion: tuple[float, float, float, float, float]
    picture_px: tuple[int, int]

    @property
    def matrix(self) -> np.ndarray:
        fx, fy, cx, cy = self.intrinsics
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])

    @property
    def truth(self) -> np.ndarray:
        """In our order."""
        k1, k2, p1, p2, k3 = self.distortion
        return np.array([*self.intrinsics, k1, k2, k3, p1, p2])

    def see(self, place: np.ndarray, board_mm: np.ndarray) -> np.ndarray:
        """Where board points (m, 2) appear for a board at rotation vector and place (6,), (m, 2)."""
        points = np.column_stack([board_mm, np.zeros(len(board_mm))])
        return cv2.projectPoints(points, place[:3], place[3:], self.matrix, np.array(self.distortion))[0].reshape(-1, 2)


CAMERA = Camera((900.0, 901.5, 402.0, 296.5), (-0.15, 0.08, 0.0008, -0.0005, 0.0), (800, 600))


def some_places(rng: np.random.Generator, camera: Camera, board: Board, count: int, tilt_deg: float = 30) -> np.ndarray:
    """Boards wholly in view, tilted to all sides, near all corners, (count, 6)."""
    points = board.points_mm
    middle = np.append((points.min(0) + points.max(0)) / 2, 0.0)
    size_mm = float(np.ptp(points, axis=0).max())
    width, height = camera.picture_px
    far_mm = camera.intrinsics[0] * size_mm / (0.55 * width)
    places: list[np.ndarray] = []
    while len(places) < count:
        side = rng.uniform(0, 2 * np.pi)
        tilt = np.radians(rng.uniform(0.3, 1.0) * tilt_deg) * np.array([np.cos(side), np.sin(side), 0.0])
        turn = cv2.Rodrigues(tilt)[0] @ cv2.Rodrigues(np.array([0, 0, rng.uniform(-0.5, 0.5)]))[0]
        depth = far_mm * rng.uniform(0.9, 1.3)
        reach = 0.5 * depth * np.array([width, height]) / camera.intrinsics[0]
        place = np.append(rng.uniform(-1, 1, 2) * reach, depth) - turn @ middle
        pose = np.concatenate([cv2.Rodrigues(turn)[0].ravel(), place])
        if in_view(camera.see(pose, outline_mm(board)), camera):
            places.append(pose)
    return np.array(places)


def outline_mm(board: Board) -> np.ndarray:
    """Corners of all that is printed, (4, 2)."""
    low, high = board.points_mm.min(0), board.points_mm.max(0)
    more = board.origin_dot_mm / 2 if isinstance(board, DotBoard) else board.square_mm
    (left, top), (right, bottom) = low - more, high + more
    return np.array([[left, top], [right, top], [right, bottom], [left, bottom]])


def in_view(points: np.ndarray, camera: Camera, margin: float = 12.0) -> bool:
    return bool(np.all(points > margin) and np.all(points < np.array(camera.picture_px) - margin))


def photograph(
    board: Board,
    camera: Camera,
    place: np.ndarray,
    rng: np.random.Generator,
    *,
    blur_px: float = 0.7,
    noise: float = 2.0,
) -> np.ndarray:
    """An 8-bit picture; ink at 40, paper and all around it at 200 levels."""
    width, height = camera.picture_px
    edge = camera.see(place, outline_mm(board))
    left, top = np.maximum(np.floor(edge.min(0)).astype(int) - MARGIN_PX, 0)
    right, bottom = np.minimum(np.ceil(edge.max(0)).astype(int) + MARGIN_PX, [width, height])
    part = _paper_and_ink(board, camera, place, (int(left), int(top), int(right), int(bottom)), blur_px)
    level = np.full((height, width), 200.0)
    level[top:bottom, left:right] = part
    return np.clip(np.rint(level + rng.normal(0, noise, level.shape)), 0, 255).astype(np.uint8)


def _paper_and_ink(
    board: Board, camera: Camera, place: np.ndarray, box: tuple[int, int, int, int], blur_px: float
) -> np.ndarray:
    """Levels of the pixels from left, top to right, bottom."""
    left, top, right, bottom = box
    size = (right - left, bottom - top)
    knots = [np.arange(low, high + STEP_PX, STEP_PX) - 0.5 for low, high in ((left, right), (top, bottom))]
    coarse = np.stack(np.meshgrid(*knots), -1).reshape(-1, 1, 2).astype(float)
    flat = cv2.undistortPointsIter(
        coarse, camera.matrix, np.array(camera.distortion), None, None, (cv2.TERM_CRITERIA_COUNT, 50, 1e-12)
    ).reshape(len(knots[1]), len(knots[0]), 2)
    rays = np.stack([_refined(flat[..., axis], size) for axis in (0, 1)], axis=-1)
    turn = cv2.Rodrigues(place[:3])[0]
    to_plane = np.linalg.inv(np.column_stack([turn[:, 0], turn[:, 1], place[3:]]))
    mm = rays @ to_plane[:, :2].T + to_plane[:, 2]
    ink = ink_of(board)(mm[..., :2] / mm[..., 2:])
    blurred = cv2.GaussianBlur((200 - 160 * ink).astype(np.float32), (0, 0), blur_px * FINE)
    return cv2.resize(blurred, size, interpolation=cv2.INTER_AREA).astype(float)


def _refined(coarse: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """A smooth function known at the borders of every second pixel, at all fine samples (straight in between)."""
    u, v = ((np.arange(count * FINE) + 0.5) / (FINE * STEP_PX) for count in size)
    wide = np.array([np.interp(u, np.arange(coarse.shape[1]), row) for row in coarse])
    low = np.minimum(v.astype(int), len(coarse) - 2)
    part = (v - low)[:, None]
    return wide[low] * (1 - part) + wide[low + 1] * part


def ink_of(board: Board) -> Ink:
    """Where a board is printed."""
    if isinstance(board, DotBoard):
        return lambda mm: _dots(mm, board)
    texture = _charuco(board) if isinstance(board, CharucoBoard) else _squares(board)
    return lambda mm: _printed(mm / board.square_mm, texture)


def _dots(mm: np.ndarray, board: DotBoard) -> np.ndarray:
    """With soft rims, as wide as the distance of the samples."""
    nearest = np.clip(np.rint(mm / board.pitch_mm), 0, [board.columns - 1, board.rows - 1])
    away = np.hypot(*np.moveaxis(mm - nearest * board.pitch_mm, -1, 0))
    radius = np.where(np.all(nearest == 0, axis=-1), board.origin_dot_mm, board.dot_mm) / 2
    return np.clip(0.5 + (radius - away) / float(np.hypot(*(mm[1, 1] - mm[0, 0]))), 0.0, 1.0)


def _printed(squares: np.ndarray, texture: np.ndarray) -> np.ndarray:
    """Ink at places in squares from the first inner corner, straight between the texture's pixels."""
    at = ((squares + 1.0) * TEXTURE_PX - 0.5).astype(np.float32)
    return cv2.remap(texture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def _squares(board: Chessboard) -> np.ndarray:
    square = np.add.outer(np.arange(board.rows + 1), np.arange(board.columns + 1)) % 2 == 0
    return np.kron(square, np.ones((TEXTURE_PX, TEXTURE_PX))).astype(np.float32)


def _charuco(board: CharucoBoard) -> np.ndarray:
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[board.dictionary])
    drawn = cv2.aruco.CharucoBoard((board.columns, board.rows), board.square_mm, board.marker_mm, dictionary)
    image = drawn.generateImage((board.columns * TEXTURE_PX, board.rows * TEXTURE_PX))
    return (image < 128).astype(np.float32)
