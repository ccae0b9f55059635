"""Answers of the PLC that are late, stale, doubled, damaged or those of another program: none is taken for a right one.

P2 to P5 of the failure catalogue; judged by what the PLC's server truly answered and when.
"""

import asyncio
import contextlib
import struct
import time

import pytest

from drivers.errors import DeviceError, Mismatch
from drivers.modbus_frames import NotTheAnswer, Question, Request, read, read_write, write
from drivers.plc import Plc
from simulators.modbus_bank import Bank, Table
from simulators.modbus_requests import WRITING
from tests.modbus_wire import serving
from tests.plc_belt import running
from tests.plc_wire import READY_S, together, wired
from tests.wire_trouble import Trouble

STALE_S = 0.25
ENOUGH = 20  # pictures that were good

# -- P2, P3: late answers ------------------------------------------------------------------------------------------

ROUGH = [
    Trouble(jitter_s=0.12),
    Trouble(late=0.1, late_s=0.3),
    Trouble(late=0.1, late_s=0.3, duplicate=0.05, stale=0.05, lose=0.03),
    Trouble(split_bytes=7, split_gap_s=0.0005, jitter_s=0.02, stale=0.1),
]


async def test_every_picture_handed_out_is_one_that_the_plc_gave_less_than_250_ms_ago() -> None:
    await together(
        (f"{trouble}, haunted {haunted}", pictures_are_true(trouble, haunted=haunted))
        for trouble in ROUGH
        for haunted in (False, True)
    )


async def pictures_are_true(trouble: Trouble, *, haunted: bool) -> None:
    pictures, last = 0, 0
    async with wired(seed=3) as c:
        c.proxy.haunted, c.proxy.down = haunted, trouble
        ends_s = time.monotonic() + 1.5
        while time.monotonic() < ends_s or (pictures < ENOUGH and time.monotonic() < ends_s + 10):
            await asyncio.sleep(0.004)
            at_s = time.monotonic()
            with contextlib.suppress(DeviceError):
                image = c.plc.image
                assert c.truth_age_s(image, at_s) < STALE_S
                assert 0 <= (image.heartbeat - last) & 0xFFFF < 0x8000  # never an older one after a newer one
                pictures, last = pictures + 1, image.heartbeat
    assert pictures >= ENOUGH
    assert trouble.jitter_s or any(name.startswith("down") for name in c.proxy.counts)


# -- P4: answers that are not right --------------------------------------------------------------------------------


@pytest.mark.parametrize("asked", [read(100, 32), write(0, range(16)), read_write(100, 32, 0, range(16))])
def test_no_bit_of_an_answer_s_frame_can_turn_unnoticed(asked: Request) -> None:
    question = Question(0x1234, 1, asked)
    pdu = question.request.answer_begins.ljust(question.request.answer_size, b"\x5a")
    right = struct.pack(">HHHB", 0x1234, 0, len(pdu) + 1, 1) + pdu
    assert question.answered_by(right) is not None
    for bit in range(8 * (7 + len(question.request.answer_begins))):
        wrong = bytearray(right)
        wrong[bit // 8] ^= 1 << bit % 8
        try:
            answer = question.answered_by(bytes(wrong))
        except NotTheAnswer:
            continue
        assert answer is None or answer.exception, f"bit {bit} of {right.hex()}"


async def test_answers_with_turned_bits_are_closed_upon_and_do_no_harm() -> None:
    async with wired(seed=9) as c:
        c.proxy.down = Trouble(flip=0.2)
        await asyncio.sleep(1.0)
        c.proxy.down = Trouble()
        await c.plc.ready(within_s=READY_S)

        assert c.proxy.counts["down flip"] > 3
        assert c.proxy.counts["connections"] > 1
        assert c.commands_executed() == []
        assert c.world.belt_starts == 0


# -- P5: another program -------------------------------------------------------------------------------------------


async def test_a_register_map_that_is_shifted_is_refused_and_nothing_is_written() -> None:
    await together((f"by {shift}", shifted_map_is_refused(shift)) for shift in (-1, 1, 16))


async def shifted_map_is_refused(shift: int) -> None:
    bank = Bank(holding=range(200))
    bank.tables[Table.HOLDING].update({100 + shift: 7, 101 + shift: 0x0100, 103 + shift: 1, 104 + shift: 15})
    async with serving(bank) as server, running(Plc("127.0.0.1", server.port)) as plc:
        with pytest.raises(Mismatch, match=r"register 101\) is 0x0.*, needed is 0x0100; load the PLC program"):
            await plc.ready(within_s=1)

        assert not WRITING & server.functions.keys()
