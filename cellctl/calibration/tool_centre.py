"""The tool's rotation centre in camera 2's picture, from pure rotations of a held board.

It does not use the hand-eye map but for the lens, so that the two check each other: the map must put the tool's
axis where the robot says that it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellctl.calibration.errors import DegenerateMotion, PosesDisagree
from cellctl.calibration.motion import rotation_spread_deg
from cellctl.calibration.plane_map import PlaneMap, distort, undistort
from cellctl.calibration.scara import QUARTER, FloatArray, Noise, rotation
from cellctl.geometry import Mm, Pose, Px

LEAST_ROTATIONS = 3
LEAST_SPREAD_DEG = 30.0
MOST_TRAVEL_MM = 0.02
MOST_RESIDUAL_UM = 100.0


class ToolCentre(NamedTuple):
    """Where the tool turns in the picture, and how truly."""

    centre_px: Px
    covariance_px2: FloatArray  # (2, 2)
    sd_um: float  # one sigma of the centre's vector
    run_out_rms_um: float  # distance of the board's middle from its circle
    run_out_worst_um: float
    worst_deg: float  # the rotation of the worst
    board_mm: Mm  # the board's origin as seen from the rotation centre, tool frame
    map_dx_um: float  # centre by the hand-eye map minus the robot's X, Y
    map_dy_um: float

    @property
    def error_um(self) -> float:
        """How far the hand-eye map is from putting the tool's axis where the robot says that it is."""
        return math.hypot(self.map_dx_um, self.map_dy_um)


class _Turns(NamedTuple):
    """Undistorted middle of the board at each rotation (n, 2) px, and board axes at rotation 0 (2, 2) px/mm."""

    angles: FloatArray
    middles: FloatArray
    axes: FloatArray
    dots_off_px: float  # rms of the dots against the turned board


def solve_tool_centre(
    poses: Sequence[Pose],
    dots_px: FloatArray,
    board_mm: FloatArray,
    camera: PlaneMap,
    noise: Noise | None = None,
) -> ToolCentre:
    """Find the rotation centre from dots (n, m, 2) px of a held board (m, 2) mm at n poses that differ in R only.

    `camera` is the fixed camera's map. Raises DegenerateMotion for too few or too narrow rotations or a robot that
    also travelled, PosesDisagree when the dots do not turn, ValueError for arrays of wrong shape.
    """
    dots, board, noise = np.asarray(dots_px, float), np.asarray(board_mm, float), noise or Noise()
    if dots.shape != (len(poses), len(board), 2) or not np.isfinite(dots).all():
        raise ValueError(f"tool centre: dots must be ({len(poses)}, {len(board)}, 2) and finite (got {dots.shape})")
    _check_rotations(poses)
    turns = _turns(camera, np.radians([pose.t_deg for pose in poses]), dots, board)
    solution, design = _solve(turns)
    off_px = turns.middles - (design @ solution).reshape(-1, 2)
    off_um = np.hypot(*np.linalg.solve(turns.axes, off_px.T)) * 1000
    _check_residual(turns, off_um)
    covariance = _covariance(turns, solution, design, off_px, noise, len(board))
    robot = Mm(poses[0].x_mm, poses[0].y_mm)
    return _result(camera, robot, turns, solution, off_um, covariance, board)


def _check_rotations(poses: Sequence[Pose]) -> None:
    spread = rotation_spread_deg([pose.t_deg for pose in poses]) if poses else 0.0
    if len(poses) < LEAST_ROTATIONS or spread < LEAST_SPREAD_DEG:
        raise DegenerateMotion(
            "rotations",
            f"{len(poses)} rotations over {spread:.1f} deg, at least {LEAST_ROTATIONS} over {LEAST_SPREAD_DEG:g} deg "
            "are needed: turn the tool further",
        )
    travel_mm = float(np.ptp(np.array(poses)[:, :2], axis=0).max())
    if travel_mm > MOST_TRAVEL_MM:
        raise DegenerateMotion(
            "rotations", f"the tool travelled {travel_mm:.3f} mm between the rotations: turn it at one X, Y"
        )


