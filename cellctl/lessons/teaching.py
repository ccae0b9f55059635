"""`cellctl recipe teach`: a recipe from pictures of a good base and battery.

The features are found without knowing their place, measured in every picture with the finders of production, and the
recipe is written only when it finds them in all the pictures it was made from. What pictures cannot show comes from
another recipe or from options; nothing is made up.
"""

import json
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click

from cellctl.config import load_config
from cellctl.desk.vision import draw
from cellctl.desk.vision_report import HEAD, as_json, line, summary
from cellctl.geometry import Px
from cellctl.lessons.from_pictures import Album, base_lessons, battery_lessons
from cellctl.lessons.lesson import base_figures, battery_figures, corner_name
from cellctl.lessons.measured import KEYS, base_values, battery_values, look_values, middle_turn_deg, picture_values
from cellctl.lessons.values import CannotTeach, Value, Values, check_known, given, of_file, recipe_of, text_of, write
from cellctl.pictures import scale
from cellctl.pictures.files import picture_paths, read_picture
from cellctl.pictures.scale import Scale
from cellctl.pictures.trial import Trial, tasks, try_picture
from cellctl.recipe import NAME, Recipe
from cellctl.recipe_parts import Margin
from cellctl.strict_toml import load
from cellctl.vision.lesson import BatteryLesson, Pointed

OK = 0
Points = tuple[float, float, float, float]
DEFAULTS: dict[str, float] = {
    "schema_version": 1,
    "base.search_mm": 1.5,
    "base.search_deg": 2.0,
    "battery.search_mm": 2.5,
    "battery.search_deg": 2.0,
    "limits.hole_radius_tolerance_mm": 0.08,
    "limits.edge_distance_tolerance_mm": 0.10,
    "limits.squareness_deg": 0.3,
}


class Order(NamedTuple):
    """What the command line asks for."""

    name: str
    base: tuple[Path, ...]
    battery: tuple[Path, ...]
    origin: Path | None  # another recipe
    settings: tuple[str, ...]  # KEY=VALUE
    drawn: dict[str, float]  # the battery's size and the seat, by dotted key
    corner: str | None
    pointed: tuple[Pointed, Pointed]  # in the first picture of the base, of the battery
    mm_per_px: float | None
    bits: int
    config: Path | None
    folder: Path | None
    out: Path | None
    force: bool
    as_json: bool


def order_of(
    *,
    battery_size: tuple[float, float] | None,
    seat: tuple[float, float, float] | None,
    hole: tuple[float, float, float] | None,
    edge: Points | None,
    battery_edge: tuple[Points, ...],
    **options: Any,
) -> Order:
    """The order out of the command line's options."""
    drawn = dict(zip(("battery.width_mm", "battery.height_mm"), battery_size or (), strict=False))
    drawn |= dict(zip(("base.seat_x_mm", "base.seat_y_mm", "base.seat_t_deg"), seat or (), strict=False))
    about_hole = (Px(hole[0], hole[1]), hole[2]) if hole else None
    base = Pointed(about_hole, (_edge(edge),) if edge else ())
    return Order(drawn=drawn, pointed=(base, Pointed(None, tuple(map(_edge, battery_edge)))), **options)


def _edge(points: Points) -> tuple[Px, Px]:
    return Px(points[0], points[1]), Px(points[2], points[3])


def teach_recipe(order: Order) -> int:
    """Make, try and write the recipe, show what was taught. Raises CannotTeach, PictureError, SettingsError."""
    path, out = _path(order), order.out or Path(f"taught-{order.name}")
    albums = _albums(order, out)
    known = _known(order, albums)
    check_known(known.keys() | KEYS)
    measured, scales = _measured(albums, known)
    values = known | measured | _given(order)
    recipe = recipe_of(values)
    trials = _tried(albums, recipe, scales, out)
    heading = (
        f"{recipe.model}: {recipe.description}\nMade by `cellctl recipe teach`; every value says where it is from."
    )
    write(path, recipe, text_of(recipe, values, heading), force=order.force)
    _print(order, path, out, values, trials)
    return OK


def _path(order: Order) -> Path:
    """The file to write. Raises CannotTeach when it exists already, SettingsError."""
    if not NAME.fullmatch(order.name):
        raise CannotTeach(f"{order.name!r:.60} is no name for a recipe: a-z, 0-9 and - only")
    if order.folder is None and order.config is None:
        raise CannotTeach("where the recipe belongs is not known: --folder, or the cell's --config")
    folder = order.folder or load_config(order.config or Path()).paths.recipes
    path = folder / f"{order.name}.toml"
    if path.exists() and not order.force:
        raise CannotTeach(f"{path} exists: choose another name, or --force to replace it")
    return path


def _albums(order: Order, out: Path) -> tuple[Album, Album]:
    """The pictures of both parts, with what pixels mean in them. Raises CannotTeach, PictureError, SettingsError."""
    base, battery = picture_paths(order.base), picture_paths(order.battery)
    if out.resolve() in {path.resolve().parent for path in (*base, *battery)}:
        raise CannotTeach(f"{out}: drawn pictures must not go among those that are measured (--out)")
    scales = _scales(order, base[0])
    say = partial(click.echo, err=True)
    return (
        Album("base", base, scales[0], order.pointed[0], out, order.bits, say),
        Album("battery", battery, scales[1], order.pointed[1], out, order.bits, say),
    )


