"""How good a lens calibration is, as one picture: residuals, pictures, coverage, and how well the lens is known."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.drawing import ALERT, FAINT, INK, PALE, PAPER, Box, Colour, Picture, arrow, frame, hue, write
from cellctl.calibration.lens.judge import coverage_count
from cellctl.calibration.lens.quality import uncertainty
from cellctl.calibration.lens.solve import LensResult

FloatArray = NDArray[np.float64]

PANEL_PX = 720
HEAD_PX = 30
ARROW_PX = 14.0  # length of an rms residual
MOST_BARS = 40
DEEP: Colour = (150, 90, 40)


def lens_picture(result: LensResult) -> Picture:
    """A BGR picture of four panels."""
    width, height = result.fit.adjustment.views.picture_px
    panel = (PANEL_PX, round(PANEL_PX * height / width) + HEAD_PX)
    canvas = np.full((2 * panel[1], 2 * panel[0], 3), PAPER, np.uint8)
    boxes: list[Box] = [
        (x * panel[0], y * panel[1], (x + 1) * panel[0] - 1, (y + 1) * panel[1] - 1) for y in (0, 1) for x in (0, 1)
    ]
    _draw_residuals(canvas, result, boxes[0])
    _draw_pictures(canvas, result, boxes[1])
    _draw_coverage(canvas, result, boxes[2])
    _draw_uncertainty(canvas, result, boxes[3])
    return canvas


def _draw_residuals(canvas: Picture, result: LensResult, box: Box) -> None:
    """Every point's residual as an arrow, one colour per picture; points that do not count are red."""
    fit = result.fit
    shrink, magnify = PANEL_PX / fit.adjustment.views.picture_px[0], ARROW_PX / max(fit.rms_px, 1e-9)
    corner = np.array([box[0], box[1] + HEAD_PX])
    count = len(fit.own)
    for index in range(count):
        seen = fit.adjustment.views.seen[index]
        places = corner + fit.adjustment.views.points_px[index][seen] * shrink
        for place, off, used in zip(places, fit.off_px[index][seen], fit.used[index][seen], strict=True):
            arrow(canvas, place, place + off * magnify, hue(index, count) if used else ALERT)
    title = f"{fit.adjustment.model.lens}: {fit.rms_px:.4f} px rms, arrows {magnify / shrink:.0f} x"
    frame(canvas, box, title)


def _draw_pictures(canvas: Picture, result: LensResult, box: Box) -> None:
    """A bar for each picture's residual, those left out by name in red."""
    rms = result.fit.picture_rms_px
    rows = [(name, f"{value:.4f}", value) for name, value in zip(result.names, rms.tolist(), strict=True)]
    rows.sort(key=lambda row: -row[2])
    out = [(out.name, "left out", 0.0) for out in result.out]
    shown = (out + rows)[:MOST_BARS]
    step = (box[3] - box[1] - HEAD_PX - 10) / max(len(shown), 12)
    left, longest = box[0] + 170, box[2] - box[0] - 260
    for index, (name, text, value) in enumerate(shown):
        y = round(box[1] + HEAD_PX + (index + 0.7) * step)
        end = left + round(longest * value / max(float(rms.max()), 1e-12))
        write(canvas, (box[0] + 10, y), name[-22:], 0.36)
        cv2.rectangle(canvas, (left, y - round(0.5 * step)), (end, y), ALERT if value == 0.0 else DEEP, -1)
        write(canvas, (end + 6, y), text, 0.36)
    more = len(rows) + len(out) - len(shown)
    frame(canvas, box, f"px rms per picture{f', {more} more are better' if more else ''}")


def _draw_coverage(canvas: Picture, result: LensResult, box: Box) -> None:
    """In how many pictures the board was seen where, and its points."""
    fit = result.fit
    views = fit.adjustment.views
    count = coverage_count(views, fit.used, PANEL_PX).astype(np.float64)
    part = count[..., None] / max(float(count.max()), 1.0)
    top = box[1] + HEAD_PX
    area = canvas[top : top + len(count), box[0] : box[0] + PANEL_PX]
    area[:] = np.where(part > 0, np.array(PALE) * (1 - part) + np.array(DEEP) * part, np.array(PAPER))[: len(area)]
    shrink = PANEL_PX / views.picture_px[0]
    for u, v in (views.points_px[fit.used] * shrink).tolist():
        cv2.circle(canvas, (round(box[0] + u), round(top + v)), 1, INK, -1)
    frame(canvas, box, f"board seen over {result.coverage:.0%} of the picture, up to {int(count.max())} times")


def _draw_uncertainty(canvas: Picture, result: LensResult, box: Box) -> None:
    """One sigma of the lens over the picture, as figures on shades."""
    known = uncertainty(result)
    top, rows = box[1] + HEAD_PX, known.sd_px.shape[0]
    cell = np.array([PANEL_PX / known.sd_px.shape[1], (box[3] - top) / rows])
    worst = max(known.worst_px, 1e-12)
    for row, line in enumerate(known.sd_px.tolist()):
        for column, value in enumerate(line):
            start = np.array([box[0], top]) + cell * (column, row)
            left, up, right, down = np.rint([*start, *(start + cell)]).astype(int).tolist()
            share = value / worst if np.isfinite(value) else 1.0
            shade = tuple(int(light * (1 - share) + dark * share) for light, dark in zip(PAPER, PALE, strict=True))
            cv2.rectangle(canvas, (left, up), (right, down), shade, -1)
            write(canvas, (left + 3, (up + down) // 2 + 4), f"{value:.2g}" if np.isfinite(value) else "-", 0.33)
    cv2.rectangle(canvas, (box[0], top), (box[2], box[3]), FAINT, 1)
    frame(
        canvas,
        box,
        f"lens known to (1 sigma, px): {known.rms_px:.3g} where the board was seen, {known.worst_px:.3g} at worst",
    )
