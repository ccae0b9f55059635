"""What a process engineer asks of the calibrations: which versions there are, how they differ, and the whole report.

These commands read files only, so they work without the daemon.
"""

import json
from pathlib import Path
from typing import Any

import click

from cellctl.calibration.difference import Difference, differences, worst_um
from cellctl.config import CellConfig, load_config
from cellctl.faults import NotCalibrated
from cellctl.learnt.calibrations import CameraCalibration, camera_config, read_calibration
from cellctl.learnt.references import CAMERAS, Eye
from cellctl.learnt.versions import Shelf, Version, shelf

HEADING = f"{'version':<14}{'made (UTC)':<18}{'standing':<9}" + "".join(
    f"{name:>{width}}" for name, width in (("hold-out", 9), ("rms px", 8), ("1 sigma", 9), ("temp", 8), ("away", 8))
)


def list_versions(config_path: Path, *, as_json: bool) -> int:
    """Print all versions of both cameras; 1 when a file cannot be read. Raises SettingsError."""
    config = load_config(config_path)
    shelves = {camera: shelf(config.paths.state, camera) for camera in CAMERAS}
    if as_json:
        rows = [_facts(config, found, version) for found in shelves.values() for version in found.versions]
        unreadable = [line for found in shelves.values() for line in found.unreadable]
        click.echo(json.dumps({"versions": rows, "unreadable": unreadable}))
    else:
        for camera, found in shelves.items():
            _print_shelf(config, camera, found)
        click.echo("\nhold-out, 1 sigma (predicted) and away (largest difference to the one in use) in um, temp in C")
    return 1 if any(found.unreadable for found in shelves.values()) else 0


def show_version(config_path: Path, camera: Eye, version_id: str | None, *, as_json: bool) -> int:
    """Print one version: figures, where it differs from the one in use, report. Raises SettingsError, NotCalibrated."""
    config = load_config(config_path)
    found = shelf(config.paths.state, camera)
    version = found.find(version_id, camera, *(() if version_id else ("in use",)))
    if as_json:
        click.echo(json.dumps(_facts(config, found, version)))
        return 0
    click.echo(f"{camera} {version.calibration.id}: {version.standing}\nfile            {version.path}\n{version.text}")
    for objection in version.calibration.objections:
        click.echo(f"refused         {objection}")
    away = _away(config, found, version)
    if away and found.in_use is not None:
        click.echo(f"\nagainst {found.in_use.calibration.id} in use, um{'x':>12}{'y':>9}{'length':>9}")
        for place in away:
            click.echo(f"{place.place:<31}{place.dx_um:>+9.1f}{place.dy_um:>+9.1f}{place.um:>9.1f}")
    return 0


def report(config_path: Path, *, as_json: bool) -> int:
    """Print the calibrations in use with their reports; 0 when both may be used. Raises SettingsError."""
    config = load_config(config_path)
    usable = True
    for camera in CAMERAS:
        found = shelf(config.paths.state, camera)
        try:
            read_calibration(config, camera)
            standing = "in use"
        except NotCalibrated as error:
            usable, standing = False, f"NOT USABLE: {error}"
        version = found.in_use
        if as_json:
            facts = _facts(config, found, version) if version else {"camera": camera}
            click.echo(json.dumps({**facts, "standing": standing}))
        else:
            click.echo(f"{camera}: {standing}")
            if version:
                click.echo(f"picture         {version.path.with_suffix('.png')}\n{version.text}\n")
    return 0 if usable else 1


def _print_shelf(config: CellConfig, camera: Eye, found: Shelf) -> None:
    none = "" if found.versions or found.unreadable else f": none yet, run `cellctl calibrate {camera}`"
    click.echo(f"\n{camera}{none}")
    if found.versions:
        click.echo(HEADING)
    for version in found.versions:
        click.echo(_row(config, found, version))
    for line in found.unreadable:
        click.echo(f"unreadable    {line}")


def _row(config: CellConfig, found: Shelf, version: Version) -> str:
    one, away = version.calibration, _away(config, found, version)
    warm = "-" if one.temperature_c is None else f"{one.temperature_c:.1f}"
    far = f"{worst_um(away):.1f}" if away else "-"
    return (
        f"{one.id:<14}{one.made_at:%Y-%m-%d %H:%M}  {version.standing:<9}{one.hold_out_um:>9.1f}{one.rms_px:>8.4f}"
        f"{one.predicted_sd_um:>9.1f}{warm:>8}{far:>8}{_note(one)}"
    )


def _note(one: CameraCalibration) -> str:
    return f"  {one.objections[0]}" if one.objections else ""


def _away(config: CellConfig, found: Shelf, version: Version) -> tuple[Difference, ...]:
    """Differences to the version in use; none for that one itself, or when none is in use."""
    used = found.in_use
    if used is None or used.calibration.id == version.calibration.id:
        return ()
    view = camera_config(config, version.calibration.camera)
    try:
        return differences(version.calibration.plane, used.calibration.plane, (view.view_width_px, view.view_height_px))
    except ValueError:  # a place of the picture beyond what one of the lens models describes
        return ()


def _facts(config: CellConfig, found: Shelf, version: Version) -> dict[str, Any]:
    away = _away(config, found, version)
    return {
        "camera": version.calibration.camera,
        "version": version.calibration.id,
        "standing": version.standing,
        "file": str(version.path),
        "worst_away_um": worst_um(away) if away else None,
        "away_um": {place.place: [place.dx_um, place.dy_um] for place in away},
        **version.calibration.model_dump(mode="json", exclude={"camera", "parameters", "covariance"}),
    }
