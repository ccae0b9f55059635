"""The strict Modbus server against the book, pymodbus and raw bytes; the driver's link against a rude server."""

import asyncio
import random
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client import AsyncModbusTcpClient

from drivers.errors import DeviceError, Garbled, LinkLost, NoAnswer, Refused
from drivers.modbus import ModbusLink
from simulators.modbus import ModbusServer
from simulators.modbus_bank import BadFrame, Bank, Identity, Table, respond, split_frames


def bank() -> Bank:
    return Bank(
        coils=range(0, 100),
        discretes=range(0, 50),
        holding=[*range(0, 16), *range(100, 132)],
        inputs=range(0, 20),
        read_only=range(100, 132),
    )


def ask(pdu_hex: str, of: Bank | None = None) -> str:
    return respond(of or bank(), Identity(), bytes.fromhex(pdu_hex)).hex(" ")


def frame(transaction: int, pdu: bytes, *, unit: int = 1, protocol: int = 0, length: int | None = None) -> bytes:
    return struct.pack(">HHHB", transaction, protocol, len(pdu) + 1 if length is None else length, unit) + pdu


@asynccontextmanager
async def serving(of: Bank | None = None, **options: int) -> AsyncIterator[ModbusServer]:
    server = ModbusServer(of or bank(), **options)  # type: ignore[arg-type]
    await server.start()
    try:
        yield server
    finally:
        await server.close()


@asynccontextmanager
async def raw(server: ModbusServer) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    try:
        yield reader, writer
    finally:
        writer.close()


async def one_frame(reader: asyncio.StreamReader) -> bytes:
    async with asyncio.timeout(2):
        head = await reader.readexactly(6)
        return head + await reader.readexactly(struct.unpack(">H", head[4:])[0])


# -- requests by the book (examples of the specification where it has one) -----------------------------------------


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("03 0064 0002", "03 04 00 00 00 00"),
        ("04 0000 0001", "04 02 00 00"),
        ("06 0001 0003", "06 00 01 00 03"),
        ("10 0001 0002 04 000a 0102", "10 00 01 00 02"),
        ("05 0010 ff00", "05 00 10 ff 00"),
        ("0f 0013 000a 02 cd01", "0f 00 13 00 0a"),
        ("16 0004 00f2 0025", "16 00 04 00 f2 00 25"),
        ("17 0003 0001 0003 0001 02 00ff", "17 02 00 ff"),
        ("2b 0e 01 00", "2b 0e 01 83 00 00 03 00 07 63 65 6c 6c 63 74 6c 01 10 73 69 6d 75 6c 61 74 65 64 20 73 65 "
         "72 76 65 72 02 03 31 2e 30"),
        ("2b 0e 04 02", "2b 0e 04 83 00 00 01 02 03 31 2e 30"),
        ("2b 0e 01 77", "2b 0e 01 83 00 00 03 00 07 63 65 6c 6c 63 74 6c 01 10 73 69 6d 75 6c 61 74 65 64 20 73 65 "
         "72 76 65 72 02 03 31 2e 30"),
    ],
)  # fmt: skip
def test_a_right_request_gets_the_answer_of_the_book(request_hex: str, answer_hex: str) -> None:
    assert ask(request_hex) == bytes.fromhex(answer_hex).hex(" ")


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("07", "87 01"),  # no such function here
        ("2b 0d 01 00", "ab 01"),  # no such MEI type
        ("2b", "ab 01"),
        ("2b 0e 05 00", "ab 03"),
        ("2b 0e 04 55", "ab 02"),
        ("03 0000 0000", "83 03"),
        ("03 0000 007e", "83 03"),
        ("03 0000 0001 00", "83 03"),  # a byte too many
        ("03 0000", "83 03"),
        ("03 000f 0002", "83 02"),  # 16 does not exist
        ("03 ffff 0001", "83 02"),
        ("03 ffff 0000", "83 03"),  # quantity is checked before the address
        ("01 0000 07d1", "81 03"),
        ("02 0032 0001", "82 02"),
        ("05 0000 0001", "85 03"),
        ("05 0064 ff00", "85 02"),
        ("06 0064 0001", "86 02"),  # read only
        ("0f 0000 000a 01 ff", "8f 03"),  # wrong byte count
        ("10 0000 0002 04 0001", "90 03"),  # too short
        ("10 0000 007c f8" + "00" * 248, "90 03"),
        ("16 0000 ffff", "96 03"),
        ("17 0064 0001 0064 0001 02 0000", "97 02"),  # writes what is read only
        ("17 0064 007e 0000 0001 02 0000", "97 03"),
        ("17 0064 0001 0000 0001 03 000000", "97 03"),
    ],
)
def test_a_wrong_request_gets_the_exception_of_the_book(request_hex: str, answer_hex: str) -> None:
    assert ask(request_hex) == answer_hex


