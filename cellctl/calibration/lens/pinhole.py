"""An ordinary lens: central projection, then the distortion of `distortion.py` in units of the focal length.

    X = R board + t,  a = (X/Z, Y/Z),  px = (fx, fy) * distort(a) + (cx, cy)

The parameters and their units are those of OpenCV, whose order of distortion coefficients is k1, k2, p1, p2, k3.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration import distortion
from cellctl.calibration.homography import homography
from cellctl.calibration.lens.model import Prior, Views
from cellctl.calibration.lens.zhang import board_pose, intrinsics
from cellctl.calibration.plane_map import Lens
from cellctl.calibration.six_dof.rigid import cross_matrix, right_jacobian, rotation_from_vector

FloatArray = NDArray[np.float64]

CENTRE_SD = 0.25  # of the principal point about the picture's middle, in widths of the picture
BENT_SD = 1.0  # of each term of the distortion at the picture's corner, in parts of the radius there
FROM_CENTRE = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # how turning moves a place at (0, 0, 1)


class Pinhole:
    """The model of an ordinary lens."""

    lens: Lens = "pinhole"
    parameters = ("fx_px", "fy_px", "cx_px", "cy_px", *distortion.COEFFICIENTS)
    own = ("rx_rad", "ry_rad", "rz_rad", "x_mm", "y_mm", "z_mm")

    def start(self, views: Views) -> FloatArray:
        """Zhang's closed solution, without distortion."""
        maps = [
            homography(views.board_mm[seen], px[seen]) for px, seen in zip(views.points_px, views.seen, strict=True)
        ]
        camera = intrinsics(maps, views.picture_px)
        return np.concatenate([camera, np.zeros(5), *(board_pose(one, camera) for one in maps)])

    def prior(self, views: Views, start: FloatArray) -> Prior:
        """Next to nothing: the principal point is in the picture, and the lens does not turn it inside out."""
        width = max(views.picture_px)
        corner = float(np.hypot(*views.middle_px)) / float(start[0])
        value = np.concatenate([[0.0, 0.0], views.middle_px, np.zeros(5)])
        powers = np.array([2, 4, 6, 1, 1])
        return Prior(value, np.array([np.inf, np.inf, CENTRE_SD * width, CENTRE_SD * width, *BENT_SD / corner**powers]))

    def see(self, shared: FloatArray, own: FloatArray, board_mm: FloatArray) -> FloatArray:
        """Where board points (m, 2) appear, (n, m, 2) px."""
        place = _place(own, board_mm)
        away = place[..., :2] / place[..., 2:]
        return np.asarray(shared[:2] * distortion.distort(away, shared[4:]) + shared[2:4], np.float64)

    def jacobian(self, shared: FloatArray, own: FloatArray, board_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of `see` by shared (n, m, 2, 9) and own parameters (n, m, 2, 6)."""
        place = _place(own, board_mm)
        away, depth = place[..., :2] / place[..., 2:], place[..., 2]
        by_away, by_coefficient = distortion.jacobians(away, shared[4:])
        focal = shared[:2, None]
        by_shared = np.zeros((*away.shape, len(self.parameters)))
        bent = distortion.distort(away, shared[4:])
        by_shared[..., 0, 0], by_shared[..., 1, 1] = bent[..., 0], bent[..., 1]
        by_shared[..., 0, 2] = by_shared[..., 1, 3] = 1.0
        by_shared[..., 4:] = focal * by_coefficient
        flattened = np.concatenate([np.broadcast_to(np.eye(2), (*away.shape, 2)), -away[..., None]], axis=-1)
        by_place = focal * by_away @ (flattened / depth[..., None, None])
        by_own = np.empty((*away.shape, len(self.own)))
        by_own[..., :3] = by_place @ _by_turn(own[:, :3], board_mm)
        by_own[..., 3:] = by_place
        return by_shared, by_own

    def at_pixels(self, shared: FloatArray, points_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How points (G, 2) of a picture shift with the parameters (G, 2, 9), and when the camera turns (G, 2, 3)."""
        rays = distortion.undistort((points_px - shared[2:4]) / shared[:2], shared[4:], "focal lengths")
        ahead = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])  # a board square before the camera, at 1
        by_shared, by_own = self.jacobian(shared, ahead, rays)
        return by_shared[0], by_own[0, ..., :3] + by_own[0, ..., 3:] @ FROM_CENTRE


def _place(own: FloatArray, board_mm: FloatArray) -> FloatArray:
    """Board points (m, 2) in the camera's frame, (n, m, 3)."""
    turns = rotation_from_vector(own[:, :3])[:, :, :2]
    return np.asarray(board_mm @ turns.transpose(0, 2, 1) + own[:, None, 3:], np.float64)


def _by_turn(vectors: FloatArray, board_mm: FloatArray) -> FloatArray:
    """Derivative of a board point in the camera's frame by the rotation vector, (n, m, 3, 3)."""
    points = np.column_stack([board_mm, np.zeros(len(board_mm))])
    turned = -rotation_from_vector(vectors)[:, None] @ cross_matrix(points)
    return np.asarray(turned @ right_jacobian(vectors)[:, None], np.float64)
