"""How good a calibration is, as text: judged against the gate, for the operator and for the file."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cellctl.calibration.hand_eye import HandEye
from cellctl.calibration.tool_centre import ToolCentre

KIND = {
    "eye_in_hand": "eye in hand (mm are in the frame of the mount)",
    "eye_to_hand": "eye to hand (mm are in the robot frame)",
}
COVERAGE_CELLS = (12, 9)


@dataclass(frozen=True, slots=True)
class Acceptance:
    """What a calibration must reach to be used."""

    rms_px: float = 0.1
    hold_out_um: float = 20.0
    absolute_um: float = 15.0
    differential_um: float = 2.0
    robot_factor: float = 2.0


def shortcomings(result: HandEye, limits: Acceptance | None = None) -> tuple[str, ...]:
    """One sentence for every figure that is not good enough; empty when the calibration may be used."""
    limits = limits or Acceptance()
    figures = [
        ("the dots' residual", result.rms_px, limits.rms_px, "px rms", "clean the board, check focus"),
        ("the hold-out error", result.hold_out_um, limits.hold_out_um, "um", "fix board and camera firmly"),
        (
            "the predicted absolute error",
            result.predicted.absolute_um,
            limits.absolute_um,
            "um",
            "take more poses with more rotation",
        ),
        (
            "the predicted error of differences",
            result.predicted.differential_um,
            limits.differential_um,
            "um",
            "take more poses",
        ),
        (
            "the robot's scatter",
            result.robot_factor,
            limits.robot_factor,
            "times what is stated",
            "look for play, or state the true repeatability",
        ),
    ]
    return tuple(
        f"{name} is {found:.3g} {unit}, {limit:g} allowed: {remedy}"
        for name, found, limit, unit, remedy in figures
        if not found <= limit
    )


def coverage(result: HandEye) -> float:
    """Part of the picture's area, in a grid of 12 x 9, where dots were seen."""
    size = np.array(result.picture_px, float)
    dots = result.dots_px.reshape(-1, 2)
    cells = np.floor(dots[np.isfinite(dots).all(1)] / size * COVERAGE_CELLS).astype(int)
    return len({tuple(cell) for cell in cells.tolist()}) / math.prod(COVERAGE_CELLS)


def report_text(result: HandEye, limits: Acceptance | None = None) -> str:
    """The quality report: one figure per line with its limit, then one line per pose."""
    limits = limits or Acceptance()
    rows = [*_fit_rows(result, limits), *_camera_rows(result), ("note", result.note)]
    rows += [("NOT GOOD", sentence) for sentence in shortcomings(result, limits)]
    return "\n".join([*(f"{name:<15} {text}" for name, text in rows), "", *_pose_rows(result)])


def _fit_rows(result: HandEye, limits: Acceptance) -> list[tuple[str, str]]:
    spread, noise, predicted = result.spread, result.noise, result.predicted
    turned = f"rotation spread {spread.rotation_deg:.1f} deg"
    stated = f"{noise.robot_sd_mm * 1000:.1f} um, {noise.robot_sd_deg * 1000:.2f} mdeg, one sigma"
    return [
        ("kind", KIND[result.kind]),
        ("poses", f"{len(result.poses)}, {turned}, free travel {spread.travel_mm:.2f} x {spread.across_mm:.2f} mm"),
        *(("left out", f"pose {one.number}: {one.why}") for one in result.left_out),
        *([("left out", f"{result.dots_left_out} single dots that lie off")] if result.dots_left_out else []),
        ("coverage", f"dots seen over {coverage(result):.0%} of the picture"),
        ("residual", f"{result.rms_px:.4f} px rms of {limits.rms_px:g} ({result.dot_factor:.2f} x stated)"),
        ("robot scatter", f"{result.robot_factor:.2f} x stated ({stated}), of {limits.robot_factor:g} x"),
        ("hold-out", f"{result.hold_out_um:.1f} um rms of {limits.hold_out_um:g}, at poses left out of the fit"),
        ("predicted", f"{predicted.absolute_um:.1f} um of {limits.absolute_um:g} absolute (one sigma)"),
        ("", f"{predicted.differential_um:.2f} um of {limits.differential_um:g} for differences from a taught part"),
    ]


