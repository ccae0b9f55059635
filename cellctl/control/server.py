"""The control socket: people and programs ask, the daemon answers. JSON lines over a unix socket.

Asked:     {"version": 1, "verb": "command", "name": "start"}
Answered:  {"version": 1, "ok": true, "reply": {...}}  or  {"version": 1, "ok": false, "code": "...", "error": "..."}
Codes:     bad_request, refused, late, busy

Events:    {"event": "state", "state": "Execute", "number": 6, "text": "..."}, and "unit", "progress", "job"

One request at a time per connection. After `watch` the connection only carries events, one JSON object per line; a
client that does not read them fast enough is told so and dropped. Who may ask is decided by the socket's owner,
group and mode (0660); who asked is logged.
"""

import asyncio
import contextlib
import errno
import json
import os
import socket
import stat
import struct
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import NamedTuple, Self

from cellctl.control.errors import ControlError, Declined
from cellctl.control.events import Event
from cellctl.control.requests import (
    MAX_LINE,
    VERSION,
    BadRequest,
    PlcRequest,
    Request,
    StatusRequest,
    WatchRequest,
    parse_request,
)
from cellctl.log import log
from cellctl.machine import NotAllowed

ANSWER_WITHIN_S = 5.0
READ_WITHIN_S = 30.0
SEND_WITHIN_S = 5.0
ALIVE_EVERY_S = 2.0
MOST_CLIENTS = 32
MOST_EVENTS_WAITING = 256
SOCKET_MODE = 0o660
NO_HANDLES = (errno.EMFILE, errno.ENFILE, errno.ENOMEM, errno.ENOBUFS)
RETRY_ACCEPT_S = 0.5

Handler = Callable[[Request], Awaitable[Mapping[str, object]]]


class Peer(NamedTuple):
    """Who is at the other end, as the kernel knows it."""

    pid: int
    uid: int
    gid: int


# -- the server --------------------------------------------------------------------------------------------


class _Watcher:
    """The events that wait for one client."""

    def __init__(self) -> None:
        self.waiting: asyncio.Queue[Event] = asyncio.Queue(MOST_EVENTS_WAITING)
        self.too_slow = False

    def offer(self, event: Event) -> None:
        if self.too_slow:
            return
        try:
            self.waiting.put_nowait(event)
        except asyncio.QueueFull:
            self._give_up()

    def _give_up(self) -> None:
        self.too_slow = True
        while not self.waiting.empty():
            self.waiting.get_nowait()
        text = f"more than {MOST_EVENTS_WAITING} events were waiting to be read; connect again and read faster"
        self.waiting.put_nowait({"event": "dropped", "text": text})

    async def next(self) -> Event:
        try:
            return await asyncio.wait_for(self.waiting.get(), ALIVE_EVERY_S)
        except TimeoutError:
            return {"event": "alive"}


