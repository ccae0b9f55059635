"""The thread that writes the log, so that a slow disk or terminal never holds the event loop up."""

import contextlib
import json
import os
import queue
import threading
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import IO, NamedTuple, TextIO

from cellctl.lines import operator_line

MOST_WAITING = 10_000
CLOSE_WITHIN_S = 2.0


class Entry(NamedTuple):
    """One event, for people and for machines."""

    line: str
    json: str


def entry_of(event: Mapping[str, object]) -> Entry:
    """Both forms of one event."""
    text = json.dumps(event, default=str, skipkeys=True, ensure_ascii=False, separators=(",", ":"))
    return Entry(operator_line(event), text)


def now_text() -> str:
    """The wall clock's time for people and records; never used to measure or to order."""
    return datetime.now().astimezone().isoformat(timespec="milliseconds")


def _own_warning(text: str) -> Entry:
    return entry_of({"time": now_text(), "level": "warning", "logger": "log", "event": text})


class LogWriter:
    """Writes entries in order, lines to a stream and JSON to a file that is put aside when it has grown.

    The files are PATH, then PATH.1 (the newest put aside) to PATH.<keep>. When more than MOST_WAITING entries wait,
    new ones are dropped, and a line says how many. A disk that refuses the file costs the file, not the lines.
    """

    def __init__(self, path: Path | None, stream: TextIO, *, rotate_bytes: int, keep: int) -> None:
        self._path = path
        self._stream = stream
        self._rotate_bytes = rotate_bytes
        self._keep = keep
        self._file: IO[bytes] | None = None
        self._complained = False
        self._dropped = 0
        self._counting = threading.Lock()
        self._entries: queue.Queue[Entry | None] = queue.Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._write_all, name="log", daemon=True)
        self._thread.start()

    def put(self, entry: Entry) -> None:
        """Hand an entry over; returns at once, from any thread."""
        try:
            self._entries.put_nowait(entry)
        except queue.Full:
            with self._counting:
                self._dropped += 1

    def close(self) -> None:
        """Write what waits, as far as stream and disk allow within CLOSE_WITHIN_S, and end the thread."""
        with contextlib.suppress(queue.Full):
            self._entries.put(None, timeout=CLOSE_WITHIN_S)
        self._thread.join(CLOSE_WITHIN_S)

    def _write_all(self) -> None:
        while (entry := self._entries.get()) is not None:
            self._write(entry)
            if self._entries.empty():
                self._confess()
        self._confess()
        if self._file is not None:
            self._file.close()

    def _confess(self) -> None:
        with self._counting:
            dropped, self._dropped = self._dropped, 0
        if dropped:
            self._write(_own_warning(f"{dropped} log entries were lost: stream or disk is too slow"))

    def _write(self, entry: Entry) -> None:
        self._say(entry.line)
        if self._path is None:
            return
        try:
            self._append(self._path, entry.json.encode("utf-8", "replace") + b"\n")
            self._complained = False
        except OSError as error:
            self._file = None
            if not self._complained:
                self._complained = True
                text = f"the log file {self._path} cannot be written: {error.strerror}; make room, check its folder"
                self._say(_own_warning(text).line)

    def _say(self, line: str) -> None:
        with contextlib.suppress(OSError, ValueError):  # nobody reads any more: a closed pipe, terminal or test
            self._stream.write(line + "\n")
            self._stream.flush()

    def _append(self, path: Path, data: bytes) -> None:
        if self._file is not None and self._file.tell() + len(data) > self._rotate_bytes:
            self._file.close()
            self._file = None
            self._put_aside(path)
        if self._file is None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("ab", buffering=0)
        self._file.write(data)

    def _put_aside(self, path: Path) -> None:
        for number in range(self._keep, 0, -1):
            older = path if number == 1 else Path(f"{path}.{number - 1}")
            with contextlib.suppress(FileNotFoundError):
                os.replace(older, f"{path}.{number}")
