"""The strict Modbus server on the wire: pieces, floods, many clients, and what is not Modbus."""

import asyncio
import random
import socket
import struct
import time
import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.modbus import QUIET_S, Exchange, ModbusServer, Units
from simulators.modbus_frames import BadFrame, split_frames
from tests.benchmarks.fuzz_modbus import GROWTH_BLOCKS, SLOW_MS, DriverSide, ServerSide, fuzzed
from tests.modbus_wire import frame, one_frame, raw, serving


@given(st.lists(st.tuples(st.integers(0, 0xFFFF), st.integers(0, 255), st.binary(min_size=1, max_size=253))), st.data())
def test_frames_survive_any_fragmentation(frames: list[tuple[int, int, bytes]], data: st.DataObject) -> None:
    stream = b"".join(frame(transaction, pdu, unit=unit) for transaction, unit, pdu in frames)
    found, rest = [], b""
    while stream:
        size = data.draw(st.integers(1, len(stream)))
        some, rest = split_frames(rest + stream[:size])
        found += some
        stream = stream[size:]

    assert (found, rest) == (frames, b"")


@given(st.binary(max_size=600))
def test_any_bytes_are_frames_or_a_reason_to_close(data: bytes) -> None:
    try:
        frames, rest = split_frames(data)
    except BadFrame:
        return
    assert sum(len(pdu) + 7 for _, _, pdu in frames) + len(rest) == len(data)
    assert len(rest) < 260


@pytest.mark.parametrize("side", [ServerSide, DriverSide])
async def test_thousands_of_broken_frames_crash_and_deceive_neither_side(side: type[ServerSide | DriverSide]) -> None:
    result = await fuzzed(side(seed=4), 6000, warm=3000)

    assert result["crashes"] == []
    assert result["slowest_ms"] < SLOW_MS
    assert result["growth_blocks"] < GROWTH_BLOCKS
    assert min(result["outcomes"].values()) > 5
    assert len(result["outcomes"]) >= 4


async def test_pipelined_requests_are_answered_all_and_in_order() -> None:
    async with serving() as server, raw(server) as (reader, writer):
        writes = [frame(n, struct.pack(">BHH", 6, 0, n)) for n in range(100)]
        writer.write(b"".join(writes) + frame(100, bytes.fromhex("0300000001")))

        answers = [await one_frame(reader) for _ in range(101)]

    assert answers[:100] == writes
    assert answers[100] == frame(100, bytes.fromhex("03020063"))


async def test_a_request_may_come_byte_by_byte() -> None:
    async with serving() as server, raw(server) as (reader, writer):
        for byte in frame(7, bytes.fromhex("1700000001000100010200ff")):
            writer.write(bytes([byte]))
            await writer.drain()
            await asyncio.sleep(0)

        assert await one_frame(reader) == frame(7, bytes.fromhex("17020000"))


@pytest.mark.parametrize(
    "bad",
    [
        frame(1, bytes(254)),
        frame(1, b"", length=1),
        frame(1, b"", length=0),
        b"GET / HTTP/1.1\r\n\r\n",
    ],
)
async def test_what_is_not_modbus_tcp_ends_that_connection_only(bad: bytes) -> None:
    async with serving() as server, raw(server) as (other_reader, other_writer), raw(server) as (reader, writer):
        writer.write(bad)
        with pytest.raises((asyncio.IncompleteReadError, ConnectionResetError)):
            await one_frame(reader)
        other_writer.write(frame(2, bytes.fromhex("0300000001")))

        assert await one_frame(other_reader) == frame(2, bytes.fromhex("03020000"))


async def test_random_bytes_on_the_wire_leave_the_server_serving() -> None:
    source = random.Random(5)
    async with serving() as server:
        for _ in range(60):
            async with raw(server) as (_, writer):
                writer.write(source.randbytes(source.randrange(1, 400)))
        async with raw(server) as (reader, writer):
            writer.write(frame(1, bytes.fromhex("0300000001")))
            assert await one_frame(reader) == frame(1, bytes.fromhex("03020000"))


async def test_a_frame_of_another_protocol_is_discarded_without_a_word() -> None:
    async with serving() as server, raw(server) as (reader, writer):
        read = bytes.fromhex("0300000001")
        writer.write(frame(1, read, protocol=1) + frame(2, read) + frame(3, read, protocol=0xFFFF) + frame(4, read))
        answers = [await one_frame(reader) for _ in range(2)]

    assert [answer[:2] for answer in answers] == [b"\0\2", b"\0\4"]


UNITS = {
    Units.OWN: ["03020000", "03020000", "03020000", "830b"],
    Units.ANY: ["03020000", "03020000", "03020000", "03020000"],
    Units.GATEWAY: ["03020000", None, "830b", "830b"],
}


