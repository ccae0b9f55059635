"""What the cell intends and has done, durable before it goes on: one row per unit, its steps, one final record.

All writing happens in one thread, one durable transaction per call. A call that is cancelled is still written,
whole, before any later call; only its caller no longer waits. A call that fails left nothing behind, except when the
sentence says that the disk is uncertain; from then on the journal refuses to write.
"""

import asyncio
import functools
import json
import math
import os
import shutil
import sqlite3
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from enum import StrEnum
from pathlib import Path
from typing import Literal, NamedTuple, Self, TypeVar

from cellctl.faults import RecordLost
from cellctl.journal_file import DiskUncertain, connect, lock, move_aside, transaction

WRITE_WITHIN_S = 5.0
OPEN_WITHIN_S = 30.0
MOST_WAITING = 64
FREE_FOR_A_UNIT = 64 * 2**20
STEPS_OF_LAST_UNITS = 10_000

T = TypeVar("T")
StepEvent = Literal["intent", "done"]


class Verdict(StrEnum):
    """How a unit ended. Every unit ends in exactly one of them."""

    PLACED = "placed"
    REJECTED = "rejected"
    REMOVED = "removed"  # by a person
    LOST = "lost"  # interrupted; the sentence says by what


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """The final record of a unit; what was not measured is None. `data` is whatever else is worth keeping, as JSON."""

    verdict: Verdict
    sentence: str
    fault: str | None = None
    cycle_s: float | None = None
    base_dx_mm: float | None = None
    base_dy_mm: float | None = None
    base_dt_deg: float | None = None
    battery_dx_mm: float | None = None
    battery_dy_mm: float | None = None
    battery_dt_deg: float | None = None
    predicted_mm: float | None = None
    pictures: tuple[str, ...] = ()
    data: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in (item.name for item in fields(self)):
            value = getattr(self, name)
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"{name} must be a finite number or None (got {value})")


class Step(NamedTuple):
    """One line of a unit's journal."""

    at_ms: int  # Unix time
    number: int
    name: str
    event: StepEvent
    data: dict[str, object]


@dataclass(frozen=True, slots=True)
class OpenUnit:
    """A unit that was begun and has no final record yet."""

    unit: str
    recipe: str
    recipe_hash: str
    arrival_sequence: int
    carrier_id: int
    began_ms: int  # Unix time
    steps: tuple[Step, ...]

    @property
    def last_words(self) -> str:
        """Where it got to, for people: "5 place (intent)"."""
        if not self.steps:
            return "begun"
        last = self.steps[-1]
        return f"{last.number} {last.name} ({last.event})"