def _scales(order: Order, first: Path) -> tuple[Scale, Scale]:
    """What pixels mean: by the option, the cell, or the other recipe, in this order."""
    if order.mm_per_px:
        height, width = read_picture(first, order.bits).pixels.shape
        return scale.of_option((width, height), order.mm_per_px)
    if order.config:
        return scale.of_cell(load_config(order.config))
    scales = scale.of_recipe(load(order.origin, Recipe)) if order.origin else None
    if scales is None:
        raise CannotTeach("how many mm a pixel shows is not known: --mm-per-px, or the cell's --config")
    return scales


# -- values ------------------------------------------------------------------------------------------------


def _known(order: Order, albums: tuple[Album, Album]) -> Values:
    """What is known without the pictures, weakest first: defaults, the other recipe, what the name says."""
    base, battery = (len(album.paths) for album in albums)
    about = f"taught from {base} pictures of the base and {battery} of the battery"
    known = {key: Value(value, "default") for key, value in DEFAULTS.items()}
    known |= of_file(order.origin) if order.origin else {}
    known |= {"model": Value(order.name.upper(), "the name"), "description": Value(about, "default")}
    return known | _given(order)


def _given(order: Order) -> Values:
    """What the command line says, strongest last."""
    drawn = {key: Value(value, "given") for key, value in order.drawn.items()}
    corner = {"battery.corner": Value(order.corner, "--corner")} if order.corner else {}
    return drawn | corner | given(order.settings)


def _measured(albums: tuple[Album, Album], known: Values) -> tuple[Values, tuple[Scale, Scale]]:
    """What the pictures show, and the scales with the parts turned as they lie in them. Raises CannotTeach."""
    bases, batteries = base_lessons(albums[0]), battery_lessons(albums[1])
    corner = _corner(batteries[0], albums[1].scale, known)
    plain = [scale.untilted(album.scale) for album in albums]
    base = [base_figures(lesson, albums[0].scale) for lesson in bases]
    battery = [battery_figures(lesson, albums[1].scale, str(corner.value)) for lesson in batteries]
    values = base_values(base, _margin(known, "base")) | battery_values(battery, _margin(known, "battery"))
    values |= {"battery.corner": corner} | look_values(base, battery)
    values |= picture_values("base", plain[0], [base_figures(lesson, plain[0]).turn_deg for lesson in bases])
    turns = [battery_figures(lesson, plain[1], str(corner.value)).turn_deg for lesson in batteries]
    values |= picture_values("battery", plain[1], turns)
    scales = (
        albums[0].scale._replace(turn_deg=middle_turn_deg([figures.turn_deg for figures in base])),
        albums[1].scale._replace(turn_deg=middle_turn_deg([figures.turn_deg for figures in battery])),
    )
    return values, scales


def _corner(lesson: BatteryLesson, scale: Scale, known: Values) -> Value:
    """Which corner of the battery the pictures show. Raises CannotTeach when nothing says it, or two things differ."""
    seen, said = corner_name(lesson, scale), known.get("battery.corner")
    if seen and said and said.source == "--corner" and said.value != seen:
        raise CannotTeach(f"--corner {said.value}: by the {scale.source} it is {seen}")
    if seen:
        return Value(seen, f"by the {scale.source}")
    if said is None:
        raise CannotTeach("which corner the pictures show is not known: --corner, or --config of a calibrated cell")
    return said


def _margin(known: Values, part: str) -> Margin:
    """How far the part may lie from its place. Raises CannotTeach for what is no number."""
    search = [known[f"{part}.search_{unit}"] for unit in ("mm", "deg")]
    if any(isinstance(value, str) for value, _ in search):
        raise CannotTeach(f"{part}.search_mm and {part}.search_deg must be numbers")
    return Margin(float(search[0].value), float(search[1].value))


# -- proof -------------------------------------------------------------------------------------------------


def _tried(albums: tuple[Album, Album], recipe: Recipe, scales: tuple[Scale, Scale], out: Path) -> list[Trial]:
    """The new recipe on all the pictures, which are drawn. Raises CannotTeach when it refuses one."""
    trials: list[Trial] = []
    for album, task in zip(albums, tasks(recipe, scales).values(), strict=True):
        for path in album.paths:
            picture = read_picture(path, album.bits)
            trials.append(try_picture(picture, task))
            draw(picture, trials[-1], out / f"{len(trials):03d}-{path.stem}.jpg")
    refused = [f"{trial.path}: {trial.refused}" for trial in trials if trial.refused]
    if refused:
        raise CannotTeach("\n".join(["the new recipe would refuse pictures that it was taught from:", *refused]))
    return trials


def _print(order: Order, path: Path, out: Path, values: Values, trials: list[Trial]) -> None:
    """What was taught: for programs, or for people."""
    if order.as_json:
        taught = {key: each._asdict() for key, each in values.items()}
        rows = [as_json(trial) for trial in trials]
        click.echo(json.dumps({"recipe": str(path), "drawn": str(out), "values": taught, "pictures": rows}))
        return
    click.echo("\n".join([HEAD, *(line(trial) for trial in trials), *summary(trials), ""]))
    for key, each in values.items():
        if order.origin is None or not each.source.endswith(order.origin.name):
            click.echo(f"{key:<36} {each.value!s:<24} {each.source}".rstrip())
    click.echo(f"\n{path} is written; drawn pictures: {out}; next: `cellctl recipe use {order.name}`, `cellctl teach`")
