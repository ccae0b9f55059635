"""Does a calibration still hold? A few pictures of the board tell how far the camera has moved since.

The camera is taken to have moved rigidly in its mount's frame, by (dx, dy) and a turn about the place that the
picture's middle shows. For a camera on the robot the board on the bench is where it was, which shows both sharply; a
held board is gripped anew, so its place on the cup is unknown as well, and the turn shows only through the travel.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellctl.calibration.board_pose import seen_boards
from cellctl.calibration.errors import DegenerateMotion
from cellctl.calibration.motion import rotation_spread_deg
from cellctl.calibration.scara import QUARTER, FloatArray, Noise, Setup, rotation
from cellctl.geometry import Pose, Px, wrap_deg

LEAST_POSES = 4
LEAST_SPREAD_DEG = 30.0
MOST_CHI2 = 11.3  # of three figures that are nothing but noise, 99 %
SURE = 3.0  # sigmas by which a figure must be beyond its limit before the calibration is blamed


class Verification(NamedTuple):
    """How far the camera seems to have moved, with the covariance (3, 3) of dx um, dy um, turn mdeg."""

    dx_um: float
    dy_um: float
    turn_mdeg: float
    covariance: FloatArray
    seen_off_um: float  # rms distance of the board from where the calibration expects it
    left_um: float  # the same once the movement is taken off
    board_moved: bool | None  # camera on the robot: the board rather than the camera; None = cannot be told apart

    @property
    def shift_um(self) -> float:
        """Length of the shift."""
        return math.hypot(self.dx_um, self.dy_um)

    @property
    def shift_sd_um(self) -> float:
        """One sigma of its vector."""
        return math.sqrt(float(self.covariance[0, 0] + self.covariance[1, 1]))

    @property
    def turn_sd_mdeg(self) -> float:
        """One sigma of the turn."""
        return math.sqrt(float(self.covariance[2, 2]))

    def far_um(self, lever_mm: float) -> tuple[float, float]:
        """What the turn moves at a lever, and one sigma of it."""
        um_per_mdeg = math.radians(1.0) * lever_mm
        return abs(self.turn_mdeg) * um_per_mdeg, self.turn_sd_mdeg * um_per_mdeg

    def holds(self, limit_um: float, lever_mm: float) -> bool:
        """Whether neither the shift nor the turn at the lever is surely beyond the limit."""
        far_um, far_sd_um = self.far_um(lever_mm)
        return self.shift_um - SURE * self.shift_sd_um <= limit_um and far_um - SURE * far_sd_um <= limit_um

    def text(self, lever_mm: float) -> str:
        """For people."""
        far_um, far_sd_um = self.far_um(lever_mm)
        return (
            f"moved by ({self.dx_um:+.1f}, {self.dy_um:+.1f}) um +-{self.shift_sd_um:.1f} and turned by "
            f"{self.turn_mdeg:+.1f} mdeg +-{self.turn_sd_mdeg:.1f}, which is {far_um:.1f} um +-{far_sd_um:.1f} at "
            f"{lever_mm:.0f} mm"
        )


class _Looks(NamedTuple):
    """What was seen: tool places (n, 2) mm and turns (n,) rad; the board's middle (n, 2) and turn (n,) by the map."""

    places: FloatArray
    turns: FloatArray
    middles: FloatArray
    board_turns: FloatArray
    pivot: FloatArray  # the place that the picture's middle shows, (2,)
    noise: Noise


def verify(
    setup: Setup,
    poses: Sequence[Pose],
    dots_px: FloatArray,
    board_mm: FloatArray,
    picture_px: tuple[int, int],
    noise: Noise | None = None,
) -> Verification:
    """Compare pictures of the board at a few poses with the calibration in `setup`.

    `dots_px` is (n, m, 2), `board_mm` (m, 2). Raises DegenerateMotion for too few poses or too little rotation,
    ValueError for arrays of wrong shape.
    """
    dots, board = np.asarray(dots_px, float), np.asarray(board_mm, float)
    if dots.shape != (len(poses), len(board), 2) or not np.isfinite(dots).all():
        raise ValueError(f"verification: dots must be ({len(poses)}, {len(board)}, 2) and finite (got {dots.shape})")
    spread_deg = rotation_spread_deg([pose.t_deg for pose in poses]) if poses else 0.0
    if len(poses) < LEAST_POSES or spread_deg < LEAST_SPREAD_DEG:
        raise DegenerateMotion(
            "verification",
            f"{len(poses)} poses over {spread_deg:.1f} deg, at least {LEAST_POSES} over {LEAST_SPREAD_DEG:g} deg are "
            "needed",
        )
    looks = _looks(setup, poses, dots, board, picture_px, noise or Noise())
    if setup.kind == "eye_to_hand":
        return _held_board(looks)
    return _fixed_board(looks, setup.board, board.mean(0))


