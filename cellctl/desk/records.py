"""Reading the unit records beside the running daemon, and handing them on as CSV or JSON lines."""

import contextlib
import csv
import json
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Literal, TextIO
from urllib.parse import quote

from cellctl.faults import RecordLost

READ_WITHIN_S = 5.0
LOOKED_BACK_UNITS = 5000  # units of other recipes since the last one of a golden assembly; else its drift is forgotten

MEASURES = (
    "base_dx_mm",
    "base_dy_mm",
    "base_dt_deg",
    "battery_dx_mm",
    "battery_dy_mm",
    "battery_dt_deg",
    "predicted_mm",
)
ENDING = ("unit", "began", "ended", "verdict", "fault", "sentence", "cycle_s")
ORIGIN = ("recipe", "recipe_hash", "arrival_sequence", "carrier_id")
NESTED = ("calibration", "pictures", "data")
COLUMNS = ENDING + MEASURES + ORIGIN + NESTED
TIMES = ("began", "ended")

Unit = dict[str, object]
"""One unit by COLUMNS: times as local ISO text, lengths in mm, angles in degrees; verdict "open" without a record."""

_QUERY = (
    "SELECT unit, began_ms, ended_ms, coalesce(verdict, 'open'), fault, sentence, cycle_s, "
    f"{', '.join(MEASURES)}, {', '.join(ORIGIN)}, "
    "calibration, coalesce(pictures, '[]'), coalesce(data, '{}') "
    "FROM unit LEFT JOIN record ON unit_serial = serial"
)
_FILTERS = {
    "unit": "unit = ?",
    "verdict": "coalesce(verdict, 'open') = ?",
    "fault": "fault = ?",
    "recipe": "recipe = ?",
    "since_ms": "began_ms >= ?",
}


def units(path: Path, *, last: int = 20, **filters: str | int) -> list[Unit]:
    """The newest `last` units, oldest first. Filters: unit, verdict, fault, recipe, since_ms. Raises RecordLost."""
    where = " AND ".join(_FILTERS[name] for name in filters)
    query = f"{_QUERY} {'WHERE ' + where if where else ''} ORDER BY serial DESC LIMIT ?"
    with _reading(path) as connection:
        rows = connection.execute(query, (*filters.values(), last)).fetchall()
    return [_unit(row) for row in reversed(rows)]


def number_of(unit: str) -> int:
    """The number in a unit's id; it always grows."""
    return int(unit.rpartition("-")[2])


def latest_kept(path: Path, what: Literal["drift", "light"], of: str) -> tuple[int, str] | None:
    """Number of, and what was kept (JSON text) by, the newest unit that was made with a golden assembly.

    None when there is no such unit among the newest, or no journal yet. Raises RecordLost.
    """
    if not path.exists():
        return None
    query = (
        "SELECT unit_serial, json_extract(data, '$.' || ?1) FROM record "
        "WHERE unit_serial > (SELECT coalesce(max(serial), 0) - ?2 FROM unit) "
        "AND json_extract(data, '$.' || ?1 || '.of') = ?3 ORDER BY unit_serial DESC LIMIT 1"
    )
    with _reading(path) as connection:
        row = connection.execute(query, (what, LOOKED_BACK_UNITS, of)).fetchone()
    return None if row is None else (int(row[0]), str(row[1]))


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[sqlite3.Connection]:
    if not path.exists():
        raise RecordLost(f"there is no journal {path}; has the daemon run with this configuration")
    try:
        with contextlib.closing(_connect(path)) as connection:
            yield connection
    except sqlite3.Error as error:
        raise RecordLost(f"the journal {path} cannot be read: {error}") from error


def _connect(path: Path) -> sqlite3.Connection:
    """Read only. Without a writer and without the right to write, the file stands still and is read as it is."""
    address = f"file:{quote(str(path.resolve()))}?mode=ro"
    connection = sqlite3.connect(address, uri=True, timeout=READ_WITHIN_S)
    try:
        connection.execute("SELECT 1 FROM unit LIMIT 1").fetchone()
    except sqlite3.OperationalError as error:
        connection.close()
        if error.sqlite_errorcode != sqlite3.SQLITE_CANTOPEN or Path(f"{path}-wal").exists():
            raise
        return sqlite3.connect(f"{address}&immutable=1", uri=True, timeout=READ_WITHIN_S)
    return connection


def _unit(row: Sequence[object]) -> Unit:
    unit: Unit = dict(zip(COLUMNS, row, strict=True))
    for name in TIMES:
        unit[name] = _local(unit[name])
    for name in NESTED:
        unit[name] = json.loads(str(unit[name]))
    return unit


def _local(at_ms: object) -> str | None:
    if not isinstance(at_ms, int):
        return None
    return datetime.fromtimestamp(at_ms / 1000).astimezone().isoformat(timespec="milliseconds")


def write_csv(rows: Iterable[Unit], stream: TextIO) -> None:
    """One line per unit under a header; nested columns as JSON text."""
    writer = csv.DictWriter(stream, COLUMNS)
    writer.writeheader()
    for row in rows:
        writer.writerow({name: json.dumps(row[name]) if name in NESTED else row[name] for name in COLUMNS})


def write_json(rows: Iterable[Unit], stream: TextIO) -> None:
    """One JSON object per line and unit."""
    for row in rows:
        stream.write(json.dumps(row, ensure_ascii=False) + "\n")


def write_table(rows: Iterable[Unit], stream: TextIO) -> None:
    """For people: one line per unit."""
    stream.write(f"{'unit':<16} {'ended':<19} {'verdict':<8}  fault  cycle  p99 um  base dX dY dT, battery dX dY dT\n")
    for row in rows:
        ended = str(row["ended"] or "-")[:19].replace("T", " ")
        cycle = f"{row['cycle_s']:5.2f}s" if isinstance(row["cycle_s"], float) else f"{'-':>6}"
        predicted = f"{1000 * row['predicted_mm']:6.1f}" if isinstance(row["predicted_mm"], float) else f"{'-':>6}"
        stream.write(
            f"{row['unit']:<16} {ended:<19} {row['verdict']:<8}  {row['fault'] or '-':<5} {cycle}  {predicted}  "
            f"{_offset(row, 'base')}, {_offset(row, 'battery')}\n"
        )


def _offset(row: Unit, part: str) -> str:
    values = [row[f"{part}_{axis}"] for axis in ("dx_mm", "dy_mm", "dt_deg")]
    return " ".join(f"{value:+.3f}" if isinstance(value, float) else "-" for value in values)
