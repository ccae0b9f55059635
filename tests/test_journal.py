"""The journal, judged by what another connection, another process or the next start finds in the file."""

import asyncio
import csv
import io
import json
import os
import re
import resource
import shutil
import sqlite3
import sys
import threading
import time
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cellctl import journal, journal_file
from cellctl.desk import records
from cellctl.faults import RecordLost
from cellctl.journal import Journal, Record, Verdict

UNIT = {"recipe": "a52", "recipe_hash": "f" * 64, "arrival_sequence": 7, "carrier_id": 3, "calibration_ids": {"c": "1"}}
PLACED = Record(verdict=Verdict.PLACED, sentence="placed")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.db"


@pytest.fixture(autouse=True)
def no_thread_is_left():
    yield
    until_s = time.monotonic() + 2
    while any(thread.name.startswith("journal") for thread in threading.enumerate()):
        assert time.monotonic() < until_s
        time.sleep(0.01)


def rows(path: Path, query: str) -> list[tuple]:
    connection = sqlite3.connect(f"file:{path}?mode=ro", uri=True)
    try:
        return connection.execute(query).fetchall()
    finally:
        connection.close()


def content_of(path: Path) -> bytes:
    return path.read_bytes()


def spoil_second_half(path: Path) -> bytes:
    content = bytearray(path.read_bytes())
    content[len(content) // 2 :] = os.urandom(len(content) - len(content) // 2)
    path.write_bytes(content)
    return bytes(content)


async def test_a_unit_is_written_step_by_step_and_read_back_by_another_connection(path: Path):
    log = await Journal.open(path)
    unit = await log.begin_unit(**UNIT)
    await log.step(unit, 4, "fetch battery", "intent", {"x_mm": 200.123456789})
    await log.step(unit, 4, "fetch battery", "done")
    before = records.units(path)
    record = Record(
        verdict=Verdict.REJECTED,
        sentence="no base",
        fault="V1",
        cycle_s=5.25,
        base_dx_mm=-0.003,
        predicted_mm=0.0123,
        pictures=("a.png",),
        data={"steps_ms": {"4 fetch": 31.5}},
    )
    await log.finish_unit(unit, record)

    assert [(row["unit"], row["verdict"], row["ended"]) for row in before] == [(unit, "open", None)]
    (row,) = records.units(path)
    assert (row["verdict"], row["fault"], row["cycle_s"], row["base_dx_mm"], row["base_dy_mm"]) == (
        "rejected", "V1", 5.25, -0.003, None,
    )  # fmt: skip
    assert (row["pictures"], row["data"], row["calibration"]) == (
        ["a.png"],
        {"steps_ms": {"4 fetch": 31.5}},
        {"c": "1"},
    )
    assert rows(path, "SELECT event, data FROM step ORDER BY serial") == [
        ("intent", '{"x_mm":200.123456789}'),
        ("done", "{}"),
    ]
    await log.close()


async def test_unit_ids_name_the_day_and_their_number_always_grows(path: Path, monkeypatch: pytest.MonkeyPatch):
    log = await Journal.open(path)
    first = await log.begin_unit(**UNIT)
    monkeypatch.setattr(journal.time, "strftime", lambda _format: "19700101")  # the clock is set back
    second = await log.begin_unit(**UNIT)
    await log.close()
    log = await Journal.open(path)
    third = await log.begin_unit(**UNIT)
    await log.close()

    assert re.fullmatch(r"20\d{6}-000001", first)
    assert (second, third) == ("19700101-000002", "19700101-000003")
    assert [row["unit"] for row in records.units(path)] == [first, second, third]


async def test_a_unit_has_exactly_one_final_record(path: Path):
    log = await Journal.open(path)
    unit = await log.begin_unit(**UNIT)
    await log.finish_unit(unit, PLACED)
    with pytest.raises(RecordLost, match="already has its final record"):
        await log.finish_unit(unit, Record(verdict=Verdict.LOST, sentence="again"))
    with pytest.raises(RecordLost, match="already has its final record"):
        await log.step(unit, 6, "place", "done")
    await log.close()

    assert rows(path, "SELECT verdict, sentence FROM record") == [("placed", "placed")]
    connection = sqlite3.connect(path)
    for change in ("UPDATE record SET verdict = 'lost'", "DELETE FROM record"):
        with pytest.raises(sqlite3.IntegrityError, match="a final record is never"):
            connection.execute(change)
    connection.close()


async def test_a_unit_that_was_never_begun_is_refused(path: Path):
    log = await Journal.open(path)
    with pytest.raises(RecordLost, match="20200101-000001 was never begun"):
        await log.finish_unit("20200101-000001", PLACED)
    with pytest.raises(RecordLost, match="never begun"):
        await log.step("20200101-000001", 1, "bring base", "intent")
    await log.close()


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
async def test_numbers_that_are_none_never_reach_a_record(path: Path, bad: float):
    with pytest.raises(ValueError, match="base_dx_mm must be a finite number"):
        Record(verdict=Verdict.PLACED, sentence="", base_dx_mm=bad)
    log = await Journal.open(path)
    unit = await log.begin_unit(**UNIT)
    with pytest.raises(ValueError, match="not JSON compliant"):
        await log.step(unit, 1, "bring base", "intent", {"x_mm": bad})
    await log.close()


async def test_a_clean_stop_is_known_at_the_next_start(path: Path):
    first = await Journal.open(path)
    assert first.clean
    await first.close()
    second = await Journal.open(path)
    assert second.clean
    await second.close(clean=False)
    third = await Journal.open(path)
    assert not third.clean
    await third.close()


KILLED = """
import asyncio, sys
from pathlib import Path
from cellctl.journal import Journal

async def main():
    log = await Journal.open(Path(sys.argv[1]))
    while True:
        unit = await log.begin_unit(recipe="a52", recipe_hash="f", arrival_sequence=1, carrier_id=2, calibration_ids={})
        print("begun", unit, flush=True)
        await log.step(unit, 4, "fetch battery", "intent", {"x_mm": 1.5})
        print("step", unit, flush=True)
        await asyncio.sleep(60)

asyncio.run(main())
"""


async def test_a_killed_daemon_leaves_its_unit_open_with_every_step_it_had_written(path: Path):
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", KILLED, str(path), stdout=asyncio.subprocess.PIPE
    )
    assert process.stdout is not None
    unit = (await process.stdout.readline()).decode().split()[1]
    assert (await process.stdout.readline()).decode().split() == ["step", unit]
    process.kill()
    await process.wait()

    log = await Journal.open(path)
    (found,) = log.interrupted
    assert not log.clean
    assert (found.unit, found.recipe, found.carrier_id, found.last_words) == (
        unit,
        "a52",
        2,
        "4 fetch battery (intent)",
    )
    assert found.steps[0].data == {"x_mm": 1.5}
    assert [closed.unit for closed in await log.close_interrupted("the daemon was killed")] == [unit]
    assert await log.close_interrupted("again") == ()
    (row,) = records.units(path)
    assert row["verdict"] == "lost"
    assert row["sentence"] == "the daemon was killed (the unit had got to: 4 fetch battery (intent))"
    await log.close()


