"""Settings files are read strictly, and every mistake is named at its place."""

import os
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import Field

from cellctl.strict_toml import LARGEST_FILE, MOST_LINES, Settings, SettingsError, load
from cellctl.toml_positions import scan


class Hole(Settings):
    depth_mm: float = Field(ge=0.5, le=9, description="How deep the hole is")
    count: int = Field(default=1, gt=0)
    side: Literal["left", "right"] = "left"

    def contradictions(self):
        if self.side == "right" and self.count > 3:
            yield "count", "must be at most 3 on the right"


class Plate(Settings):
    name: str = ""
    flat: bool = True
    settle_s: float = Field(default=0.1, ge=0, le=2)
    times_s: list[Annotated[float, Field(gt=0, le=5)]] = Field(default=[])
    main: Hole = Hole(depth_mm=1)
    holes: list[Hole] = Field(default=[])

    def contradictions(self):
        if self.name == "deep" and self.main.depth_mm < 5:
            yield "main.depth_mm", "is not deep"


@pytest.fixture
def refused(tmp_path: Path) -> Callable[..., list[str]]:
    """Load a text that must be refused; the lines come back without the file's name."""

    def refused(text: str | bytes) -> list[str]:
        path = tmp_path / "plate.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        with pytest.raises(SettingsError) as caught:
            load(path, Plate)
        assert all(line.startswith(f"{path}:") for line in caught.value.lines)
        assert str(caught.value) == "\n".join(caught.value.lines)
        return [line.removeprefix(f"{path}:") for line in caught.value.lines]

    return refused


@pytest.fixture
def accepted(tmp_path: Path) -> Callable[..., Plate]:
    def accepted(text: str | bytes) -> Plate:
        path = tmp_path / "plate.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return load(path, Plate)

    return accepted


# One mistake each


def test_an_unknown_key_is_refused_with_a_suggestion(refused):
    lines = refused('name = "a"\n[main]\ndepth_mm = 1\n  dept_mm = 2\n')
    assert lines == ["4:3: main.dept_mm: is not known here; did you mean depth_mm?"]


def test_a_key_in_the_wrong_table_is_sent_to_the_right_one(refused):
    assert refused("depth_mm = 1\n") == ["1:1: depth_mm: is not known here; it belongs in [main] or [holes]"]
    assert refused("[main]\ndepth_mm = 1\nflat = true\n") == [
        "3:1: main.flat: is not known here; it belongs in the top of the file, before all tables"
    ]


def test_an_unknown_table_is_refused_at_its_name(refused):
    assert refused("[main]\ndepth_mm = 1\n\n[ zzz ]\n") == ["4:3: zzz: is not known here"]


@pytest.mark.parametrize("word", ["nan", "inf", "-inf", "+nan", "1e999"])
def test_nan_and_infinity_are_refused(refused, word):
    (line,) = refused(f"[main]\ndepth_mm = {word}\n")
    assert line.startswith("2:12: main.depth_mm: must be a finite number (got ")


def test_a_value_out_of_range_is_refused_with_both_bounds_and_the_unit(refused):
    assert refused("[main]\ndepth_mm = 12\n") == ["2:12: main.depth_mm: must be at least 0.5 and at most 9 mm (got 12)"]


def test_a_value_that_would_fit_in_a_smaller_unit_is_asked_about(refused):
    assert refused("[main]\ndepth_mm = 3000\n") == [
        "2:12: main.depth_mm: must be at least 0.5 and at most 9 mm, is it in um? (got 3000)"
    ]
    assert refused("settle_s = 50\n") == ["1:12: settle_s: must be at least 0 and at most 2 s, is it in ms? (got 50)"]


def test_an_open_bound_is_named_as_such(refused):
    assert refused("[main]\ndepth_mm = 1\ncount = 0") == ["3:9: main.count: must be above 0 (got 0)"]


def test_a_missing_key_points_at_its_tables_header_and_tells_its_meaning(refused):
    assert refused("flat = true\n\n  [main]\ncount = 2\n") == ["3:3: main.depth_mm: is missing: How deep the hole is"]


def test_a_missing_key_of_an_inline_table_points_at_its_brace(refused):
    assert refused("main = { count = 2 }\n") == ["1:8: main.depth_mm: is missing: How deep the hole is"]


