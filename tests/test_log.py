"""The log, judged by what stands in its file and on its stream, and by what the tail makes of them."""

import asyncio
import io
import json
import logging
import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import structlog
from hypothesis import given
from hypothesis import strategies as st

from cellctl import log_file
from cellctl.desk.tail import Choice, NoLog, tail
from cellctl.lines import operator_line
from cellctl.log import Log, StepTime, bind, bound, configure, log, step, trace


class Logged:
    """A log in a folder, and what came out of it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stream = io.StringIO()
        self.log: Log = configure(path, stream=self.stream)

    def end(self) -> tuple[list[str], list[dict]]:
        self.log.close()
        lines = self.path.read_text(encoding="utf-8").splitlines() if self.path.exists() else []
        return self.stream.getvalue().splitlines(), [json.loads(line) for line in lines]


@pytest.fixture
def logged(tmp_path: Path) -> Iterator[Logged]:
    logged = Logged(tmp_path / "log" / "cellctl.jsonl")
    yield logged
    logged.log.close()
    assert not any(thread.name == "log" for thread in threading.enumerate())
    assert structlog.contextvars.get_contextvars() == {}


def test_a_step_is_one_readable_line_with_its_unit_number_and_duration(logged: Logged):
    with bound(unit="20261122-000123"), step(3, "locate base") as found:
        found.text = "base dX -0.003 dY +0.115 mm dT -0.134 deg"
        found.data["residual_px"] = 0.04
        time.sleep(0.02)
    (line,), (entry,) = logged.end()

    assert re.fullmatch(
        r"\d\d:\d\d:\d\d\.\d{3} unit 20261122-000123 3 locate base +"
        r"base dX -0\.003 dY \+0\.115 mm dT -0\.134 deg \(\d+ ms\)",
        line,
    )
    assert (entry["unit"], entry["step"], entry["name"], entry["data"]) == (
        "20261122-000123", 3, "locate base", {"residual_px": 0.04},
    )  # fmt: skip
    assert 20 <= entry["took_ms"] < 500


def test_a_step_that_fails_says_so_and_lets_the_error_go_on(logged: Logged):
    with trace() as steps:
        with pytest.raises(ValueError, match="too small"), step(1, "bring base"):
            raise ValueError("the base is too small")
        with step(2, "start signal"):
            pass
    (failed, done), (entry, _) = logged.end()

    assert "1 bring base" in failed
    assert "WARNING failed: the base is too small (" in failed
    assert "2 start signal" in done
    assert (entry["outcome"], entry["error"]) == ("failed", "ValueError")
    assert [(time.number, time.name, time.outcome) for time in steps] == [
        (1, "bring base", "failed"),
        (2, "start signal", "done"),
    ]


def test_a_step_inside_the_handling_of_an_error_is_not_taken_for_a_failed_one(logged: Logged):
    try:
        raise ValueError
    except ValueError:
        with trace() as steps, step(4, "fetch battery"):
            pass
    assert steps[0].outcome == "done"
    logged.end()


async def test_a_cancelled_step_says_so(logged: Logged):
    with trace() as steps:

        async def work() -> None:
            with step(5, "look at battery"):
                await asyncio.sleep(60)

        task = asyncio.create_task(work())
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    (line,), _ = logged.end()

    assert "5 look at battery" in line
    assert "cancelled" in line
    assert [time.outcome for time in steps] == ["cancelled"]


async def test_steps_of_tasks_started_inside_are_in_the_trace_and_name_the_unit(logged: Logged):
    async def beside() -> None:
        with step(3, "locate base"):
            await asyncio.sleep(0)

    with bound(unit="u-1"), trace() as steps:
        async with asyncio.TaskGroup() as group:
            group.create_task(beside())
            with step(4, "fetch battery"):
                await asyncio.sleep(0)
    _, entries = logged.end()

    assert {(time.number, time.name) for time in steps} == {(3, "locate base"), (4, "fetch battery")}
    assert all(isinstance(time, StepTime) and time.took_ms >= 0 for time in steps)
    assert [entry["unit"] for entry in entries] == ["u-1", "u-1"]


def test_a_unit_bound_inside_a_step_outlives_the_step_but_not_the_block_around(logged: Logged):
    with bound():
        with step(1, "bring base"):
            bind(unit="u-2")
        log.info("after the step")
    log.info("after the unit")
    _, entries = logged.end()

    assert [(entry.get("unit"), entry.get("step")) for entry in entries] == [("u-2", 1), ("u-2", None), (None, None)]


def test_warnings_say_what_to_do(logged: Logged):
    log.warning("battery lost", remedy="Find the battery, then Unhold.", code="P3")
    log.info("state Held", why="hold by command")
    (warning, state), _ = logged.end()

    assert warning.endswith(
        "cell                                  WARNING battery lost -> Find the battery, then Unhold."
    )
    assert state.endswith("state Held: hold by command")


def test_loggers_of_libraries_come_in_on_one_line(logged: Logged, monkeypatch: pytest.MonkeyPatch):
    ours = [handler for handler in logging.getLogger().handlers if type(handler).__module__ == "cellctl.log"]
    monkeypatch.setattr(logging.getLogger(), "handlers", ours)
    logging.getLogger("other.library").warning("lost\n  the %s", "link")
    logging.getLogger("some.library").error("bad %d", "format")
    try:
        1 / 0  # noqa: B018
    except ZeroDivisionError:
        logging.getLogger("asyncio").exception("Task exception")
    lines, entries = logged.end()

    assert [line.split(" ", 1)[1].split()[0] for line in lines] == ["other.library", "some.library", "asyncio"]
    assert lines[0].endswith("WARNING lost the link")
    assert lines[1].endswith("ERROR bad %d")
    assert "ZeroDivisionError" in entries[2]["exception"]


def test_after_close_nothing_is_routed_any_more(logged: Logged):
    before = len(logging.getLogger().handlers)
    logged.log.close()
    assert len(logging.getLogger().handlers) == before - 1
    logged.log.close()


def test_what_is_below_the_level_is_not_written(tmp_path: Path):
    stream = io.StringIO()
    handle = configure(tmp_path / "l.jsonl", "warning", stream)
    log.info("quiet")
    log.warning("loud")
    handle.close()
    assert [line.split(" ", 1)[1].split() for line in stream.getvalue().splitlines()] == [["cell", "WARNING", "loud"]]


def test_the_file_is_put_aside_when_it_has_grown_and_only_so_many_are_kept(tmp_path: Path):
    path = tmp_path / "cellctl.jsonl"
    handle = configure(path, stream=io.StringIO(), rotate_mb=0.002, keep=2)
    for number in range(60):
        log.info("entry", number=number)
    handle.close()

    assert sorted(file.name for file in tmp_path.iterdir()) == ["cellctl.jsonl", "cellctl.jsonl.1", "cellctl.jsonl.2"]
    assert all(file.stat().st_size <= 2000 for file in tmp_path.iterdir())
    kept = [tmp_path / name for name in ("cellctl.jsonl.2", "cellctl.jsonl.1", "cellctl.jsonl")]
    numbers = [json.loads(line)["number"] for file in kept for line in file.read_text().splitlines()]
    assert numbers == list(range(numbers[0], 60))


def test_a_file_that_cannot_be_written_costs_one_warning_and_no_line(tmp_path: Path):
    (tmp_path / "file").write_text("in the way")
    stream = io.StringIO()
    handle = configure(tmp_path / "file" / "cellctl.jsonl", stream=stream)
    log.info("one")
    log.info("two")
    handle.close()

    first, warning, second = stream.getvalue().splitlines()
    assert first.endswith("one")
    assert re.search(r"WARNING the log file .*/file/cellctl\.jsonl cannot be written: .*; make room", warning)
    assert second.endswith("two")


class StuckStream(io.StringIO):
    """A terminal that nobody scrolls."""

    def __init__(self) -> None:
        super().__init__()
        self.goes_on = threading.Event()

    def write(self, text: str) -> int:
        self.goes_on.wait(10)
        return super().write(text)


def test_a_stuck_terminal_never_holds_up_whoever_logs_and_losses_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(log_file, "MOST_WAITING", 5)
    stream = StuckStream()
    handle = configure(tmp_path / "l.jsonl", stream=stream)
    began_s = time.monotonic()
    for number in range(50):
        log.info("entry", number=number)
    took_s = time.monotonic() - began_s
    stream.goes_on.set()
    handle.close()

    lines = stream.getvalue().splitlines()
    lost = int(re.search(r"WARNING (\d+) log entries were lost", lines[-1])[1])
    assert took_s < 1
    assert len(lines) - 1 + lost == 50
    assert lost >= 40


def test_a_closed_stream_is_no_reason_to_stop_logging_to_the_file(tmp_path: Path):
    stream = io.StringIO()
    stream.close()
    handle = configure(tmp_path / "l.jsonl", stream=stream)
    log.info("still here")
    handle.close()
    assert json.loads((tmp_path / "l.jsonl").read_text())["event"] == "still here"


@given(
    event=st.dictionaries(
        st.text(max_size=8) | st.sampled_from(["time", "event", "took_ms", "step"]),
        st.none() | st.integers() | st.text() | st.floats(),
    )
)
def test_every_event_becomes_one_line(event: dict):
    text = operator_line(event)
    assert len(text.splitlines()) <= 1 or not {"\n", "\r"} & set(operator_line({"event": event.get("event", "")}))


# -- the tail ----------------------------------------------------------------------------------------------


def written(path: Path, *texts: str, unit: str | None = None) -> None:
    with path.open("a", encoding="utf-8") as file:
        for text in texts:
            event = {"time": "2026-11-22T14:03:07.412+01:00", "level": "info", "event": text}
            file.write(json.dumps(event | ({"unit": unit} if unit else {})) + "\n")


def said(lines: list[str]) -> list[str]:
    return [line.split()[-1] for line in lines]


class Following:
    """A tail that runs beside the test."""

    def __init__(self, path: Path, choice: Choice | None = None, lines: int = 10) -> None:
        self.lines: list[str] = []
        self._stop = threading.Event()
        self._source = tail(path, choice or Choice(), lines=lines, follow=True)
        self._thread = threading.Thread(target=self._read)
        self._thread.start()

    def _read(self) -> None:
        for line in self._source:
            self.lines.append(line)
            if line.endswith("THE END"):
                return

    def until(self, count: int) -> list[str]:
        until_s = time.monotonic() + 5
        while len(self.lines) < count and time.monotonic() < until_s:
            time.sleep(0.01)
        return said(self.lines)

    def end(self, path: Path) -> None:
        written(path, "THE END")
        self._thread.join(5)
        assert not self._thread.is_alive()
        self._source.close()


@pytest.fixture(autouse=True)
def looks_often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cellctl.desk.tail.LOOK_EVERY_S", 0.01)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "cellctl.jsonl"


def test_the_tail_shows_the_last_lines_as_the_operator_saw_them(path: Path, logged: Logged):
    with bound(unit="u-3"), step(3, "locate base"):
        pass
    log.warning("look", remedy="here")
    lines, entries = logged.end()

    assert list(tail(logged.path, Choice(), lines=10, follow=False)) == lines
    assert list(tail(logged.path, Choice(), lines=1, follow=False)) == lines[-1:]
    raw = list(tail(logged.path, Choice(as_json=True), lines=10, follow=False))
    assert [json.loads(line) for line in raw] == entries


def test_the_tail_reads_back_over_files_that_were_put_aside(path: Path):
    for name, texts in (("2", "ab"), ("1", "cd")):
        written(Path(f"{path}.{name}"), *texts)
    written(path, "e", "f")
    assert said(list(tail(path, Choice(), lines=5, follow=False))) == list("bcdef")
    assert said(list(tail(path, Choice(), lines=2, follow=False))) == list("ef")
    assert said(list(tail(path, Choice(), lines=99, follow=False))) == list("abcdef")
    assert list(tail(path, Choice(), lines=0, follow=False)) == []


def test_the_tail_shows_one_unit_alone(path: Path):
    written(path, "one", unit="20261122-000001")
    written(path, "mentions 20261122-000002", unit="20261122-000001")
    written(path, "two", unit="20261122-000002")
    with path.open("a") as file:
        file.write("garbage 20261122-000002\n")
    assert said(list(tail(path, Choice(unit="20261122-000002"), lines=9, follow=False))) == ["two"]


def test_a_log_that_is_not_there_is_named(path: Path):
    with pytest.raises(NoLog, match=r"there is no log file .*cellctl\.jsonl; has the daemon run"):
        list(tail(path, Choice(), lines=9, follow=False))


def test_following_waits_for_the_file_and_goes_on_over_rotation_and_truncation(path: Path):
    following = Following(path)
    time.sleep(0.03)
    written(path, "a")
    assert following.until(1) == ["a"]
    written(path, "b")
    path.rename(f"{path}.1")
    time.sleep(0.03)
    written(Path(f"{path}.1"), "c")  # the writer had it still open
    written(path, "d")
    assert following.until(4) == ["a", "b", "c", "d"]
    path.write_text("")
    time.sleep(0.03)
    written(path, "e")
    assert following.until(5) == ["a", "b", "c", "d", "e"]
    following.end(path)


def test_half_a_line_is_shown_when_it_is_whole(path: Path):
    following = Following(path)
    whole = json.dumps({"event": "whole"}) + "\n"
    with path.open("w") as file:
        file.write(whole[:7])
        file.flush()
        time.sleep(0.05)
        assert following.lines == []
        file.write(whole[7:])
    assert following.until(1) == ["whole"]
    following.end(path)


def test_nothing_is_lost_while_a_real_log_rotates_under_the_tail(path: Path):
    following = Following(path)
    handle = configure(path, stream=io.StringIO(), rotate_mb=0.002, keep=3)
    for number in range(200):
        log.info(f"n{number}")
        time.sleep(0.0005)
    handle.close()
    assert following.until(200) == [f"n{number}" for number in range(200)]
    following.end(path)


@given(content=st.binary(max_size=300))
def test_any_file_can_be_tailed(tmp_path_factory: pytest.TempPathFactory, content: bytes):
    path = tmp_path_factory.mktemp("any") / "cellctl.jsonl"
    path.write_bytes(content)
    shown = list(tail(path, Choice(), lines=1000, follow=False))
    assert len(shown) == content.count(b"\n")
