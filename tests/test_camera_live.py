"""The live picture: what a browser on this computer gets, what others do not get, and the picture in a terminal."""

import asyncio
import re

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.desk import live_http
from cellctl.desk.live_http import LiveServer, parsed
from cellctl.desk.live_terminal import HALF, drawn
from cellctl.desk.live_view import STRIP_PX, LiveView, jpeg_of, sharpness, smaller

GREY = np.arange(256, dtype=np.uint8).reshape(1, -1).repeat(64, axis=0)


async def ask(server: LiveServer, request: str | bytes) -> bytes:
    port = int(server.url.rstrip("/").rpartition(":")[2])
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request if isinstance(request, bytes) else request.replace("\n", "\r\n").encode())
    try:
        async with asyncio.timeout(5.0):
            return await reader.read()
    except ConnectionResetError:  # ended without an answer
        return b""
    finally:
        writer.close()


def status(answer: bytes) -> int:
    return int(answer.split()[1])


async def test_the_page_the_picture_and_nothing_else_is_served():
    view = LiveView()
    view.show(jpeg_of(GREY, "hello"))
    async with LiveServer(view, "camera <1>") as server:
        page = await ask(server, "GET / HTTP/1.1\nHost: localhost:80\n\n")
        picture = await ask(server, "GET /picture.jpg?x=1 HTTP/1.1\nHost: 127.0.0.1\n\n")
        nothing = await ask(server, "GET /etc/passwd HTTP/1.1\nHost: 127.0.0.1\n\n")
    assert status(page) == 200
    assert b"camera &lt;1&gt;" in page
    decoded = cv2.imdecode(np.frombuffer(picture.partition(b"\r\n\r\n")[2], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert decoded.shape == (64 + STRIP_PX, 256)
    assert np.abs(decoded[:64].astype(int) - GREY).max() < 12
    assert status(nothing) == 404


async def test_the_stream_goes_on_with_every_new_picture():
    view = LiveView()
    async with LiveServer(view, "camera 1") as server:
        port = int(server.url.rstrip("/").rpartition(":")[2])
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET /stream HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert b"multipart/x-mixed-replace; boundary=picture" in await reader.readuntil(b"\r\n\r\n")
        for content in (b"first", b"second"):
            view.show(content)
            head = await reader.readuntil(b"\r\n\r\n")
            assert head.startswith(b"--picture\r\nContent-Type: image/jpeg")
            assert await reader.readexactly(len(content) + 2) == content + b"\r\n"
        writer.close()
    assert asyncio.all_tasks() == {asyncio.current_task()}


@pytest.mark.parametrize(
    ("request_text", "refused"),
    [
        ("GET / HTTP/1.1\nHost: evil.example\n\n", 403),
        ("GET / HTTP/1.1\nHost: 127.0.0.1.evil.example\n\n", 403),
        ("GET / HTTP/1.1\nHost: 127.0.0.1\nHost: evil.example\n\n", 403),
        ("GET / HTTP/1.1\n\n", 403),
        ("POST / HTTP/1.1\nHost: 127.0.0.1\n\n", 405),
        ("GET  / HTTP/1.1\nHost: 127.0.0.1\n\n", 400),
        ("rubbish\n\n", 400),
    ],
)
async def test_a_page_of_the_internet_cannot_look_through_the_camera(request_text: str, refused: int):
    view = LiveView()
    view.show(b"secret")
    async with LiveServer(view, "camera 1") as server:
        answer = await ask(server, request_text)
    assert status(answer) == refused
    assert b"secret" not in answer


@given(st.binary(max_size=300))
@settings(max_examples=40, deadline=None)
def test_any_bytes_are_a_request_or_refused(head: bytes):
    asked = parsed(head)
    assert asked.refused or asked.path.startswith("/")


@given(st.text(max_size=40), st.text(max_size=40))
@settings(max_examples=40, deadline=None)
def test_only_requests_for_this_computer_are_answered(path: str, host: str):
    asked = parsed(f"GET /{path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode("utf-8", "replace"))
    if not asked.refused:
        assert re.match(r"\s*(127\.0\.0\.1|localhost|\[::1\])", host, re.IGNORECASE)


async def test_a_request_that_does_not_end_is_not_waited_for(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(live_http, "HEAD_WITHIN_S", 0.1)
    async with LiveServer(LiveView(), "camera 1") as server:
        assert await ask(server, "GET / HTTP/1.1\nHost: ") == b""
        assert await ask(server, b"x" * 20_000) == b""


async def test_viewers_beyond_the_most_are_turned_away(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(live_http, "MOST_VIEWERS", 2)
    async with LiveServer(LiveView(), "camera 1") as server:
        port = int(server.url.rstrip("/").rpartition(":")[2])
        ends = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2)]
        for reader, writer in ends:
            writer.write(b"GET /stream HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            await reader.readuntil(b"\r\n\r\n")
        assert status(await ask(server, "GET / HTTP/1.1\nHost: 127.0.0.1\n\n")) == 503
        for _, writer in ends:
            writer.close()


async def test_a_viewer_that_is_slow_gets_the_newest_picture_next():
    view = LiveView()
    view.show(b"1")
    first = await view.newer_than(0)
    for content in (b"2", b"3", b"4"):
        view.show(content)
    assert (await view.newer_than(first.number)).jpeg == b"4"


@given(st.integers(1, 300), st.integers(1, 300), st.integers(1, 200), st.integers(3, 60))
@settings(max_examples=40, deadline=None)
def test_a_terminal_never_gets_more_than_it_has_room_for(height: int, width: int, columns: int, lines: int):
    pixels = np.random.default_rng(1).integers(0, 256, (height, width), dtype=np.uint8)
    text = drawn(pixels, columns, lines, "caption")
    rows = re.sub(r"\x1b\[[\d;]*[A-Za-z]", "", text).split("\n")
    assert len(rows) <= lines
    assert all(len(row) <= columns for row in rows)
    assert set("".join(rows[:-1])) == {HALF}


def test_a_terminal_shows_black_dark_and_white_bright():
    pixels = np.zeros((20, 40), np.uint8)
    pixels[:, 20:] = 255
    first = drawn(pixels, 40, 12, "").split("\n")[0]
    assert first.count("38;5;232;48;5;232m") == 1
    assert first.count("38;5;255;48;5;255m") == 1


def test_a_picture_is_made_smaller_by_whole_factors_only():
    pixels = np.full((1944, 2592), 7, np.uint8)
    assert smaller(pixels, 1300).shape == (972, 1296)
    assert smaller(pixels, 2592) is pixels


def test_sharpness_is_largest_in_focus():
    sharp = np.random.default_rng(2).integers(0, 256, (200, 200), dtype=np.uint8)
    blurred = [cv2.GaussianBlur(sharp, (0, 0), sigma) for sigma in (0.5, 1.0, 2.0)]
    values = [sharpness(np.asarray(each, np.uint8)) for each in (sharp, *blurred)]
    assert values == sorted(values, reverse=True)
    assert values[0] > 2 * values[-1]
