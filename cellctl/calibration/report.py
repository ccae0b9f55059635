"""How good a calibration is: as text for the operator and the file, and as a small picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.hand_eye import HandEye
from cellctl.calibration.scara import Setup
from cellctl.calibration.tool_centre import ToolCentre
from cellctl.geometry import Px

Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

MOUNT = {
    "eye_in_hand": "eye in hand (mm are in the tool frame)",
    "eye_to_hand": "eye to hand (mm are in the robot frame)",
}
PICTURE_WIDTH_PX = 864
FOOT_PX = 58
ARROW_PX = 12.0  # length of an rms residual in the picture
COVERAGE_CELLS = (12, 9)
PAPER: Colour = (250, 250, 250)
INK: Colour = (40, 40, 40)
PALE: Colour = (225, 215, 200)
ALERT: Colour = (40, 40, 210)


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
    cells = np.floor(result.dots_px.reshape(-1, 2) / size * COVERAGE_CELLS).astype(int)
    return len({tuple(cell) for cell in cells.tolist()}) / math.prod(COVERAGE_CELLS)


def report_text(result: HandEye) -> str:
    """The quality report, one figure per line."""
    rows = [*_fit_rows(result), *_camera_rows(result), ("note", result.note)]
    rows += [("NOT GOOD", sentence) for sentence in shortcomings(result)]
    return "\n".join(f"{name:<15}{text}" for name, text in rows)


def _fit_rows(result: HandEye) -> list[tuple[str, str]]:
    spread, noise, predicted = result.spread, result.noise, result.predicted
    worst = result.poses[result.worst_pose]
    turned = f"rotation spread {spread.rotation_deg:.1f} deg"
    robot = f"robot {worst.dx_um:+.1f}, {worst.dy_um:+.1f} um, {worst.dt_mdeg:+.2f} mdeg"
    stated = f"{noise.robot_sd_mm * 1000:.1f} um, {noise.robot_sd_deg * 1000:.2f} mdeg, one sigma"
    return [
        ("mount", MOUNT[result.kind]),
        ("poses", f"{len(result.poses)}, {turned}, free travel {spread.travel_mm:.2f} x {spread.across_mm:.2f} mm"),
        ("coverage", f"dots seen over {coverage(result):.0%} of the picture"),
        ("residual", f"{result.rms_px:.4f} px rms ({result.dot_factor:.2f} x stated)"),
        ("worst pose", f"{result.worst_pose + 1} (R {worst.pose.t_deg:+.2f} deg): {worst.rms_px:.4f} px rms, {robot}"),
        ("robot scatter", f"{result.robot_factor:.2f} x stated ({stated})"),
        ("hold-out", f"{result.hold_out_um:.1f} um rms at poses left out of the fit"),
        ("predicted", f"{predicted.absolute_um:.1f} um absolute (one sigma)"),
        ("", f"{predicted.differential_um:.2f} um for differences from a taught part (one sigma)"),
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


def tool_centre_text(result: ToolCentre, hand_eye: HandEye) -> str:
    """The rotation centre beside what the hand-eye map says of it."""
    expected_um = math.hypot(result.sd_um, hand_eye.sd_um(result.centre_px))
    return "\n".join(
        [
            f"rotation centre ({result.centre_px.u:.2f}, {result.centre_px.v:.2f}) px, +-{result.sd_um:.1f} um",
            f"run-out         {result.run_out_rms_um:.1f} um rms, worst {result.run_out_worst_um:.1f} um at "
            f"R {result.worst_deg:+.1f} deg",
            f"hand-eye map    {result.error_um:.1f} um away ({result.map_dx_um:+.1f}, {result.map_dy_um:+.1f}), "
            f"{expected_um:.1f} um expected: {'agrees' if result.error_um <= 3 * expected_um else 'DOES NOT AGREE'}",
        ]
    )


def report_picture(result: HandEye) -> Picture:
    """A small BGR picture: every dot's residual as an arrow, magnified, over the area that the dots covered."""
    width, height = result.picture_px
    shrink = PICTURE_WIDTH_PX / width
    canvas = np.full((round(height * shrink) + FOOT_PX, PICTURE_WIDTH_PX, 3), PAPER, np.uint8)
    _draw_coverage(canvas, result, shrink)
    magnify = ARROW_PX / max(result.rms_px, 1e-6)
    for index, (dots, residuals) in enumerate(zip(result.dots_px, result.residuals_px, strict=True)):
        colour = ALERT if index == result.worst_pose else _hue(index, len(result.dots_px))
        for start, arrow in zip(dots * shrink, residuals * magnify, strict=True):
            _arrow(canvas, start, start + arrow, colour)
    _draw_middle(canvas, result.setup, shrink, result.picture_px)
    for above, line in zip((34, 12), _captions(result, magnify / shrink), strict=True):
        _write(canvas, above, line)
    return canvas


def _captions(result: HandEye, magnified: float) -> tuple[str, str]:
    fit = f"{result.kind}: {len(result.poses)} poses, {result.rms_px:.4f} px rms, arrows {magnified:.0f} x"
    absolute_um, differential_um = result.predicted
    known = f"predicted {absolute_um:.1f} um absolute, {differential_um:.2f} um differences"
    return (
        f"{fit}; worst pose {result.worst_pose + 1} in red",
        f"hold-out {result.hold_out_um:.1f} um, {known}, coverage {coverage(result):.0%}",
    )


def _draw_coverage(canvas: Picture, result: HandEye, shrink: float) -> None:
    """Shade where dots were seen, outline the picture."""
    for dots in result.dots_px:
        hull = cv2.convexHull((dots * shrink).astype(np.float32))
        cv2.fillConvexPoly(canvas, np.rint(hull).astype(np.int32), PALE)
    bottom = canvas.shape[0] - FOOT_PX
    cv2.rectangle(canvas, (0, 0), (canvas.shape[1] - 1, bottom), INK, 1)


def _draw_middle(canvas: Picture, setup: Setup, shrink: float, picture_px: tuple[int, int]) -> None:
    """The plane's x and y axis at the picture's middle, 1 mm long."""
    u, v = (picture_px[0] - 1) / 2, (picture_px[1] - 1) / 2
    middle = np.array(setup.plane_map.mm_at(Px(u, v)))
    for name, step in (("x", (1.0, 0.0)), ("y", (0.0, 1.0))):
        start, end = setup.plane_map.px_from_mm(np.array([middle, middle + step])) * shrink
        _arrow(canvas, start, end, INK)
        cv2.putText(canvas, name, _whole(end + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.45, INK, 1, cv2.LINE_AA)


def _arrow(canvas: Picture, start: NDArray[np.float64], end: NDArray[np.float64], colour: Colour) -> None:
    limit = 4 * PICTURE_WIDTH_PX  # beyond it cv2's whole numbers overflow
    end = np.clip(end, -limit, limit)
    cv2.arrowedLine(canvas, _whole(start), _whole(end), colour, 1, cv2.LINE_AA, 0, 0.25)


def _whole(point: NDArray[np.float64]) -> tuple[int, int]:
    u, v = np.rint(point).astype(int).tolist()
    return u, v


def _hue(index: int, count: int) -> Colour:
    hsv = np.array([[[int(120 * index / max(1, count)) + 30, 200, 150]]], np.uint8)
    blue, green, red = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0].tolist()
    return blue, green, red


def _write(canvas: Picture, above_bottom: int, text: str) -> None:
    place = (8, canvas.shape[0] - above_bottom)
    cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.47, INK, 1, cv2.LINE_AA)
