"""Settings files: TOML, read strictly, every mistake as one line `file:line:column: key.path: what is wrong (got ...)`.

Recipes and cell.toml are written by people who are not programmers, and a wrong number moves a robot. So a file is
refused as a whole, with all its mistakes at once and each at its place. Models derive from `Settings`.
"""

import codecs
import difflib
import json
import math
import re
import stat
import tomllib
from collections.abc import Iterator
from functools import reduce
from pathlib import Path
from typing import Any, NoReturn, Self, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from cellctl.toml_positions import KeyPath, Layout, scan

LARGEST_FILE = 1024 * 1024
MOST_LINES = 50

Contradiction = tuple[str, str]
"""A key below the table that complains (dotted), and what is wrong with it."""


class SettingsError(Exception):
    """A settings file cannot be used. `lines`: one sentence per mistake, each with its place."""

    def __init__(self, lines: list[str]) -> None:
        super().__init__("\n".join(lines))
        self.lines = tuple(lines)


class Settings(BaseModel):
    """A table of a settings file: strict types, no unknown keys, no nan, no inf, never changed."""

    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", allow_inf_nan=False)

    def contradictions(self) -> Iterator[Contradiction]:
        """Values that are right one by one but do not fit together."""
        return iter(())

    @model_validator(mode="after")
    def _values_fit_together(self) -> Self:
        mistakes = [
            InitErrorDetails(
                type=PydanticCustomError("contradiction", "{said}", {"said": said}),
                loc=tuple(key.split(".")),
                input=reduce(getattr, key.split("."), self),
            )
            for key, said in self.contradictions()
        ]
        if mistakes:
            raise ValidationError.from_exception_data(type(self).__name__, mistakes)
        return self


S = TypeVar("S", bound=Settings)


def load(path: Path | str, model: type[S]) -> S:
    """Read a file into its model; validators find the file's folder as `info.context["folder"]`.

    Raises SettingsError, whatever the file holds.
    """
    path = Path(path)
    text = _read(path)
    layout = scan(text)
    if layout.too_much:
        at = layout.stuck or 0
        _refuse(path, text, (at, f"{_key_at(text, layout, at)}{layout.too_much}"))
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        _refuse(path, text, _syntax_mistake(text, layout, str(error)))
    try:
        return model.model_validate(content, context={"folder": path.parent.resolve()})
    except ValidationError as error:
        errors = sorted(error.errors(include_url=False), key=lambda each: _offset_of(each, layout))
        mistakes = [
            (_offset_of(each, layout), f"{_dotted(each['loc'])}: {_sentence(each, model)}")
            for each in errors[:MOST_LINES]
        ]
        _refuse(path, text, *mistakes, untold=len(errors) - len(mistakes))


def _refuse(path: Path, text: str, *mistakes: tuple[int, str], untold: int = 0) -> NoReturn:
    """Raise SettingsError with a line per mistake, given by its offset and its sentence."""
    lines = []
    for offset, said in mistakes:
        line, column = _line_and_column(text, offset)
        lines.append(f"{path}:{line}:{column}: {said}")
    if untold:
        lines.append(f"{path}: and {untold} more mistakes")
    raise SettingsError(lines) from None


def _line_and_column(text: str, offset: int) -> tuple[int, int]:
    return text.count("\n", 0, offset) + 1, offset - text.rfind("\n", 0, offset)


# Reading


def _read(path: Path) -> str:
    """The text of a file with "\\n" line ends and without byte order mark."""
    try:
        about = path.stat()
        if stat.S_ISDIR(about.st_mode):
            raise SettingsError([f"{path}: is a folder, not a file"])
        if not stat.S_ISREG(about.st_mode):
            raise SettingsError([f"{path}: is not a regular file"])
        with path.open("rb") as file:
            raw = file.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise SettingsError([f"{path}: there is no such file"]) from None
    except OSError as error:
        raise SettingsError([f"{path}: cannot be read: {error.strerror}"]) from error
    except ValueError:
        raise SettingsError([f"{str(path)!r}: is not the name of a file"]) from None
    if len(raw) > LARGEST_FILE:
        raise SettingsError([f"{path}: is larger than {LARGEST_FILE} bytes, this is not a settings file"])
    raw = raw.removeprefix(codecs.BOM_UTF8)
    try:
        return raw.decode().replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        before = raw[: error.start].decode().replace("\r\n", "\n")
        _refuse(path, before, (len(before), f"is not UTF-8 text (byte 0x{raw[error.start]:02x}); save it as UTF-8"))


