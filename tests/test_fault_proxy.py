"""The proxy does to a wire what it is told, the same for the same seed, and nothing else."""

import asyncio
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fault_proxy import FaultProxy, proxied
from tests.wire_trouble import Trouble, fate, lines, modbus_frames


class Line:
    """A client behind the proxy and the server's side of its connection."""

    def __init__(self, proxy: FaultProxy, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.proxy, self.reader, self.writer = proxy, reader, writer

    async def send(self, *messages: bytes) -> None:
        for message in messages:
            self.writer.write(message)
        await self.writer.drain()

    async def comes(self, size: int) -> bytes:
        async with asyncio.timeout(2):
            return await self.reader.readexactly(size)

    async def all_that_comes(self, for_s: float = 0.05) -> bytes:
        received = b""
        try:
            async with asyncio.timeout(for_s):
                while piece := await self.reader.read(1000):
                    received += piece
        except TimeoutError:
            pass
        return received


async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        while received := await reader.read(65536):
            writer.write(received)
    except ConnectionError:
        pass
    finally:
        writer.close()


@asynccontextmanager
async def line(**options: int) -> AsyncIterator[Line]:
    """A client that reaches an echo through a proxy whose messages are lines."""
    server = await asyncio.start_server(echo, "127.0.0.1", 0)
    try:
        async with proxied(server.sockets[0].getsockname()[1], messages=lines, **options) as proxy:
            client = Line(proxy, *await asyncio.open_connection("127.0.0.1", proxy.port))
            try:
                yield client
            finally:
                client.writer.close()
                await asyncio.sleep(0.005)
    finally:
        server.close()
        await asyncio.sleep(0.01)  # the echoes see that their clients have gone


async def test_a_wire_without_trouble_changes_nothing() -> None:
    async with line() as client:
        data = [random.Random(1).randbytes(100).replace(b"\n", b"") + b"\n" for _ in range(50)]
        await client.send(*data)

        assert await client.comes(sum(map(len, data))) == b"".join(data)
        assert {passed.became for passed in client.proxy.record} == {()}
        assert len(client.proxy.record) == 100


@pytest.mark.parametrize(
    ("trouble", "comes"),
    [
        (Trouble(lose=1, count=1), b"b\nc\n"),
        (Trouble(duplicate=1, count=2), b"a\na\nb\nb\nc\n"),
        (Trouble(stale=1), b"a\nb\n"),
        (Trouble(split_bytes=1), b"a\nb\nc\n"),
        (Trouble(merge_s=0.02), b"a\nb\nc\n"),
        (Trouble(late=1, late_s=0.02, count=1), b"b\nc\na\n"),
        (Trouble(delay_s=0.01, jitter_s=0.01), b"a\nb\nc\n"),
    ],
)
async def test_each_trouble_is_what_it_says(trouble: Trouble, comes: bytes) -> None:
    async with line() as client:
        client.proxy.down = trouble
        await client.send(b"a\nb\nc\n")

        assert await client.comes(len(comes)) == comes
        assert await client.all_that_comes(0.03) == b""


@pytest.mark.parametrize("name", ["flip", "cut", "noise"])
async def test_damage_damages_and_is_the_same_for_the_same_seed(name: str) -> None:
    received = []
    for seed in (3, 3, 4):
        async with line(seed=seed) as client:
            client.proxy.up = Trouble(**{name: 0.5})
            for number in range(20):
                await client.send(b"message %d\n" % number)
                await asyncio.sleep(0)
            received.append(await client.all_that_comes(0.15))
            assert 3 < client.proxy.counts[f"up {name}"] < 17
    assert received[0] == received[1] != received[2]


async def test_a_stall_loses_nothing() -> None:
    async with line() as client:
        client.proxy.stall("down")
        await client.send(b"a\n", b"b\n")
        assert await client.all_that_comes() == b""
        client.proxy.go_on()

        assert await client.comes(4) == b"a\nb\n"


async def test_an_unplugged_cable_is_silent_and_breaks_connections_when_it_is_back() -> None:
    async with line() as client:
        client.proxy.unplug()
        await client.send(b"a\n")
        assert await client.all_that_comes() == b""
        client.proxy.plug_in()
        with pytest.raises((ConnectionResetError, asyncio.IncompleteReadError)):
            await client.comes(1)
        again = Line(client.proxy, *await asyncio.open_connection("127.0.0.1", client.proxy.port))
        await again.send(b"b\n")
        assert await again.comes(2) == b"b\n"
        again.writer.close()


async def test_reset_and_hang_up_differ_and_nobody_listens_after_refuse() -> None:
    async with line() as client:
        client.proxy.reset()
        with pytest.raises(ConnectionResetError):
            await client.comes(1)
        other = Line(client.proxy, *await asyncio.open_connection("127.0.0.1", client.proxy.port))
        await other.send(b"a\n")
        await other.comes(2)
        client.proxy.hang_up()
        assert await other.all_that_comes() == b""
        assert other.reader.at_eof()
        other.writer.close()
        client.proxy.refuse()
        with pytest.raises(ConnectionRefusedError):
            await asyncio.open_connection("127.0.0.1", client.proxy.port)
        await client.proxy.start()
        _, writer = await asyncio.open_connection("127.0.0.1", client.proxy.port)
        writer.close()


async def test_what_was_late_for_one_connection_haunts_the_next() -> None:
    async with line() as client:
        client.proxy.haunted = True
        client.proxy.down = Trouble(delay_s=5, count=1)
        await client.send(b"late\n")
        await asyncio.sleep(0.02)
        client.writer.close()
        await asyncio.sleep(0.02)
        again = Line(client.proxy, *await asyncio.open_connection("127.0.0.1", client.proxy.port))
        await again.send(b"b\n")

        assert await again.comes(7) == b"late\nb\n"
        assert client.proxy.counts["ghosts"] == 1
        again.writer.close()


async def test_a_server_that_does_not_listen_ends_the_client_s_connection() -> None:
    server = await asyncio.start_server(echo, "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    server.close()
    async with proxied(port) as proxy:
        reader, writer = await asyncio.open_connection("127.0.0.1", proxy.port)
        assert await reader.read() == b""
        writer.close()


@given(st.binary(max_size=200), st.lists(st.integers(1, 50)))
def test_framing_loses_and_invents_nothing(data: bytes, sizes: list[int]) -> None:
    for framing in (lines, modbus_frames):
        left, rest, found = data, b"", list[bytes]()
        for size in [*sizes, len(data)]:
            messages, rest = framing(rest + left[:size])
            left = left[size:]
            found += messages
        assert b"".join(found) + rest == data


@given(st.binary(max_size=60), st.integers(), st.sampled_from(["lose", "flip", "cut", "noise", "stale", "duplicate"]))
def test_every_message_has_a_fate(message: bytes, seed: int, name: str) -> None:
    drawn = fate(Trouble(**{name: 1.0}), message, b"before", random.Random(seed))

    assert drawn.names == (name,)
    if name == "flip" and message:
        (turned,) = drawn.arrives
        assert sum((a ^ b).bit_count() for a, b in zip(turned, message, strict=True)) == 1
