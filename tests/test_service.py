"""What systemd is told, judged by what arrives at a notify socket, and the watchdog's progress rule."""

import asyncio
import io
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from cellctl import log, service
from cellctl.service import Progress, feed_watchdog, notify, watchdog_s


@pytest.fixture(params=["file", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The service manager's end of the notify socket."""
    name = f"{tmp_path}/notify" if request.param == "file" else f"@cellctl-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(name.replace("@", "\0"))
        manager.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", name)
        yield manager


def received(manager: socket.socket) -> list[str]:
    messages = []
    while True:
        try:
            messages.append(manager.recv(4096).decode())
        except BlockingIOError:
            return messages


def test_the_manager_is_told_in_one_message(manager: socket.socket):
    assert service.ready("Idle")
    assert service.show("unit 20261122-000123\nWATCHDOG=1")  # a text can never smuggle an assignment in
    assert service.stopping("stopping")
    assert received(manager) == [
        "READY=1\nSTATUS=Idle",
        "STATUS=unit 20261122-000123 WATCHDOG=1",
        "STOPPING=1\nSTATUS=stopping",
    ]


@pytest.mark.parametrize("address", [None, "", "relative", "/nowhere/notify", "@nobody-listens"])
def test_without_a_manager_nothing_happens(address: str | None, monkeypatch: pytest.MonkeyPatch):
    if address is None:
        monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    else:
        monkeypatch.setenv("NOTIFY_SOCKET", address)
    assert notify("READY=1") is False


def test_a_manager_that_does_not_read_never_blocks_us(manager: socket.socket):
    told = [notify("STATUS=" + "x" * 1000) for _ in range(2000)]
    assert told[0] is True
    assert told[-1] is False


@pytest.mark.parametrize(
    ("usec", "pid", "expected_s"),
    [
        ("2000000", None, 2.0),
        ("2000000", str(os.getpid()), 2.0),
        ("2000000", "1", None),
        ("0", None, None),
        ("", None, None),
        ("soon", None, None),
        ("-5", None, None),
    ],
)
def test_the_timeout_is_ours_only_when_it_is_meant_for_us(
    usec: str, pid: str | None, expected_s: float | None, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setenv("WATCHDOG_USEC", usec)
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    if pid is not None:
        monkeypatch.setenv("WATCHDOG_PID", pid)
    assert watchdog_s() == expected_s


def test_a_task_that_nobody_registered_is_a_mistake():
    with pytest.raises(KeyError, match="plc is not registered"):
        Progress().mark("plc")


@pytest.fixture
async def feeding(monkeypatch: pytest.MonkeyPatch):
    """A running feeder for two tasks, which look every 10 ms."""
    monkeypatch.setenv("WATCHDOG_USEC", "80000")
    monkeypatch.delenv("WATCHDOG_PID", raising=False)
    progress = Progress()
    progress.register("plc scan")
    progress.register("cell")
    task = asyncio.create_task(feed_watchdog(progress, within_s=0.2))
    yield progress
    task.cancel()
    await asyncio.wait([task])


async def test_the_watchdog_is_fed_while_all_tasks_move_on(manager: socket.socket, feeding: Progress):
    for _ in range(30):
        feeding.mark("plc scan")
        feeding.mark("cell")
        await asyncio.sleep(0.01)
    assert len(received(manager)) >= 5


async def test_one_stuck_task_is_enough_to_starve_the_watchdog_and_is_named(manager: socket.socket, feeding: Progress):
    stream = io.StringIO()
    logged = log.configure(None, stream=stream)
    for _ in range(40):
        feeding.mark("plc scan")
        await asyncio.sleep(0.01)
    fed = received(manager)
    logged.close()
    assert fed == ["WATCHDOG=1"]  # once, for the registration
    (line,) = stream.getvalue().splitlines()
    assert line.split("ERROR ")[1].startswith("no progress for 0.2")
    assert line.endswith("s: cell")
    feeding.mark("cell")
    await asyncio.sleep(0.1)
    assert received(manager) == ["WATCHDOG=1"]


async def test_a_task_that_has_ended_as_it_should_is_not_waited_for(manager: socket.socket, feeding: Progress):
    feeding.forget("cell")
    for _ in range(10):
        feeding.mark("plc scan")
        await asyncio.sleep(0.02)
    assert len(received(manager)) >= 3


class AnyOrder(RuleBasedStateMachine):
    """`stuck` against the plain rule: who has not marked since the last feed."""

    def __init__(self) -> None:
        super().__init__()
        self.progress = Progress()
        self.moved: dict[str, bool] = {}

    names = st.sampled_from("abc")

    @rule(name=names)
    def register(self, name: str) -> None:
        self.progress.register(name)
        self.moved[name] = True

    @rule(name=names)
    def mark(self, name: str) -> None:
        if name in self.moved:
            self.progress.mark(name)
            self.moved[name] = True

    @rule(name=names)
    def forget(self, name: str) -> None:
        self.progress.forget(name)
        self.moved.pop(name, None)

    @rule()
    def fed(self) -> None:
        self.progress.fed()
        self.moved = dict.fromkeys(self.moved, False)

    @invariant()
    def stuck_are_those_who_have_not_moved(self) -> None:
        assert set(self.progress.stuck()) == {name for name, moved in self.moved.items() if not moved}


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=50, deadline=None)
