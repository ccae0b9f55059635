"""How well a lens is known where in the picture, and how much of the residual is the board's own."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.lens.judge import COVERAGE_WIDTH_PX, coverage_count
from cellctl.calibration.lens.model import LensModel
from cellctl.calibration.lens.solve import LensResult

FloatArray = NDArray[np.float64]

GRID = (16, 12)  # places along and across the picture


class Uncertainty(NamedTuple):
    """One sigma of where the lens puts a point (rows, columns) px; nan where the lens is not described."""

    sd_px: FloatArray
    near: NDArray[np.bool_]  # (rows, columns): where the board was seen

    @property
    def rms_px(self) -> float:
        """Where the board was seen."""
        return math.sqrt(float(np.nanmean(self.sd_px[self.near] ** 2)))

    @property
    def worst_px(self) -> float:
        """In the whole picture: nearly always at a corner."""
        return float(np.nanmax(self.sd_px))


def uncertainty(result: LensResult) -> Uncertainty:
    """What the covariance of the lens does to points of the picture, apart from what turning the camera undoes."""
    columns, rows = GRID
    fit = result.fit
    width, height = fit.adjustment.views.picture_px
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns * width, (np.arange(rows) + 0.5) / rows * height)
    points = np.column_stack([u.ravel(), v.ravel()]) - 0.5
    count = coverage_count(fit.adjustment.views, fit.used, COVERAGE_WIDTH_PX)
    part = COVERAGE_WIDTH_PX / width
    at = np.minimum((points * part).astype(int), [count.shape[1] - 1, count.shape[0] - 1])
    near = count[at[:, 1], at[:, 0]] > 0
    inside = np.array([_described(fit.adjustment.model, fit.shared, point) for point in points])
    sd_px = np.full(len(points), np.nan)
    sd_px[inside] = _sd_px(result, points[inside], near[inside])
    return Uncertainty(sd_px.reshape(rows, columns), near.reshape(rows, columns))


def _sd_px(result: LensResult, points: FloatArray, near: NDArray[np.bool_]) -> FloatArray:
    """One sigma (n,), the camera turned so that the points where the board was seen stay where they are."""
    by_shared, free = result.fit.adjustment.model.at_pixels(result.fit.shared, points)
    flat, seen = (part[near].reshape(-1, part.shape[-1]) for part in (by_shared, free))
    turned = np.linalg.lstsq(seen, flat, rcond=None)[0]
    left = by_shared - free @ turned
    variance = np.einsum("nis,st,nit->n", left, result.covariance, left)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), np.float64)


def _described(model: LensModel, shared: FloatArray, point: FloatArray) -> bool:
    try:
        model.at_pixels(shared, point[None])
    except ValueError:
        return False
    return True


def common_residual(result: LensResult) -> tuple[float, float]:
    """What is the same in all pictures, px rms per point, and what chance alone would leave of it.

    Each point's residual is turned into the board's directions first. More than chance: the board is printed or
    bent so, or is not as described.
    """
    fit = result.fit
    steps = _board_directions(result)
    off = np.einsum("nmij,nmj->nmi", np.linalg.inv(steps), fit.off_px)
    used = fit.used[..., None]
    count = used.sum(0)
    mean = np.where(count > 0, (off * used).sum(0) / np.maximum(count, 1), 0.0)
    points = fit.used.any(0)
    common = math.sqrt(float((mean[points] ** 2).sum(1).mean()))
    chance = fit.rms_px / math.sqrt(float(fit.used.sum(0)[points].mean()))
    return common, chance


def _board_directions(result: LensResult) -> FloatArray:
    """How the board's directions lie in the picture at each point, without their lengths: (n, m, 2, 2)."""
    fit, board = result.fit, result.fit.adjustment.views.board_mm
    step = 1e-4 * float(np.ptp(board, axis=0).max())
    model = fit.adjustment.model
    here = model.see(fit.shared, fit.own, board)
    ways = [model.see(fit.shared, fit.own, board + np.array(way) * step) - here for way in ((1.0, 0.0), (0.0, 1.0))]
    steps = np.stack(ways, axis=-1)
    lengths = np.sqrt(np.abs(np.linalg.det(steps)))[..., None, None]
    return np.asarray(steps / lengths, np.float64)
