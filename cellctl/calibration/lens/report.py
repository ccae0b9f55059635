"""How good a lens calibration is, as text."""

from __future__ import annotations

import math

import numpy as np

from cellctl.calibration.lens.judge import tilts_deg
from cellctl.calibration.lens.quality import common_residual, uncertainty
from cellctl.calibration.lens.solve import LensResult

ASSUMED = 0.8  # of the sigma taken for granted: a parameter known no better was not seen in the pictures
BAR = 30
WELL_ABOVE = 2.0  # times chance
DIFFERENT = 2.0  # between the sigmas from points and from pictures


def lens_text(result: LensResult) -> str:
    """The report for people."""
    rows = [*_summary_rows(result), ("", "")]
    lines = [f"{name:<13}{text}".rstrip() for name, text in rows]
    return "\n".join([*lines, *_parameter_lines(result), "", *_picture_lines(result), *_note_lines(result)])


def assumed(result: LensResult) -> tuple[str, ...]:
    """Parameters that the pictures do not show: they are what was taken for granted."""
    prior = result.fit.adjustment.prior.sd
    names = result.fit.adjustment.model.parameters
    return tuple(name for name, sd, limit in zip(names, result.sd, prior, strict=True) if sd > ASSUMED * limit)


def _summary_rows(result: LensResult) -> list[tuple[str, str]]:
    fit, known = result.fit, uncertainty(result)
    width, height = fit.adjustment.views.picture_px
    used, seen = int(fit.used.sum()), int(fit.adjustment.views.seen.sum())
    left_out = f", {seen - used} points far off left out" if seen > used else ""
    hold_out = "one picture only" if result.hold_out_px is None else f"{result.hold_out_px:.4f} px in pictures left out"
    common, chance = common_residual(result)
    tilts = tilts_deg(fit)
    return [
        ("lens", f"{fit.adjustment.model.lens}, pictures of {width} x {height} px"),
        ("pictures", f"{len(result.names)} used, {len(result.out)} left out; {used} points{left_out}"),
        ("residual", f"{fit.rms_px:.4f} px rms distance ({fit.adjustment.sd_px:.4f} px per axis)"),
        ("hold-out", f"{hold_out}{' of the fit' if result.hold_out_px is not None else ''}"),
        ("board", f"{common:.4f} px rms of it are the same in all pictures ({chance:.4f} px by chance)"),
        ("coverage", f"board seen over {result.coverage:.0%} of the picture, tilted {tilts.min():.0f} to "
         f"{tilts.max():.0f} deg"),
        ("lens known", f"to {known.rms_px:.4f} px rms where the board was seen, {known.worst_px:.3g} px at worst"),
    ]  # fmt: skip


def _parameter_lines(result: LensResult) -> list[str]:
    fold_sd = result.fold_sd
    lines = [f"{'parameter':<17}{'value':>14}{'sd (points)':>14}{'sd (pictures)':>15}"]
    for index, name in enumerate(result.fit.adjustment.model.parameters):
        from_pictures = "-" if fold_sd is None else f"{fold_sd[index]:.3g}"
        lines.append(f"{name:<17}{result.fit.shared[index]:>14.6g}{result.sd[index]:>14.3g}{from_pictures:>15}")
    return lines


def _picture_lines(result: LensResult) -> list[str]:
    rms, used = result.fit.picture_rms_px, result.fit.used.sum(1)
    longest = max(len(name) for name in (*result.names, *(out.name for out in result.out)))
    lines = [f"{'picture':<{longest}}  points  rms px"]
    for name, points, value in zip(result.names, used.tolist(), rms.tolist(), strict=True):
        bar = "#" * max(1, round(BAR * value / max(float(rms.max()), 1e-12)))
        lines.append(f"{name:<{longest}}  {points:>6}  {value:6.4f}  {bar}")
    return lines + [f"{out.name:<{longest}}  left out: {out.reason}" for out in result.out]


def _note_lines(result: LensResult) -> list[str]:
    notes = []
    if names := assumed(result):
        notes.append(f"not seen in these pictures, taken for granted: {', '.join(names)}")
    common, chance = common_residual(result)
    if common > WELL_ABOVE * chance:
        notes.append("the board is not quite as described or not quite flat: part of the residual repeats")
    if result.fold_sd is not None:
        ratio = float(np.median(result.fold_sd / result.sd))
        if math.isfinite(ratio) and ratio > DIFFERENT:
            notes.append(f"pictures differ {ratio:.1f} x more than their points scatter: believe sd (pictures)")
    return ["", *(f"note: {note}" for note in notes)] if notes else []
