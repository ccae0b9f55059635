"""Which pictures contradict the others, and how that shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.errors import LensRefused
from cellctl.calibration.homography import homography, mapped
from cellctl.calibration.lens.fit import LensFit, without
from cellctl.calibration.lens.model import Views
from cellctl.calibration.plane_map import Lens

FloatArray = NDArray[np.float64]

LEAST_PICTURES = {"pinhole": 3, "telecentric": 1}
MOST_OFF_PLANE = 0.2  # of the distance of neighbouring points: beyond it they are not those of the board
OUT_FACTOR = 2.5  # a picture's residual against the usual one
LEAST_OUT_PX = 0.05
LEAST_USED = 0.7  # part of a picture's points that must count
SUSPECTS = 3  # pictures that are left out in turn to see what that changes
LEAST_FOR_INFLUENCE = 5  # pictures
MOST_PULL = 25.0  # squared sigmas by which one picture may move the lens: 0.1 to 3 for noise, to 12 in good real sets
PULL_FACTOR = 3.0  # against the next suspect
MOST_OUT = 0.25  # part of the pictures


class PictureOut(NamedTuple):
    """A picture that is left out, and why."""

    name: str
    reason: str


def check_count(lens: Lens, count: int, out: Sequence[PictureOut]) -> None:
    """Raise LensRefused when there are too few pictures."""
    least = LEAST_PICTURES[lens]
    if count < least:
        named = "; ".join(f"{name}: {reason}" for name, reason in out[:3])
        left = f", {len(out)} {'were' if len(out) > 1 else 'was'} left out ({named})" if out else ""
        raise LensRefused(
            "pictures", f"{count} usable picture{'s' * (count != 1)}, a {lens} lens needs {least} or more{left}"
        )


def off_plane(views: Views, names: Sequence[str]) -> list[PictureOut]:
    """Pictures whose points are not those of a flat, even board, whatever the lens."""
    out = []
    for name, px, seen in zip(names, views.points_px, views.seen, strict=True):
        board, points = views.board_mm[seen], px[seen]
        off = mapped(homography(board, points), board) - points
        rms, step = math.sqrt(float((off**2).sum(1).mean())), _least_step(points)
        if not rms <= MOST_OFF_PLANE * step:
            where = f"its points lie {rms:.1f} px rms beside a flat board's, {step:.1f} px from one to the next"
            out.append(PictureOut(name, where))
    return out


def copies(views: Views, names: Sequence[str]) -> list[PictureOut]:
    """Pictures that show exactly what an earlier one shows: they would count twice and tell nothing."""
    first: dict[bytes, str] = {}
    out = []
    for name, px, seen in zip(names, views.points_px, views.seen, strict=True):
        known = first.setdefault(px[seen].tobytes(), name)
        if known != name:
            out.append(PictureOut(name, f"shows exactly what {known} shows"))
    return out


def wrong_picture(fit: LensFit, names: Sequence[str]) -> tuple[int, PictureOut] | None:
    """The picture that contradicts the others most, when one does: by its residual, or by how it pulls the lens."""
    if len(names) < LEAST_PICTURES["pinhole"]:
        return None
    return _by_residual(fit, names) or _by_pull(fit, names)


def check_outliers(lens: Lens, out: Sequence[PictureOut], count: int) -> None:
    """Raise LensRefused when so many pictures contradict the others that nobody knows who is right."""
    if len(out) > max(1, MOST_OUT * count):
        named = "; ".join(f"{name}: {reason}" for name, reason in out[:2])
        raise LensRefused(
            "pictures disagree",
            f"{len(out)} of {count} pictures fit no common {lens} lens ({named}): check that zoom and focus were not "
            "touched and that the board is flat and as described",
        )


def _by_residual(fit: LensFit, names: Sequence[str]) -> tuple[int, PictureOut] | None:
    rms, seen = fit.picture_rms_px, fit.adjustment.views.seen.sum(1)
    used, usual = fit.used.sum(1) / seen, float(np.median(rms))
    bad = ((rms > OUT_FACTOR * usual) & (rms > LEAST_OUT_PX)) | (used < LEAST_USED)
    if not bad.any():
        return None
    worst = int(np.where(bad, rms, -1.0).argmax())
    text = f"{rms[worst]:.2f} px rms, {usual:.2f} px is usual here"
    if used[worst] < LEAST_USED:
        text = f"{round((1 - used[worst]) * seen[worst])} of its {seen[worst]} points are far from where they should be"
    return worst, PictureOut(names[worst], f"{text}: another zoom or focus, a bent board, blur, or wrongly read points")


def _by_pull(fit: LensFit, names: Sequence[str]) -> tuple[int, PictureOut] | None:
    """A picture of another zoom may fit well by bending the lens: then the lens changes much without it."""
    if len(names) < LEAST_FOR_INFLUENCE:
        return None
    suspects = np.argsort(-fit.picture_rms_px)[:SUSPECTS].tolist()
    rests = [without(fit, [index]) for index in suspects]
    pulls = [_pull(fit, rest) for rest in rests]
    first, second = sorted(pulls, reverse=True)[:2]
    if first <= MOST_PULL or first <= PULL_FACTOR * second:
        return None
    which = pulls.index(first)
    name, shift = fit.adjustment.model.parameters[0], fit.shared[0] - rests[which].shared[0]
    text = f"alone it moves the lens by {math.sqrt(first):.1f} sigma ({name} by {shift:+.3g}): another zoom or focus?"
    return suspects[which], PictureOut(names[suspects[which]], text)


def _pull(fit: LensFit, rest: LensFit) -> float:
    """Squared sigmas between the lens of all and that of the rest (Cook's distance, not divided)."""
    moved = fit.shared - rest.shared
    sd = np.sqrt(np.diag(covariance := rest.adjustment.normal(rest.x).covariance()))
    scaled = covariance / np.outer(sd, sd)
    return float((moved / sd) @ np.linalg.lstsq(scaled, moved / sd, rcond=None)[0])


def _least_step(points: FloatArray) -> float:
    """Distance of the nearest neighbours, the middle of all."""
    away = np.hypot(*np.moveaxis(points[None] - points[:, None], -1, 0))
    np.fill_diagonal(away, np.inf)
    return float(np.median(away.min(1)))
