"""A telecentric lens: parallel projection, then distortion about a centre.

    q = scale K R(turn) (1 - v v^T) F board + place,  px = centre + distort(q - centre),  K = [[1 + e, g], [g, 1 - e]]

v says how the board is tilted: its direction on the board, and 1 - cos(tilt) = |v|^2; to which side cannot be seen.
e and g are a tilt of the sensor or pixels that are not square: they are taken to be small, because one picture alone
shows only the board's and the sensor's tilt together. F mirrors the board for a camera that sees it mirrored.
Source of the model: C. Steger, M. Ulrich, C. Wiedemann, Machine Vision Algorithms and Applications, 2018, section 3.9.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration import distortion
from cellctl.calibration.lens.model import Prior, Views
from cellctl.calibration.plane_map import Lens
from cellctl.calibration.scara import QUARTER, rotation

FloatArray = NDArray[np.float64]

SQUEEZE_SD = 0.0002  # 1 - cos 1.1 deg: how much a sensor may be tilted
CENTRE_SD = 0.05  # of the distortion's centre about the picture's middle, in widths of the picture
BENT_SD = (0.01, 0.001, 0.001)  # of the terms k1, k2, k3 at the picture's corner, in parts of the radius there
RADIAL = 3  # of the five coefficients: p1 and p2 only shift the centre of so weak a distortion


class Telecentric:
    """The model of a telecentric lens; `mirrored` when the camera sees the board's frame mirrored."""

    lens: Lens = "telecentric"
    parameters = (
        "scale_px_per_mm", "squeeze_e", "squeeze_g", "k1_per_px2", "k2_per_px4", "k3_per_px6",
        "centre_u_px", "centre_v_px",
    )  # fmt: skip
    own = ("turn_rad", "tilt_v1", "tilt_v2", "u_px", "v_px")

    def __init__(self, *, mirrored: bool) -> None:
        self.mirrored = mirrored

    def start(self, views: Views) -> FloatArray:
        """From one affine map per picture: its larger scale is the lens', the smaller one shows the tilt."""
        maps = affine_maps(views._replace(board_mm=self._faced(views.board_mm)))
        scales = [float(np.linalg.svd(one[:2].T, compute_uv=False)[0]) for one in maps]
        scale = float(np.median(scales))
        own = [_unfolded(one, scale) for one in maps]
        return np.concatenate([[scale, 0.0, 0.0, 0.0, 0.0, 0.0], views.middle_px, *own])

    def prior(self, views: Views, start: FloatArray) -> Prior:
        """The sensor is nearly square to the axis, the lens bends little and about the picture's middle."""
        width, corner = max(views.picture_px), float(np.hypot(*views.middle_px))
        value = np.concatenate([np.zeros(6), views.middle_px])
        bent = np.array(BENT_SD) / corner ** np.array([2.0, 4.0, 6.0])
        return Prior(value, np.array([np.inf, SQUEEZE_SD, SQUEEZE_SD, *bent, CENTRE_SD * width, CENTRE_SD * width]))

    def see(self, shared: FloatArray, own: FloatArray, board_mm: FloatArray) -> FloatArray:
        """Where board points (m, 2) appear, (n, m, 2) px."""
        _, away = self._steps(shared, own, board_mm)
        return np.asarray(distortion.distort(away, _coefficients(shared)) + shared[6:], np.float64)

    def jacobian(self, shared: FloatArray, own: FloatArray, board_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of `see` by shared (n, m, 2, 8) and own parameters (n, m, 2, 5)."""
        turned, away = self._steps(shared, own, board_mm)
        lens, by_coefficient = distortion.jacobians(away, _coefficients(shared))
        scale, squeeze = float(shared[0]), _squeeze(shared)
        x, y = turned[..., 0], turned[..., 1]
        flat = np.empty((*away.shape, 3))  # of the undistorted px by scale, e, g
        flat[..., 0] = turned @ squeeze
        flat[..., 1], flat[..., 2] = np.stack([x, -y], -1) * scale, np.stack([y, x], -1) * scale
        by_shared = np.empty((*away.shape, len(self.parameters)))
        by_shared[..., :3] = lens @ flat
        by_shared[..., 3:6] = by_coefficient[..., :RADIAL]
        by_shared[..., 6:] = np.eye(2) - lens
        by_own = np.empty((*away.shape, len(self.own)))
        onto_px = lens @ (scale * squeeze)
        by_own[..., 0] = (onto_px @ (turned @ QUARTER.T)[..., None])[..., 0]
        by_own[..., 1:3] = onto_px @ rotation(own[:, 0])[:, None] @ self._by_tilt(own[:, 1:3], board_mm)
        by_own[..., 3:] = lens
        return by_shared, by_own

    def at_pixels(self, shared: FloatArray, points_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How points (G, 2) of a picture shift with the parameters (G, 2, 8), and when the camera turns or moves."""
        coefficients = _coefficients(shared)
        away = distortion.undistort(points_px - shared[6:], coefficients, "px")
        board = away @ np.linalg.inv(_squeeze(shared)).T / float(shared[0])
        if self.mirrored:
            board = board * np.array([1.0, -1.0])
        square = np.array([[0.0, 0.0, 0.0, *shared[6:].tolist()]])
        by_shared, by_own = self.jacobian(shared, square, board)
        return by_shared[0], by_own[0][..., [0, 3, 4]]

    def _steps(self, shared: FloatArray, own: FloatArray, board_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Board points after tilting and turning, mm, and as ways from the distortion's centre, px: (n, m, 2) each."""
        tilt = own[:, 1:3]
        board = self._faced(board_mm)
        tilted = board - (board @ tilt[:, :, None]) * tilt[:, None]
        turned = tilted @ rotation(-own[:, 0])  # rows times R(-a) are columns times R(a)
        flat = float(shared[0]) * turned @ _squeeze(shared) + own[:, None, 3:]
        return turned, flat - shared[6:]

    def _by_tilt(self, tilt: FloatArray, board_mm: FloatArray) -> FloatArray:
        """Derivative of the tilted board point by v, (n, m, 2, 2)."""
        board = self._faced(board_mm)
        along = (board @ tilt[:, :, None])[..., None]
        return np.asarray(-along * np.eye(2) - tilt[:, None, :, None] * board[:, None], np.float64)

    def _faced(self, board_mm: FloatArray) -> FloatArray:
        return board_mm * np.array([1.0, -1.0]) if self.mirrored else board_mm


def is_mirrored(views: Views) -> bool:
    """Whether most pictures show the board's frame mirrored."""
    turns = [float(np.linalg.det(one[:2])) for one in affine_maps(views)]
    return float(np.median(np.sign(turns))) < 0


def affine_maps(views: Views) -> list[FloatArray]:
    """The map of each picture, rows (3, 2): two directions of the board, and its origin."""
    maps = []
    for px, seen in zip(views.points_px, views.seen, strict=True):
        design = np.column_stack([views.board_mm[seen], np.ones(int(seen.sum()))])
        maps.append(np.asarray(np.linalg.lstsq(design, px[seen], rcond=None)[0], np.float64))
    return maps


def _unfolded(affine: FloatArray, scale: float) -> FloatArray:
    """A picture's own parameters (5,) from its affine map."""
    left, sizes, right = np.linalg.svd(affine[:2].T / scale)
    turn = left @ right
    tilt = right[1] * np.sqrt(max(0.0, 1.0 - float(sizes[1]) / max(1.0, float(sizes[0]))))
    return np.array([np.arctan2(turn[1, 0], turn[0, 0]), *tilt, *affine[2]])


def _squeeze(shared: FloatArray) -> FloatArray:
    e, g = shared[1:3].tolist()
    return np.array([[1 + e, g], [g, 1 - e]])


def _coefficients(shared: FloatArray) -> FloatArray:
    return np.array([*shared[3:6].tolist(), 0.0, 0.0])
