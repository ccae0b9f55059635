"""The tool's rotation centre by camera 2, and the run-out of what the cup holds, from pure rotations of a held board.

The middle of the board moves on a circle about the R axis: its centre is the rotation centre, its radius the
eccentricity of the grip, and how far the middle strays from it the wobble of the axis. No pose of the board is
assumed and no travel is used, so that this and the hand-eye map check each other: the map must put the tool's axis
where the robot says that it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellctl.calibration.errors import DegenerateMotion, PosesDisagree
from cellctl.calibration.motion import rotation_spread_deg
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.scara import QUARTER, FloatArray, Noise, rotation
from cellctl.geometry import Mm, Pose, Px

LEAST_ROTATIONS = 3
LEAST_SPREAD_DEG = 30.0
MOST_TRAVEL_MM = 0.02
MOST_RESIDUAL_UM = 100.0


class ToolCentre(NamedTuple):
    """Where the tool turns, how what it holds runs out, and how well that is known. Covariances are (2, 2)."""

    centre_px: Px
    covariance_um2: FloatArray  # of the centre, robot frame
    eccentricity_mm: Mm  # the board's middle as seen from the rotation centre, tool frame at R = 0
    eccentricity_covariance_um2: FloatArray
    wobble_rms_um: float  # distance of the board's middle from its circle
    wobble_worst_um: float
    worst_deg: float  # the rotation of the worst
    board_mm: Mm  # the board's origin as seen from the rotation centre, tool frame
    map_dx_um: float  # centre by the hand-eye map minus the robot's X, Y
    map_dy_um: float

    @property
    def sd_um(self) -> float:
        """One sigma of the centre's vector."""
        return math.sqrt(float(np.trace(self.covariance_um2)))

    @property
    def eccentricity_um(self) -> float:
        """Radius of the circle on which the board's middle moves."""
        return math.hypot(*self.eccentricity_mm) * 1000

    @property
    def eccentricity_sd_um(self) -> float:
        """One sigma of the eccentricity's vector."""
        return math.sqrt(float(np.trace(self.eccentricity_covariance_um2)))

    @property
    def error_um(self) -> float:
        """How far the hand-eye map is from putting the tool's axis where the robot says that it is."""
        return math.hypot(self.map_dx_um, self.map_dy_um)


class _Turns(NamedTuple):
    """Middle of the board at each rotation (n, 2) mm by the map, and the board's axes at rotation 0 (2, 2)."""

    angles: FloatArray
    middles: FloatArray
    axes: FloatArray
    board_middle: FloatArray  # in the board frame, (2,) mm
    dots_off_mm: float  # rms of the dots against the turned board


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
    seen_mm = camera.mm_from_px(dots.reshape(-1, 2)).reshape(dots.shape)
    turns = _turns(np.radians([pose.t_deg for pose in poses]), seen_mm, board)
    solution, design = _solve(turns)
    off_mm = turns.middles - (design @ solution).reshape(-1, 2)
    _check_residual(turns, off_mm)
    dot_sd_mm = noise.dot_sd_px * camera.mm_per_px / math.sqrt(len(board))
    covariance = _covariance(turns, solution, design, off_mm, noise, dot_sd_mm)
    return _result(camera, Mm(poses[0].x_mm, poses[0].y_mm), turns, solution, off_mm, covariance)


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


def _turns(angles: FloatArray, seen_mm: FloatArray, board: FloatArray) -> _Turns:
    around = board - board.mean(0)
    axes = np.stack([np.linalg.lstsq(around, one - one.mean(0), rcond=None)[0].T for one in seen_mm])
    common = np.mean(rotation(-angles) @ axes, axis=0)
    middles = seen_mm.mean(1)
    expected = np.einsum("nij,mj->nmi", rotation(angles) @ common, around)
    off = seen_mm - middles[:, None] - expected
    return _Turns(angles, middles, common, board.mean(0), math.sqrt(float((off**2).mean())))


def _solve(turns: _Turns) -> tuple[FloatArray, FloatArray]:
    """Middle = R(r) arm + centre: the arm (2) in the tool frame, the centre (2) in the robot frame; and the design."""
    arms = rotation(turns.angles)
    centres = np.broadcast_to(np.eye(2), arms.shape)
    design = np.concatenate([arms, centres], axis=-1).reshape(-1, 4)
    solution = np.linalg.lstsq(design, turns.middles.reshape(-1), rcond=None)[0]
    return np.asarray(solution, np.float64), design


def _check_residual(turns: _Turns, off_mm: FloatArray) -> None:
    off_um = np.hypot(*off_mm.T) * 1000
    worst = max(float(off_um.max()), turns.dots_off_mm * 1000)
    if not worst <= MOST_RESIDUAL_UM:
        raise PosesDisagree(
            "rotations",
            f"the dots do not turn as the tool says ({worst:.0f} um off, {MOST_RESIDUAL_UM:g} um allowed): check the "
            "sign of R, that only R was moved, and that the board is held firmly",
            poses=(int(off_um.argmax()),),
        )


def _covariance(
    turns: _Turns, solution: FloatArray, design: FloatArray, off_mm: FloatArray, noise: Noise, dot_sd_mm: float
) -> FloatArray:
    """Of arm and centre, (4, 4) mm^2: the robot's repeatability carried through, enlarged if the fit is worse."""
    swing = rotation(turns.angles) @ (QUARTER @ solution[:2])
    place = np.eye(2) * (noise.robot_sd_mm**2 + dot_sd_mm**2)
    each = place + math.radians(noise.robot_sd_deg) ** 2 * swing[:, :, None] * swing[:, None, :]
    inverse = np.linalg.pinv(design).reshape(4, -1, 2)
    spread = np.einsum("ani,nij,bnj->ab", inverse, each, inverse)
    chi2 = float(np.einsum("ni,nij,nj->", off_mm, np.linalg.inv(each), off_mm))
    freedom = 2 * len(turns.angles) - 4
    return np.asarray(spread * max(1.0, chi2 / freedom), np.float64)


def _result(
    camera: PlaneMap,
    robot: Mm,
    turns: _Turns,
    solution: FloatArray,
    off_mm: FloatArray,
    covariance: FloatArray,
) -> ToolCentre:
    x_mm, y_mm = solution[2:].tolist()
    off_um = np.hypot(*off_mm.T) * 1000
    origin = solution[:2] - turns.axes @ turns.board_middle
    return ToolCentre(
        centre_px=camera.px_at(Mm(x_mm, y_mm)),
        covariance_um2=covariance[2:, 2:] * 1e6,
        eccentricity_mm=Mm(*solution[:2].tolist()),
        eccentricity_covariance_um2=covariance[:2, :2] * 1e6,
        wobble_rms_um=math.sqrt(float((off_um**2).mean())),
        wobble_worst_um=float(off_um.max()),
        worst_deg=math.degrees(float(turns.angles[int(off_um.argmax())])),
        board_mm=Mm(*origin.tolist()),
        map_dx_um=(x_mm - robot.x_mm) * 1000,
        map_dy_um=(y_mm - robot.y_mm) * 1000,
    )