class Journal:
    """The one writer of a journal file. Made by `open`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.clean = False  # the last daemon said goodbye and left no unit open
        self.interrupted: tuple[OpenUnit, ...] = ()  # the open units found by `open`
        self._executor = ThreadPoolExecutor(max_workers=1, thread_name_prefix="journal")
        self._waiting = 0
        self._closed = False
        self._broken: str | None = None
        self._connection: sqlite3.Connection | None = None
        self._lock: int | None = None
        self._session = 0

    @classmethod
    async def open(cls, path: Path, *, put_old_aside: bool = False) -> Self:
        """Lock, check, migrate. `put_old_aside` begins a new file, on a person's request. Raises RecordLost."""
        journal = cls(path)
        opened = False
        try:
            await journal._ask(functools.partial(journal._open, put_old_aside), OPEN_WITHIN_S)
            opened = True
        finally:
            if not opened:
                await journal.close(clean=False)
        return journal

    async def close(self, *, clean: bool = True) -> None:
        """Finish what is waiting and let the file go. `clean` = the cell was brought to rest. May be called twice."""
        if self._closed:
            return
        self._closed = True
        try:
            await self._ask(functools.partial(self._close, clean), WRITE_WITHIN_S, even_if_broken=True)
        finally:
            self._executor.shutdown(wait=False)

    async def begin_unit(
        self,
        *,
        recipe: str,
        recipe_hash: str,
        arrival_sequence: int,
        carrier_id: int,
        calibration_ids: Mapping[str, str],
    ) -> str:
        """Begin a unit and return its id, such as "20261122-000123"; the number always grows.

        Raises RecordLost, also when the disk has no room left to finish a unit.
        """
        calibration = _json(calibration_ids)

        def job(connection: sqlite3.Connection) -> str:
            self._room_for_a_unit()
            row = (self._session, _now_ms(), recipe, recipe_hash, arrival_sequence, carrier_id, calibration)
            return _insert_unit(connection, row)

        return await self._write(job)

    async def step(
        self,
        unit: str,
        number: int,
        name: str,
        event: StepEvent,
        data: Mapping[str, object] | None = None,
    ) -> None:
        """Write down that a step is about to be done, or is done. Raises RecordLost."""
        row = (_now_ms(), number, name, event, _json(data or {}))

        def job(connection: sqlite3.Connection) -> None:
            connection.execute(
                "INSERT INTO step (unit_serial, at_ms, number, name, event, data) VALUES (?, ?, ?, ?, ?, ?)",
                (_serial_of(connection, unit), *row),
            )

        await self._write(job)

    async def finish_unit(self, unit: str, record: Record) -> None:
        """Write the final record. A second one for the same unit is refused. Raises RecordLost."""
        values = _record_values(record)
        await self._write(lambda connection: _insert_record(connection, unit, values))

    async def open_units(self) -> tuple[OpenUnit, ...]:
        """The units that have no final record. Raises RecordLost."""
        return await self._write(_open_units)

    async def close_interrupted(self, reason: str, verdict: Verdict = Verdict.LOST) -> tuple[OpenUnit, ...]:
        """Give every open unit its final record, and say which they were. Raises RecordLost."""

        def job(connection: sqlite3.Connection) -> tuple[OpenUnit, ...]:
            units = _open_units(connection)
            for unit in units:
                sentence = f"{reason} (the unit had got to: {unit.last_words})"
                record = Record(verdict=verdict, sentence=sentence, data={"interrupted": True})
                _insert_record(connection, unit.unit, _record_values(record))
            return units

        return await self._write(job)

    async def counts(self) -> dict[Verdict, int]:
        """How many units ended with each verdict, over the life of the file. Raises RecordLost."""
        return await self._write(_counts)

    async def _write(self, job: Callable[[sqlite3.Connection], T]) -> T:
        def in_thread() -> T:
            if self._connection is None:
                raise RecordLost(f"the journal {self.path} is closed")
            return transaction(self._connection, self.path, job)

        return await self._ask(in_thread, WRITE_WITHIN_S)

    async def _ask(self, job: Callable[[], T], within_s: float, *, even_if_broken: bool = False) -> T:
        """Run `job` in the writer thread, after all earlier ones; being cancelled does not undo it."""
        if self._broken and not even_if_broken:
            raise RecordLost(self._broken)
        if self._waiting >= MOST_WAITING:
            raise RecordLost(f"the disk with the journal {self.path} is too slow: {self._waiting} entries wait")
        self._waiting += 1
        future = asyncio.get_running_loop().run_in_executor(self._executor, job)
        future.add_done_callback(self._is_done)
        try:
            return await asyncio.wait_for(asyncio.shield(future), within_s)
        except TimeoutError:
            self._broken = f"the disk with the journal {self.path} did not answer within {within_s:g} s; check it"
            raise RecordLost(self._broken) from None

    def _is_done(self, future: asyncio.Future[T]) -> None:
        self._waiting -= 1
        error = None if future.cancelled() else future.exception()
        if error is not None and isinstance(error.__cause__, DiskUncertain):
            self._broken = str(error)

    # ------------------------------------------------------------------------------- in the writer thread

    def _open(self, put_old_aside: bool) -> None:
        self._lock = lock(self.path)
        if put_old_aside:
            move_aside(self.path)
        self._connection = connect(self.path)
        transaction(self._connection, self.path, self._begin_session)

    def _begin_session(self, connection: sqlite3.Connection) -> None:
        last = connection.execute("SELECT ended_ms FROM session ORDER BY serial DESC LIMIT 1").fetchone()
        self.interrupted = _open_units(connection)
        self.clean = (last is None or last[0] is not None) and not self.interrupted
        boot_id = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
        row = connection.execute("INSERT INTO session (began_ms, boot_id) VALUES (?, ?)", (_now_ms(), boot_id))
        self._session = row.lastrowid or 0

    def _close(self, clean: bool) -> None:
        connection, self._connection = self._connection, None
        try:
            if connection is not None:
                self._end_session(connection, clean)
        finally:
            if self._lock is not None:
                os.close(self._lock)
                self._lock = None

    def _end_session(self, connection: sqlite3.Connection, clean: bool) -> None:
        try:
            if clean and not self._broken:
                end = "UPDATE session SET ended_ms = ? WHERE serial = ?"
                transaction(connection, self.path, lambda file: file.execute(end, (_now_ms(), self._session)))
        finally:
            connection.close()

    def _room_for_a_unit(self) -> None:
        free = shutil.disk_usage(self.path.parent).free
        if free < FREE_FOR_A_UNIT:
            least = FREE_FOR_A_UNIT // 2**20
            raise RecordLost(
                f"the disk with the journal {self.path} has {free // 2**20} MB left, a unit is begun "
                f"only with {least} MB; make room"
            )