def _looks(
    setup: Setup,
    poses: Sequence[Pose],
    dots: FloatArray,
    board: FloatArray,
    picture_px: tuple[int, int],
    noise: Noise,
) -> _Looks:
    seen, table = seen_boards(setup.plane_map, dots, board), np.array(poses, float)
    pivot = np.array(setup.plane_map.mm_at(Px((picture_px[0] - 1) / 2, (picture_px[1] - 1) / 2)))
    return _Looks(table[:, :2], np.radians(table[:, 2]), seen[:, :2], seen[:, 2], pivot, noise)


def _fixed_board(looks: _Looks, board: Pose, middle_mm: FloatArray) -> Verification:
    """The board is known: per pose a shift (2) and a turn (1) of the camera; then once more with the board unknown."""
    back = rotation(-looks.turns)
    place = np.array(board.point(*middle_mm.tolist()))
    expected = np.einsum("nij,nj->ni", back, place - looks.places)
    turn_off = [wrap_deg(math.degrees(t)) for t in (math.radians(board.t_deg) - looks.turns - looks.board_turns)]
    off = np.column_stack([expected - looks.middles, np.radians(turn_off)])
    design = np.tile(np.eye(3), (len(off), 1, 1))
    design[:, :2, 2] = (looks.middles - looks.pivot) @ QUARTER.T
    found, covariance = _weighted(design, off, _noise_of_pose(looks))
    left = off - design @ found
    return _result(found, covariance, off[:, :2], left[:, :2], _blame_board(found, *_free_board(looks, back)))


def _free_board(looks: _Looks, back: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The camera's movement when the board's place is unknown: the angle says nothing then."""
    arms = (looks.middles - looks.pivot) @ QUARTER.T
    design = np.concatenate([np.tile(np.eye(2), (len(arms), 1, 1)), arms[..., None], -back], axis=-1)
    right = -np.einsum("nij,nj->ni", back, looks.places) - looks.middles
    found, covariance = _weighted(design, right, _noise_of_pose(looks)[:, :2, :2])
    return found[:3], covariance[:3, :3]


def _held_board(looks: _Looks) -> Verification:
    """The board's place on the cup is unknown: shift (2), turn (1), grip (2) from the middles alone."""
    arms = (looks.middles - looks.pivot) @ QUARTER.T
    turned = rotation(looks.turns)
    design = np.concatenate([np.tile(np.eye(2), (len(arms), 1, 1)), arms[..., None], -turned], axis=-1)
    right = looks.places - looks.middles
    grip = np.linalg.lstsq(turned.reshape(-1, 2), (-right).reshape(-1), rcond=None)[0]
    found, covariance = _weighted(design, right, _noise_of_pose(looks, turned @ grip))
    still = right + np.einsum("nij,j->ni", turned, grip)
    return _result(found[:3], covariance[:3, :3], still, right - design @ found, None)


def _noise_of_pose(looks: _Looks, arms: FloatArray | None = None) -> FloatArray:
    """Covariance of each pose's row: the robot's place, and its turn acting at the board's lever. mm, mm, rad."""
    lever = (looks.middles if arms is None else arms) @ QUARTER.T
    carried = np.column_stack([lever, np.ones(len(lever))])[:, : 3 if arms is None else 2]
    place = np.zeros((carried.shape[1], carried.shape[1]))
    place[:2, :2] = np.eye(2) * looks.noise.robot_sd_mm**2
    turn = math.radians(looks.noise.robot_sd_deg) ** 2
    return np.asarray(place + turn * carried[:, :, None] * carried[:, None, :], np.float64)


def _weighted(design: FloatArray, right: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Generalised least squares over poses; the covariance is enlarged when they scatter more than stated."""
    weight = np.linalg.inv(noise)
    normal = np.einsum("nia,nij,njb->ab", design, weight, design)
    found = np.linalg.solve(normal, np.einsum("nia,nij,nj->a", design, weight, right))
    left = right - design @ found
    chi2 = float(np.einsum("ni,nij,nj->", left, weight, left))
    freedom = right.size - len(found)
    return found, np.linalg.inv(normal) * max(1.0, chi2 / freedom)


def _blame_board(by_board: FloatArray, free: FloatArray, covariance: FloatArray) -> bool | None:
    """Whether the camera's movement against the board is explained without the board, by nothing, or by both."""
    still, moved = _likely(free, covariance), _likely(by_board - free, covariance)
    return None if still == moved else still


def _likely(away: FloatArray, covariance: FloatArray) -> bool:
    """Not to be told from nothing."""
    return bool(away @ np.linalg.solve(covariance, away) <= MOST_CHI2)


def _result(
    found: FloatArray, covariance: FloatArray, off_mm: FloatArray, left_mm: FloatArray, board_moved: bool | None
) -> Verification:
    units = np.array([1000.0, 1000.0, math.degrees(1.0) * 1000.0])
    dx_um, dy_um, turn_mdeg = (found * units).tolist()
    return Verification(
        dx_um=dx_um,
        dy_um=dy_um,
        turn_mdeg=turn_mdeg,
        covariance=covariance * np.outer(units, units),
        seen_off_um=_rms_um(off_mm),
        left_um=_rms_um(left_mm),
        board_moved=board_moved,
    )


def _rms_um(off_mm: FloatArray) -> float:
    return math.sqrt(float((off_mm**2).sum(1).mean())) * 1000
