"""A live picture for a browser on this computer: a page, a stream of JPEGs, the newest JPEG. Loopback only.

A page of the Internet must not be able to look through the camera by way of the browser, so a request that names
another host than this computer is refused (DNS rebinding), and no other origin is allowed to read.
"""

import asyncio
import html
import re
from typing import NamedTuple

from cellctl.desk.live_view import LiveView

HOST = "127.0.0.1"
LONGEST_HEAD = 8192
HEAD_WITHIN_S = 5.0
SENT_WITHIN_S = 5.0
MOST_VIEWERS = 8
BOUNDARY = "picture"
REQUEST = re.compile(r"([A-Z]{1,16}) (/[\x21-\x7e]{0,1000}) HTTP/1\.[01]")
HERE = re.compile(r"(127\.0\.0\.1|localhost|\[::1\])(:\d{1,5})?", re.IGNORECASE)
REASONS = {
    200: "OK",
    400: "Bad Request",
    403: "Forbidden",
    404: "Not Found",
    405: "Method Not Allowed",
    503: "Service Unavailable",
}
PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title>
<style>body{{margin:0;background:#222;color:#ddd;font:14px sans-serif}}img{{max-width:100%;max-height:92vh}}</style>
<img src="/stream" alt="live picture"><p>{title}</p></html>"""


class Asked(NamedTuple):
    """A request: what to do with it, or the status that refuses it."""

    path: str
    refused: int = 0


def parsed(head: bytes) -> Asked:
    """The request in these bytes, the empty line included."""
    lines = head.decode("latin-1").split("\r\n")
    request = REQUEST.fullmatch(lines[0])
    if request is None:
        return Asked("", 400)
    headers = [line.partition(":") for line in lines[1:] if line]
    hosts = [value.strip() for name, _, value in headers if name.strip().lower() == "host"]
    if len(hosts) != 1 or not HERE.fullmatch(hosts[0]):
        return Asked("", 403)
    if request[1] != "GET":
        return Asked("", 405)
    return Asked(request[2].partition("?")[0])


class LiveServer:
    """Serves a LiveView on a port of 127.0.0.1; use it as an async context manager."""

    def __init__(self, view: LiveView, title: str, port: int = 0) -> None:
        self._view, self._title, self._port = view, title, port
        self._viewers: set[asyncio.Task[None]] = set()

    @property
    def url(self) -> str:
        """Where a browser finds it."""
        return f"http://{HOST}:{self._server.sockets[0].getsockname()[1]}/"

    async def __aenter__(self) -> "LiveServer":
        """Raises OSError when the port is taken."""
        self._server = await asyncio.start_server(self._begin, HOST, self._port, limit=LONGEST_HEAD)
        return self

    async def __aexit__(self, *exception: object) -> None:
        self._server.close()
        for viewer in set(self._viewers):
            viewer.cancel()
        if self._viewers:
            await asyncio.wait(set(self._viewers))

    def _begin(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        viewer = asyncio.get_running_loop().create_task(self._serve(reader, writer))
        self._viewers.add(viewer)
        viewer.add_done_callback(self._viewers.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            await self._answer(reader, writer)
        except (ConnectionError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            return  # the viewer went away, or is too slow to be waited for
        finally:
            writer.transport.abort()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        async with asyncio.timeout(HEAD_WITHIN_S):
            asked = parsed(await reader.readuntil(b"\r\n\r\n"))
        if asked.refused:
            await _send(writer, asked.refused)
        elif len(self._viewers) > MOST_VIEWERS:
            await _send(writer, 503, f"{MOST_VIEWERS} viewers at most\n".encode())
        elif asked.path == "/":
            await _send(writer, 200, PAGE.format(title=html.escape(self._title)).encode(), "text/html; charset=utf-8")
        elif asked.path == "/picture.jpg":
            await _send(writer, 200, (await self._view.newer_than(0)).jpeg, "image/jpeg")
        elif asked.path == "/stream":
            await self._stream(writer)
        else:
            await _send(writer, 404)

    async def _stream(self, writer: asyncio.StreamWriter) -> None:
        writer.write(_head(200, f"multipart/x-mixed-replace; boundary={BOUNDARY}", None))
        number = 0
        while True:
            shown = await self._view.newer_than(number)
            number = shown.number
            part = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(shown.jpeg)}\r\n\r\n"
            writer.write(part.encode() + shown.jpeg + b"\r\n")
            async with asyncio.timeout(SENT_WITHIN_S):
                await writer.drain()


async def _send(writer: asyncio.StreamWriter, status: int, body: bytes = b"", kind: str = "text/plain") -> None:
    body = body or f"{status} {REASONS[status]}\n".encode()
    writer.write(_head(status, kind, len(body)) + body)
    async with asyncio.timeout(SENT_WITHIN_S):
        await writer.drain()
    writer.close()
    await writer.wait_closed()


def _head(status: int, kind: str, length: int | None) -> bytes:
    lines = [
        f"HTTP/1.1 {status} {REASONS[status]}",
        f"Content-Type: {kind}",
        "Cache-Control: no-store",
        "X-Content-Type-Options: nosniff",
        "Cross-Origin-Resource-Policy: same-origin",
        "Connection: close",
    ]
    if length is not None:
        lines.append(f"Content-Length: {length}")
    return ("\r\n".join(lines) + "\r\n\r\n").encode()
