"""The line link against real sockets and pseudo terminals."""

import asyncio
import os
import random
import re
import tty
from contextlib import asynccontextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import Garbled, LinkLost, NoAnswer
from drivers.link import MOST_LINES, LineLink
from drivers.link_address import SerialAddress, TcpAddress, parse_address
from drivers.link_lines import LONGEST_LINE, LineSplitter


@asynccontextmanager
async def peer():
    """A TCP server; yields its address and a queue of (reader, writer) of those who came."""
    came: asyncio.Queue[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = asyncio.Queue()
    server = await asyncio.start_server(lambda r, w: came.put_nowait((r, w)), "127.0.0.1", 0)
    async with server:
        yield f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}", came
        while not came.empty():
            came.get_nowait()[1].close()


@asynccontextmanager
async def linked():
    """A link and the peer's end of it."""
    async with peer() as (address, came):
        link = LineLink(address, device="robot")
        await link.open()
        reader, writer = await came.get()
        try:
            yield link, reader, writer
        finally:
            await link.close()
            writer.close()


@pytest.fixture
def terminal():
    near, far = os.openpty()
    tty.setraw(far)
    os.set_blocking(near, False)
    yield near, os.ttyname(far)
    os.close(near)
    os.close(far)


def send_much(link):
    for _ in range(200_000):
        link.send("@" + "x" * 79)


# -- addresses -----------------------------------------------------------------------------------------------


def test_addresses_are_read():
    assert parse_address("tcp://192.168.0.2:23") == TcpAddress("192.168.0.2", 23)
    assert parse_address("serial:/dev/ttyS0") == SerialAddress("/dev/ttyS0", 9600, "odd", "xonxoff")
    assert parse_address("serial:/dev/ttyUSB0?baud=38400&parity=none&flow=rtscts") == SerialAddress(
        "/dev/ttyUSB0", 38400, "none", "rtscts"
    )


@pytest.mark.parametrize(
    ("address", "remedy"),
    [
        ("192.168.0.2:23", "write tcp://HOST:PORT or serial:"),
        ("tcp://192.168.0.2", "write tcp://192.168.0.2:23"),
        ("tcp://host:0", "from 1 to 65535"),
        ("tcp://host:70000", "from 1 to 65535"),
        ("tcp://host:23/path", "write tcp://"),
        ("serial:ttyS0", "write serial:/dev/ttyS0"),
        ("serial:/dev/ttyS0?baud=1234", "choose one of 4800, 9600"),
        ("serial:/dev/ttyS0?parity=mark", "choose one of none, odd, even"),
        ("serial:/dev/ttyS0?flow=", "choose one of none, xonxoff, rtscts"),
        ("serial:/dev/ttyS0?speed=9600", "there are baud, parity, flow"),
    ],
)
def test_a_bad_address_is_named_with_the_remedy(address, remedy):
    with pytest.raises(ValueError, match=re.escape(remedy)) as refused:
        LineLink(address, device="robot")

    assert address in str(refused.value)


# -- lines ---------------------------------------------------------------------------------------------------


def split(data, *, telnet=True):
    return LineSplitter(telnet=telnet).feed(data)


def test_lines_end_with_lf_and_lose_cr_and_nul():
    assert split(b"RUN\r\nEN\0D\r\n\r\nhalf") == (["RUN", "END", ""], b"")


def test_katakana_bytes_survive():
    assert split(b"5.30:\xb1\xb2\n")[0] == ["5.30:\xb1\xb2"]


def test_telnet_negotiation_is_swallowed_and_refused():
    lines, refusals = split(
        b"\xff\xfb\x01OK\xff\xfd\x03\r\n\xff\xfa\x18\x01\x02\xff\xf0\xff\xf1A\n\xff\xfe\x01\xff\xfc\x01"
    )

    assert lines == ["OK", "A"]
    assert refusals == b"\xff\xfe\x01\xff\xfc\x03"


def test_a_stray_ff_takes_no_line_end_with_it():
    assert split(b"A\xff\nB\n")[0] == ["A", "B"]


def test_a_serial_line_knows_no_telnet():
    assert split(b"\xff\xfb\x01\n", telnet=False) == (["\xff\xfb\x01"], b"")


@given(st.binary(max_size=200), st.lists(st.integers(1, 7), max_size=100), st.booleans())
def test_how_bytes_are_cut_into_pieces_does_not_matter(data, cuts, telnet):
    splitter, lines, refusals, rest = LineSplitter(telnet=telnet), [], b"", data
    for cut in [*cuts, len(data)]:
        new, answer = splitter.feed(rest[:cut])
        rest = rest[cut:]
        lines += new
        refusals += answer
    for byte in rest:
        new, answer = splitter.feed(bytes((byte,)))
        lines += new
        refusals += answer

    assert (lines, refusals) == split(data, telnet=telnet)


def test_twenty_thousand_pieces_of_noise_are_split_and_bounded():
    rng = random.Random(20261122)
    splitter, lines = LineSplitter(telnet=True), 0
    for _ in range(20_000):
        new, _ = splitter.feed(rng.randbytes(rng.randrange(12)) + rng.choice([b"\r\n", b"", b"OK\n", b"\xff"]))
        lines += len(new)
        assert all("\r" not in line and "\n" not in line and "\0" not in line for line in new)
    assert lines > 5_000
    assert not splitter.overlong


