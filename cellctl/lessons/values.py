"""The values of a recipe in the making, by dotted key, each with where it comes from; and the file of them."""

import json
import os
import tomllib
from collections.abc import Container, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import ValidationError

from cellctl.recipe import Recipe
from cellctl.strict_toml import Settings, load

COMMENT_COLUMN = 32
LONGEST_LINE = 120
REMEDIES = {
    "battery.width_mm": "--battery-size WIDTH,HEIGHT",
    "battery.height_mm": "--battery-size WIDTH,HEIGHT",
    "base.seat_x_mm": "--seat X,Y,T",
    "base.seat_y_mm": "--seat X,Y,T",
    "base.seat_t_deg": "--seat X,Y,T",
    "battery.corner": "--corner",
}


class CannotTeach(Exception):
    """A recipe cannot be made of what was given; the text says why and what to do, one line per reason."""


class Value(NamedTuple):
    """A value and its origin, in words for the table and the comment."""

    value: str | float | bool
    source: str


Values = dict[str, Value]


def given(settings: Iterable[str]) -> Values:
    """Values of `KEY=VALUE` texts. Raises CannotTeach."""
    values: Values = {}
    for text in settings:
        key, equals, written = text.partition("=")
        try:
            value = tomllib.loads(f"value = {written}")["value"] if equals else None
        except tomllib.TOMLDecodeError:
            value = written.strip()  # a word without quotes, as a shell hands it over
        if not key.strip() or not isinstance(value, str | int | float):
            raise CannotTeach(f"--set {text}: must be KEY=VALUE, such as base.search_mm=1.5")
        values[key.strip()] = Value(value, "--set")
    return values


def of_file(path: Path) -> Values:
    """All values of a recipe file. Raises SettingsError."""
    recipe = load(path, Recipe).model_dump(mode="json", exclude_unset=True, exclude_none=True)
    return {key: Value(value, f"from {path.name}") for key, value in _flat(recipe)}


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def recipe_of(values: Values) -> Recipe:
    """The recipe that these values make. Raises CannotTeach with everything that is missing or wrong."""
    nested: dict[str, Any] = {}
    for key, each in values.items():
        table = nested
        *tables, name = key.split(".")
        for inner in tables:
            table = table.setdefault(inner, {})
            if not isinstance(table, dict):
                raise CannotTeach(f"{key}: {inner} is a value, not a table")
        table[name] = each.value
    check_known(values)
    try:
        return Recipe.model_validate(nested)
    except ValidationError as error:
        raise CannotTeach("\n".join(_said(each, values) for each in error.errors(include_url=False))) from None


def check_known(known: Container[str]) -> None:
    """Raises CannotTeach when a recipe must have keys that are not known, each with the option that gives it."""
    if unknown := [key for key in _needed(Recipe) if key not in known]:
        raise CannotTeach("\n".join(f"{key} is not known: {_remedy(key)}" for key in unknown))


def _needed(model: type[Settings], prefix: str = "") -> Iterator[str]:
    """Dotted keys that a recipe must have."""
    for name, field in model.model_fields.items():
        inner = field.annotation
        if field.is_required() and isinstance(inner, type) and issubclass(inner, Settings):
            yield from _needed(inner, f"{prefix}{name}.")
        elif field.is_required():
            yield f"{prefix}{name}"


def _remedy(key: str) -> str:
    option = REMEDIES.get(key, f"--set {key}=VALUE")
    return f"{option}, or take it --from another recipe"


def _said(error: Mapping[str, Any], values: Values) -> str:
    key = ".".join(str(part) for part in error["loc"])
    origin = f" ({values[key].source})" if key in values else ""
    return f"{key}: {error['msg']}{origin}; another value: --set {key}=VALUE"


# -- the file ----------------------------------------------------------------------------------------------


def text_of(recipe: Recipe, values: Values, heading: str) -> str:
    """The recipe as TOML with a comment at each value: what it is, and where it comes from."""
    lines = [*(_comment(line) for line in heading.splitlines()), "", *_table(recipe, values, "")]
    return "\n".join(lines) + "\n"


def _table(table: Settings, values: Values, prefix: str) -> Iterator[str]:
    """The lines of a table's own values, then those of its tables."""
    inner: list[tuple[str, Settings]] = []
    for name, field in type(table).model_fields.items():
        value, key = getattr(table, name), f"{prefix}{name}"
        if isinstance(value, Settings):
            inner.append((key, value))
        elif key in values:
            yield from _line(f"{name} = {_toml(value)}", field.description or "", values[key].source)
    for key, value in inner:
        if any(f"{key}.{name}" in values for name in type(value).model_fields):
            yield from ("", f"# {type(value).__doc__}", f"[{key}]")
        yield from _table(value, values, f"{key}.")


def _line(setting: str, what: str, source: str) -> Iterator[str]:
    """A setting with its comment, which stands above it when the line would be too long."""
    comment = _comment("; ".join(text for text in (what, source) if text))
    line = f"{setting:<{COMMENT_COLUMN - 1}} {comment}"
    yield from [line] if len(line) <= LONGEST_LINE else [comment, setting]


def _comment(text: str) -> str:
    return f"# {''.join(letter if letter.isprintable() else ' ' for letter in text)}"


def _toml(value: object) -> str:
    """A value as JSON writes it; of texts TOML allows no raw delete character."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def write(path: Path, recipe: Recipe, text: str, *, force: bool) -> None:
    """Write the file whole or not at all, and only if it reads back as this recipe. Raises CannotTeach."""
    part = path.with_name(f".{path.name}.part")
    try:
        with part.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        if load(part, Recipe) != recipe:
            raise CannotTeach(f"{path}: the recipe would not read back as it was made")
        if force:
            os.replace(part, path)
        else:
            os.link(part, path)
    except FileExistsError:
        raise CannotTeach(f"{path} exists: choose another name, or --force to replace it") from None
    except OSError as error:
        raise CannotTeach(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        part.unlink(missing_ok=True)