# Syntax


UNFINISHED = {
    '"': "this text has no closing quote",
    "'": "this text has no closing quote",
    "[": "this bracket is not closed",
    "{": "this bracket is not closed",
}


def _syntax_mistake(text: str, layout: Layout, message: str) -> tuple[int, str]:
    """Offset and sentence of what tomllib refused. It gives some mistakes no place, or the place where it noticed."""
    said = re.fullmatch(r"(.*?)(?: \(at (?:line (\d+), column (\d+)|(end) of document)\))?", message, re.DOTALL)
    what, line, column, at_end = said.groups() if said else (message, None, None, None)
    offset = _offset(text, int(line), int(column or 1)) if line else len(text) if at_end else 0
    if what.startswith(("Cannot", "Duplicate")):
        return _given_twice(text, layout, offset)
    if layout.stuck is not None and (at_end or what == "Illegal character '\\n'"):
        offset = layout.stuck
        what = UNFINISHED.get(text[offset : offset + 1], what)
    elif re.search(r"\d$", text[:offset]) and re.match(r",\s*\d", text[offset:]):
        what = "a number has a decimal point, not a comma"
    elif what == "Invalid value":
        what = "is not a value: texts stand in quotes, numbers begin with a digit"
    return offset, f"{_key_at(text, layout, offset)}{what[:1].lower()}{what[1:]}"


def _offset(text: str, line: int, column: int) -> int:
    start = 0
    for _ in range(line - 1):
        start = text.index("\n", start) + 1
    return start + column - 1


def _key_at(text: str, layout: Layout, offset: int) -> str:
    """The key whose value contains the offset, or that ends before it on its line, as the beginning of a sentence."""
    begun = [each for each in layout.statements + layout.unfinished if each.start <= offset]
    inside = max((each for each in begun if offset <= each.end), default=None)
    before = max(begun, key=lambda each: each.end, default=None)
    if inside is None and before and "\n" not in text[before.end : offset]:
        inside = before
    return f"{_dotted(inside.path)}: " if inside else ""


def _given_twice(text: str, layout: Layout, noticed: int) -> tuple[int, str]:
    """tomllib notices a second definition where it ends; point at its key and name the line of the first."""
    second = next((each for each in layout.statements if each.end == noticed), None)
    if second is None:
        return noticed, "is given twice"
    earlier = [each for each in sorted(layout.statements) if each.start < second.start]
    same = [each for each in earlier if each.path[: len(second.path)] == second.path]
    above = [each for each in earlier if second.path[: len(each.path)] == each.path]
    first = next(iter(same or above[::-1]), second)
    return (
        second.start,
        f"{_dotted(second.path)}: is given twice, first in line {_line_and_column(text, first.start)[0]}",
    )


# Content

WRONG_TYPE = {
    "bool_type": "must be true or false",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be a text in quotes",
    "list_type": "must be an array in [ ]",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "finite_number": "must be a finite number",
}
UNITS = {
    "mm_per_px": "mm per px",
    **{unit: unit for unit in ("mm", "um", "px", "deg", "s", "ms", "us", "days")},
    "pct": "%",
    "db": "dB",
    "mb": "MB",
}
BOUNDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
THOUSANDTH = {"mm": "um", "s": "ms", "ms": "us"}


def _offset_of(error: ErrorDetails, layout: Layout) -> int:
    """Of the key when it is unknown, of its table's header when it is missing, else of its value."""
    path: KeyPath = error["loc"]
    if error["type"] == "missing":
        path = path[:-1]
    while path and path not in layout.spots:
        path = path[:-1]
    if not path:
        return 0
    return layout.spots[path].key if error["type"] == "extra_forbidden" else layout.spots[path].value


