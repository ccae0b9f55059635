"""How it stands with what the cell has learnt: in use since when, stale and why, to be verified. In sentences."""

from collections.abc import Callable
from pathlib import Path

from cellctl.config import CellConfig
from cellctl.faults import CellError, NotCalibrated
from cellctl.learnt.calibrations import caution, read_calibration
from cellctl.learnt.references import CAMERAS, Eye
from cellctl.learnt.taught import taught_in_use
from cellctl.monitoring import light_watch, watch
from cellctl.recipe import Recipe


def standing_texts(config: CellConfig, recipe: Recipe | None) -> dict[str, str]:
    """One text per camera, and one for the golden assembly of the recipe in use. Reads files."""
    texts: dict[str, str] = {camera: _calibration_text(config, camera) for camera in CAMERAS}
    if recipe is not None:
        texts["golden assembly"] = _taught_text(config, recipe)
        texts["light"] = _kept_text(config, recipe, light_watch.standing_text)
        if recipe.gap.when != "never":
            texts["drift"] = _kept_text(config, recipe, watch.standing_text)
    return texts


def objections(config: CellConfig, recipe: Recipe | None) -> list[str]:
    """What keeps the cell from producing as far as calibration and teaching go, and what should be known."""
    found = []
    for camera in CAMERAS:
        try:
            noted = caution(config, read_calibration(config, camera))
        except NotCalibrated as error:
            noted = str(error)
        found += [noted] if noted else []
    if recipe is not None:
        try:
            taught_in_use(config, recipe)
        except NotCalibrated as error:
            if str(error) not in found:
                found.append(str(error))
    return found


def _calibration_text(config: CellConfig, camera: Eye) -> str:
    try:
        used = read_calibration(config, camera)
        noted = caution(config, used)
    except NotCalibrated as error:
        return f"NOT USABLE: {error}"
    return f"{used.id} of {used.made}, hold-out {used.hold_out_um:.1f} um{'; ' + noted if noted else ''}"


def _taught_text(config: CellConfig, recipe: Recipe) -> str:
    try:
        taught = taught_in_use(config, recipe)
    except NotCalibrated as error:
        return f"NOT USABLE: {error}"
    return (
        f"{recipe.model}: {taught.id} of {taught.made}, {taught.pairs} x {taught.repeats} assemblies, "
        f"known to {taught.uncertainty_mm * 1000:.1f} um {taught.uncertainty_deg * 1000:.1f} mdeg"
    )


def _kept_text(config: CellConfig, recipe: Recipe, text: Callable[[Path, Recipe, str], str]) -> str:
    """What the units since the golden assembly say."""
    try:
        return text(config.paths.state, recipe, taught_in_use(config, recipe).id)
    except CellError as error:
        return f"unknown: {error}"