def test_mask_write_follows_the_formula_of_the_specification() -> None:
    registers = bank()
    registers.write(Table.HOLDING, 4, [0x12])

    ask("16 0004 00f2 0025", registers)

    assert registers.tables[Table.HOLDING][4] == 0x17


def test_coils_are_packed_with_the_first_in_the_lowest_bit() -> None:
    coils = bank()

    ask("0f 0013 000a 02 cd01", coils)

    assert ask("01 0013 000a", coils) == "01 02 cd 01"
    assert [coils.tables[Table.COILS][at] for at in range(19, 29)] == [1, 0, 1, 1, 0, 0, 1, 1, 1, 0]


def test_fc23_writes_before_it_reads_and_a_refused_one_writes_nothing() -> None:
    registers = bank()

    assert ask("17 0000 0002 0001 0001 02 beef", registers) == "17 04 00 00 be ef"
    assert ask("17 0010 0001 0001 0001 02 dead", registers) == "97 02"
    assert registers.tables[Table.HOLDING][1] == 0xBEEF


def test_a_long_identity_is_handed_out_in_pieces() -> None:
    identity = Identity({number: bytes([65 + number]) * 90 for number in range(5)})

    first = respond(bank(), identity, bytes.fromhex("2b0e0300"))
    second = respond(bank(), identity, bytes((0x2B, 0x0E, 3, first[5])))

    assert first[4:7] == bytes((0xFF, 2, 2))
    assert second[4:7] == bytes((0xFF, 4, 2))
    assert max(len(first), len(second)) <= 253


# -- fuzz ----------------------------------------------------------------------------------------------------------


def assert_proper(pdu: bytes, answer: bytes) -> None:
    assert 2 <= len(answer) <= 253
    assert answer[0] & 0x7F == pdu[0] & 0x7F
    if answer[0] & 0x80:
        assert len(answer) == 2
        assert answer[1] in (1, 2, 3)


