"""Hand-eye calibration of a SCARA, for every mount and lens: solve, judge, refuse."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cellctl.calibration.accuracy import Predicted, covariance, noise_factors, point_jacobian, predict
from cellctl.calibration.agreement import LeftOut, agreeing, check_dots
from cellctl.calibration.errors import PosesDisagree
from cellctl.calibration.motion import Spread, check_motion
from cellctl.calibration.parameters import PARAMETERS
from cellctl.calibration.plane_map import Lens, PlaneMap
from cellctl.calibration.problem import (
    Fit,
    Looks,
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
LEAST_HEIGHT_MM = 0.2  # pictures must differ by so much in height for the slope to be seen
HOLD_OUT_FOLDS = 5


@dataclass(frozen=True, eq=False)
class HandEye:
    """Where a camera is, and how well that is known.

    `plane_map` maps mm of the mount's frame (eye_in_hand) or the robot frame (eye_to_hand) to px; `board` is
    robot_from_board (eye_in_hand) or tool_from_board (eye_to_hand).
    """

    kind: Kind
    plane_map: PlaneMap
    board: Pose
    slope_px_per_mm: tuple[float, float]  # shift of the picture per mm that the robot's Z grows
    height_span_mm: float  # of the pictures; 0 = the slope is not known
    poses: tuple[PoseFit, ...]  # those that were used
    left_out: tuple[LeftOut, ...]  # those that were not
    dots_left_out: int  # single dots
    rms_px: float  # per axis
    hold_out_um: float  # rms distance between seen and predicted board at poses left out of the fit
    predicted: Predicted
    spread: Spread
    board_scale: float  # board pitch over robot travel, from the linear solution
    robot_factor: float  # robot noise found over robot noise stated
    dot_factor: float  # dot noise found over dot noise stated
    covariance: FloatArray  # (21, 21) of PARAMETERS; enlarged when the noise found is larger than stated
    noise: Noise
    picture_px: tuple[int, int]  # width, height
    dots_px: FloatArray  # (n, m, 2) as measured
    residuals_px: FloatArray  # (n, m, 2) predicted minus measured, 0 for dots that were left out

    @property
    def slope_known(self) -> bool:
        """Whether pictures at several heights tell how the picture shifts with height."""
        return self.height_span_mm >= LEAST_HEIGHT_MM

    @property
    def slope_um_per_mm(self) -> tuple[float, float]:
        """What a mm of height shifts a point by in the plane, x and y."""
        by_mm = np.linalg.solve(self.plane_map.jacobian([self._middle_mm])[0], np.array(self.slope_px_per_mm))
        x, y = (by_mm * 1000).tolist()
        return x, y

    @property
    def _middle_mm(self) -> tuple[float, float]:
        width, height = self.picture_px
        x_mm, y_mm = self.plane_map.mm_at(Px((width - 1) / 2, (height - 1) / 2))
        return x_mm, y_mm

    def plane_at(self, below_mm: float) -> PlaneMap:
        """The map for a robot Z so far below the one of calibration. Only the shift is known, not a change of scale."""
        (u, v), (su, sv) = self.plane_map.offset_px, self.slope_px_per_mm
        return replace(self.plane_map, offset_px=(u + su * below_mm, v + sv * below_mm))

    @property
    def note(self) -> str:
        """What cannot be seen, in words."""
        z = (
            "z is not observable: all rotations of a SCARA are about one direction, so height and working distance "
            "of the camera are not part of this result"
        )
        if not self.slope_known:
            return f"{z}, nor is its slope: all pictures are of one height; keep picture and teaching heights equal"
        x, y = self.slope_um_per_mm
        return f"{z}; a mm of robot Z shifts what is seen by ({x:+.2f}, {y:+.2f}) um"

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
            "worst_pose": worst.number,
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
            "slope_px_per_mm": list(self.slope_px_per_mm),
            "slope_known": self.slope_known,
            "left_out": [list(one) for one in self.left_out],
            "dots_left_out": self.dots_left_out,
            "note": self.note,
        }


def solve_hand_eye(
    kind: Kind,
    looks: Looks,
    board_mm: FloatArray,
    noise: Noise | None = None,
    picture_px: tuple[int, int] = PICTURE_PX,
    lens: Lens = "telecentric",
) -> HandEye:
    """Solve the planar hand-eye problem from one picture of the board (m, 2) mm at each robot pose.

    The poses are robot_from_mount (eye_in_hand) or robot_from_tool (eye_to_hand). Linear start, then a bundle with one
    correction per pose that the robot's repeatability limits. Single dots and up to a tenth of the poses that do not
    fit are left out and named. Raises DegenerateMotion when the poses cannot tell the unknowns apart, PosesDisagree
    when no camera explains them (naming the poses to blame or the sign that is wrong), ValueError for arrays of wrong
    shape.
    """
    problem = checked_problem(kind, lens, looks, board_mm, noise or Noise(), picture_px)
    check_motion(looks.poses)
    check_dots(problem)
    fit, left_out = agreeing(problem)
    used = [looks.poses[number - 1] for number in fit.problem.numbers]
    return _result(problem, fit, left_out, check_motion(used))


def _hold_out_um(problem: Problem) -> float:
    """Leave every fifth pose out in turn, predict it from the others; rms distance."""
    every = range(len(problem.numbers))
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


def _result(problem: Problem, fit: Fit, left_out: tuple[LeftOut, ...], spread: Spread) -> HandEye:
    setup, bundle, x = _believable(fit), fit.bundle, fit.x
    robot_factor, dot_factor = noise_factors(bundle, x)
    parameters = covariance(bundle, x, bundle.normal(x)) * max(1.0, robot_factor, dot_factor) ** 2
    u, v = bundle.lens_centre_px.tolist()
    shots, residuals = fit.problem.shots, bundle.residuals_px(x)
    return HandEye(
        kind=setup.kind,
        plane_map=setup.plane_map,
        board=setup.board,
        slope_px_per_mm=bundle.slope_px_per_mm(x),
        height_span_mm=float(np.ptp(shots.heights_mm)),
        poses=tuple(pose_fits(fit)),
        left_out=left_out,
        dots_left_out=int((shots.used == 0).sum()),
        rms_px=math.sqrt(float((residuals**2).sum() / (2 * shots.used.sum()))),
        hold_out_um=_hold_out_um(fit.problem),
        predicted=predict(setup.plane_map, parameters, Px(u, v)),
        spread=spread,
        board_scale=fit.linear.scale,
        robot_factor=robot_factor,
        dot_factor=dot_factor,
        covariance=parameters,
        noise=problem.noise,
        picture_px=problem.picture_px,
        dots_px=problem.only([number - 1 for number in fit.problem.numbers]).shots.dots_px,
        residuals_px=residuals,
    )