def test_a_line_without_end_is_noticed():
    splitter = LineSplitter(telnet=True)
    splitter.feed(b"x" * LONGEST_LINE)
    assert not splitter.overlong
    splitter.feed(b"x")
    assert splitter.overlong


# -- TCP -----------------------------------------------------------------------------------------------------


async def test_lines_go_both_ways_and_control_bytes_go_alone():
    async with linked() as (link, reader, writer):
        link.send("@?MODE")
        link.tell(b"\x03")
        assert await reader.readexactly(9) == b"@?MODE\r\n\x03"
        writer.write(b"2\r\nO")
        assert await link.line() == "2"
        writer.write(b"K\r\n")
        assert await link.line() == "OK"


async def test_nobody_listening_is_a_lost_link():
    async with peer() as (address, _):
        pass
    with pytest.raises(LinkLost, match="no connection to tcp://127"):
        await LineLink(address, device="robot").open()


async def test_a_link_that_was_never_opened_is_lost():
    link = LineLink("tcp://127.0.0.1:1", device="robot")

    with pytest.raises(LinkLost):
        await link.line()
    with pytest.raises(LinkLost):
        link.send("@?MODE")
    await link.close()


async def test_a_peer_that_hangs_up_is_a_lost_link():
    async with linked() as (link, _, writer):
        writer.close()
        with pytest.raises(LinkLost, match="hung up"):
            await link.line()
        assert not link.is_open
        with pytest.raises(LinkLost):
            link.send("@?MODE")


async def test_a_poisoned_link_delivers_nothing_more_and_opens_afresh():
    async with peer() as (address, came):
        link = LineLink(address, device="robot")
        await link.open()
        _, first = await came.get()
        first.write(b"late answer\r\n")
        await asyncio.sleep(0.02)
        link.poison("an answer did not come in time")
        with pytest.raises(LinkLost, match="did not come in time"):
            await link.line()

        await link.open()
        _, second = await came.get()
        second.write(b"new\r\n")
        assert await link.line() == "new"
        await link.close()
        for writer in (first, second):
            writer.close()


async def test_an_endless_line_is_garbled():
    async with linked() as (link, _, writer):
        writer.write(b"x" * (LONGEST_LINE + 1))
        with pytest.raises(Garbled, match="without a line end"):
            await link.line()


async def test_a_chatterbox_is_garbled_and_bounded():
    async with linked() as (link, _, writer):
        writer.write(b"x\r\n" * (MOST_LINES + 1))
        await asyncio.sleep(0.05)
        with pytest.raises(Garbled, match=f"more than {MOST_LINES} lines"):
            await link.line()


async def test_a_peer_that_reads_nothing_is_noticed():
    async with linked() as (link, _, writer):
        writer.transport.pause_reading()
        with pytest.raises(NoAnswer, match="does not take"):
            send_much(link)
        assert not link.is_open


# -- serial --------------------------------------------------------------------------------------------------


async def heard(near, count):
    data = b""
    while len(data) < count:
        try:
            data += os.read(near, 1000)
        except BlockingIOError:
            await asyncio.sleep(0.001)
    return data


async def test_a_serial_line_goes_both_ways(terminal):
    near, path = terminal
    link = LineLink(f"serial:{path}?baud=9600&parity=odd&flow=xonxoff", device="robot")
    await link.open()
    link.send("@?MODE")
    assert await heard(near, 8) == b"@?MODE\r\n"
    os.write(near, b"2\r\nOK\r\n")
    assert [await link.line(), await link.line()] == ["2", "OK"]
    await link.close()


async def test_a_serial_line_is_held_by_one_only(terminal):
    _, path = terminal
    link, other = (LineLink(f"serial:{path}", device="robot") for _ in range(2))
    await link.open()
    with pytest.raises(LinkLost, match="no connection"):
        await other.open()
    await link.close()
    await other.open()
    await other.close()


async def test_a_serial_port_that_is_not_there_is_a_lost_link():
    with pytest.raises(LinkLost, match="no connection to serial:/dev/nothing"):
        await LineLink("serial:/dev/nothing", device="robot").open()


async def test_bytes_of_an_earlier_conversation_are_not_delivered(terminal):
    near, path = terminal
    os.write(near, b"late answer\r\n")
    link = LineLink(f"serial:{path}", device="robot")
    await link.open()
    os.write(near, b"new\r\n")
    assert await link.line() == "new"
    await link.close()


async def test_a_serial_line_that_vanishes_is_a_lost_link():
    near, far = os.openpty()
    link = LineLink(f"serial:{os.ttyname(far)}", device="robot")
    await link.open()
    os.close(far)
    os.close(near)
    with pytest.raises(LinkLost):
        await link.line()
    with pytest.raises(LinkLost):
        link.send("@?MODE")
    await link.close()


async def test_a_held_serial_line_does_not_block_and_is_noticed(terminal):
    _, path = terminal  # nobody reads
    link = LineLink(f"serial:{path}", device="robot")
    await link.open()
    with pytest.raises(NoAnswer, match="does not take"):
        send_much(link)
    await link.close()
