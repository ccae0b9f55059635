"""The journal's file: its schema, how it is opened, and what its errors mean. Who writes into it is in journal.py.

SQLite with a write-ahead log. `synchronous=FULL` makes every commit wait until the disk has it, so what a call has
returned from survives a power cut.
"""

import contextlib
import fcntl
import os
import sqlite3
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from cellctl.faults import RecordLost

FILE_NAME = "journal.db"
CHECK_WITHIN_S = 1.0
BUSY_S = 2.0

T = TypeVar("T")

SCHEMA_1 = """
CREATE TABLE session (
    serial INTEGER PRIMARY KEY,
    began_ms INTEGER NOT NULL,
    boot_id TEXT NOT NULL,
    ended_ms INTEGER
) STRICT;
CREATE TABLE unit (
    serial INTEGER PRIMARY KEY AUTOINCREMENT,
    unit TEXT NOT NULL UNIQUE,
    session INTEGER NOT NULL REFERENCES session,
    began_ms INTEGER NOT NULL,
    recipe TEXT NOT NULL,
    recipe_hash TEXT NOT NULL,
    arrival_sequence INTEGER NOT NULL,
    carrier_id INTEGER NOT NULL,
    calibration TEXT NOT NULL CHECK (json_valid(calibration))
) STRICT;
CREATE TABLE step (
    serial INTEGER PRIMARY KEY,
    unit_serial INTEGER NOT NULL REFERENCES unit,
    at_ms INTEGER NOT NULL,
    number INTEGER NOT NULL CHECK (number BETWEEN 0 AND 9),
    name TEXT NOT NULL,
    event TEXT NOT NULL CHECK (event IN ('intent', 'done')),
    data TEXT NOT NULL CHECK (json_valid(data))
) STRICT;
CREATE INDEX step_of_unit ON step (unit_serial);
CREATE TABLE record (
    unit_serial INTEGER PRIMARY KEY REFERENCES unit,
    ended_ms INTEGER NOT NULL,
    verdict TEXT NOT NULL CHECK (verdict IN ('placed', 'rejected', 'removed', 'lost')),
    fault TEXT,
    sentence TEXT NOT NULL,
    cycle_s REAL,
    base_dx_mm REAL, base_dy_mm REAL, base_dt_deg REAL,
    battery_dx_mm REAL, battery_dy_mm REAL, battery_dt_deg REAL,
    predicted_mm REAL,
    pictures TEXT NOT NULL CHECK (json_valid(pictures)),
    data TEXT NOT NULL CHECK (json_valid(data))
) STRICT;
CREATE INDEX record_by_verdict ON record (verdict);
CREATE TRIGGER record_is_final BEFORE UPDATE ON record
    BEGIN SELECT RAISE(ABORT, 'a final record is never changed'); END;
CREATE TRIGGER record_stays BEFORE DELETE ON record
    BEGIN SELECT RAISE(ABORT, 'a final record is never deleted'); END;
CREATE TRIGGER no_step_after_record BEFORE INSERT ON step
    WHEN EXISTS (SELECT 1 FROM record WHERE unit_serial = NEW.unit_serial)
    BEGIN SELECT RAISE(ABORT, 'the unit already has its final record'); END;
"""

MIGRATIONS: tuple[str, ...] = (SCHEMA_1,)
"""Number N turns schema N into schema N + 1. Once released, a migration is never edited; a new one is added."""


def lock(path: Path) -> int:
    """Keep every other daemon from this journal; the lock ends with the returned file descriptor.

    A file of its own, since closing any descriptor of the database would drop SQLite's own locks.
    """
    try:
        descriptor = os.open(f"{path}.lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
    except OSError as error:
        raise RecordLost(f"the journal {path} cannot be opened: {error.strerror}") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        owner = os.pread(descriptor, 20, 0).decode("ascii", "replace").strip() or "unknown"
        os.close(descriptor)
        raise RecordLost(f"another cellctl (process {owner}) writes the journal {path}; stop that one first") from None
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, f"{os.getpid()}\n".encode("ascii"), 0)
    return descriptor


def connect(path: Path, migrations: Sequence[str] = MIGRATIONS) -> sqlite3.Connection:
    """The writing connection: whole file checked, schema brought up to date, commits durable. Raises RecordLost."""
    connection = _translated(
        path, lambda: sqlite3.connect(path, isolation_level=None, timeout=BUSY_S, check_same_thread=False)
    )
    try:
        _translated(path, lambda: _prepare(connection, path, migrations))
    except RecordLost:
        connection.close()
        raise
    return connection


