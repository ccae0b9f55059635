"""The PLC driver's end of the wire: answers judged to the last byte, brands that turn bytes, words and addresses."""

import asyncio
import struct
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import DeviceError
from drivers.modbus_frames import NotTheAnswer, Question, Request, read, read_write, said, write
from drivers.plc import Plc
from drivers.plc_layout import Layout
from drivers.plc_tags import Value, values
from simulators.modbus import ModbusServer
from simulators.modbus_bank import Bank, Table
from tests.fault_proxy import proxied
from tests.plc_belt import eventually, powered, running
from tests.plc_storm import storm
from tests.wire_trouble import modbus_frames

WORD = st.integers(0, 0xFFFF)
WORDS = st.lists(WORD, min_size=1, max_size=120)
ADDRESS = st.integers(0, 0xFF00)


# -- one answer ------------------------------------------------------------------------------------------------


@st.composite
def asked(draw: st.DrawFn) -> tuple[Question, bytes, list[int]]:
    """Any question, its right answer as the specification spells it, and the words in it."""
    transaction, unit, address, words = draw(WORD), draw(st.integers(0, 255)), draw(ADDRESS), draw(WORDS)
    kind = draw(st.sampled_from(("FC3", "FC4", "FC16", "FC23")))
    request: Request
    if kind == "FC16":
        request, pdu, seen = write(address, words), struct.pack(">BHH", 16, address, len(words)), []
    else:
        code = int(kind[2:])
        request = read_write(address, len(words), 0, [1, 2]) if code == 23 else read(address, len(words), code)
        pdu, seen = struct.pack(f">BB{len(words)}H", code, 2 * len(words), *words), words
    frame = struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu
    return Question(transaction, unit, request), frame, seen


def verdict(question: Question, received: bytes) -> Sequence[int] | int | str | None:
    """Words, exception code, None (more must come), or what is wrong."""
    try:
        answer = question.answered_by(received)
    except NotTheAnswer as wrong:
        return str(wrong)
    return answer and (answer.exception or list(answer.words))


@given(asked())
def test_the_right_answer_is_taken_when_it_is_whole_and_never_before(case: tuple[Question, bytes, list[int]]) -> None:
    question, frame, words = case

    assert verdict(question, frame) == words
    assert {verdict(question, frame[:size]) for size in range(len(frame))} == {None}


@given(asked(), st.integers(1, 255))
def test_an_exception_is_told_with_its_code(case: tuple[Question, bytes, list[int]], code: int) -> None:
    question, frame, _ = case

    assert verdict(question, frame[:4] + b"\0\3" + frame[6:7] + bytes((frame[7] | 0x80, code))) == code


@given(asked(), st.binary(min_size=1, max_size=30), st.data())
def test_a_changed_answer_is_refused_or_waited_for_unless_only_its_words_changed(
    case: tuple[Question, bytes, list[int]], noise: bytes, data: st.DataObject
) -> None:
    question, frame, words = case
    at = data.draw(st.integers(0, len(frame)))
    changed = frame[:at] + noise + frame[data.draw(st.integers(at, len(frame))) :]

    found = verdict(question, changed)

    if isinstance(found, list):
        assert len(changed) == len(frame)
        assert changed[:9] == frame[:9]
        assert found == list(struct.unpack(f">{len(words)}H", changed[9:])) if words else changed == frame
    elif isinstance(found, int):
        assert changed[7] == frame[7] | 0x80
        assert changed[:4] + changed[6:7] == frame[:4] + frame[6:7]


@given(asked(), asked())
def test_the_answer_to_another_question_is_refused(
    case: tuple[Question, bytes, list[int]], other: tuple[Question, bytes, list[int]]
) -> None:
    question, frame, _ = case

    if other[1][:8] != frame[:8]:
        assert "instead of" in str(verdict(question, other[1]))


@given(asked())
def test_a_request_is_told_in_words(case: tuple[Question, bytes, list[int]]) -> None:
    request = case[0].request

    assert str(request) == said(request.pdu)
    assert str(request).startswith(f"FC{request.pdu[0]} ")


# -- thousands of bad answers ------------------------------------------------------------------------------------


