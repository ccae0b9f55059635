"""The command line's side of the control socket: ask, watch, wait for a job, print.

Only the standard library is imported here, so that a question to the daemon costs no time before it is asked.
"""

import asyncio
import contextlib
import json
import sys
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

VERSION = 1
CALL_WITHIN_S = 10.0
SILENT_S = 10.0
MAX_LINE = 2**20

Reply = dict[str, Any]


class NotReachable(Exception):
    """Nobody answers at the control socket; the text says what to do."""


class RequestFailed(Exception):
    """The daemon said no. `code` is one of those in control.py."""

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(sentence)
        self.code = code


async def call(path: Path, request: Mapping[str, object], within_s: float = CALL_WITHIN_S) -> Reply:
    """Ask one thing, such as {"verb": "status"}, and return the reply. Raises NotReachable, RequestFailed."""
    try:
        async with asyncio.timeout(within_s), _connected(path) as (reader, writer):
            return await _asked(path, reader, writer, request)
    except TimeoutError:
        raise NotReachable(f"the daemon did not answer within {within_s:g} s at {path}; look at its log") from None


async def watch(path: Path) -> AsyncGenerator[Reply, None]:
    """Events as they happen; the first is {"event": "status", ...}. Close it with aclosing().

    Raises NotReachable when the daemon ends or falls silent, RequestFailed when we read too slowly.
    """
    async with _connected(path) as (reader, writer):
        status = await asyncio.wait_for(_asked(path, reader, writer, {"verb": "watch"}), CALL_WITHIN_S)
        yield {"event": "status", **status}
        while True:
            try:
                event = await asyncio.wait_for(_line(path, reader), SILENT_S)
            except TimeoutError:
                raise NotReachable(f"the daemon fell silent at {path}; look at its log") from None
            if event["event"] == "dropped":
                raise RequestFailed("slow", event["text"])
            if event["event"] != "alive":
                yield event


@contextlib.asynccontextmanager
async def _connected(path: Path) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    try:
        reader, writer = await asyncio.open_unix_connection(path, limit=MAX_LINE)
    except (FileNotFoundError, ConnectionRefusedError):
        remedy = "start it with `systemctl start cellctl` or `cellctl run`"
        raise NotReachable(f"the daemon does not run: nobody listens on {path}; {remedy}") from None
    except OSError as error:
        remedy = "you must be in the socket's group" if isinstance(error, PermissionError) else "look at its log"
        raise NotReachable(f"the daemon cannot be asked on {path}: {error.strerror}; {remedy}") from None
    try:
        yield reader, writer
    finally:
        writer.close()
        with contextlib.suppress(ConnectionError):
            await writer.wait_closed()


async def _asked(
    path: Path, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, request: Mapping[str, object]
) -> Reply:
    writer.write(json.dumps({"version": VERSION, **request}).encode("ascii") + b"\n")
    with contextlib.suppress(ConnectionError):  # a refusal may already be there to be read
        await writer.drain()
    answer = await _line(path, reader)
    if not answer["ok"]:
        raise RequestFailed(answer["code"], answer["error"])
    reply: Reply = answer["reply"]
    return reply


async def _line(path: Path, reader: asyncio.StreamReader) -> Reply:
    try:
        line = await reader.readuntil(b"\n")
    except (asyncio.IncompleteReadError, ConnectionError):
        raise NotReachable(f"the daemon closed the connection at {path}; look at its log") from None
    message: Reply = json.loads(line)
    return message


# -- jobs --------------------------------------------------------------------------------------------------

OVER = {"Complete": True, "Stopped": False, "Aborted": False}
"""The states in which a production run is over, and whether that is what was asked for."""

JOB_OVER = {**OVER, "Held": False}  # a job that is held before it has begun has not gone well

Show = Callable[[Reply], None]


async def wait_for_job(path: Path, request: Mapping[str, object], show: Show) -> bool:
    """Start a job and show what happens until it has ended; whether it went well.

    A job has the name of its verb (calibrate, teach). One that is stopped or aborted ends with the machine.
    """
    async with contextlib.aclosing(watch(path)) as events:
        await anext(events)
        await call(path, request)
        async for event in events:
            show(event)
            if event["event"] == "job" and event["job"] == request["verb"]:
                return bool(event["ok"])
            if event["event"] == "state" and event["state"] in JOB_OVER:
                return JOB_OVER[event["state"]]
    raise NotReachable("the daemon ended before the job did")


async def wait_for_run(path: Path, requests: Sequence[Mapping[str, object]], show: Show) -> bool:
    """Start production and show states and units until the run is over; whether it was completed."""
    async with contextlib.aclosing(watch(path)) as events:
        await anext(events)
        for request in requests:
            await call(path, request)
        async for event in events:
            show(event)
            if event["event"] == "state" and event["state"] in OVER:
                return OVER[event["state"]]
    raise NotReachable("the daemon ended before the run did")


def run_requests(path: Path, requests: Sequence[Mapping[str, object]], *, as_json: bool) -> None:
    """Ask one after the other and print the last reply."""

    async def ask_all() -> Reply:
        reply: Reply = {}
        for request in requests:
            reply = await call(path, request)
        return reply

    print_reply(asyncio.run(ask_all()), as_json=as_json)


# -- printing ----------------------------------------------------------------------------------------------


def print_reply(reply: Mapping[str, object], *, as_json: bool) -> None:
    """One line of JSON, or one line per fact."""
    if as_json:
        _write(json.dumps(reply))
        return
    facts = list(_facts(reply))
    width = max((len(name) for name, _ in facts), default=0)
    for name, value in facts:
        _write(f"{name:<{width}}  {value}")


def print_event(event: Mapping[str, object]) -> None:
    """One line per event, for people."""
    words = [str(event[key]) for key in ("state", "unit", "verdict", "job") if event.get(key)]
    if event["event"] == "job":
        words.append("done:" if event["ok"] else "failed:")
    _write(" ".join([*words, str(event.get("text", ""))]).rstrip())
    if event.get("asks"):
        _write("  when it is done: cellctl proceed")


def event_printer(as_json: bool) -> Show:
    """How events are printed."""
    return (lambda event: _write(json.dumps(event))) if as_json else print_event


def _facts(reply: Mapping[str, object], prefix: str = "") -> list[tuple[str, str]]:
    facts = []
    for key, value in reply.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            facts += _facts(value, f"{name} ")
        elif isinstance(value, list):
            facts.append((name, ", ".join(str(item) for item in value) or "none"))
        else:
            facts.append((name, _plain(value)))
    return facts


def _plain(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)


def _write(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