def test_a_missing_key_of_an_array_element_points_at_that_element(refused):
    text = "[[holes]]\ndepth_mm = 1\n[[holes]]\ncount = 2\n"
    assert refused(text) == ["3:1: holes.1.depth_mm: is missing: How deep the hole is"]


def test_a_missing_table_is_reported_at_the_top_of_the_file(tmp_path):
    class Strict(Settings):
        main: Hole

    (tmp_path / "a.toml").write_text("# nothing\n")
    with pytest.raises(SettingsError, match=r"a\.toml:1:1: main: this table is missing$"):
        load(tmp_path / "a.toml", Strict)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("name = 3", "1:8: name: must be a text in quotes (got 3)"),
        ("flat = 1", "1:8: flat: must be true or false (got 1)"),
        ('settle_s = "0.1"', '1:12: settle_s: must be a number (got "0.1")'),
        ("settle_s = true", "1:12: settle_s: must be a number (got true)"),
        ("[main]\ndepth_mm=1\ncount = 1.0", "3:9: main.count: must be a whole number (got 1.0)"),
        ("main = 3", "1:8: main: must be a table (got 3)"),
        ("[times_s]", "1:1: times_s: must be an array in [ ] (got a table)"),
        ('[main]\ndepth_mm=1\nside = "lft"', '3:8: main.side: must be "left" or "right" (got "lft")'),
        ("settle_s = 2020-01-01", "1:12: settle_s: must be a number (got 2020-01-01)"),
    ],
)
def test_a_wrong_type_is_refused_in_words_of_toml(refused, text, line):
    assert refused(text) == [line]


def test_a_long_value_is_shortened(refused):
    (line,) = refused(f'flat = "{"x" * 500}"')
    assert len(line) < 120


def test_an_element_of_an_array_is_pointed_at(refused):
    assert refused("times_s = [\n  1, # one\n  2,\n    7.5,\n]\n") == ["4:5: times_s.2: must be at most 5 s (got 7.5)"]


def test_values_that_do_not_fit_together_are_refused_at_the_right_key(refused):
    assert refused('[[holes]]\ndepth_mm = 1\nside = "right"\ncount = 4\n') == [
        "4:9: holes.0.count: must be at most 3 on the right (got 4)"
    ]
    assert refused('name = "deep"\n[main]\ndepth_mm = 4\n') == ["3:12: main.depth_mm: is not deep (got 4.0)"]


def test_all_mistakes_of_a_file_come_at_once_in_the_order_of_its_lines(refused):
    lines = refused('nam = "a"\nsettle_s = 9\n[main]\ndepth_mm = 99\nside = "right"\ncount = 0\n[other]\n')
    assert [line.split(": ")[0] for line in lines] == ["1:1", "2:12", "4:12", "6:9", "7:2"]


def test_a_file_full_of_mistakes_does_not_flood_the_screen(refused):
    lines = refused("".join(f"k{number} = 1\n" for number in range(300)))
    assert len(lines) == MOST_LINES + 1
    assert lines[-1] == f" and {300 - MOST_LINES} more mistakes"


# Syntax


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("flat = true\nflat = false", "2:1: flat: is given twice, first in line 1"),
        ("flat = true\nflat = false\n[main]\n", "2:1: flat: is given twice, first in line 1"),
        ("flat = true\nflat = [\n1,\n2]\n", "2:1: flat: is given twice, first in line 1"),
        ("[main]\ncount = 1\n\n [main]\n", "4:3: main: is given twice, first in line 1"),
        ("main.count = 1\n[main]\n", "2:2: main: is given twice, first in line 1"),
        ("main = 1\n[main.deep]\n", "2:7: main.deep: is given twice, first in line 1"),
        ("main = {}\nmain.count = 1", "2:6: main.count: is given twice, first in line 1"),
        ("main = {count = 1, count = 2}", "1:20: main.count: is given twice, first in line 1"),
        ("[[holes]]\n[holes]\n", "2:2: holes: is given twice, first in line 1"),
    ],
)
def test_a_second_definition_is_refused_with_the_line_of_the_first(refused, text, line):
    assert refused(text) == [line]


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('\nname = "abc\nflat = true', "2:8: name: this text has no closing quote"),
        ("\nname = 'abc", "2:8: name: this text has no closing quote"),
        ('name = """abc\n\n', "1:8: name: this text has no closing quote"),
        ("times_s = [1, 2\n\n", "1:11: times_s: this bracket is not closed"),
        ("times_s = [[1], [2\n\n", "1:17: times_s: this bracket is not closed"),
        ("main = { count = 1", "1:8: main: this bracket is not closed"),
        ("flat = true\n[main", "2:1: this bracket is not closed"),
        ("flat", "1:1: flat: expected '=' after a key in a key/value pair"),
        ("flat =", "1:1: flat: invalid value"),
        (
            "name = abc",
            "1:8: name: is not a value: texts stand in quotes, numbers begin with a digit",
        ),
        ("settle_s = 0,5", "1:13: settle_s: a number has a decimal point, not a comma"),
        ("settle_s = 1 2", "1:14: settle_s: expected newline or end of document after a statement"),
        (r'name = "\q"', r"1:11: name: unescaped '\' in a string"),
        ("main = {count = 1} 2", "1:20: main: expected newline or end of document after a statement"),
        ("= 1", "1:1: invalid statement"),
        ("flat = true\rname", "1:12: flat: expected newline or end of document after a statement"),
    ],
)
def test_broken_syntax_is_refused_where_it_is_broken(refused, text, line):
    assert refused(text) == [line]