class ControlServer:
    """Serves one socket. `open` offers it, `run` serves it until cancelled and takes it away."""

    def __init__(self, path: Path, handler: Handler) -> None:
        self._path = path
        self._handler = handler
        self._socket: socket.socket | None = None
        self._clients = 0
        self._watchers: set[_Watcher] = set()

    def open(self) -> Self:
        """Take the socket's name, or raise ControlError. Nothing is answered before `run`."""
        _remove_stale(self._path)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK)
        try:
            os.fchmod(listener.fileno(), SOCKET_MODE)  # Linux gives the name this mode at most, from its first moment
            listener.bind(os.fspath(self._path))
            self._path.chmod(SOCKET_MODE)
            listener.listen(MOST_CLIENTS)
        except OSError as error:
            listener.close()
            why = f"{error.strerror or error}; its folder must exist and be writable"
            raise ControlError(f"the control socket {self._path} cannot be made: {why}") from error
        self._socket = listener
        return self

    def close(self) -> None:
        """Take the socket away. May be called twice; `run` does it, too."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
            self._path.unlink(missing_ok=True)

    async def run(self) -> None:
        """Serve until cancelled. An error of the handler that is neither Declined nor NotAllowed ends the server."""
        if self._socket is None:
            self.open()
        try:
            async with asyncio.TaskGroup() as group:
                while True:
                    connection = await self._accept()
                    group.create_task(self._serve(connection))
        finally:
            self.close()

    def publish(self, event: Event) -> None:
        """Hand an event to all who watch. Returns at once; from the event loop only."""
        for watcher in self._watchers:
            watcher.offer(event)

    async def _accept(self) -> socket.socket:
        assert self._socket is not None
        while True:
            try:
                connection, _ = await asyncio.get_running_loop().sock_accept(self._socket)
            except OSError as error:
                if error.errno not in NO_HANDLES:
                    raise
                log.warning(f"the control socket cannot take a client: {error.strerror}", logger="control")
                await asyncio.sleep(RETRY_ACCEPT_S)
                continue
            return connection

    async def _serve(self, connection: socket.socket) -> None:
        peer = peer_of(connection)
        reader, writer = await asyncio.open_unix_connection(sock=connection, limit=MAX_LINE)
        self._clients += 1
        try:
            if self._clients > MOST_CLIENTS:
                await _send(writer, _no("busy", f"{MOST_CLIENTS} clients are connected already"))
            else:
                await self._converse(reader, writer, peer)
        except (TimeoutError, ConnectionError):
            writer.transport.abort()
        finally:
            self._clients -= 1
            await _end(writer)

    async def _converse(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, peer: Peer) -> None:
        while True:
            try:
                line = await asyncio.wait_for(reader.readuntil(b"\n"), READ_WITHIN_S)
            except asyncio.IncompleteReadError:
                return
            except asyncio.LimitOverrunError:
                await _send(writer, _no("bad_request", f"the line is longer than {MAX_LINE} bytes"))
                return
            try:
                request = parse_request(line)
            except BadRequest as error:
                await _send(writer, _no("bad_request", str(error)))
                continue
            if isinstance(request, WatchRequest):
                await self._stream(writer)
                return
            await _send(writer, await self._answer(request, peer))

    async def _answer(self, request: Request, peer: Peer | None) -> Mapping[str, object]:
        asked = " ".join(str(value) for key, value in request if key != "version")
        quiet = isinstance(request, StatusRequest | PlcRequest)
        try:
            reply = await asyncio.wait_for(self._handler(request), ANSWER_WITHIN_S)
        except (Declined, NotAllowed) as error:
            log.warning(f"{asked}: refused, {error}", logger="control", peer=peer)
            return _no("refused", str(error))
        except TimeoutError:
            log.warning(f"{asked}: no answer within {ANSWER_WITHIN_S:g} s", logger="control", peer=peer)
            return _no("late", f"the cell did not answer within {ANSWER_WITHIN_S:g} s; look at the log")
        if not quiet:
            log.info(f"{asked}: done", logger="control", peer=peer)
        return {"version": VERSION, "ok": True, "reply": dict(reply)}

    async def _stream(self, writer: asyncio.StreamWriter) -> None:
        """First the status as the reply, then every event from before that reply on: nothing falls in between."""
        watcher = _Watcher()
        self._watchers.add(watcher)
        try:
            await _send(writer, await self._answer(StatusRequest(version=1, verb="status"), None))
            event: Event = {}
            while event.get("event") != "dropped":
                event = await watcher.next()
                await _send(writer, event)
        finally:
            self._watchers.discard(watcher)


def peer_of(connection: socket.socket) -> Peer:
    """Process, user and group at the other end (SO_PEERCRED)."""
    layout = struct.Struct("3i")
    return Peer(*layout.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, layout.size)))


def _no(code: str, sentence: str) -> Mapping[str, object]:
    return {"version": VERSION, "ok": False, "code": code, "error": sentence}


async def _send(writer: asyncio.StreamWriter, message: Mapping[str, object]) -> None:
    writer.write(json.dumps(message, default=str).encode("ascii") + b"\n")
    await asyncio.wait_for(writer.drain(), SEND_WITHIN_S)


async def _end(writer: asyncio.StreamWriter) -> None:
    """Close; what could not be sent by then is given up."""
    writer.close()
    with contextlib.suppress(TimeoutError, ConnectionError):
        await asyncio.wait_for(writer.wait_closed(), 1.0)
    writer.transport.abort()


def _remove_stale(path: Path) -> None:
    """Remove a socket that a dead daemon left; anything else at that place is an error."""
    try:
        kind = path.lstat().st_mode
    except FileNotFoundError:
        return
    except OSError as error:
        raise ControlError(f"the control socket {path} cannot be looked at: {error.strerror}") from error
    if not stat.S_ISSOCK(kind):
        raise ControlError(f"{path} is not a socket; remove it or name another control_socket in cell.toml")
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(os.fspath(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
            return
        except OSError as error:
            raise ControlError(f"the control socket {path} cannot be tried: {error.strerror or error}") from error
    raise ControlError(f"another cellctl listens on {path}; stop it first")
