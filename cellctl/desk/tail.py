"""Reading the log file back: the last lines, and what comes after them, over rotation and restarts."""

import json
import os
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from cellctl.lines import operator_line

LOOK_EVERY_S = 0.2


class NoLog(Exception):
    """There is no log file; the text says where it should be."""


class Choice:
    """Which entries are wanted, and how they are shown."""

    def __init__(self, *, unit: str | None = None, as_json: bool = False) -> None:
        self._unit = unit
        self._as_json = as_json

    def shown(self, line: bytes) -> str | None:
        """The line as it is printed, or None when it is not wanted. A line that is no JSON is shown as it is."""
        text = line.decode("utf-8", "replace").rstrip("\n")
        if self._unit is not None and self._unit not in text:
            return None
        try:
            event = json.loads(text)
        except ValueError:
            event = None
        if not isinstance(event, dict):
            return None if self._unit is not None else text
        if self._unit is not None and event.get("unit") != self._unit:
            return None
        return text if self._as_json else operator_line(event)


def tail(path: Path, choice: Choice, *, lines: int, follow: bool) -> Iterator[str]:
    """The last `lines` wanted lines; then, with `follow`, every new one until the caller stops. Raises NoLog."""
    if not follow and not path.exists():
        raise NoLog(f"there is no log file {path}; has the daemon run with this configuration")
    wanted: deque[str] = deque(maxlen=lines)
    log = _Growing(path)
    try:
        log.reopen()
        earlier = _put_aside(path, choice, lines)
        wanted.extend(earlier)
        wanted.extend(text for line in log.new_lines() if (text := choice.shown(line)) is not None)
        yield from wanted
        while follow:
            for line in log.new_lines():
                if (text := choice.shown(line)) is not None:
                    yield text
            time.sleep(LOOK_EVERY_S)
    finally:
        log.close()


def _put_aside(path: Path, choice: Choice, lines: int) -> list[str]:
    """The last wanted lines of the files that were put aside; reads back only as many files as it needs."""
    found: list[str] = []
    number = 1
    while len(found) < lines and (older := Path(f"{path}.{number}")).exists():
        with older.open("rb") as file:
            shown = deque((text for line in file if (text := choice.shown(line)) is not None), maxlen=lines)
        found = [*shown, *found]
        number += 1
    return found[-lines:]


class _Growing:
    """A file that is written by somebody else, may be put aside by a rename, and may not be there yet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: IO[bytes] | None = None
        self._rest = b""

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def reopen(self) -> None:
        """The file that has the name now, from its beginning."""
        self.close()
        self._rest = b""
        try:
            self._file = self._path.open("rb")
        except FileNotFoundError:
            self._file = None

    def new_lines(self) -> Iterator[bytes]:
        """Every whole line that was written since the last call."""
        if self._file is not None:
            replaced = self._is_replaced(self._file)  # looked at first: then what is read now is all of it
            yield from self._whole_lines(self._file)
            if not replaced:
                return
        self.reopen()
        if self._file is not None:
            yield from self._whole_lines(self._file)

    def _whole_lines(self, file: IO[bytes]) -> Iterator[bytes]:
        for piece in file:
            self._rest += piece
            if self._rest.endswith(b"\n"):
                line, self._rest = self._rest, b""
                yield line

    def _is_replaced(self, file: IO[bytes]) -> bool:
        mine = os.fstat(file.fileno())
        if mine.st_size < file.tell():
            return True
        try:
            named = self._path.stat()
        except FileNotFoundError:
            return False  # put aside, the new one is not there yet
        return (named.st_dev, named.st_ino) != (mine.st_dev, mine.st_ino)