async def test_a_cancelled_call_is_still_written_before_any_later_one(path: Path):
    log = await Journal.open(path)
    unit = await log.begin_unit(**UNIT)
    for number in range(1, 7):
        task = asyncio.create_task(log.step(unit, number, "step", "intent"))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    await log.finish_unit(unit, PLACED)

    assert rows(path, "SELECT number FROM step ORDER BY serial") == [(number,) for number in range(1, 7)]
    await log.close()


async def test_a_unit_whose_beginning_was_cancelled_can_be_closed(path: Path):
    log = await Journal.open(path)
    task = asyncio.create_task(log.begin_unit(**UNIT))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert [unit.last_words for unit in await log.open_units()] == ["begun"]
    assert len(await log.close_interrupted("stopped")) == 1
    await log.close()


async def test_two_daemons_never_write_the_same_journal(path: Path):
    log = await Journal.open(path)
    with pytest.raises(RecordLost, match=rf"another cellctl \(process {os.getpid()}\) writes .* stop that one first"):
        await Journal.open(path)
    await log.close()
    again = await Journal.open(path)
    await again.close()


async def test_a_full_disk_refuses_the_entry_whole_and_goes_on_after_room_was_made(path: Path):
    log = await Journal.open(path)
    unit = await log.begin_unit(**UNIT)
    assert log._connection is not None
    (pages,) = log._connection.execute("PRAGMA page_count").fetchone()
    log._connection.execute(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(RecordLost, match="is full, nothing was recorded; make room"):
        await log.finish_unit(unit, Record(verdict=Verdict.PLACED, sentence="x" * 100_000))
    assert records.units(path)[0]["verdict"] == "open"
    log._connection.execute("PRAGMA max_page_count = 1000000")
    await log.finish_unit(unit, PLACED)
    await log.close()


async def test_no_unit_is_begun_on_a_disk_that_cannot_hold_its_end(path: Path, monkeypatch: pytest.MonkeyPatch):
    log = await Journal.open(path)
    usage = shutil.disk_usage(path.parent)._replace(free=10 * 2**20)
    monkeypatch.setattr(journal.shutil, "disk_usage", lambda _folder: usage)
    with pytest.raises(RecordLost, match="has 10 MB left, a unit is begun only with 64 MB"):
        await log.begin_unit(**UNIT)
    assert records.units(path) == []
    await log.close()


async def test_after_a_disk_error_nothing_more_is_written(path: Path):
    """The kernel refuses to let the file grow, which SQLite reports as an I/O error."""
    log = await Journal.open(path)
    unit = await log.begin_unit(**UNIT)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(content_of(Path(f"{path}-wal"))), hard))
    try:
        with pytest.raises(RecordLost, match=r"reports an error \(SQLITE_IOERR_WRITE\), what it holds is uncertain"):
            await log.finish_unit(unit, PLACED)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    with pytest.raises(RecordLost, match="what it holds is uncertain"):
        await log.finish_unit(unit, PLACED)
    await log.close()

    log = await Journal.open(path)
    assert not log.clean
    assert [found.unit for found in log.interrupted] == [unit]
    await log.close()