async def test_of_late_doubled_and_reordered_answers_none_is_ever_taken_for_another() -> None:
    """`make bench-plc` does it with 10,000."""
    sent, taken = await storm(800)

    assert min(sent[kind] for kind in ("doubled", "out of turn", "late, on another connection")) > 50
    assert taken["wrong"] == 0
    assert taken["right"] > 500
    assert taken["NoAnswer"] > 50
    assert taken["Garbled"] > 250


async def test_the_number_of_a_question_goes_on_over_connections() -> None:
    async with powered() as (_, server), proxied(server.port, messages=modbus_frames) as proxy:
        async with running(Plc("127.0.0.1", proxy.port)) as plc:
            for _ in range(3):
                await plc.ready(within_s=2)
                await asyncio.sleep(0.05)
                proxy.reset()
                await eventually(lambda: bool(plc.seen().trouble))
        asked = [passed.message[:2] for passed in proxy.record if passed.direction == "up"]
        numbers = [int.from_bytes(message) for message in asked]

    assert proxy.counts["connections"] == 3
    assert len(numbers) > 10
    assert {(after - before) % 0x10000 for before, after in pairwise(numbers)} <= {1, 2}  # one may die on its way
    assert numbers[:2] != [1, 2]


# -- brands ------------------------------------------------------------------------------------------------------


def turned(words: Sequence[int], *, bytes_turned: bool, long_turned: bool) -> list[int]:
    """As another brand keeps the PLC's words."""
    words = list(words)
    if long_turned:
        words[11:13] = reversed(words[11:13])
    return [int.from_bytes(word.to_bytes(2, "little")) for word in words] if bytes_turned else words


@asynccontextmanager
async def brand(
    *, cell_at: int, plc_at: int, inputs: bool = False, bytes_turned: bool = False, long_turned: bool = False
) -> AsyncIterator[tuple[Any, ModbusServer]]:
    """The simulated PLC behind a server that keeps its registers elsewhere, in another order or in another table."""
    async with powered() as (world, plc):
        cell, own = range(cell_at, cell_at + 16), range(plc_at, plc_at + 32)
        bank = Bank(holding=cell, inputs=own) if inputs else Bank(holding=[*cell, *own])
        ours, shown = bank.tables[Table.HOLDING], bank.tables[Table.INPUTS if inputs else Table.HOLDING]

        def show(*_block: object) -> None:
            plc.modbus.bank.before_read(Table.HOLDING, 100, 32)
            words = [plc.memory[at] for at in range(100, 132)]
            shown.update(zip(own, turned(words, bytes_turned=bytes_turned, long_turned=long_turned), strict=True))

        def take(_table: Table, address: int, count: int) -> None:
            words = turned([ours[at] for at in cell], bytes_turned=bytes_turned, long_turned=False)
            plc.memory.update(enumerate(words))
            plc.modbus.bank.after_write(Table.HOLDING, 0, 16)
            show()

        bank.before_read, bank.after_write = show, take
        server = ModbusServer(bank)
        await server.start()
        try:
            yield world, server
        finally:
            await server.close()


@pytest.mark.parametrize(
    ("offered", "settings"),
    [
        ({"cell_at": 0x8000, "plc_at": 0x8064}, {"layout": Layout(0x8000, 0x8064)}),
        ({"cell_at": 0, "plc_at": 0, "inputs": True}, {"exchange": "fc4+fc16", "layout": Layout(plc_at=0)}),
        (
            {"cell_at": 0, "plc_at": 100, "long_turned": True},
            {"exchange": "fc3+fc16", "layout": Layout(low_word_first=True)},
        ),
        ({"cell_at": 7, "plc_at": 23, "bytes_turned": True}, {"layout": Layout(7, 23, low_byte_first=True)}),
        (
            {"cell_at": 65520, "plc_at": 65400, "bytes_turned": True, "long_turned": True},
            {"layout": Layout(65520, 65400, low_byte_first=True, low_word_first=True)},
        ),
    ],
    ids=["Beckhoff GVL", "CODESYS input registers", "Mitsubishi FX5", "bytes turned", "everything turned"],
)
async def test_a_unit_comes_and_goes_with_every_brand(offered: dict[str, Any], settings: dict[str, Any]) -> None:
    async with brand(**offered) as (world, server), running(Plc("127.0.0.1", server.port, **settings)) as plc:
        await plc.ready(within_s=2)
        arrival = await plc.bring_base(within_s=3)
        await plc.vacuum(True, within_s=1)
        await plc.light(2, True)
        await plc.release(arrival.carrier_id, good=True, within_s=3)

        assert (arrival.sequence, arrival.carrier_id) == (1, 501)
        assert arrival.age_s < 2
        assert world.left == [(501, True)]
        assert world.lights == {1: False, 2: True}
        assert world.valve_changes == [True]


