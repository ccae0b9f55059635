"""How good a calibration is, as one picture: residual map, the robot's poses, and the figures of all versions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.drawing import (
    ALERT,
    FAINT,
    INK,
    PALE,
    PAPER,
    Box,
    Colour,
    Picture,
    arrow,
    frame,
    hue,
    whole,
    write,
)
from cellctl.calibration.hand_eye import HandEye
from cellctl.calibration.report import Acceptance, coverage
from cellctl.calibration.scara import Setup
from cellctl.geometry import Px

MAP_WIDTH_PX = 864
SIDE_PX = 460
FOOT_PX = 58
MARGIN_PX = 44
ARROW_PX = 12.0  # length of an rms residual in the picture
POSE_ARROW_PX = 26.0
MOST_PAST = 12
HOLD_OUT: Colour = (160, 90, 20)
PREDICTED: Colour = (60, 140, 60)


class Past(NamedTuple):
    """Figures of one version, for the history."""

    made: str
    hold_out_um: float
    predicted_um: float
    refused: bool


def report_picture(result: HandEye, past: Sequence[Past], limits: Acceptance | None = None) -> Picture:
    """A BGR picture: left every dot's residual as an arrow, magnified; right the poses above the history of figures."""
    shrink = MAP_WIDTH_PX / result.picture_px[0]
    height = max(round(result.picture_px[1] * shrink) + FOOT_PX, 400)
    canvas = np.full((height, MAP_WIDTH_PX + SIDE_PX, 3), PAPER, np.uint8)
    _draw_residuals(canvas, result, shrink)
    _draw_poses(canvas, result, (MAP_WIDTH_PX, 0, MAP_WIDTH_PX + SIDE_PX - 1, height // 2))
    box = (MAP_WIDTH_PX, height // 2, MAP_WIDTH_PX + SIDE_PX - 1, height - 1)
    _draw_history(canvas, past[-MOST_PAST:], limits or Acceptance(), box)
    return canvas


# -- residual map ------------------------------------------------------------------------------------------------------


def _draw_residuals(canvas: Picture, result: HandEye, shrink: float) -> None:
    _draw_coverage(canvas, result, shrink)
    magnify = ARROW_PX / max(result.rms_px, 1e-6)
    for index, (dots, residuals) in enumerate(zip(result.dots_px, result.residuals_px, strict=True)):
        colour = _colour(result, index)
        seen = np.isfinite(dots).all(1)
        for start, residual in zip(dots[seen] * shrink, residuals[seen] * magnify, strict=True):
            arrow(canvas, start, start + residual, colour)
    _draw_middle(canvas, result.setup, shrink, result.picture_px)
    for above, line in zip((34, 12), _captions(result, magnify / shrink), strict=True):
        write(canvas, (8, canvas.shape[0] - above), line)


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
        hull = cv2.convexHull((dots[np.isfinite(dots).all(1)] * shrink).astype(np.float32))
        cv2.fillConvexPoly(canvas, np.rint(hull).astype(np.int32), PALE)
    bottom = round(result.picture_px[1] * shrink)
    cv2.rectangle(canvas, (0, 0), (MAP_WIDTH_PX - 1, bottom), INK, 1)


def _draw_middle(canvas: Picture, setup: Setup, shrink: float, picture_px: tuple[int, int]) -> None:
    """The plane's x and y axis at the picture's middle, 1 mm long."""
    u, v = (picture_px[0] - 1) / 2, (picture_px[1] - 1) / 2
    middle = np.array(setup.plane_map.mm_at(Px(u, v)))
    for name, step in (("x", (1.0, 0.0)), ("y", (0.0, 1.0))):
        start, end = setup.plane_map.px_from_mm(np.array([middle, middle + step])) * shrink
        arrow(canvas, start, end, INK)
        cv2.putText(canvas, name, whole(end + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.45, INK, 1, cv2.LINE_AA)


# -- poses -------------------------------------------------------------------------------------------------------------


def _draw_poses(canvas: Picture, result: HandEye, box: Box) -> None:
    """Where the robot stood, x to the right and y upwards, an arrow along the tool's x axis, numbered in order."""
    places = np.array([(one.pose.x_mm, one.pose.y_mm) for one in result.poses])
    middle, span_mm = (places.max(0) + places.min(0)) / 2, float(np.ptp(places, axis=0).max())
    room = min(box[2] - box[0], box[3] - box[1]) - 2 * MARGIN_PX
    scale = room / max(span_mm, 0.1)
    centre = np.array([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2 + 6])
    frame(canvas, box, f"robot poses: x {middle[0]:.1f}, y {middle[1]:.1f} mm +-{span_mm / 2:.1f}, arrow = R")
    for index, (one, place) in enumerate(zip(result.poses, places, strict=True)):
        at = centre + (place - middle) * scale * (1, -1)
        turn = np.radians(one.pose.t_deg)
        arrow(canvas, at, at + POSE_ARROW_PX * np.array([np.cos(turn), -np.sin(turn)]), _colour(result, index))
        cv2.circle(canvas, whole(at), 3, _colour(result, index), -1, cv2.LINE_AA)
        write(canvas, whole(at + np.array([4, 14])), str(index + 1), 0.38)


# -- history -----------------------------------------------------------------------------------------------------------


def _draw_history(canvas: Picture, past: Sequence[Past], limits: Acceptance, box: Box) -> None:
    """Hold-out and predicted error of the versions, the oldest left, with the gate as a line; refused ones are red."""
    frame(canvas, box, f"history, um: hold-out (gate {limits.hold_out_um:g}) and predicted")
    left, right, top, bottom = box[0] + MARGIN_PX, box[2] - MARGIN_PX, box[1] + MARGIN_PX, box[3] - MARGIN_PX
    highest = 1.15 * max([limits.hold_out_um, *(min(one.hold_out_um, 4 * limits.hold_out_um) for one in past)])

    def at(index: int, value_um: float) -> NDArray[np.float64]:
        share = (index + 0.5) / max(1, len(past))
        return np.array([left + share * (right - left), bottom - min(value_um / highest, 1.0) * (bottom - top)])

    gate = int(at(0, limits.hold_out_um)[1])
    cv2.line(canvas, (left, gate), (right, gate), FAINT, 1, cv2.LINE_AA)
    cv2.line(canvas, (left, bottom), (right, bottom), INK, 1, cv2.LINE_AA)
    for colour, values in (
        (PREDICTED, [one.predicted_um for one in past]),
        (HOLD_OUT, [one.hold_out_um for one in past]),
    ):
        line = np.array([at(index, value) for index, value in enumerate(values)])
        cv2.polylines(canvas, [np.rint(line).astype(np.int32)], False, colour, 1, cv2.LINE_AA)
        for one, place in zip(past, line, strict=True):
            cv2.circle(canvas, whole(place), 4, ALERT if one.refused else colour, -1, cv2.LINE_AA)
    for index, one in enumerate(past):
        write(canvas, whole(at(index, one.hold_out_um) + np.array([-10, -10])), f"{one.hold_out_um:.1f}", 0.38)
        if index in (0, len(past) - 1):
            write(canvas, whole(at(index, 0.0) + np.array([-26, 18])), one.made, 0.38)


# -- colours -----------------------------------------------------------------------------------------------------------


def _colour(result: HandEye, index: int) -> Colour:
    return ALERT if index == result.worst_pose else hue(index, len(result.poses))
