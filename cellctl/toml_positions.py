"""Where in a TOML text each key and each value stands. Pure.

tomllib gives values without places. This scanner gives places without values: it walks over keys, tables, arrays
and inline tables and only skips over texts and numbers. It judges nothing, since tomllib does; on every document
that tomllib accepts it finds exactly tomllib's keys (a property test compares them).
"""

import re
import tomllib
from typing import NamedTuple

KeyPath = tuple[str | int, ...]

DEEPEST = 32
LONGEST_NUMBER = 400

BLANK = re.compile(r"(?:[ \t\n]++|#[^\n]*+)*+")
SPACE = re.compile(r"[ \t]*+")
KEY = re.compile(r"""[A-Za-z0-9_-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+'""")
NUMBER = re.compile(r"""[^\s,\[\]{}#"'=][^,\]}#\n]*+""")  # also dates, true, false
TEXTS = {
    '"""': re.compile(r'"""(?:[^"\\]++|\\.|"(?!""))*+"{3,5}', re.DOTALL),
    "'''": re.compile(r"'''(?:[^']++|'(?!''))*+'{3,5}"),
    '"': re.compile(r'"(?:[^"\\\n]|\\.)*+"'),
    "'": re.compile(r"'[^'\n]*+'"),
}


class Spot(NamedTuple):
    """Offsets of a key and of its value; the value of a table is its header, of an array element the element."""

    key: int
    value: int


class Statement(NamedTuple):
    """One `key = value` or one header; `end` is where it ends (a header: where its name ends)."""

    start: int
    path: KeyPath
    end: int


class Layout(NamedTuple):
    """What was found: every path, every statement, and, when the text could not be followed, where and why."""

    spots: dict[KeyPath, Spot]
    statements: list[Statement]
    stuck: int | None
    unfinished: list[Statement]
    too_much: str


class _Stuck(Exception):
    """The text cannot be followed from here on."""

    def __init__(self, offset: int, too_much: str = "") -> None:
        self.offset = offset
        self.too_much = too_much


def scan(text: str) -> Layout:
    """Find the places in a text with "\\n" line ends. Never raises; a broken text is followed as far as possible."""
    scanner = _Scanner(text)
    try:
        scanner.document()
    except _Stuck as stuck:
        return Layout(scanner.spots, scanner.statements, stuck.offset, scanner.unfinished, stuck.too_much)
    return Layout(scanner.spots, scanner.statements, None, [], "")


class _Scanner:
    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.table: KeyPath = ()
        self.spots: dict[KeyPath, Spot] = {}
        self.statements: list[Statement] = []
        self.unfinished: list[Statement] = []
        self.last_element: dict[KeyPath, int] = {}  # of arrays of tables

    def document(self) -> None:
        self.skip(BLANK)
        while self.at < len(self.text):
            if self.text[self.at] == "[":
                self.header()
            else:
                self.pair(self.table)
            self.skip(SPACE)
            if not self.text.startswith(("\n", "#"), self.at) and self.at < len(self.text):
                raise _Stuck(self.at)
            self.skip(BLANK)

    def header(self) -> None:
        start = self.at
        brackets = 2 if self.text.startswith("[[", start) else 1
        self.at += brackets
        names = self.names(start)
        path = self.mark((), names[:-1])
        name, key = names[-1]
        path = (*path, name)
        end = self.at
        if brackets == 2:
            self.spots.setdefault(path, Spot(key, start))
            self.last_element[path] = self.last_element.get(path, -1) + 1
            path = (*path, self.last_element[path])
        self.spots[path] = Spot(key if brackets == 1 else start, start)
        self.take("]" * brackets, start)
        self.statements.append(Statement(key, path, end))
        self.table = path

    def pair(self, table: KeyPath) -> None:
        names = self.names(self.at)
        name, key = names[-1]
        path = (*self.mark(table, names[:-1]), name)
        self.unfinished.append(Statement(key, path, len(self.text)))
        self.take("=", key)
        self.skip(SPACE)
        self.value(path, key)
        self.unfinished.pop()
        self.statements.append(Statement(key, path, self.at))

    def mark(self, path: KeyPath, names: list[tuple[str, int]]) -> KeyPath:
        """Enter tables that are only named on the way, and the newest element of arrays of tables."""
        for name, offset in names:
            path = (*path, name)
            self.spots.setdefault(path, Spot(offset, offset))
            if path in self.last_element:
                path = (*path, self.last_element[path])
        return path

    def names(self, start: int) -> list[tuple[str, int]]:
        """A dotted key: each name with its offset."""
        names: list[tuple[str, int]] = []
        while not names or self.text.startswith(".", self.at):
            self.at += bool(names)
            self.skip(SPACE)
            found = KEY.match(self.text, self.at)
            if found is None:
                raise _Stuck(start)
            names.append((_plain(found[0], self.at), self.at))
            self.at = found.end()
            self.skip(SPACE)
            if len(names) + len(self.table) > DEEPEST:
                raise _Stuck(start, f"tables are nested more than {DEEPEST} deep")
        return names

    def value(self, path: KeyPath, key: int) -> None:
        start = self.at
        if len(path) > DEEPEST:
            raise _Stuck(start, f"values are nested more than {DEEPEST} deep")
        self.spots[path] = Spot(key, start)
        if self.text.startswith(("[", "{"), start):
            self.container(path, self.text[start])
            return
        quotes = next((quotes for quotes in TEXTS if self.text.startswith(quotes, start)), None)
        found = (TEXTS[quotes] if quotes else NUMBER).match(self.text, start)
        if found is None:
            raise _Stuck(start if quotes else key)
        if quotes is None and len(found[0]) > LONGEST_NUMBER:
            raise _Stuck(start, f"the value has more than {LONGEST_NUMBER} characters")
        self.at = start + len(found[0].rstrip() if quotes is None else found[0])

    def container(self, path: KeyPath, bracket: str) -> None:
        """An array or an inline table, from bracket to bracket."""
        start, count, closing = self.at, 0, "]" if bracket == "[" else "}"
        self.at += 1
        self.skip(BLANK)
        while not self.text.startswith(closing, self.at):
            if bracket == "[":
                self.value((*path, count), self.at)
            else:
                self.pair(path)
            count += 1
            self.skip(BLANK)
            if not self.text.startswith(closing, self.at):
                self.take(",", start)
                self.skip(BLANK)
            if self.at == len(self.text):
                raise _Stuck(start)
        self.at += 1

    def skip(self, blank: re.Pattern[str]) -> None:
        found = blank.match(self.text, self.at)
        self.at = found.end() if found else self.at

    def take(self, expected: str, start: int) -> None:
        if not self.text.startswith(expected, self.at):
            raise _Stuck(start)
        self.at += len(expected)


def _plain(raw: str, offset: int) -> str:
    """A key without its quotes and escapes."""
    if raw[0] not in "\"'":
        return raw
    try:
        return str(tomllib.loads(f"key={raw}")["key"])
    except tomllib.TOMLDecodeError:
        raise _Stuck(offset) from None
