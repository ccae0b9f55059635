"""Do the pictures tell what the lens is like? Refuses, with a sentence, what they cannot tell."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.errors import LensRefused
from cellctl.calibration.lens.fit import LensFit, fit_lens
from cellctl.calibration.lens.model import LensModel, Views
from cellctl.calibration.lens.outliers import LEAST_PICTURES
from cellctl.calibration.lens.pinhole import Pinhole
from cellctl.calibration.lens.telecentric import Telecentric, is_mirrored
from cellctl.calibration.plane_map import Lens
from cellctl.calibration.six_dof.rigid import rotation_from_vector

FloatArray = NDArray[np.float64]

LEAST_COVERAGE = 0.2  # part of the picture where the board was seen
COVERAGE_WIDTH_PX = 240  # of the small picture in which that is counted
PARALLEL_DEG = 3.0
MOST_FOCAL_SD = 0.03  # of the focal length
MOST_FOLD_SD = {"pinhole": 0.03, "telecentric": 0.003}  # of focal length or scale, between pictures
DOUBTFUL_FOCAL_SD = 0.005  # where it is worth a look whether there is any perspective
MOST_CENTRE_SD = 0.05  # of the picture's width
MOST_RMS_PX = 1.0  # in pictures of up to RMS_WIDTH_PX, in larger ones in proportion
RMS_WIDTH_PX = 2000
EXACT_PX = 0.05  # a residual that needs no other model
PLAIN_FACTOR = 1.1  # residual of parallel over central projection below which there is no perspective to be seen
BETTER_FACTOR = 0.5  # residual of the other model that shows that it is the right one


def model_for(lens: Lens, views: Views) -> LensModel:
    """The model of this name, for pictures of one handedness."""
    return Pinhole() if lens == "pinhole" else Telecentric(mirrored=is_mirrored(views))


def check_lens(fit: LensFit) -> None:
    """Raise LensRefused when the result cannot be trusted, with what is missing."""
    views = fit.adjustment.views
    _check_coverage(coverage(views, fit.used))
    if fit.adjustment.model.lens == "pinhole":
        _check_tilts(fit)
        _check_observed(fit)
    _check_residual(fit)


def check_folds(fit: LensFit, fold_sd: FloatArray | None) -> None:
    """Raise LensRefused when the lens depends on which pictures are left out."""
    limit = MOST_FOLD_SD[fit.adjustment.model.lens]
    if fold_sd is not None and fold_sd[0] > limit * abs(fit.shared[0]):
        raise LensRefused(
            "pictures disagree",
            f"{fit.adjustment.model.parameters[0]} is {fit.shared[0]:.5g} +- {fold_sd[0]:.2g} depending on which "
            "pictures are left out: were zoom or focus touched between them?",
        )


def coverage(views: Views, used: NDArray[np.bool_]) -> float:
    """Part of the picture over which the board was seen."""
    return float(coverage_count(views, used, COVERAGE_WIDTH_PX).astype(bool).mean())


def coverage_count(views: Views, used: NDArray[np.bool_], width_px: int) -> NDArray[np.uint16]:
    """In how many pictures the board was seen where, as a small picture of this width."""
    width, height = views.picture_px
    part = width_px / width
    count = np.zeros((max(1, round(height * part)), width_px), np.uint16)
    for px, good in zip(views.points_px, used, strict=True):
        if good.sum() >= 3:
            hull = cv2.convexHull(((px[good] + 0.5) * part - 0.5).astype(np.float32))
            count += np.asarray(cv2.fillConvexPoly(np.zeros_like(count), np.rint(hull).astype(np.int32), 1), np.uint16)
    return count


def tilts_deg(fit: LensFit) -> FloatArray:
    """How each board is tilted against the picture, (n,)."""
    if isinstance(fit.adjustment.model, Pinhole):
        facing = np.abs(rotation_from_vector(fit.own[:, :3])[:, 2, 2])
    else:
        facing = 1.0 - (fit.own[:, 1:3] ** 2).sum(1)
    return np.asarray(np.degrees(np.arccos(np.clip(facing, -1.0, 1.0))), np.float64)


def _check_coverage(part: float) -> None:
    if part < LEAST_COVERAGE:
        raise LensRefused(
            "coverage",
            f"the board was seen over {part:.0%} of the picture only, {LEAST_COVERAGE:.0%} are needed: the distortion "
            "of the rest would be guessed; take pictures with the board near all sides and corners",
        )


def _check_tilts(fit: LensFit) -> None:
    """All boards parallel: each shows the same vanishing line, and the focal length stays open."""
    normals = rotation_from_vector(fit.own[:, :3])[:, :, 2]
    apart = np.degrees(np.arccos(np.clip(np.abs(normals @ normals.T), 0.0, 1.0)))
    if apart.max() < PARALLEL_DEG:
        raise LensRefused(
            "parallel",
            f"all {len(normals)} boards are parallel (within {apart.max():.1f} deg), which leaves the focal length "
            "open: tilt the board by 20 to 40 deg to different sides",
        )


def _check_observed(fit: LensFit) -> None:
    sd = np.sqrt(np.diag(fit.adjustment.normal(fit.x).covariance()))
    focal, width = float(np.abs(fit.shared[:2]).max()), max(fit.adjustment.views.picture_px)
    part = float(sd[:2].max()) / focal
    if not part < DOUBTFUL_FOCAL_SD:
        _check_perspective(fit)
    if not part < MOST_FOCAL_SD:
        raise LensRefused(
            "focal length",
            f"hardly observable: {focal:.0f} px +- {part:.0%}; tilt the board by 20 to 40 deg to different sides, and "
            "come closer",
        )
    if not sd[2:4].max() < MOST_CENTRE_SD * width:
        raise LensRefused(
            "principal point",
            f"hardly observable: +-{sd[2:4].max():.0f} px; tilt the board to different sides, not about one line only",
        )


def _check_perspective(fit: LensFit) -> None:
    """Pictures that parallel projection explains as well say nothing about the focal length."""
    other = _other_fit(fit)
    if other is not None and other.rms_px < PLAIN_FACTOR * fit.rms_px:
        raise LensRefused(
            "focal length",
            f"not observable: the pictures show no perspective, a telecentric lens explains them as well "
            f"({other.rms_px:.3f} px rms against {fit.rms_px:.3f} px): if it is one, use the telecentric model; "
            "if not, tilt the board by 20 to 40 deg to different sides, and come closer",
        )


def _check_residual(fit: LensFit) -> None:
    limit = MOST_RMS_PX * max(1.0, max(fit.adjustment.views.picture_px) / RMS_WIDTH_PX)
    doubtful = fit.rms_px > (EXACT_PX if fit.adjustment.model.lens == "telecentric" else limit)
    other = _other_fit(fit) if doubtful else None
    if other is not None and other.rms_px < BETTER_FACTOR * fit.rms_px:
        name, right = fit.adjustment.model.lens, other.adjustment.model.lens
        raise LensRefused(
            "model",
            f"the {name} model leaves {fit.rms_px:.2f} px rms, the {right} one {other.rms_px:.2f} px: this lens is "
            f"{right}",
        )
    if fit.rms_px > limit:
        raise LensRefused(
            "residual",
            f"{fit.rms_px:.2f} px rms are left, {limit:g} px are allowed: check that the board is as described and "
            "flat, that zoom and focus were not touched, and that the lens is no fisheye",
        )


def _other_fit(fit: LensFit) -> LensFit | None:
    """The same views through the other model, None when it cannot be fitted at all."""
    views = fit.adjustment.views
    other: Lens = "telecentric" if fit.adjustment.model.lens == "pinhole" else "pinhole"
    if len(views.seen) < LEAST_PICTURES[other]:
        return None
    try:
        return fit_lens(model_for(other, views), views)
    except np.linalg.LinAlgError:
        return None
