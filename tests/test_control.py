"""The control socket, judged by what travels over it."""

import asyncio
import contextlib
import json
import os
import socket
import stat
from collections.abc import AsyncIterator, Mapping
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellctl.control import server
from cellctl.control.errors import ControlError, Declined
from cellctl.control.events import job_event, progress_event, state_event
from cellctl.control.requests import (
    MAX_LINE,
    BadRequest,
    CalibrateRequest,
    CommandRequest,
    ModeRequest,
    Request,
    StatusRequest,
    TeachRequest,
    parse_request,
)
from cellctl.control.server import ControlServer
from cellctl.desk.client import NotReachable, RequestFailed, call, wait_for_job, wait_for_run, watch
from cellctl.machine import Command, Mode, NotAllowed


class Daemon:
    """Answers like a cell would, and remembers what it was asked."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.asked: list[Request] = []
        self.gate = asyncio.Event()
        self.started = asyncio.Event()
        self.server = ControlServer(path, self.answer)

    async def answer(self, request: Request) -> Mapping[str, object]:
        self.asked.append(request)
        match request:
            case CommandRequest(name="stop"):
                raise NotAllowed("stop is not possible in Stopped; allowed now: reset, abort")
            case CommandRequest(name="hold"):
                raise Declined("a person is teaching")
            case CommandRequest(name="clear"):
                await self.gate.wait()
            case CommandRequest(name="start"):
                self.started.set()
            case CommandRequest(name="abort"):
                raise ZeroDivisionError("a bug")
            case CalibrateRequest():
                self.server.publish(progress_event("calibrate", "pose 1 of 2"))
                self.server.publish(state_event("Execute", 6, "Maintenance", "begun"))
                self.server.publish(job_event("calibrate", request.what == "camera-1", "0.004 mm", {"mm": 0.004}))
            case TeachRequest():
                self.server.publish(progress_event("teach", "seat it", asks="seat-golden-assembly"))
                self.server.publish(state_event("Aborted", 9, "Maintenance", "guard open"))
        return {"state": "Idle"}


@pytest.fixture
async def daemon(tmp_path: Path) -> AsyncIterator[Daemon]:
    daemon = Daemon(tmp_path / "c.sock")
    daemon.server.open()
    serving = asyncio.create_task(daemon.server.run())
    yield daemon
    serving.cancel()
    await asyncio.wait([serving])
    assert not daemon.path.exists()
    assert len(asyncio.all_tasks()) == 1


@contextlib.asynccontextmanager
async def connected(daemon: Daemon) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_unix_connection(daemon.path)
    yield reader, writer
    writer.close()
    with contextlib.suppress(ConnectionError):
        await writer.wait_closed()


async def raw(daemon: Daemon, *lines: bytes) -> list[dict]:
    """What comes back for these bytes until the end of what was asked."""
    async with connected(daemon) as (reader, writer):
        writer.write(b"".join(lines))
        writer.write_eof()
        answer = await asyncio.wait_for(reader.read(), 5)
    return [json.loads(line) for line in answer.splitlines()]


STATUS = b'{"version": 1, "verb": "status"}\n'


async def test_a_question_is_answered(daemon: Daemon):
    assert await call(daemon.path, {"verb": "status"}) == {"state": "Idle"}
    assert daemon.asked == [StatusRequest(version=1, verb="status")]


async def test_requests_on_one_connection_are_answered_in_order_even_when_they_come_at_once(daemon: Daemon):
    answers = await raw(daemon, STATUS, b"nonsense\n", STATUS)
    assert [answer["ok"] for answer in answers] == [True, False, True]


async def test_the_next_request_waits_for_the_answer_of_the_one_before(daemon: Daemon):
    async with connected(daemon) as (reader, writer):
        writer.write(b'{"version": 1, "verb": "command", "name": "clear"}\n' + STATUS)
        await asyncio.sleep(0.05)
        assert len(daemon.asked) == 1
        daemon.gate.set()
        await reader.readline()
        await reader.readline()
    assert len(daemon.asked) == 2


async def test_the_machines_and_the_handlers_no_reach_the_asker(daemon: Daemon):
    with pytest.raises(RequestFailed, match="stop is not possible in Stopped; allowed now: reset, abort") as refused:
        await call(daemon.path, {"verb": "command", "name": "stop"})
    assert refused.value.code == "refused"
    with pytest.raises(RequestFailed, match="a person is teaching"):
        await call(daemon.path, {"verb": "command", "name": "hold"})


async def test_a_handler_that_hangs_is_given_up(daemon: Daemon, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(server, "ANSWER_WITHIN_S", 0.05)
    with pytest.raises(RequestFailed, match=r"did not answer within 0.05 s") as late:
        await call(daemon.path, {"verb": "command", "name": "clear"})
    assert late.value.code == "late"


async def test_a_bug_in_the_handler_ends_the_server_instead_of_hiding(tmp_path: Path):
    daemon = Daemon(tmp_path / "c.sock")
    daemon.server.open()
    serving = asyncio.create_task(daemon.server.run())
    with pytest.raises(NotReachable, match="closed the connection"):
        await call(daemon.path, {"verb": "command", "name": "abort"})
    with pytest.raises(ExceptionGroup) as group:
        await serving
    assert group.group_contains(ZeroDivisionError)
    assert not daemon.path.exists()


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (b"{", "Invalid JSON"),
        (b'{"version": 1}', "discriminator 'verb'"),
        (b'{"version": 1, "verb": "dance"}', "'dance'"),
        (b'{"verb": "status"}', r"version: Field required"),
        (b'{"version": 2, "verb": "status"}', r"version: Input should be 1 \(got 2\)"),
        (b'{"version": 1, "verb": "status", "x": 1}', r"x: Extra inputs are not permitted \(got 1\)"),
        (b'{"version": 1, "verb": "command", "name": "fly"}', r"name: Input should be 'reset'.*\(got 'fly'\)"),
        (b'{"version": 1, "verb": "units_left", "count": -1}', r"count: .* greater than or equal to 0 \(got -1\)"),
        (b'{"version": 1, "verb": "units_left", "count": true}', r"count: Input should be a valid integer"),
        (b'{"version": 1, "verb": "units_left", "count": "5"}', r"count: Input should be a valid integer"),
        (b'{"version": 1, "verb": "recipe_use", "name": "../../etc/passwd"}', r"name: String should match"),
        (b'{"version": 1, "verb": "recipe_use", "name": "a\\n"}', r"name: String should match"),
        (b'{"version": 1, "verb": "teach", "repeats": 0, "pairs": 1}', r"repeats: "),
        (b'{"version": 1, "verb": "teach", "repeats": 1, "pairs": 21}', r"pairs: "),
        (b'{"version": 1, "verb": "temperature", "celsius": NaN}', r"celsius: "),
        (b'{"version": 1, "verb": "verify", "camera": "tool"}', r"camera: "),
        (
            b'{"version": 1, "verb": "calibration_use", "camera": "camera-1", "what": "accept", "calibration": "../x"}',
            r"calibration: ",
        ),
        (b"\xff\xfe", "Invalid JSON"),
        (b"[" * 5000, "Invalid JSON"),
        (b"", "Invalid JSON"),
    ],
)
def test_what_is_wrong_with_a_request_is_said_with_place_and_value(line: bytes, says: str):
    with pytest.raises(BadRequest, match=says) as bad:
        parse_request(line)
    assert len(str(bad.value)) < 400


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
verbs = st.sampled_from(
    ["status", "command", "mode", "recipe_use", "calibrate", "teach", "proceed", "units_left", "watch"]
)
verbs |= st.sampled_from(["verify", "hysteresis", "calibration_use", "temperature"])
nearly_requests = st.fixed_dictionaries(
    {"version": st.just(1) | json_values, "verb": verbs},
    optional=dict.fromkeys(("name", "what", "repeats", "count", "camera", "celsius"), json_values),
).map(lambda value: json.dumps(value).encode())


@given(line=st.binary(max_size=200) | json_values.map(lambda value: json.dumps(value).encode()) | nearly_requests)
def test_any_line_is_a_request_or_refused_in_a_sentence(line: bytes):
    try:
        request = parse_request(line)
    except BadRequest as error:
        said = str(error)
    else:
        assert json.loads(request.model_dump_json()) == json.loads(line)
        return
    assert 0 < len(said) <= 300
    assert len(said.splitlines()) == 1


def test_the_commands_and_modes_of_the_socket_are_those_of_the_machine():
    for command in Command:
        line = json.dumps({"version": 1, "verb": "command", "name": command.title})
        request = parse_request(line.encode())
        assert isinstance(request, CommandRequest)
        assert request.command is command
    for mode in Mode:
        request = parse_request(json.dumps({"version": 1, "verb": "mode", "name": mode.title.lower()}).encode())
        assert isinstance(request, ModeRequest)
        assert request.mode is mode


async def test_a_line_without_end_is_refused_at_64_kib(daemon: Daemon):
    (answer,) = await raw(daemon, b" " * (MAX_LINE + 10))
    assert answer == {"version": 1, "ok": False, "code": "bad_request", "error": "the line is longer than 65536 bytes"}
    assert await call(daemon.path, {"verb": "status"})


async def test_half_a_request_is_none(daemon: Daemon):
    assert await raw(daemon, STATUS[:10]) == []
    assert daemon.asked == []


async def test_a_client_that_says_nothing_is_let_go(daemon: Daemon, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(server, "READ_WITHIN_S", 0.05)
    async with connected(daemon) as (reader, writer):
        writer.write(STATUS[:10])
        with contextlib.suppress(ConnectionError):
            assert await asyncio.wait_for(reader.read(), 2) == b""


async def test_too_many_clients_are_told_so_and_the_others_still_served(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(server, "MOST_CLIENTS", 2)
    async with connected(daemon) as first, connected(daemon) as second:
        for reader, writer in (first, second):
            writer.write(STATUS)
            assert json.loads(await reader.readline())["ok"]
        (answer,) = await raw(daemon)
        assert (answer["code"], answer["error"]) == ("busy", "2 clients are connected already")
    await asyncio.sleep(0.05)
    assert await call(daemon.path, {"verb": "status"})


async def test_who_asked_is_known_from_the_kernel(daemon: Daemon):
    ours, theirs = socket.socketpair(socket.AF_UNIX)
    with ours, theirs:
        assert server.peer_of(ours) == (os.getpid(), os.getuid(), os.getgid())


# -- the socket itself -------------------------------------------------------------------------------------


async def test_owner_and_group_may_ask_and_nobody_else(daemon: Daemon):
    assert stat.filemode(os.stat(daemon.path).st_mode) == "srw-rw----"


def test_a_socket_that_a_dead_daemon_left_is_replaced(tmp_path: Path):
    path = tmp_path / "c.sock"
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(os.fspath(path))
    assert path.exists()
    ControlServer(path, None).open().close()
    assert not path.exists()


async def test_a_living_daemon_keeps_its_socket(daemon: Daemon):
    with pytest.raises(ControlError, match=r"another cellctl listens on .*c\.sock; stop it first"):
        ControlServer(daemon.path, daemon.answer).open()
    assert await call(daemon.path, {"verb": "status"})


def test_a_file_in_the_place_of_the_socket_is_not_touched(tmp_path: Path):
    path = tmp_path / "c.sock"
    path.write_text("precious")
    with pytest.raises(ControlError, match="is not a socket; remove it or name another"):
        ControlServer(path, None).open()
    assert path.read_text() == "precious"


def test_a_folder_that_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(ControlError, match=r"cannot be made: No such file or directory; its folder must exist"):
        ControlServer(tmp_path / "nowhere" / "c.sock", None).open()


async def test_without_a_daemon_the_remedy_is_said(tmp_path: Path):
    with pytest.raises(NotReachable, match=r"does not run: nobody listens on .*start it with `systemctl start"):
        await call(tmp_path / "c.sock", {"verb": "status"})


async def test_a_daemon_that_hangs_is_not_waited_for(daemon: Daemon):
    with pytest.raises(NotReachable, match=r"did not answer within 0.1 s"):
        await call(daemon.path, {"verb": "command", "name": "clear"}, within_s=0.1)


# -- watching ----------------------------------------------------------------------------------------------


async def test_a_watcher_sees_the_status_first_and_then_every_event_in_order(daemon: Daemon):
    async with contextlib.aclosing(watch(daemon.path)) as events:
        assert await anext(events) == {"event": "status", "state": "Idle"}
        for number in range(100):
            daemon.server.publish({"event": "state", "number": number})
        assert [(await anext(events))["number"] for _ in range(100)] == list(range(100))


async def test_silence_is_filled_so_that_a_dead_daemon_is_noticed(daemon: Daemon, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(server, "ALIVE_EVERY_S", 0.01)
    async with connected(daemon) as (reader, writer):
        writer.write(b'{"version": 1, "verb": "watch"}\n')
        lines = [json.loads(await asyncio.wait_for(reader.readline(), 2)) for _ in range(3)]
    assert lines[1:] == [{"event": "alive"}, {"event": "alive"}]

    monkeypatch.setattr(server, "ALIVE_EVERY_S", 60)
    monkeypatch.setattr("cellctl.desk.client.SILENT_S", 0.05)
    async with contextlib.aclosing(watch(daemon.path)) as events:
        await anext(events)
        with pytest.raises(NotReachable, match="fell silent"):
            await anext(events)


async def test_a_watcher_that_does_not_read_is_told_and_dropped_while_others_go_on(
    daemon: Daemon, monkeypatch: pytest.MonkeyPatch
):
    async with connected(daemon) as (reader, writer), contextlib.aclosing(watch(daemon.path)) as quick:
        writer.write(b'{"version": 1, "verb": "watch"}\n')
        await reader.readline()
        await anext(quick)
        seen = 0
        for _ in range(3):  # in portions that a reader who reads can take
            for number in range(200):
                daemon.server.publish({"event": "state", "number": number, "text": "x" * 2000})
            for _ in range(200):
                seen += (await anext(quick))["event"] == "state"
        received = await asyncio.wait_for(reader.read(), 5)
        last = json.loads(received.splitlines()[-1])
        assert last["event"] == "dropped"
        assert "256 events were waiting" in last["text"]
        assert seen == 600
    assert await call(daemon.path, {"verb": "status"})


async def test_a_watcher_that_never_reads_again_is_cut_off(daemon: Daemon, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(server, "SEND_WITHIN_S", 0.1)
    async with connected(daemon) as (reader, writer):
        writer.write(b'{"version": 1, "verb": "watch"}\n')
        await reader.readline()
        for _ in range(100):
            daemon.server.publish({"event": "state", "text": "x" * 60_000})
            await asyncio.sleep(0)
        await asyncio.sleep(1.5)
        assert not daemon.server._watchers
    assert await call(daemon.path, {"verb": "status"})


async def test_the_end_of_the_daemon_ends_the_watching(daemon: Daemon):
    async with contextlib.aclosing(watch(daemon.path)) as events:
        await anext(events)
        for task in asyncio.all_tasks() - {asyncio.current_task()}:
            task.cancel()
        with pytest.raises(NotReachable, match="closed the connection"):
            await anext(events)


# -- jobs --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("what", "well"), [("camera-1", True), ("camera-2", False)])
async def test_a_job_shows_its_own_progress_and_ends_with_its_result(daemon: Daemon, what: str, well: bool):
    shown: list[dict] = []
    assert await wait_for_job(daemon.path, {"verb": "calibrate", "what": what}, shown.append) is well
    assert [event["text"] for event in shown] == ["pose 1 of 2", "begun", "0.004 mm"]


async def test_a_job_that_is_aborted_ends_with_the_machine(daemon: Daemon):
    shown: list[dict] = []
    assert await wait_for_job(daemon.path, {"verb": "teach", "repeats": 1, "pairs": 1}, shown.append) is False
    assert [event["text"] for event in shown] == ["seat it", "guard open"]


@pytest.mark.parametrize(("end", "well"), [("Complete", True), ("Stopped", False), ("Aborted", False)])
async def test_waiting_for_a_run_ends_with_the_machine(daemon: Daemon, end: str, well: bool):
    async def happens() -> None:
        await daemon.started.wait()
        for state in ("Starting", "Execute", "Held", end):
            daemon.server.publish({"event": "state", "state": state})

    shown: list[dict] = []
    async with asyncio.TaskGroup() as group:
        group.create_task(happens())
        requests = [{"verb": "units_left", "count": 3}, {"verb": "command", "name": "start"}]
        assert await wait_for_run(daemon.path, requests, shown.append) is well
    assert [event["state"] for event in shown] == ["Starting", "Execute", "Held", end]
