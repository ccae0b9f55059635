"""What `cellctl vision test` prints: a line per picture, a summary per camera, the same as JSON."""

import statistics
from collections.abc import Iterator, Sequence
from typing import Any

from cellctl.pictures.trial import PARTS, Trial

HEAD = (
    f"{'picture':<28} part     verdict      u px     v px    dX mm    dY mm   dT deg  "
    "sd um  sd mdeg  blur px  contrast    ms"
)


def line(trial: Trial) -> str:
    """One picture for people: found with its figures, or refused with the check and its figure."""
    name, part = trial.path.name, PARTS[trial.task.camera]
    shown = name if len(name) <= 28 else f"...{name[-25:]}"
    found, offset = trial.found, trial.offset
    if found is None or offset is None:
        return f"{shown:<28} {part:<8} refused  {trial.refused} {_noted(trial)}".rstrip()
    looks = found.seen.appearances.values()
    return (
        f"{shown:<28} {part:<8} found    {found.mark_px.u:8.2f} {found.mark_px.v:8.2f} "
        f"{offset.x_mm:+8.4f} {offset.y_mm:+8.4f} {offset.t_deg:+8.4f} {_sd_um(trial):6.2f} "
        f"{found.edge.angle_sd_deg * 1000:8.2f} {max(look.blur_px for look in looks):8.2f} "
        f"{min(look.contrast for look in looks):9.0f} {trial.took_ms:5.1f} {_noted(trial)}"
    ).rstrip()


def _noted(trial: Trial) -> str:
    return f"({'; '.join(trial.notes)})" if trial.notes else ""


def _sd_um(trial: Trial) -> float:
    return trial.found.sd_px * trial.task.scale.plane.mm_per_px * 1000 if trial.found else 0.0


def summary(trials: Sequence[Trial]) -> Iterator[str]:
    """Per camera: how many were found, how far they differ, how long it took."""
    for camera, part in PARTS.items():
        mine = [trial for trial in trials if trial.task.camera == camera]
        if not mine:
            continue
        figures = figures_of(mine)
        yield f"{part}: found {figures['found']} of {figures['pictures']}; {_timing(figures)}"
        if figures["found"] > 1:
            yield (
                f"  spread {figures['spread_x_um']:.2f} um {figures['spread_y_um']:.2f} um "
                f"{figures['spread_t_mdeg']:.2f} mdeg (1 sigma: noise only when nothing moved between the pictures)"
            )


def _timing(figures: dict[str, Any]) -> str:
    return f"{figures['median_ms']:.1f} ms median, {figures['p99_ms']:.1f} ms p99"


def figures_of(trials: Sequence[Trial]) -> dict[str, Any]:
    """The summary of one camera's pictures."""
    offsets = [trial.offset for trial in trials if trial.offset is not None]
    took = sorted(trial.took_ms for trial in trials)
    figures = {
        "pictures": len(trials),
        "found": len(offsets),
        "median_ms": round(statistics.median(took), 3),
        "p99_ms": round(took[min(len(took) - 1, int(0.99 * len(took)))], 3),
    }
    if len(offsets) > 1:
        x, y, t = (statistics.stdev(values) for values in zip(*offsets, strict=True))
        figures |= {"spread_x_um": x * 1e3, "spread_y_um": y * 1e3, "spread_t_mdeg": t * 1e3}
    return figures


def as_json(trial: Trial) -> dict[str, Any]:
    """One picture for programs."""
    row: dict[str, Any] = {
        "file": str(trial.path),
        "camera": trial.task.camera,
        "found": trial.found is not None,
        "took_ms": round(trial.took_ms, 3),
        "notes": list(trial.notes),
    }
    if trial.refused is not None:
        row |= {"check": trial.refused.check, "detail": trial.refused.detail}
    offset = trial.offset
    if trial.found is not None and offset is not None:
        row |= {"u_px": trial.found.mark_px.u, "v_px": trial.found.mark_px.v}
        row |= {"dx_mm": offset.x_mm, "dy_mm": offset.y_mm, "dt_deg": offset.t_deg}
        row |= {"sd_um": _sd_um(trial), "sd_mdeg": trial.found.edge.angle_sd_deg * 1000}
        row["looks"] = {name: look._asdict() for name, look in trial.found.seen.appearances.items()}
    return row
