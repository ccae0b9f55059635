"""`cellctl vision test`: the finders of a recipe over files and folders of pictures."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import click

from cellctl.config import load_config
from cellctl.desk.commands import OK
from cellctl.desk.vision_report import HEAD, as_json, figures_of, line, summary
from cellctl.pictures import scale
from cellctl.pictures.files import Picture, PictureError, picture_paths, read_picture, write_picture
from cellctl.pictures.scale import Scale, Size
from cellctl.pictures.trial import PARTS, Camera, Task, Trial, tasks, try_either, try_picture
from cellctl.recipe import Recipe
from cellctl.strict_toml import load
from cellctl.vision.annotate import annotate

REFUSED = 1
CAMERAS: dict[str, Camera | None] = {"1": 1, "2": 2, "auto": None}


class Order(NamedTuple):
    """What the command line asks for."""

    pictures: tuple[Path, ...]
    recipe: Path
    config: Path | None
    camera: Camera | None  # None: whichever part the picture shows
    mm_per_px: float | None
    search_mm: float | None
    bits: int
    out: Path | None
    as_json: bool


def try_pictures(order: Order) -> int:
    """Print a line per picture and a summary; 1 when anything was refused. Raises SettingsError, PictureError."""
    paths = picture_paths(order.pictures)
    if order.out and order.out.resolve() in {path.resolve().parent for path in paths}:
        raise PictureError(f"{order.out}: drawn pictures must not go among those that are measured (--out)")
    recipe = load(order.recipe, Recipe)
    first = next((each for each in _read(paths, order.bits) if isinstance(each, Picture)), None)
    size = (first.pixels.shape[1], first.pixels.shape[0]) if first else (0, 0)
    either = tasks(recipe, _scales(order, recipe, size), order.search_mm) if first else {}
    if first:
        _try(first, either, order.camera)  # makes the finders' tables: their time is not a picture's
    trials, unread = _shown(_read(paths, order.bits), either, order)
    _print_summary(trials, unread, for_programs=order.as_json)
    return REFUSED if unread or any(trial.refused for trial in trials) else OK


def _read(paths: Iterable[Path], bits: int) -> Iterator[Picture | PictureError]:
    for path in paths:
        try:
            yield read_picture(path, bits)
        except PictureError as error:
            yield error


def _scales(order: Order, recipe: Recipe, size: Size) -> tuple[Scale, Scale]:
    """What pixels mean: by the option, the recipe or the cell, in this order. Raises PictureError, SettingsError."""
    if order.mm_per_px:
        return scale.of_option(size, order.mm_per_px)
    if scales := scale.of_recipe(recipe):
        return scales
    if order.config:
        return scale.of_cell(load_config(order.config))
    raise PictureError(
        f"how many mm a pixel shows is not known: {order.recipe} was not taught from pictures; "
        "give --mm-per-px, or the cell's --config"
    )


def _shown(
    pictures: Iterable[Picture | PictureError], either: dict[Camera, Task], order: Order
) -> tuple[list[Trial], int]:
    """All trials, each printed and drawn as it comes, and how many files were no pictures."""
    trials: list[Trial] = []
    unread = 0
    if not order.as_json:
        click.echo(_heading(either))
    for number, picture in enumerate(pictures, 1):
        if isinstance(picture, PictureError):
            unread += 1
            click.echo(json.dumps({"error": str(picture)}) if order.as_json else str(picture))
            continue
        trial = _try(picture, either, order.camera)
        click.echo(json.dumps(as_json(trial)) if order.as_json else line(trial))
        if order.out:
            draw(picture, trial, order.out / f"{number:03d}-{picture.path.stem}.jpg")
        trials.append(trial)
    return trials, unread


def _heading(either: dict[Camera, Task]) -> str:
    known = [
        f"{PARTS[task.camera]}: {1000 * task.scale.plane.mm_per_px:.4f} um per px, by {task.scale.source}"
        for task in either.values()
    ]
    return "\n".join([*known, HEAD])


def _try(picture: Picture, either: dict[Camera, Task], camera: Camera | None) -> Trial:
    return try_picture(picture, either[camera]) if camera else try_either(picture, either)


def draw(picture: Picture, trial: Trial, path: Path) -> None:
    """Write the picture with what was expected and found in it. Raises PictureError."""
    said = "found" if trial.found else f"refused: {trial.refused}"
    seen = trial.found.seen if trial.found else None
    caption = f"{picture.path.name} {PARTS[trial.task.camera]} {said}"
    write_picture(path, annotate(picture.pixels, seen, trial.task.expected, caption))


def _print_summary(trials: list[Trial], unread: int, *, for_programs: bool) -> None:
    if for_programs:
        by_part = {part: [t for t in trials if t.task.camera == camera] for camera, part in PARTS.items()}
        figures = {part: figures_of(mine) for part, mine in by_part.items() if mine}
        click.echo(json.dumps({"summary": figures, "unreadable": unread}))
        return
    for text in summary(trials):
        click.echo(text)
    if unread:
        click.echo(f"not readable: {unread}")