def _prepare(connection: sqlite3.Connection, path: Path, migrations: Sequence[str]) -> None:
    for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        connection.execute(f"PRAGMA {pragma}")
    _check(connection, path)
    _migrate(connection, path, migrations)


def _check(connection: sqlite3.Connection, path: Path) -> None:
    """Read the pages through; a file too large to be read in time is checked as far as the time allows."""
    until_s = time.monotonic() + CHECK_WITHIN_S
    connection.set_progress_handler(lambda: time.monotonic() > until_s, 20_000)
    try:
        (finding,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    except sqlite3.OperationalError as error:
        if error.sqlite_errorcode != sqlite3.SQLITE_INTERRUPT:
            raise
        finding = "ok"
    finally:
        connection.set_progress_handler(None, 0)
    if finding != "ok":
        raise RecordLost(_damaged(path, str(finding).splitlines()[-1]))


def _migrate(connection: sqlite3.Connection, path: Path, migrations: Sequence[str]) -> None:
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version > len(migrations):
        raise RecordLost(
            f"the journal {path} has schema {version}, this cellctl knows up to {len(migrations)}; "
            "install the newer cellctl again or use another state folder"
        )
    if 0 < version < len(migrations):
        _back_up(connection, Path(f"{path}.schema-{version}"))
    for number in range(version, len(migrations)):
        connection.executescript(f"BEGIN IMMEDIATE; {migrations[number]} PRAGMA user_version = {number + 1}; COMMIT;")


def _back_up(connection: sqlite3.Connection, copy: Path) -> None:
    copy.unlink(missing_ok=True)
    connection.execute("VACUUM INTO ?", (str(copy),))


def transaction(connection: sqlite3.Connection, path: Path, job: Callable[[sqlite3.Connection], T]) -> T:
    """Carry `job` out in one durable transaction, whole or not at all. Raises RecordLost."""

    def carry_out() -> T:
        connection.execute("BEGIN IMMEDIATE")
        try:
            result = job(connection)
            connection.execute("COMMIT")
        finally:
            if connection.in_transaction:
                with contextlib.suppress(sqlite3.Error):
                    connection.execute("ROLLBACK")
        return result

    return _translated(path, carry_out)


class DiskUncertain(Exception):
    """Cause of a RecordLost after which nobody knows what the disk holds; the journal writes no more."""


def _translated(path: Path, job: Callable[[], T]) -> T:
    try:
        return job()
    except sqlite3.Error as error:
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        cause = DiskUncertain(str(error)) if code == sqlite3.SQLITE_IOERR else error
        raise RecordLost(_sentence(path, code, error)) from cause


def _sentence(path: Path, code: int, error: sqlite3.Error) -> str:
    name = getattr(error, "sqlite_errorname", type(error).__name__)
    disk = f"the disk with the journal {path}"
    sentences = {
        sqlite3.SQLITE_FULL: f"{disk} is full, nothing was recorded; make room",
        sqlite3.SQLITE_IOERR: f"{disk} reports an error ({name}), what it holds is uncertain; check the disk",
        sqlite3.SQLITE_READONLY: f"the journal {path} is read-only; give cellctl the right to write it",
        sqlite3.SQLITE_CANTOPEN: f"the journal {path} cannot be opened; its folder must exist and be writable",
        sqlite3.SQLITE_BUSY: f"another program has locked the journal {path} for over {BUSY_S:g} s; end it",
        sqlite3.SQLITE_CORRUPT: _damaged(path, str(error)),
        sqlite3.SQLITE_NOTADB: _damaged(path, str(error)),
    }
    return sentences.get(code, f"the journal {path} refused the entry: {error} ({name})")


def _damaged(path: Path, finding: str) -> str:
    return (
        f"the journal {path} is damaged ({finding}); keep a copy for analysis, "
        f"then move {path.name}* out of {path.parent} to begin a new one"
    )


def move_aside(path: Path) -> Path:
    """Put the journal's files aside, to begin a new one. Only on a person's request. Returns the new name."""
    aside = Path(f"{path}.aside-{time.strftime('%Y%m%dT%H%M%S')}")
    for suffix in ("", "-wal", "-shm"):
        with contextlib.suppress(FileNotFoundError):
            os.replace(f"{path}{suffix}", f"{aside}{suffix}")
    return aside