def _turns(camera: PlaneMap, angles: FloatArray, dots: FloatArray, board: FloatArray) -> _Turns:
    flat = undistort(dots, camera.k1_per_px2, np.array(camera.distortion_centre_px))
    around = board - board.mean(0)
    axes = np.stack([np.linalg.lstsq(around, one - one.mean(0), rcond=None)[0].T for one in flat])
    common = np.mean(axes @ rotation(-angles), axis=0)
    expected = np.einsum("nij,mj->nmi", common @ rotation(angles), around)
    middles = flat.mean(1)
    off = flat - middles[:, None] - expected
    return _Turns(angles, middles, common, math.sqrt(float((off**2).mean())))


def _solve(turns: _Turns) -> tuple[FloatArray, FloatArray]:
    """Middle = axes R(r) arm + centre: the arm (2) in the board's directions at 0, the centre (2); and the design."""
    arms = turns.axes @ rotation(turns.angles)
    centres = np.broadcast_to(np.eye(2), arms.shape)
    design = np.concatenate([arms, centres], axis=-1).reshape(-1, 4)
    solution = np.linalg.lstsq(design, turns.middles.reshape(-1), rcond=None)[0]
    return np.asarray(solution, np.float64), design


def _check_residual(turns: _Turns, off_um: FloatArray) -> None:
    scale = math.sqrt(abs(float(np.linalg.det(turns.axes))))
    dots_um = turns.dots_off_px / scale * 1000 if scale > 0 else math.inf
    worst = max(float(off_um.max()), dots_um)
    if not worst <= MOST_RESIDUAL_UM:
        raise PosesDisagree(
            "rotations",
            f"the dots do not turn as the tool says ({worst:.0f} um off, {MOST_RESIDUAL_UM:g} um allowed): check the "
            "sign of R, that only R was moved, and that the board is held firmly",
            poses=(int(off_um.argmax()),),
        )


def _covariance(
    turns: _Turns, solution: FloatArray, design: FloatArray, off_px: FloatArray, noise: Noise, dots: int
) -> FloatArray:
    """Of the centre, px^2: the robot's repeatability carried through the fit, enlarged if it fits worse than that."""
    swing = (turns.axes @ rotation(turns.angles)) @ (QUARTER @ solution[:2])
    place = turns.axes @ turns.axes.T * noise.robot_sd_mm**2 + np.eye(2) * noise.dot_sd_px**2 / dots
    each = place + math.radians(noise.robot_sd_deg) ** 2 * swing[:, :, None] * swing[:, None, :]
    inverse = np.linalg.pinv(design).reshape(4, -1, 2)
    spread = np.einsum("ani,nij,bnj->ab", inverse, each, inverse)
    chi2 = float(np.einsum("ni,nij,nj->", off_px, np.linalg.inv(each), off_px))
    freedom = 2 * len(turns.angles) - 4
    return np.asarray(spread[2:, 2:] * max(1.0, chi2 / freedom), np.float64)


def _result(
    camera: PlaneMap,
    robot: Mm,
    turns: _Turns,
    solution: FloatArray,
    off_um: FloatArray,
    covariance: FloatArray,
    board: FloatArray,
) -> ToolCentre:
    u, v = distort(solution[2:], camera.k1_per_px2, np.array(camera.distortion_centre_px)).tolist()
    x_mm, y_mm = camera.mm_at(Px(u, v))
    to_mm = np.linalg.inv(camera.matrix)
    towards = to_mm @ turns.axes  # the board's axes at rotation 0, in the tool frame
    origin = towards @ (solution[:2] - board.mean(0))
    return ToolCentre(
        centre_px=Px(u, v),
        covariance_px2=covariance,
        sd_um=math.sqrt(float(np.trace(to_mm @ covariance @ to_mm.T))) * 1000,
        run_out_rms_um=math.sqrt(float((off_um**2).mean())),
        run_out_worst_um=float(off_um.max()),
        worst_deg=math.degrees(float(turns.angles[int(off_um.argmax())])),
        board_mm=Mm(*origin.tolist()),
        map_dx_um=(x_mm - robot.x_mm) * 1000,
        map_dy_um=(y_mm - robot.y_mm) * 1000,
    )
