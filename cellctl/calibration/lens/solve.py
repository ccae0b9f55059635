"""Calibrate a lens: fit, leave out pictures that contradict the others, judge, and see how well it predicts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.adjustment import minimise
from cellctl.calibration.disks import disk_centres
from cellctl.calibration.errors import LensRefused
from cellctl.calibration.lens.fit import MOST_STEPS, LensFit, fit_lens, rms_distance, without
from cellctl.calibration.lens.judge import check_folds, check_lens, coverage, model_for
from cellctl.calibration.lens.model import LensModel, Views
from cellctl.calibration.lens.outliers import PictureOut, check_count, check_outliers, copies, off_plane, wrong_picture
from cellctl.calibration.plane_map import Lens

FloatArray = NDArray[np.float64]
Say = Callable[[str], None]

MOST_FOLDS = 10
DISK_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class LensResult:
    """A lens, and how well it is known."""

    fit: LensFit
    names: tuple[str, ...]  # of the pictures that count
    out: tuple[PictureOut, ...]
    covariance: FloatArray  # (S, S) of the shared parameters
    own_covariances: FloatArray  # (n, P, P)
    folds: FloatArray  # (k, S): the shared parameters without one k-th of the pictures
    hold_out_px: float | None  # rms distance in pictures whose lens was found without them; None for one picture
    coverage: float

    @property
    def sd(self) -> FloatArray:
        """Of the shared parameters (S,), from the points' scatter."""
        return np.asarray(np.sqrt(np.diag(self.covariance)), np.float64)

    @property
    def fold_sd(self) -> FloatArray | None:
        """The same from how they change when pictures are left out (jackknife): shows what repeats in a picture."""
        count = len(self.folds)
        if count < 2:
            return None
        away = self.folds - self.folds.mean(0)
        return np.asarray(np.sqrt((away**2).sum(0) * (count - 1) / count), np.float64)


def calibrate_lens(lens: Lens, views: Views, names: Sequence[str], say: Say = lambda _: None) -> LensResult:
    """The lens from the points of one board in pictures of these names.

    Raises LensRefused when the pictures are too few, contradict each other, or leave something of the lens open.
    """
    with np.errstate(all="ignore"):  # a step too far is not taken, points of nothing are refused
        try:
            return _calibrated(lens, views, list(names), say)
        except np.linalg.LinAlgError as error:
            raise LensRefused(
                "points", f"no {lens} lens shows the board like this ({error}): check that the board is as described"
            ) from error


def _calibrated(lens: Lens, views: Views, names: list[str], say: Say) -> LensResult:
    views, names, out = _flat_ones(lens, views, names)
    fit, names, out = _agreeing(lens, views, names, out, say)
    check_lens(fit)
    folds, hold_out_px = _held_out(fit, say)
    normal = fit.adjustment.normal(fit.x)
    result = LensResult(
        fit=fit,
        names=tuple(names),
        out=tuple(out),
        covariance=normal.covariance(),
        own_covariances=normal.own_covariances(),
        folds=folds,
        hold_out_px=hold_out_px,
        coverage=coverage(fit.adjustment.views, fit.used),
    )
    check_folds(fit, result.fold_sd)
    return result


def _flat_ones(lens: Lens, views: Views, names: list[str]) -> tuple[Views, list[str], list[PictureOut]]:
    """Without the pictures whose points are not the board's, or another's."""
    check_count(lens, len(names), [])
    out = [*off_plane(views, names), *copies(views, names)]
    bad = {picture.name for picture in out}
    keep = [index for index, name in enumerate(names) if name not in bad]
    check_count(lens, len(keep), out)
    return views.only(keep), [names[index] for index in keep], out


def _agreeing(
    lens: Lens, views: Views, names: list[str], out: list[PictureOut], say: Say
) -> tuple[LensFit, list[str], list[PictureOut]]:
    """The fit of the pictures that agree, without those that do not."""
    count = len(names)
    while True:
        say(f"fitting a {lens} lens to {len(names)} pictures")
        fit = fit_views(model_for(lens, views), views)
        wrong = wrong_picture(fit, names)
        if wrong is None:
            return fit, names, out
        index, picture = wrong
        out = [*out, picture]
        check_outliers(lens, out, count)
        views, names = views.only([i for i in range(len(names)) if i != index]), [n for n in names if n != picture.name]


def fit_views(model: LensModel, views: Views) -> LensFit:
    """The fit of points, or of dots, whose seen middles are first moved to where their centres would be seen."""
    fit = fit_lens(model, views)
    if views.diameters_mm is None:
        return fit
    for _ in range(DISK_ROUNDS):
        corrected = views._replace(points_px=views.points_px - _disk_shifts(fit, views.diameters_mm))
        fit = fit_lens(model, corrected, fit.x)
    return fit


def _disk_shifts(fit: LensFit, diameters_mm: FloatArray) -> FloatArray:
    """How far the middles of dots are seen beside their centres, (n, m, 2)."""
    model, board = fit.adjustment.model, fit.adjustment.views.board_mm
    centres = model.see(fit.shared, fit.own, board)

    def middles(own: FloatArray) -> FloatArray:
        return disk_centres(lambda points: model.see(fit.shared, own[None], points)[0], board, diameters_mm)

    return np.array([middles(own) for own in fit.own]) - centres


def _held_out(fit: LensFit, say: Say) -> tuple[FloatArray, float | None]:
    """Leave each k-th of the pictures out in turn, find the lens from the others, and only place the board in these."""
    count = len(fit.own)
    folds = min(count, MOST_FOLDS)
    if folds < 2:
        return np.zeros((0, len(fit.shared))), None
    found, off, used = [], [], []
    say(f"leaving pictures out in turn, {folds} times")
    for fold in range(folds):
        left_out = np.arange(fold, count, folds)
        lens = without(fit, left_out.tolist()).shared
        unseen = replace(fit.some(left_out), shared_fixed=True)
        x = minimise(unseen, fit.unknowns(lens, left_out), most_steps=MOST_STEPS)
        found.append(lens)
        off.append(unseen.off_px(x))
        used.append(fit.used[left_out])
    return np.array(found), rms_distance(np.concatenate(off), np.concatenate(used))
