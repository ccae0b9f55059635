"""The line link against real sockets and pseudo terminals."""

import asyncio
import contextlib
import fcntl
import os
import random
import re
import termios
import tty
from contextlib import asynccontextmanager

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

import drivers.link
from drivers import link_serial
from drivers.errors import Garbled, LinkLost, NoAnswer
from drivers.link import MOST_LINES, LineLink
from drivers.link_address import BAUDS, FLOWS, PARITIES, SerialAddress, TcpAddress, parse_address
from drivers.link_lines import LONGEST_LINE, LineSplitter

TIOCGEXCL = 0x80045440  # asks whether a terminal is closed to others


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
    assert parse_address("/dev/ttyS0?baud=4800") == SerialAddress("/dev/ttyS0", 4800, "odd", "xonxoff")
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


@given(
    st.text(max_size=60)
    | st.builds(
        "{}{}{}".format,
        st.sampled_from(["tcp://", "serial:", "/dev/", "TCP://", ""]),
        st.text("abcdev/tyS0123456789.:[]@%", max_size=20),
        st.sampled_from(["", "?", "?baud=9600", "?baud=", "?parity=odd&flow", "?baud=1&baud=9600", ":23", ":x", "#f"]),
    )
)
def test_any_text_is_an_address_or_is_refused_with_itself_and_the_remedy(text):
    address = None
    with contextlib.suppress(ValueError):
        address = parse_address(text)
    if address is None:
        with pytest.raises(ValueError, match=re.escape(repr(text))):
            parse_address(text)
    elif isinstance(address, TcpAddress):
        assert address.host
        assert 1 <= address.port <= 65535
    else:
        assert address.path.startswith("/")
        assert (address.parity in PARITIES, address.flow in FLOWS, address.baud in BAUDS) == (True, True, True)


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


async def test_a_held_serial_line_is_closed_to_other_programs_too_and_opened_again_afterwards(terminal):
    _, path = terminal
    link = LineLink(path, device="robot")
    await link.open()
    with pytest.raises(LinkLost, match=f"{path} is in use by another program"):
        await LineLink(path, device="robot").open()
    assert exclusive(path)
    await link.close()
    assert not exclusive(path)


def exclusive(path):
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        return fcntl.ioctl(fd, TIOCGEXCL, b"\0\0\0\0") != b"\0\0\0\0"
    finally:
        os.close(fd)


@pytest.mark.parametrize(
    ("settings", "flags", "speed"),
    [
        ("", termios.IXON | termios.IXOFF, termios.B9600),
        ("?baud=38400&flow=none", 0, termios.B38400),
        ("?baud=115200&flow=rtscts", 0, termios.B115200),
    ],
)
async def test_a_serial_port_gets_its_settings(terminal, settings, flags, speed):
    _, path = terminal
    link = LineLink(f"serial:{path}{settings}", device="robot")
    await link.open()
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    input_flags, _, control, local, *speeds, _ = termios.tcgetattr(fd)
    os.close(fd)
    await link.close()
    assert input_flags & (termios.IXON | termios.IXOFF) == flags
    assert bool(control & termios.CRTSCTS) is ("rtscts" in settings)
    assert control & termios.CSIZE == termios.CS8
    assert not control & termios.CSTOPB
    assert not local & (termios.ICANON | termios.ECHO)
    assert speeds == [speed, speed]


@pytest.mark.parametrize("parity", ["none", "odd", "even"])
async def test_a_real_port_gets_its_parity(terminal, parity, monkeypatch):
    """A pseudo terminal has none, so it is the request for it that is looked at."""
    asked = {}

    class Port(serial.Serial):
        def __init__(self, *args, **settings):
            asked.update(settings)
            super().__init__(*args, **settings | {"parity": serial.PARITY_NONE})

    monkeypatch.setattr(serial, "Serial", Port)
    monkeypatch.setattr(link_serial, "_has_no_parity", lambda path: False)
    link = LineLink(f"{terminal[1]}?parity={parity}", device="robot")
    await link.open()
    await link.close()
    assert asked["parity"] == {"none": "N", "odd": "O", "even": "E"}[parity]
    assert asked["exclusive"] is True


@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("/dev/nothing", "there is no /dev/nothing: is the adapter plugged in"),
        ("/dev/null", "/dev/null is no serial port"),
    ],
)
async def test_a_port_that_cannot_be_opened_is_named_with_the_reason(path, why):
    with pytest.raises(LinkLost, match=re.escape(f"no connection to serial:{path}: {why}")):
        await LineLink(f"serial:{path}", device="robot").open()


async def test_what_is_sent_can_be_waited_for_until_it_is_taken(terminal):
    near, path = terminal
    link = LineLink(path, device="robot")
    await link.open()
    reading = asyncio.create_task(heard(near, 300 * 82))
    for _ in range(300):
        link.send("@" + "x" * 79)
        await link.drained()
    assert len(await reading) == 300 * 82
    await link.close()


async def test_a_line_that_is_not_taken_in_time_is_told(terminal, monkeypatch):
    monkeypatch.setattr(drivers.link, "DRAIN_S", 0.05)
    link = LineLink(terminal[1], device="robot")
    await link.open()
    with pytest.raises(NoAnswer, match="does not take"):
        await send_and_wait(link)


async def send_and_wait(link):
    for _ in range(1000):
        link.send("@" + "x" * 79)
        await link.drained()


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