def test_extreme_nesting_and_endless_numbers_are_refused_in_words(refused):
    assert refused("times_s = " + "[" * 5000) == ["1:43: times_s: values are nested more than 32 deep"]
    assert refused("a." * 5000 + "b = 1") == ["1:1: tables are nested more than 32 deep"]
    assert refused("settle_s = " + "9" * 5000) == ["1:12: settle_s: the value has more than 400 characters"]


# What TOML allows


@pytest.mark.parametrize(
    "text",
    [
        "main.depth_mm = 10\nmain.count = 2",
        '"main"."depth_mm" = 10',
        "'main' . \"depth\\u005fmm\" = 10",
        "main = { depth_mm = 10, count = 2 }",
        "[main]\ndepth_mm = 10",
        '[ "main" ] # a comment = 3\n\tdepth_mm=10',
    ],
)
def test_dotted_quoted_and_inline_keys_are_found(refused, text):
    (line,) = refused(text)
    row, column = map(int, line.split(":")[:2])
    assert text.splitlines()[row - 1][column - 1 :].startswith("10")
    assert "main.depth_mm: must be at least" in line


def test_multi_line_texts_do_not_confuse_the_positions(refused):
    text = 'name = """\n[main]\n"quoted" \\""" = 3\n\\"""" # end\n[main]\ndepth_mm = 10\n'
    assert refused(text) == ["6:12: main.depth_mm: must be at least 0.5 and at most 9 mm (got 10)"]
    text = "name = '''\n# no comment ''\n''''' \n[main]\ndepth_mm = 10\n"
    assert refused(text) == ["5:12: main.depth_mm: must be at least 0.5 and at most 9 mm (got 10)"]


def test_windows_line_ends_and_byte_order_marks_count_as_nothing(refused, accepted):
    assert refused(b"\xef\xbb\xbfflat = 1\r\n\r\n[main]\r\ndepth_mm = 10\r\n") == [
        "1:8: flat: must be true or false (got 1)",
        "4:12: main.depth_mm: must be at least 0.5 and at most 9 mm (got 10)",
    ]
    assert accepted(b"\xef\xbb\xbfname = 'a'\r\n").name == "a"


def test_columns_count_characters_not_bytes(refused):
    assert refused('main = { "größe" = 1, depth_mm = 1 }') == ['1:10: main."gr\\u00f6\\u00dfe": is not known here']
    assert refused('main = { side = "лево", depth_mm = 10 }')[1].startswith("1:36: main.depth_mm: ")


def test_a_whole_number_is_welcome_where_a_fraction_is_meant(accepted):
    assert accepted("settle_s = 1").settle_s == 1.0


def test_what_was_read_cannot_be_changed(accepted):
    with pytest.raises(ValueError, match="frozen"):
        accepted("settle_s = 1").settle_s = 2


# Files


def test_files_that_cannot_be_settings_are_refused_in_one_sentence(refused, tmp_path):
    assert refused(b"# " + b"x" * LARGEST_FILE) == [
        f" is larger than {LARGEST_FILE} bytes, this is not a settings file"
    ]
    assert refused(b"flat = true\nname = '\xff'") == ["2:9: is not UTF-8 text (byte 0xff); save it as UTF-8"]
    assert refused("flat = true".encode("utf-16")) == ["1:1: is not UTF-8 text (byte 0xff); save it as UTF-8"]
    os.mkfifo(tmp_path / "pipe")
    for name, said in {
        "absent.toml": ": there is no such file",
        "absent/a.toml": ": there is no such file",
        ".": ": is a folder, not a file",
        "pipe": ": is not a regular file",
        "plate.toml/a.toml": ": cannot be read: Not a directory",
        "nul\0": "': is not the name of a file",
    }.items():
        with pytest.raises(SettingsError, match=re.escape(said) + "$"):
            load(tmp_path / name, Plate)