def _camera_rows(result: HandEye) -> list[tuple[str, str]]:
    camera = result.plane_map
    corner_px = math.hypot(*result.picture_px) / 2
    mismatch_ppm = (result.board_scale - 1) * 1e6
    squeeze_ppm = (1 - camera.squeeze) * 1e6
    return [
        ("scale", f"{camera.mm_per_px * 1000:.4f} um/px; board over robot {mismatch_ppm:+.0f} ppm"),
        ("direction", f"u axis at {camera.rotation_deg:+.3f} deg, mirrored: {'yes' if camera.mirrored() else 'no'}"),
        ("tilt, shear", f"scales differ by {squeeze_ppm:.0f} ppm, as a tilt of {camera.tilt_deg:.2f} deg causes"),
        ("distortion", f"{camera.k1_per_px2 * corner_px**3:+.2f} px at the picture's corner"),
    ]


def _pose_rows(result: HandEye) -> list[str]:
    """Every pose with its residual and the robot error that it suggests; the worst is marked."""
    heading = f"{'pose':>4}{'X mm':>11}{'Y mm':>11}{'R deg':>10}{'rms px':>9}{'dx um':>8}{'dy um':>8}{'dR mdeg':>9}"
    rows = [
        f"{one.number:>4}{one.pose.x_mm:>11.3f}{one.pose.y_mm:>11.3f}{one.pose.t_deg:>+10.3f}{one.rms_px:>9.4f}"
        f"{one.dx_um:>+8.1f}{one.dy_um:>+8.1f}{one.dt_mdeg:>+9.2f}"
        for one in result.poses
    ]
    rows[result.worst_pose] += "  worst"
    return [heading, *rows]


def tool_centre_text(result: ToolCentre, map_sd_um: float) -> str:
    """The rotation centre beside what the hand-eye map, known to `map_sd_um` there, says of it; and the run-out."""
    expected_um = math.hypot(result.sd_um, map_sd_um)
    agrees = "agrees" if result.error_um <= 3 * expected_um else "DOES NOT AGREE"
    x_mm, y_mm = result.eccentricity_mm
    phase_deg = math.degrees(math.atan2(y_mm, x_mm))
    return "\n".join(
        [
            f"rotation centre ({result.centre_px.u:.2f}, {result.centre_px.v:.2f}) px, +-{result.sd_um:.1f} um "
            f"({_sigmas(result.covariance_um2)})",
            f"hand-eye map    {result.error_um:.1f} um away ({result.map_dx_um:+.1f}, {result.map_dy_um:+.1f}), "
            f"{expected_um:.1f} um expected: {agrees}",
            f"run-out         held plate's middle {result.eccentricity_um:.1f} um off the R axis at "
            f"{phase_deg:+.1f} deg ({x_mm * 1000:+.1f}, {y_mm * 1000:+.1f}), +-{result.eccentricity_sd_um:.1f} um "
            f"({_sigmas(result.eccentricity_covariance_um2)})",
            f"wobble          {result.wobble_rms_um:.1f} um rms about its circle, worst {result.wobble_worst_um:.1f} "
            f"at R {result.worst_deg:+.1f} deg",
        ]
    )


def tool_centre_line(result: ToolCentre) -> str:
    """The same in one line."""
    return (
        f"rotation centre {result.error_um:.1f} um from the map's (+-{result.sd_um:.1f} um), "
        f"run-out {result.eccentricity_um:.0f} um (+-{result.eccentricity_sd_um:.1f} um), "
        f"wobble {result.wobble_rms_um:.1f} um"
    )


def _sigmas(covariance_um2: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> str:
    """A (2, 2) covariance in words."""
    sx, sy = np.sqrt(np.diag(covariance_um2)).tolist()
    correlation = float(covariance_um2[0, 1]) / (sx * sy) if sx * sy > 0 else 0.0
    return f"sd x {sx:.2f}, y {sy:.2f} um, correlation {correlation:+.2f}"