async def test_a_disk_that_does_not_answer_is_not_waited_for_and_not_trusted_again(
    path: Path, monkeypatch: pytest.MonkeyPatch
):
    log = await Journal.open(path)
    answers = threading.Event()
    log._executor.submit(answers.wait)
    monkeypatch.setattr(journal, "WRITE_WITHIN_S", 0.05)
    with pytest.raises(RecordLost, match=r"did not answer within 0.05 s; check it"):
        await log.begin_unit(**UNIT)
    answers.set()
    with pytest.raises(RecordLost, match="did not answer"):
        await log.begin_unit(**UNIT)
    monkeypatch.setattr(journal, "WRITE_WITHIN_S", 5.0)
    await log.close()


async def test_what_waits_for_the_disk_is_bounded(path: Path):
    log = await Journal.open(path)
    unit = await log.begin_unit(**UNIT)
    answers = threading.Event()
    log._executor.submit(answers.wait)
    steps = [asyncio.create_task(log.step(unit, 1, "s", "intent")) for _ in range(journal.MOST_WAITING)]
    await asyncio.sleep(0)
    with pytest.raises(RecordLost, match="too slow: 64 entries wait"):
        await log.step(unit, 1, "one too many", "intent")
    answers.set()
    await asyncio.gather(*steps)
    await log.close()
    assert rows(path, "SELECT count(*) FROM step") == [(64,)]


async def test_a_damaged_file_is_refused_and_put_aside_only_on_request(path: Path):
    log = await Journal.open(path)
    for _ in range(20):
        await log.finish_unit(await log.begin_unit(**UNIT), Record(verdict=Verdict.PLACED, sentence="s" * 2000))
    await log.close()
    content = spoil_second_half(path)
    with pytest.raises(RecordLost, match=r"is damaged \(.*move journal\.db\* out of"):
        await Journal.open(path)
    assert content_of(path) == content
    log = await Journal.open(path, put_old_aside=True)
    assert log.interrupted == ()
    await log.close()
    (aside,) = path.parent.glob("journal.db.aside-*[0-9]")
    assert content_of(aside) == content


@given(content=st.binary(min_size=1, max_size=4000))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_file_is_either_opened_or_refused_with_a_sentence(tmp_path_factory: pytest.TempPathFactory, content: bytes):
    path = tmp_path_factory.mktemp("any") / "journal.db"
    path.write_bytes(content)

    async def use_it() -> None:
        log = await Journal.open(path)
        await log.begin_unit(**UNIT)
        await log.close()
        assert len(records.units(path)) == 1

    if refused := refusal_of(use_it):
        assert str(path) in refused
        assert path.read_bytes() == content


def refusal_of(job: Callable[[], Coroutine[Any, Any, None]]) -> str | None:
    try:
        asyncio.run(job())
    except RecordLost as error:
        return str(error)
    return None


async def test_a_newer_schema_is_refused(path: Path):
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA user_version = 99")
    connection.close()
    with pytest.raises(RecordLost, match=r"has schema 99, this cellctl knows up to \d+; install the newer cellctl"):
        await Journal.open(path)


