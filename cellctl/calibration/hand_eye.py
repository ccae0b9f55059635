"""Hand-eye calibration of a SCARA with a telecentric camera, for both mounts: solve, judge, refuse."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellctl.calibration.accuracy import Predicted, covariance, noise_factors, point_jacobian, predict
from cellctl.calibration.agreement import check_agreement, check_dots
from cellctl.calibration.bundle import PARAMETERS
from cellctl.calibration.errors import PosesDisagree
from cellctl.calibration.motion import Spread, check_motion
from cellctl.calibration.plane_map import PlaneMap
from cellctl.calibration.problem import (
    Fit,
    PoseFit,
    Problem,
    checked_problem,
    fit_problem,
    pose_fits,
    prediction_error_mm,
)
from cellctl.calibration.scara import FloatArray, Kind, Noise, Setup
from cellctl.geometry import Pose, Px

PICTURE_PX = (2592, 1944)
Z_NOT_OBSERVABLE = (
    "z is not observable: all rotations of a SCARA are about one direction, so height and working distance "
    "of the camera are not part of this result; keep picture and teaching heights equal"
)
HOLD_OUT_FOLDS = 5


@dataclass(frozen=True, eq=False)
class HandEye:
    """Where a camera is, and how well that is known.

    `plane_map` maps mm of the tool frame (eye_in_hand) or the robot frame (eye_to_hand) to px; `board` is
    robot_from_board (eye_in_hand) or tool_from_board (eye_to_hand).
    """

    kind: Kind
    plane_map: PlaneMap
    board: Pose
    poses: tuple[PoseFit, ...]
    rms_px: float  # per axis
    hold_out_um: float  # rms distance between seen and predicted board at poses left out of the fit
    predicted: Predicted
    spread: Spread
    board_scale: float  # board pitch over robot travel, from the linear solution
    robot_factor: float  # robot noise found over robot noise stated
    dot_factor: float  # dot noise found over dot noise stated
    covariance: FloatArray  # (12, 12) of PARAMETERS; enlarged when the noise found is larger than stated
    noise: Noise
    picture_px: tuple[int, int]  # width, height
    dots_px: FloatArray  # (n, m, 2) as measured
    residuals_px: FloatArray  # (n, m, 2) predicted minus measured
    note: str = Z_NOT_OBSERVABLE

    @property
    def setup(self) -> Setup:
        """Camera and board, for a new plan."""
        return Setup(self.kind, self.plane_map, self.board)

    @property
    def worst_pose(self) -> int:
        """Index of the pose that fits least."""
        return max(range(len(self.poses)), key=lambda i: self.poses[i].worst_sd)

    def covariance_mm2(self, point: Px) -> FloatArray:
        """Covariance (2, 2) of the mm that the map gives for one px."""
        jacobian = point_jacobian(self.plane_map, point)
        return jacobian @ self.covariance @ jacobian.T

    def sd_um(self, point: Px) -> float:
        """Expected absolute error at one px: one sigma of the vector's length."""
        return math.sqrt(float(np.trace(self.covariance_mm2(point)))) * 1000

    def as_dict(self) -> dict[str, Any]:
        """What a calibration file keeps: floats, strings and lists."""
        worst = self.poses[self.worst_pose]
        return {
            "kind": self.kind,
            "plane_map": self.plane_map.as_dict(),
            "board": list(self.board),
            "poses": len(self.poses),
            "rms_px": self.rms_px,
            "worst_pose": self.worst_pose,
            "worst_pose_rms_px": worst.rms_px,
            "hold_out_um": self.hold_out_um,
            "predicted_absolute_um": self.predicted.absolute_um,
            "predicted_differential_um": self.predicted.differential_um,
            "rotation_spread_deg": self.spread.rotation_deg,
            "board_scale": self.board_scale,
            "robot_factor": self.robot_factor,
            "dot_factor": self.dot_factor,
            "parameters": list(PARAMETERS),
            "covariance": self.covariance.tolist(),
            "note": self.note,
        }


def solve_hand_eye(
    kind: Kind,
    poses: Sequence[Pose],
    dots_px: FloatArray,
    board_mm: FloatArray,
    noise: Noise | None = None,
    picture_px: tuple[int, int] = PICTURE_PX,
) -> HandEye:
    """Solve the planar hand-eye problem from one picture of the board at each robot pose.

    `poses` are robot_from_tool (for a camera on the second arm: robot_from_arm), `dots_px` is (n, m, 2), `board_mm`
    (m, 2). Linear start, then a bundle with one correction per pose that the robot's repeatability limits.
    Raises DegenerateMotion when the poses cannot tell the unknowns apart, PosesDisagree when no camera explains
    them (naming the poses to blame or the sign that is wrong), ValueError for arrays of wrong shape.
    """
    problem = checked_problem(kind, poses, dots_px, board_mm, noise or Noise(), picture_px)
    spread = check_motion(poses)
    check_dots(problem)
    fit = fit_problem(problem)
    check_agreement(fit)
    return _result(fit, spread, poses)


def _hold_out_um(problem: Problem) -> float:
    """Leave every fifth pose out in turn, predict it from the others; rms distance."""
    every = range(len(problem.poses))
    errors = []
    for fold in range(HOLD_OUT_FOLDS):
        rest = [i for i in every if i % HOLD_OUT_FOLDS != fold]
        fit = fit_problem(problem.only(rest))
        errors.append(prediction_error_mm(fit, problem.only(every[fold::HOLD_OUT_FOLDS])))
    return float(np.sqrt((np.concatenate(errors) ** 2).sum(1).mean())) * 1000


def _believable(fit: Fit) -> Setup:
    try:
        return fit.bundle.setup(fit.x)
    except ValueError as error:
        raise PosesDisagree("camera", str(error)) from error


def _result(fit: Fit, spread: Spread, poses: Sequence[Pose]) -> HandEye:
    setup = _believable(fit)
    robot_factor, dot_factor = noise_factors(fit.bundle, fit.x, fit.problem.dots_px)
    normal = fit.bundle.normal(fit.x, fit.problem.dots_px)
    parameters = covariance(fit.bundle, normal) * max(1.0, robot_factor, dot_factor) ** 2
    u, v = fit.bundle.lens_centre_px.tolist()
    fits = [one._replace(pose=Pose(*pose)) for one, pose in zip(pose_fits(fit), poses, strict=True)]
    return HandEye(
        kind=setup.kind,
        plane_map=setup.plane_map,
        board=setup.board,
        poses=tuple(fits),
        rms_px=math.sqrt(float((fit.residuals_px**2).mean())),
        hold_out_um=_hold_out_um(fit.problem),
        predicted=predict(setup.plane_map, parameters, Px(u, v)),
        spread=spread,
        board_scale=fit.linear.scale,
        robot_factor=robot_factor,
        dot_factor=dot_factor,
        covariance=parameters,
        noise=fit.problem.noise,
        picture_px=fit.problem.picture_px,
        dots_px=fit.problem.dots_px,
        residuals_px=fit.residuals_px,
    )