async def test_turned_bytes_are_told_by_the_map_version_and_nothing_is_written() -> None:
    async with brand(cell_at=0, plc_at=100, bytes_turned=True) as (world, server):
        async with running(Plc("127.0.0.1", server.port)) as plc:
            with pytest.raises(DeviceError, match=r"register 10[13]"):
                await plc.ready(within_s=0.4)
        assert world.valve_changes == []
        assert not world.robot_enable


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"layout": Layout(cell_at=100)}, "cellctl's registers 100..115 overlap the PLC's 100..131"),
        ({"layout": Layout(cell_at=85)}, "cellctl's registers 85..100 overlap"),
        ({"layout": Layout(plc_at=65505)}, "the PLC's registers 65505..65536 are not all in 0..65535"),
        ({"layout": Layout(cell_at=-1)}, "cellctl's registers -1..14 are not all in"),
    ],
)
def test_registers_that_cannot_be_there_are_refused(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Plc("127.0.0.1", 1, **settings)


# -- ages --------------------------------------------------------------------------------------------------------


def by_name(found: list[Value]) -> dict[str, Value]:
    return {value.name: value for value in found}


async def test_every_value_has_its_age_and_the_time_since_it_changed() -> None:
    async with powered() as (world, server), running(Plc("127.0.0.1", server.port)) as plc:
        await plc.ready(within_s=2)
        await asyncio.sleep(0.1)
        world.safety(guard_open=True)
        await eventually(lambda: not plc.image.guard_closed)
        seen = by_name(values(plc.seen()))

        assert 0 <= seen["safety"].unchanged_s < 0.06
        assert 0.08 < seen["map version"].unchanged_s < 2.5
        assert seen["PLC heartbeat"].unchanged_s < 0.05
        assert seen["safety"].value["guard closed"] is False  # type: ignore[index,call-overload]
        assert {value.age_s < 0.06 for value in seen.values()} == {True}
        assert len(seen) == 30

        world.inject("mute")
        await asyncio.sleep(0.15)
        ages = {value.age_s for value in values(plc.seen()) if value.address >= 100}
        assert min(ages) == max(ages) > 0.14


async def test_the_newest_packets_are_kept_and_read_like_sentences() -> None:
    async with powered() as (_, server), running(Plc("127.0.0.1", server.port)) as plc:
        await plc.ready(within_s=2)
        await eventually(lambda: len(plc.seen().packets) == 400, within_s=6)
        packets = plc.seen().packets
        sent = [packet for packet in packets if packet.sent]

        assert len(sent) in (199, 200, 201)
        assert str(sent[-1]).endswith("FC23 reading registers 100..131 and writing registers 0..15")
        assert packets[-1].at_s - packets[0].at_s > 1


@pytest.mark.parametrize("exchange", ["fc23", "fc3+fc16", "fc4+fc16"])
async def test_an_exchange_of_two_requests_has_the_deadline_of_one(exchange: Any) -> None:
    async with brand(cell_at=0, plc_at=100, inputs=exchange == "fc4+fc16") as (_, server):
        plc = Plc("127.0.0.1", server.port, exchange=exchange)
        async with running(plc):
            await plc.ready(within_s=2)
            watch = asyncio.create_task(plc.unsafe())
            await asyncio.sleep(0.05)
            server.troubles.delay_s = 0.15 if exchange != "fc23" else 0.3  # of each answer

            assert "no answer within 200 ms" in await watch