def _insert_unit(connection: sqlite3.Connection, row: tuple[int | str, ...]) -> str:
    (last,) = connection.execute("SELECT coalesce(max(serial), 0) FROM unit").fetchone()
    # The number alone decides the order: the wall clock may jump, the number may not.
    unit = f"{time.strftime('%Y%m%d')}-{last + 1:06d}"
    connection.execute("INSERT INTO unit VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", (last + 1, unit, *row))
    return unit


def _serial_of(connection: sqlite3.Connection, unit: str) -> int:
    row = connection.execute("SELECT serial FROM unit WHERE unit = ?", (unit,)).fetchone()
    if row is None:
        raise RecordLost(f"unit {unit} was never begun")
    return int(row[0])


def _record_values(record: Record) -> dict[str, str | float | None]:
    values = {item.name: getattr(record, item.name) for item in fields(record)}
    return values | {
        "ended_ms": _now_ms(),
        "verdict": record.verdict.value,
        "pictures": json.dumps(record.pictures),
        "data": _json(record.data),
    }


def _insert_record(connection: sqlite3.Connection, unit: str, values: dict[str, str | float | None]) -> None:
    serial = _serial_of(connection, unit)
    if connection.execute("SELECT 1 FROM record WHERE unit_serial = ?", (serial,)).fetchone():
        raise RecordLost(f"unit {unit} already has its final record")
    names, marks = ", ".join(values), ", ".join(f":{name}" for name in values)
    connection.execute(
        f"INSERT INTO record (unit_serial, {names}) VALUES (:unit_serial, {marks})",
        {"unit_serial": serial, **values},
    )
    # The record says it all; single steps are kept as long as somebody may still ask how a unit came about.
    connection.execute("DELETE FROM step WHERE unit_serial <= ?", (serial - STEPS_OF_LAST_UNITS,))


def _open_units(connection: sqlite3.Connection) -> tuple[OpenUnit, ...]:
    rows = connection.execute(
        "SELECT unit, recipe, recipe_hash, arrival_sequence, carrier_id, began_ms, serial FROM unit "
        "WHERE serial NOT IN (SELECT unit_serial FROM record) ORDER BY serial"
    ).fetchall()
    return tuple(
        OpenUnit(unit, recipe, recipe_hash, arrival, carrier, began_ms, _steps(connection, serial))
        for unit, recipe, recipe_hash, arrival, carrier, began_ms, serial in rows
    )


def _steps(connection: sqlite3.Connection, serial: int) -> tuple[Step, ...]:
    rows = connection.execute(
        "SELECT at_ms, number, name, event, data FROM step WHERE unit_serial = ? ORDER BY serial", (serial,)
    )
    return tuple(Step(at_ms, number, name, event, json.loads(data)) for at_ms, number, name, event, data in rows)


def _counts(connection: sqlite3.Connection) -> dict[Verdict, int]:
    rows = dict(connection.execute("SELECT verdict, count(*) FROM record GROUP BY verdict").fetchall())
    return {verdict: rows.get(verdict.value, 0) for verdict in Verdict}


def _json(data: Mapping[str, object]) -> str:
    """Raises ValueError for nan and inf, TypeError for what JSON cannot hold: the caller's mistakes, not the disk's."""
    return json.dumps(dict(data), allow_nan=False, ensure_ascii=False, separators=(",", ":"))


def _now_ms() -> int:
    return time.time_ns() // 1_000_000