def plausible(source: random.Random) -> bytes:
    """A request that is right but perhaps for its addresses."""
    address, count, values = source.randrange(120), source.randrange(1, 12), source.randbytes(40)
    function = source.choice((1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43))
    if function in (1, 2, 3, 4):
        body = struct.pack(">HH", address, count)
    elif function == 5:
        body = struct.pack(">HH", address, source.choice((0, 0xFF00)))
    elif function == 6:
        body = struct.pack(">H", address) + values[:2]
    elif function == 15:
        body = struct.pack(">HHB", address, count, (count + 7) // 8) + values[: (count + 7) // 8]
    elif function == 16:
        body = struct.pack(">HHB", address, count, 2 * count) + values[: 2 * count]
    elif function == 22:
        body = struct.pack(">H", address) + values[:4]
    elif function == 23:
        body = struct.pack(">HHHHB", address, count, 0, count, 2 * count) + values[: 2 * count]
    else:
        body = bytes((14, source.randrange(1, 5), source.randrange(4)))
    return bytes([function]) + body


def test_twenty_thousand_random_requests_get_proper_answers() -> None:
    source = random.Random(20261122)
    registers, answered, refused = bank(), 0, 0
    addresses = {table: set(values) for table, values in registers.tables.items()}
    for number in range(20_000):
        pdu = source.randbytes(source.randrange(1, 253)) if number % 4 == 0 else plausible(source)
        if number % 4 == 1:
            at = source.randrange(len(pdu))
            pdu = pdu[:at] + source.randbytes(1) + pdu[at + 1 :]
        answer = respond(registers, Identity(), pdu)
        assert_proper(pdu, answer)
        answered += answer[0] < 0x80
        refused += answer[0] >= 0x80
    assert answered + refused == 20_000
    assert min(answered, refused) > 4000
    assert {table: set(values) for table, values in registers.tables.items()} == addresses
    assert all(0 <= value <= 0xFFFF for values in registers.tables.values() for value in values.values())


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


# -- on the wire ---------------------------------------------------------------------------------------------------


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
        frame(1, bytes.fromhex("0300000001"), protocol=1),
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


async def test_units_are_its_own_and_the_two_that_mean_no_unit() -> None:
    async with serving(unit_id=9) as server, raw(server) as (reader, writer):
        for unit in (9, 0, 255, 1):
            writer.write(frame(unit, bytes.fromhex("0300000001"), unit=unit))
        answers = [await one_frame(reader) for _ in range(4)]

    assert [answer[7:].hex() for answer in answers] == ["03020000", "03020000", "03020000", "830b"]
    assert [answer[6] for answer in answers] == [9, 0, 255, 1]


async def test_one_client_too_many_is_shown_the_door() -> None:
    async with serving(most_clients=1) as server, raw(server) as (first_reader, first), raw(server) as (reader, writer):
        writer.write(frame(1, bytes.fromhex("0300000001")))
        with pytest.raises((asyncio.IncompleteReadError, ConnectionResetError)):
            await one_frame(reader)
        first.write(frame(1, bytes.fromhex("0300000001")))

        assert await one_frame(first_reader) == frame(1, bytes.fromhex("03020000"))


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


async def test_hooks_run_inside_the_request() -> None:
    registers = bank()
    seen: list[tuple[str, Table, int, int]] = []

    def double(table: Table, address: int, count: int) -> None:
        seen.append(("write", table, address, count))
        registers.tables[Table.HOLDING][100] = 2 * registers.tables[Table.HOLDING][0]

    registers.after_write = double
    registers.before_read = lambda table, address, count: seen.append(("read", table, address, count))

    assert ask("17 0064 0001 0000 0001 02 0015", registers) == "17 02 00 2a"
    assert seen == [("write", Table.HOLDING, 0, 1), ("read", Table.HOLDING, 100, 1)]


async def test_pymodbus_as_a_third_party_reads_and_writes_everything() -> None:
    registers = bank()
    registers.tables[Table.DISCRETES].update({0: 1, 3: 1, 9: 1})
    registers.tables[Table.INPUTS].update({0: 0xCAFE})
    async with serving(registers) as server:
        client = AsyncModbusTcpClient("127.0.0.1", port=server.port, retries=0, reconnect_delay=0, timeout=1)
        await client.connect()
        try:
            await client.write_coils(19, [True, False, True, True, False, False, True, True, True, False])
            await client.write_coil(50, True)
            await client.write_registers(0, [1, 2, 3])
            await client.write_register(3, 4)
            await client.mask_write_register(address=3, and_mask=0xFFF0, or_mask=0x000A)
            both = await client.readwrite_registers(read_address=0, read_count=5, write_address=4, values=[5])
            coils = await client.read_coils(19, count=10)
            inputs = await client.read_discrete_inputs(0, count=10)
            words = await client.read_input_registers(0, count=1)
            about = await client.read_device_information()
            refused = await client.read_holding_registers(16, count=1)
        finally:
            client.close()

    assert both.registers == [1, 2, 3, 0xA, 5]
    assert coils.bits[:10] == [True, False, True, True, False, False, True, True, True, False]
    assert inputs.bits[:10] == [True, False, False, True, False, False, False, False, False, True]
    assert words.registers == [0xCAFE]
    assert about.information == {0: b"cellctl", 1: b"simulated server", 2: b"1.0"}
    assert refused.isError()
    assert refused.exception_code == 2


# -- the driver's link against a server that does not behave -------------------------------------------------------

Rude = Callable[[bytes], Awaitable[bytes | None] | bytes | None]


@asynccontextmanager
async def rude(answer: Rude) -> AsyncIterator[int]:
    """A server that answers whole frames with what `answer` makes of them; None closes."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while True:
                head = await reader.readexactly(6)
                request = head + await reader.readexactly(struct.unpack(">H", head[4:])[0])
                reply = answer(request)
                reply = await reply if isinstance(reply, Awaitable) else reply
                if reply is None:
                    break
                writer.write(reply)
                await writer.drain()
        except (asyncio.IncompleteReadError, ConnectionError):
            pass
        finally:
            writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()
        await asyncio.sleep(0.01)  # the clients have gone: their tasks end


async def fail(port: int, within_s: float = 0.2) -> DeviceError:
    """Read two registers, which must not work."""
    link = ModbusLink("plc", "127.0.0.1", port, within_s=within_s)
    await link.open()
    with pytest.raises(DeviceError) as caught:
        await link.read(100, 2)
    with pytest.raises(DeviceError):  # after an error the connection is of no more use
        await link.read(100, 2)
    link.close()
    return caught.value


GOOD = bytes.fromhex("0304 00010002")


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (lambda request: frame(9999, GOOD), "transaction 9999 instead of 1"),
        (lambda request: frame(0, GOOD), "transaction 0 instead of 1"),
        (lambda request: frame(1, GOOD, unit=3), "unit 3 instead of 1"),
        (lambda request: frame(1, GOOD, protocol=5), "protocol id 5 instead of 0"),
        (lambda request: frame(1, bytes.fromhex("0404 00010002")), "function 4 instead of 3"),
        (lambda request: frame(1, bytes.fromhex("0302 0001")), "length 5 instead of 7"),
        (lambda request: frame(1, bytes.fromhex("0306 000100020003")), "length 9 instead of 7"),
        (lambda request: frame(1, bytes.fromhex("0303 00010002")), "byte count 3 instead of 4"),
        (lambda request: frame(1, GOOD) + b"xyz", "3 bytes too many"),
        (lambda request: b"HTTP/1.1 400 Bad Request\r\n", "protocol id"),
    ],
)
async def test_a_wrong_answer_is_garbled_at_once_and_says_what_is_wrong(answer: Rude, said: str) -> None:
    async with rude(answer) as port:
        started_s = asyncio.get_running_loop().time()
        error = await fail(port, within_s=1.0)

        assert isinstance(error, Garbled)
        assert said in error.detail
        assert asyncio.get_running_loop().time() - started_s < 0.5


@pytest.mark.parametrize(
    ("code", "said"),
    [(1, "illegal function"), (2, "illegal data address"), (6, "server device busy"), (99, "unknown exception")],
)
async def test_an_exception_answer_is_refused_with_its_code_and_name(code: int, said: str) -> None:
    async with rude(lambda request: frame(1, bytes((0x83, code)))) as port:
        error = await fail(port)

    assert isinstance(error, Refused)
    assert error.code == f"exception {code}"
    assert said in error.detail
    assert "registers 100..101" in error.detail


async def test_a_connection_that_breaks_during_a_request_is_noticed_at_once() -> None:
    async with rude(lambda request: None) as port:
        started_s = asyncio.get_running_loop().time()
        error = await fail(port, within_s=5.0)

        assert isinstance(error, LinkLost)
        assert asyncio.get_running_loop().time() - started_s < 1.0


async def test_nobody_listening_is_link_lost_with_the_address() -> None:
    async with serving() as server:
        port = server.port
    link = ModbusLink("plc", "127.0.0.1", port)
    with pytest.raises(LinkLost, match=f"127.0.0.1:{port}"):
        await link.open()


async def test_a_late_answer_is_never_taken_for_a_later_question() -> None:
    questions = 0

    async def first_one_late(request: bytes) -> bytes:
        nonlocal questions
        questions += 1
        value = questions
        await asyncio.sleep(0.15 if value == 1 else 0)
        return frame(struct.unpack(">H", request[:2])[0], struct.pack(">BBHH", 3, 4, value, value))

    async with rude(first_one_late) as port:
        error = await fail(port, within_s=0.1)
        link = ModbusLink("plc", "127.0.0.1", port)
        await link.open()
        later = [await link.read(100, 2) for _ in range(3)]
        await asyncio.sleep(0.1)
        later.append(await link.read(100, 2))
        link.close()

    assert isinstance(error, NoAnswer)
    assert later == [[2, 2], [3, 3], [4, 4], [5, 5]]


async def test_bytes_that_nobody_asked_for_make_the_next_question_fail() -> None:
    async def answer_twice(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(12)
        writer.write(frame(1, GOOD))
        await asyncio.sleep(0.02)
        writer.write(frame(2, GOOD))
        await reader.read()
        writer.close()

    server = await asyncio.start_server(answer_twice, "127.0.0.1", 0)
    link = ModbusLink("plc", "127.0.0.1", server.sockets[0].getsockname()[1])
    await link.open()
    assert await link.read(100, 2) == [1, 2]
    await asyncio.sleep(0.06)
    with pytest.raises(Garbled, match="not asked for"):
        await link.read(100, 2)
    server.close()
    await asyncio.sleep(0.01)


async def test_a_cancelled_question_closes_the_connection() -> None:
    async def never(request: bytes) -> bytes | None:
        await asyncio.sleep(0.5)
        return None

    async with rude(never) as port:
        link = ModbusLink("plc", "127.0.0.1", port, within_s=5)
        await link.open()
        question = asyncio.create_task(link.read(100, 2))
        await asyncio.sleep(0.02)
        question.cancel()
        with pytest.raises(asyncio.CancelledError):
            await question
        with pytest.raises(LinkLost):
            await link.read(100, 2)


async def test_a_cancellation_that_meets_the_answer_is_not_swallowed() -> None:
    """The trap of wait_for in Python 3.11: cancel in the very turn of the loop in which the answer arrives."""
    async with rude(lambda request: frame(struct.unpack(">H", request[:2])[0], GOOD)) as port:
        link = ModbusLink("plc", "127.0.0.1", port, within_s=5)
        await link.open()
        inspect = link._client.ctx.trace_packet

        def cancel_on_arrival(sending: bool, data: bytes) -> bytes:
            if not sending:
                question.cancel()
            return inspect(sending, data)

        link._client.ctx.trace_packet = cancel_on_arrival
        question = asyncio.create_task(link.read(100, 2))
        with pytest.raises(asyncio.CancelledError):
            await question
        link.close()


async def test_random_answers_are_typed_errors_in_time() -> None:
    source = random.Random(11)
    async with rude(lambda request: request[:2] + source.randbytes(source.randrange(0, 40))) as port:
        for _ in range(40):
            error = await fail(port, within_s=0.03)
            assert isinstance(error, Garbled | NoAnswer)


async def test_the_link_reads_and_writes_through_all_three_functions() -> None:
    registers = bank()
    async with serving(registers) as server:
        link = ModbusLink("plc", "127.0.0.1", server.port)
        await link.open()
        await link.write(0, [1, 2, 3])
        assert await link.read_write(0, 4, 3, [4]) == [1, 2, 3, 4]
        assert await link.read(2, 2) == [3, 4]
        link.close()
        link.close()
