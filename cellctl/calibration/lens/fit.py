"""One model adjusted to one set of views, robustly: single bad points count less, then not at all."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.adjustment import minimise
from cellctl.calibration.lens.model import LensAdjustment, LensModel, Views

FloatArray = NDArray[np.float64]

MOST_ROUNDS = 8
SETTLED = 0.005  # change of the noise, as a part of it, that ends the rounds
HUBER_SD = 2.0  # points further off count less
OUT_SD = 5.0  # points further off do not count; a good one is so with a chance of 4e-6
MEDIAN_OF_DISTANCE = 1.1774  # of a point's distance, in sigmas per axis
LEAST_SD_PX = 1e-6  # keeps perfect points from rejecting each other
FIRST_SD_PX = 1.0
OWN_SD = {"rad": np.inf, "mm": np.inf, "px": np.inf, "v1": 0.5, "v2": 0.5}  # a tilt of 41 deg has |v| = 0.5
MOST_STEPS = 40


@dataclass(frozen=True)
class LensFit:
    """An adjusted model. `adjustment.weights` is 1 for the points that count, and its `sd_px` is what they show."""

    adjustment: LensAdjustment
    x: FloatArray

    @property
    def shared(self) -> FloatArray:
        """The lens (S,)."""
        return self.adjustment.split(self.x)[0]

    @property
    def own(self) -> FloatArray:
        """The pictures' own parameters (n, P)."""
        return self.adjustment.split(self.x)[1]

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which points count, (n, m)."""
        return self.adjustment.weights > 0

    @property
    def off_px(self) -> FloatArray:
        """Expected minus seen, (n, m, 2)."""
        return self.adjustment.off_px(self.x)

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the points that count."""
        return rms_distance(self.off_px, self.used)

    @property
    def picture_rms_px(self) -> FloatArray:
        """The same picture by picture, (n,)."""
        off = self.off_px
        return np.array([rms_distance(*picture) for picture in zip(off, self.used, strict=True)])

    def some(self, pictures: NDArray[np.intp]) -> LensAdjustment:
        """The adjustment of some of the pictures."""
        whole = self.adjustment
        return replace(whole, views=whole.views.only(pictures), weights=whole.weights[pictures])

    def unknowns(self, shared: FloatArray, pictures: NDArray[np.intp]) -> FloatArray:
        """Where the adjustment of some of the pictures may start."""
        return np.concatenate([shared, self.own[pictures].ravel()])


def fit_lens(model: LensModel, views: Views, start: FloatArray | None = None) -> LensFit:
    """From the closed solution or `start`: reweighted until the noise settles, then the good points alone."""
    start = model.start(views) if start is None else start
    own_sd = np.array([OWN_SD[name.rsplit("_")[-1]] for name in model.own])
    prior = model.prior(views, start)
    adjustment = LensAdjustment(model, views, views.seen.astype(np.float64), FIRST_SD_PX, prior, own_sd)
    x = minimise(adjustment, start, most_steps=MOST_STEPS)
    for _ in range(MOST_ROUNDS):
        before = adjustment.sd_px
        adjustment = _reweighted(adjustment, x)
        x = minimise(adjustment, x, most_steps=MOST_STEPS)
        if abs(adjustment.sd_px - before) < SETTLED * before:
            break
    return refit(_decided(adjustment, x), x)


def refit(adjustment: LensAdjustment, x: FloatArray) -> LensFit:
    """Adjust with the weights as they are, and take the noise from the result."""
    x = minimise(adjustment, x, most_steps=MOST_STEPS)
    count = 2 * int((adjustment.weights > 0).sum())
    square = float((adjustment.weights[..., None] * adjustment.off_px(x) ** 2).sum())
    sd_px = max(np.sqrt(square / max(count - len(x), 1)), LEAST_SD_PX)
    adjustment = replace(adjustment, sd_px=float(sd_px))
    return LensFit(adjustment, minimise(adjustment, x, most_steps=MOST_STEPS))


def without(fit: LensFit, pictures: list[int]) -> LensFit:
    """The fit of the other pictures."""
    rest = np.setdiff1d(np.arange(len(fit.own)), pictures)
    return refit(fit.some(rest), fit.unknowns(fit.shared, rest))


def rms_distance(off_px: FloatArray, used: NDArray[np.bool_]) -> float:
    """Root mean square length of residuals (n, m, 2) where `used`: not per axis, as OpenCV gives it."""
    return float(np.sqrt((off_px[used] ** 2).sum(-1).mean())) if used.any() else float("inf")


def _reweighted(adjustment: LensAdjustment, x: FloatArray) -> LensAdjustment:
    """Huber's weights against the noise that the middle of all points shows."""
    away = np.hypot(*np.moveaxis(adjustment.off_px(x), -1, 0))
    seen = adjustment.views.seen
    sd_px = max(float(np.median(away[seen])) / MEDIAN_OF_DISTANCE, LEAST_SD_PX)
    weights = np.minimum(1.0, HUBER_SD * sd_px / np.maximum(away, 1e-12)) * seen
    return replace(adjustment, weights=weights, sd_px=sd_px)


def _decided(adjustment: LensAdjustment, x: FloatArray) -> LensAdjustment:
    """Points count or do not, against the noise of all or, where a picture is blurred, of that picture."""
    away = np.hypot(*np.moveaxis(adjustment.off_px(x), -1, 0))
    seen = adjustment.views.seen
    own = np.array([float(np.median(picture[there])) for picture, there in zip(away, seen, strict=True)])
    limit = OUT_SD * np.maximum(adjustment.sd_px, own / MEDIAN_OF_DISTANCE)
    return replace(adjustment, weights=(seen & (away <= limit[:, None])).astype(np.float64))