async def test_an_older_schema_is_migrated_and_a_copy_of_it_kept(path: Path):
    log = await Journal.open(path)
    unit = await log.begin_unit(**UNIT)
    await log.close()
    known = len(journal_file.MIGRATIONS)
    newer = (*journal_file.MIGRATIONS, "ALTER TABLE unit ADD COLUMN line TEXT;")
    journal_file.connect(path, newer).close()

    assert rows(path, "SELECT unit, line FROM unit") == [(unit, None)]
    assert rows(path, "PRAGMA user_version") == [(known + 1,)]
    assert rows(Path(f"{path}.schema-{known}"), "SELECT unit FROM unit") == [(unit,)]


async def test_a_migration_that_fails_leaves_the_file_as_it_was(path: Path):
    await (await Journal.open(path)).close()
    with pytest.raises(RecordLost, match="refused the entry"):
        journal_file.connect(path, (*journal_file.MIGRATIONS, "CREATE TABLE half (a); SELECT nonsense;"))
    assert rows(path, "SELECT count(*) FROM sqlite_schema WHERE name = 'half'") == [(0,)]
    await (await Journal.open(path)).close()


async def test_steps_of_old_units_are_forgotten_but_never_their_records(path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(journal, "STEPS_OF_LAST_UNITS", 2)
    log = await Journal.open(path)
    for _ in range(5):
        unit = await log.begin_unit(**UNIT)
        await log.step(unit, 1, "bring base", "done")
        await log.finish_unit(unit, PLACED)
    assert rows(path, "SELECT unit_serial FROM step") == [(4,), (5,)]
    assert await log.counts() == {Verdict.PLACED: 5, Verdict.REJECTED: 0, Verdict.REMOVED: 0, Verdict.LOST: 0}
    await log.close()


async def test_a_closed_journal_refuses_and_may_be_closed_twice(path: Path):
    log = await Journal.open(path)
    await log.close()
    await log.close()
    with pytest.raises((RecordLost, RuntimeError)):
        await log.begin_unit(**UNIT)


async def test_a_folder_that_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(RecordLost, match=r"nowhere/journal.db cannot be opened: No such file"):
        await Journal.open(tmp_path / "nowhere" / "journal.db")


# -- reading back ------------------------------------------------------------------------------------------


async def test_records_are_filtered_and_exported(path: Path):
    log = await Journal.open(path)
    for verdict, fault in ((Verdict.PLACED, None), (Verdict.REJECTED, "V1"), (Verdict.PLACED, None)):
        unit = await log.begin_unit(**UNIT)
        await log.finish_unit(unit, Record(verdict=verdict, fault=fault, sentence='said "so",\nthus', cycle_s=5.0))
    await log.close()

    assert [row["unit"][-1] for row in records.units(path, last=2)] == ["2", "3"]
    assert [row["unit"][-1] for row in records.units(path, verdict="placed")] == ["1", "3"]
    assert [row["unit"][-1] for row in records.units(path, fault="V1")] == ["2"]
    assert [row["unit"][-1] for row in records.units(path, unit=unit, recipe="a52")] == ["3"]
    assert records.units(path, since_ms=10**15) == []

    text = io.StringIO()
    records.write_csv(records.units(path), text)
    table = list(csv.DictReader(io.StringIO(text.getvalue())))
    assert [row["verdict"] for row in table] == ["placed", "rejected", "placed"]
    assert table[0]["sentence"] == 'said "so",\nthus'
    assert json.loads(table[0]["calibration"]) == {"c": "1"}

    text = io.StringIO()
    records.write_json(records.units(path), text)
    assert [json.loads(line) for line in text.getvalue().splitlines()] == records.units(path)

    text = io.StringIO()
    records.write_table(records.units(path), text)
    assert "rejected  V1     5.00s" in text.getvalue()


async def test_records_are_read_while_the_daemon_writes(path: Path):
    log = await Journal.open(path)
    for done in range(5):
        assert len(records.units(path)) == done
        await log.finish_unit(await log.begin_unit(**UNIT), PLACED)
    await log.close()


def test_reading_says_that_there_is_no_journal(path: Path):
    with pytest.raises(RecordLost, match=r"there is no journal .* has the daemon run"):
        records.units(path)


def test_reading_something_else_says_so(path: Path):
    path.write_bytes(b"not a database at all" * 100)
    with pytest.raises(RecordLost, match="cannot be read: file is not a database"):
        records.units(path)