def test_an_empty_file_is_a_valid_document(accepted):
    assert accepted("") == Plate()


# Properties: the scanner against tomllib, and against a writer that knows where it wrote


def paths(value: object, path: tuple = ()) -> set[tuple]:
    below = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return {path}.union(*(paths(inner, (*path, key)) for key, inner in below))


NAMES = st.one_of(
    st.text("abcXYZ019_-", min_size=1, max_size=5),
    st.text(st.characters(codec="utf-8", exclude_characters="\x7f"), max_size=4),
)
SCALARS = st.sampled_from(
    [
        *re.findall(r"\S+", "1 -17 +1_000 0xDEAD_beef 0o17 0b1 1.5 -0.1e-3 6.02E+23 inf -nan true false"),
        *re.findall(r"\S+", "1979-05-27 07:32:00.5 1979-05-27T07:32:00Z"),
        "1979-05-27 07:32:00",
        "1979-05-27T00:32:00.999-07:00",
        '""',
        '"a # b"',
        '"größe 电池"',
        r'"\"]\\"',
        r"'C:\'",
        "'\"#,]}'",
        '""""""',
        "''''''",
        '"""\n"a" ""b\\\n  \\"""#]"""""',
        "'''\n['a']\n''='''''",
    ]
)
GAPS = st.sampled_from(["", " ", "\t", "  "])
BREAKS = st.sampled_from(["", " ", "\n", " # ]},=\n\t", "\n\n  "])


class Writer:
    """Writes TOML and notes where; the independent witness of the positions."""

    def __init__(self, draw) -> None:
        self.draw = draw
        self.text = ""
        self.keys: dict[tuple, int] = {}
        self.values: dict[tuple, int] = {}

    def write(self, text: str | st.SearchStrategy[str]) -> None:
        self.text += text if isinstance(text, str) else self.draw(text)

    def name(self, name: str) -> None:
        bare = re.fullmatch(r"[A-Za-z0-9_-]+", name)
        plain = not re.search(r"[\x00-\x1f']", name)
        how = self.draw(st.sampled_from(["basic"] + ["bare"] * bool(bare) + ["literal"] * plain))
        escaped = "".join(f"\\U{ord(c):08x}" if c in '"\\' or c < " " else c for c in name)
        self.write({"bare": name, "literal": f"'{name}'", "basic": f'"{escaped}"'}[how])

    def pair(self, table: tuple, name: str, depth: int) -> None:
        path = (*table, name)
        for dotted in self.draw(st.lists(NAMES, max_size=2)) if depth else []:
            self.keys.setdefault(path, len(self.text))
            self.name(str(path[-1]))
            self.write(GAPS)
            self.write(".")
            self.write(GAPS)
            path = (*path, dotted)
        self.keys[path] = len(self.text)
        self.name(str(path[-1]))
        self.write(GAPS)
        self.write("=")
        self.write(GAPS)
        self.value(path, depth)

    def value(self, path: tuple, depth: int) -> None:
        self.values[path] = len(self.text)
        kind = self.draw(st.sampled_from(["scalar", "array", "inline"])) if depth else "scalar"
        if kind == "scalar":
            self.write(SCALARS)
            return
        gaps = BREAKS if kind == "array" else GAPS
        count = self.draw(st.integers(0, 3))
        names = self.draw(st.lists(NAMES, min_size=count, max_size=count, unique=True))
        self.write("[" if kind == "array" else "{")
        for index, name in enumerate(names):
            self.write("," if index else "")
            self.write(gaps)
            if kind == "array":
                self.keys[*path, index] = len(self.text)
                self.value((*path, index), depth - 1)
            else:
                self.pair(path, name, depth - 1)
            self.write(gaps)
        self.write("]" if kind == "array" else "}")

    def pairs(self, table: tuple, names: list[str]) -> None:
        for name in names:
            self.write(GAPS)
            self.pair(table, name, 2)
            self.write(st.sampled_from(["\n", " # a = 1\n", "\n\n"]))

    def header(self, written: list[str], path: tuple, *, array: bool) -> None:
        self.write(GAPS)
        start = len(self.text)
        self.write("[[" if array else "[")
        for index, name in enumerate(written):
            self.write("." if index else "")
            self.write(GAPS)
            key = len(self.text)
            self.name(name)
            self.write(GAPS)
        self.keys[path] = start if array else key
        self.values[path] = start
        self.write("]]\n" if array else "] # [x]\n")

    def section(self, name: str, names: list[str], elements: int) -> None:
        """A table with a sub-table (elements = 0), or an array of so many tables, each with a sub-array."""
        for index in range(max(1, elements)):
            path = (name, index) if elements else (name,)
            self.header([name], path, array=bool(elements))
            self.pairs(path, names[1:])
            for sub in range(2 if elements and names else len(names[:1])):
                below = (*path, names[0], sub) if elements else (*path, names[0])
                self.header([name, names[0]], below, array=bool(elements))
                self.pairs(below, names[:2])