def _sentence(error: ErrorDetails, model: type[Settings]) -> str:
    kind, path, context = error["type"], error["loc"], error.get("ctx", {})
    if kind == "missing":
        return _missing(_field(model, path))
    if kind == "extra_forbidden":
        return _unknown(model, path)
    if kind in ("contradiction", "value_error"):
        said = str(context.get("said") or context.get("error"))
    elif kind == "literal_error":
        said = f"must be {context['expected']}".replace("'", '"')
    elif context.keys() & BOUNDS.keys():
        said = _range(error, _field(model, path))
    else:
        said = WRONG_TYPE.get(kind, error["msg"][:1].lower() + error["msg"][1:])
    return said if isinstance(error["input"], Settings) else f"{said} (got {_shown(error['input'])})"


def _missing(field: FieldInfo | None) -> str:
    if field and _table(field.annotation):
        return "this table is missing"
    return f"is missing: {field.description}" if field and field.description else "is missing"


def _unknown(model: type[Settings], path: KeyPath) -> str:
    name, table = str(path[-1]), _table_at(model, path[:-1])
    if table and (close := difflib.get_close_matches(name, table.model_fields, n=1)):
        return f"is not known here; did you mean {close[0]}?"
    homes = [where for where, other in _tables(model) if name in other.model_fields]
    return f"is not known here; it belongs in {' or '.join(homes)}" if homes else "is not known here"


def _range(error: ErrorDetails, field: FieldInfo | None) -> str:
    """Both bounds with the unit, and what unit the value may have been given in."""
    bounds: dict[str, float] = {name: error["ctx"][name] for name in BOUNDS if name in error["ctx"]}
    for constraint in field.metadata if field else ():
        bounds |= {name: getattr(constraint, name) for name in BOUNDS if hasattr(constraint, name)}
    name = next((str(part) for part in reversed(error["loc"]) if isinstance(part, str)), "")
    unit = next((unit for unit in UNITS if name.endswith(f"_{unit}") or name == unit), "")
    said = " and ".join(f"{word} {bounds[name]:g}" for name, word in BOUNDS.items() if name in bounds)
    hint = f", is it in {THOUSANDTH[unit]}?" if unit in THOUSANDTH and _thousandfold(error["input"], bounds) else ""
    return f"must be {said} {UNITS.get(unit, '')}".rstrip() + hint


def _thousandfold(value: float, bounds: dict[str, float]) -> bool:
    """Far above the bounds, but well within them as thousandths."""
    lowest = bounds.get("ge", bounds.get("gt", -math.inf))
    highest = bounds.get("le", bounds.get("lt", math.inf))
    return value >= 10 * highest and lowest <= value / 1000 <= highest


def _table(annotation: Any) -> type[Settings] | None:
    """The table that a field holds, also as elements of an array."""
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        return annotation
    return next(filter(None, map(_table, get_args(annotation))), None)


def _field(model: type[Settings], path: KeyPath) -> FieldInfo | None:
    names = [part for part in path if isinstance(part, str)]
    table = _table_at(model, tuple(names[:-1]))
    return table.model_fields.get(names[-1]) if table and names else None


def _table_at(model: type[Settings], path: KeyPath) -> type[Settings] | None:
    table: type[Settings] | None = model
    for name in path:
        if isinstance(name, str):
            field = table.model_fields.get(name) if table else None
            table = _table(field.annotation) if field else None
    return table


def _tables(model: type[Settings], where: str = "") -> Iterator[tuple[str, type[Settings]]]:
    """All tables of a model with their headers."""
    yield f"[{where}]" if where else "the top of the file, before all tables", model
    for name, field in model.model_fields.items():
        if table := _table(field.annotation):
            yield from _tables(table, f"{where}.{name}" if where else name)


def _dotted(path: KeyPath) -> str:
    """The path as in TOML, with the numbers of array elements counted from 0."""
    return ".".join(str(part) if re.fullmatch(r"[A-Za-z0-9_-]+", str(part)) else json.dumps(part)[:60] for part in path)


def _shown(value: object) -> str:
    """A value as it would stand in the file, shortened."""
    if isinstance(value, dict):
        return "a table"
    shown = json.dumps(value, ensure_ascii=False) if isinstance(value, bool | str) else str(value)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."
