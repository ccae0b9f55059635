"""The driver's Modbus link against a server that does not behave."""

import asyncio
import random
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import pytest

from drivers.errors import DeviceError, Garbled, LinkLost, NoAnswer, Refused
from drivers.modbus import ModbusLink
from tests.modbus_wire import bank, frame, serving

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
    """Cancel in the very turn of the loop in which the answer arrives: a trap of wait_for in Python 3.11."""
    async with rude(lambda request: frame(struct.unpack(">H", request[:2])[0], GOOD)) as port:
        link = ModbusLink("plc", "127.0.0.1", port, within_s=5)
        await link.open()
        receive = link.data_received

        def cancel_on_arrival(data: bytes) -> None:
            question.cancel()
            receive(data)

        link.data_received = cancel_on_arrival  # type: ignore[method-assign]
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