@st.composite
def documents(draw) -> Writer:
    writer = Writer(draw)
    names = draw(st.lists(NAMES, max_size=6, unique=True))
    split = draw(st.integers(0, len(names)))
    writer.pairs((), names[:split])
    for name in names[split:]:
        writer.section(name, draw(st.lists(NAMES, max_size=3, unique=True)), draw(st.integers(0, 2)))
    return writer


@settings(max_examples=60, deadline=None)
@given(documents())
def test_every_key_and_value_of_a_document_is_found_where_it_was_written(writer):
    layout = scan(writer.text)
    assert layout.stuck is None
    assert set(layout.spots) == paths(tomllib.loads(writer.text)) - {()}
    assert {path: layout.spots[path].key for path in writer.keys} == writer.keys
    assert {path: layout.spots[path].value for path in writer.values} == writer.values


TOMLISH = st.text(st.sampled_from("[]{}=\"'#.,ab1- \t\n\\"), max_size=40)
PIECES = st.lists(
    st.sampled_from(
        [
            "a",
            "b",
            ".",
            "=",
            "1",
            "[",
            "]",
            "[[",
            "]]",
            "{",
            "}",
            ",",
            "\n",
            '"',
            '"""',
            "'''",
            "#",
            "a=1\n",
            "[a]\n",
            " ",
        ]
    ),
    max_size=25,
).map("".join)


@settings(max_examples=200, deadline=None)
@given(st.one_of(TOMLISH, PIECES))
@example('a="""""\\""""""')
@example("a=''''''''")
@example("[[a]]\n[[a.b]]\n[a.b.c]\n[[a]]\n[a.b]")
def test_the_scanner_never_fails_and_agrees_with_tomllib_on_whatever_it_accepts(text):
    layout = scan(text)
    assert all(0 <= offset <= len(text) for spot in layout.spots.values() for offset in spot)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    assert layout.stuck is None
    assert set(layout.spots) == paths(content) - {()}


GOOD = b"""name = "a"
times_s = [1, 2.5]
main = { depth_mm = 1.5, side = "left" }
[[holes]]
depth_mm = 3
"""


@st.composite
def damaged(draw) -> bytes:
    text = bytearray(GOOD)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(text)))
        text[at : at + draw(st.integers(0, 6))] = draw(st.binary(max_size=4))
    return bytes(text)


@settings(max_examples=200, deadline=None)
@given(st.one_of(st.binary(max_size=60), damaged(), TOMLISH.map(str.encode)))
@example(b"settle_s = " + b"9" * 399)
@example(b"settle_s = -1e999")
@example(b"main.count = " + b"9" * 50)
def test_whatever_a_file_holds_it_is_read_or_refused_with_a_place_inside_it(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "fuzz.toml"
    path.write_bytes(content)
    try:
        load(path, Plate)
    except SettingsError as error:
        rows = content.decode("utf-8", "replace").replace("\r\n", "\n").split("\n")
        for line in error.lines:
            row, column = map(int, re.match(rf"{re.escape(str(path))}:(\d+):(\d+): .", line).groups())
            assert 1 <= row <= len(rows)
            assert 1 <= column <= len(rows[row - 1]) + 1


def test_a_contradiction_is_also_found_without_a_file():
    with pytest.raises(ValueError, match="at most 3 on the right"):
        Hole(depth_mm=1, side="right", count=4)