@pytest.mark.parametrize("units", UNITS)
async def test_units_are_served_as_told(units: Units) -> None:
    async with serving(unit_id=9, units=units) as server, raw(server) as (reader, writer):
        for unit in (9, 0, 255, 1):
            writer.write(frame(unit, bytes.fromhex("0300000001"), unit=unit))
        wanted = [(unit, pdu) for unit, pdu in zip((9, 0, 255, 1), UNITS[units], strict=True) if pdu]
        answers = [await one_frame(reader) for _ in wanted]

    assert [(answer[6], answer[7:].hex()) for answer in answers] == wanted


async def test_a_broadcast_is_executed_and_not_answered() -> None:
    async with serving(unit_id=9, units=Units.GATEWAY) as server, raw(server) as (reader, writer):
        writer.write(frame(1, bytes.fromhex("060000002a"), unit=0) + frame(2, bytes.fromhex("0300000001"), unit=9))

        assert await one_frame(reader) == frame(2, bytes.fromhex("0302002a"), unit=9)


async def test_the_listener_hears_of_every_request_and_what_came_of_it() -> None:
    heard: list[Exchange] = []
    async with serving() as server, raw(server) as (reader, writer):
        server.listener = heard.append
        writer.write(frame(7, bytes.fromhex("0300000001")) + frame(8, bytes.fromhex("99")))
        await one_frame(reader)
        await one_frame(reader)
        client = "{}:{}".format(*writer.get_extra_info("sockname"))

    assert [entry[1:] for entry in heard] == [
        (client, 7, 1, bytes.fromhex("0300000001"), bytes.fromhex("03020000")),
        (client, 8, 1, b"\x99", bytes.fromhex("9901")),
    ]
    assert server.functions == {3: 1, 0x99: 1}


async def test_one_client_too_many_is_shown_the_door() -> None:
    async with serving(most_clients=1) as server, raw(server) as (first_reader, first), raw(server) as (reader, writer):
        writer.write(frame(1, bytes.fromhex("0300000001")))
        with pytest.raises((asyncio.IncompleteReadError, ConnectionResetError)):
            await one_frame(reader)
        first.write(frame(1, bytes.fromhex("0300000001")))

        assert await one_frame(first_reader) == frame(1, bytes.fromhex("03020000"))


async def test_a_client_that_was_quiet_for_long_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    read = frame(1, bytes.fromhex("0300000001"))
    async with serving(most_clients=2) as server, raw(server) as (quiet, _), raw(server) as (reader, busy):
        monkeypatch.setattr("simulators.modbus.QUIET_S", 0.05)
        await asyncio.sleep(0.06)
        busy.write(read)
        await one_frame(reader)
        async with raw(server) as (new_reader, new):
            with pytest.raises(ConnectionResetError):
                await one_frame(quiet)
            for each_reader, each in ((reader, busy), (new_reader, new)):
                each.write(read)
                assert await one_frame(each_reader) == frame(1, bytes.fromhex("03020000"))
    assert QUIET_S >= 1


async def flood(server: ModbusServer, requests: bytes) -> asyncio.StreamWriter:
    """A client that asks for much and never reads an answer."""
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    deaf.setblocking(False)
    await asyncio.get_running_loop().sock_connect(deaf, ("127.0.0.1", server.port))
    _, writer = await asyncio.open_connection(sock=deaf, limit=1)
    writer.write(requests)
    return writer


async def test_clients_that_flood_and_never_read_cost_the_others_little_and_the_server_no_memory() -> None:
    big = frame(1, bytes.fromhex("030064001e"))
    async with serving() as server, raw(server) as (reader, polite):
        tracemalloc.start()
        floods = [await flood(server, big * 10_000) for _ in range(4)]
        before, took_s = tracemalloc.get_traced_memory()[0], []
        for _ in range(100):
            began_s = time.perf_counter()
            polite.write(big)
            await one_frame(reader)
            took_s.append(time.perf_counter() - began_s)
        grown = tracemalloc.get_traced_memory()[1] - before
        tracemalloc.stop()
        for writer in floods:
            writer.transport.abort()

    assert sorted(took_s)[50] < 0.05
    assert max(took_s) < 0.5
    assert grown < 2 << 20
    assert server.requests < 4 * 10_000 * 0.8


async def test_a_flood_is_not_read_without_bound() -> None:
    async with serving() as server, raw(server) as (_, writer):
        server.troubles.delay_s = 5.0
        writer.write(frame(1, bytes.fromhex("0300000001")) * 60_000)
        await asyncio.sleep(0.3)

        assert 64 <= server.requests < 40_000


async def test_delayed_answers_keep_their_order() -> None:
    async with serving() as server, raw(server) as (reader, writer):
        server.troubles.delay_s = 0.02
        writer.write(b"".join(frame(n, bytes.fromhex("0300000001")) for n in range(400)))

        transactions = [struct.unpack(">H", (await one_frame(reader))[:2])[0] for _ in range(400)]

    assert transactions == list(range(400))
