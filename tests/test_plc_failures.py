"""What goes wrong between cellctl and the PLC: seen in time, told in a sentence, and nothing done that was not ordered.

The failures P1..P12 of the failure catalogue. Judged by what was on the wire (the proxy's record), what the PLC
executed (its server's) and what the belt did, never by what the driver says of itself. Of the twelve, a switch that
bounces or sees something for a moment (P7, P8) is in test_plc.py, a carrier without a base (P11) in
test_whole_faults.py, a lost answer (P12) also in test_plc_exactly_once.py. Cases that only wait run together.
"""

import asyncio
import contextlib
import struct
import time
from typing import NamedTuple

import pytest

from cellctl.faults import sentence
from drivers.errors import DeviceError, Garbled, LinkLost, Mismatch, NoAnswer, Refused
from drivers.modbus_frames import NotTheAnswer, Question, read, read_write, write
from drivers.plc import Plc
from simulators.modbus_bank import Bank, Table
from tests.modbus_wire import serving
from tests.plc_belt import eventually, running
from tests.plc_wire import Provoke, WiredCell, down, together, wired
from tests.wire_trouble import Trouble

LINK_S, STALE_S = 0.5, 0.25  # bounds of the catalogue
SLACK_S = 0.1  # this computer may be busy
WATCHDOG_S = 0.5  # within which the PLC stops when cellctl falls silent


class Failure(NamedTuple):
    """One failure: how it is made, by when it must be seen and as what."""

    name: str
    provoke: Provoke
    within_s: float
    kinds: tuple[type[DeviceError], ...]
    code: str  # that the operator reads


def gone(c: WiredCell) -> None:
    """Nobody listens any more."""
    c.proxy.refuse()
    c.proxy.reset()


def inject(fault: str, **params: object) -> Provoke:
    return lambda c: c.world.inject(fault, **params)


FAILURES = [
    Failure("P1 reset", lambda c: c.proxy.reset(), LINK_S, (LinkLost,), "D1"),
    Failure("P1 hung up", lambda c: c.proxy.hang_up(), LINK_S, (LinkLost,), "D1"),
    Failure("P1 nobody listens", gone, LINK_S, (LinkLost,), "D1"),
    Failure("P1 cable out", lambda c: c.proxy.unplug(), LINK_S, (NoAnswer,), "D2"),
    Failure("P1 requests vanish", lambda c: setattr(c.proxy, "up", Trouble(lose=1)), LINK_S, (NoAnswer,), "D2"),
    Failure("P2 answers stall", lambda c: c.proxy.stall("down"), STALE_S, (NoAnswer,), "D2"),
    Failure("P2 requests stall", lambda c: c.proxy.stall("up"), STALE_S, (NoAnswer,), "D2"),
    Failure("P2 answers late", down(delay_s=0.4), STALE_S, (NoAnswer,), "D2"),
    Failure("P2 answers crawl", down(split_bytes=1, split_gap_s=0.01), STALE_S, (NoAnswer,), "D2"),
    Failure("P3 the answer before", down(stale=1), STALE_S, (Garbled,), "D3"),
    Failure("P3 answers twice", down(duplicate=1), STALE_S, (Garbled,), "D3"),
    Failure("P3 answers change places", down(late=0.5, late_s=0.3), STALE_S, (NoAnswer, Garbled), "D"),
    Failure("P4 noise", down(noise=1), STALE_S, (Garbled,), "D3"),
    Failure("P4 cut short", down(cut=1), STALE_S, (NoAnswer,), "D2"),
    *(
        Failure(f"P4 exception {code}", inject("exception", code=code), STALE_S, (Refused,), "D4")
        for code in range(1, 12)
    ),
    Failure("P5 another map", inject("map_version"), STALE_S, (Mismatch,), "D5"),
    Failure("P5 program stopped", inject("program_stop"), LINK_S, (NoAnswer,), "D2"),
    Failure("P5 heartbeat frozen", inject("heartbeat_freeze"), LINK_S, (NoAnswer,), "D2"),
    Failure("P12 answers lost", down(lose=1), STALE_S, (NoAnswer,), "D2"),
]


@pytest.mark.parametrize("catalogue", ["P1", "P2", "P3", "P4", "P5", "P12"])
async def test_a_failure_is_seen_inside_its_bound_and_named_for_the_operator(catalogue: str) -> None:
    await together((failure.name, is_seen(failure)) for failure in FAILURES if failure.name.split()[0] == catalogue)


async def is_seen(failure: Failure) -> None:
    async with wired() as c:
        await c.plc.vacuum(True, within_s=1)
        watch = asyncio.create_task(c.plc.unsafe())
        await asyncio.sleep(0.05)

        failure.provoke(c)
        after_s, error = await c.trouble_within(2)
        async with asyncio.timeout(0.1):
            why = await watch

        assert after_s < failure.within_s + SLACK_S
        assert isinstance(error, failure.kinds)
        assert why  # and the watch that aborts the cell has ended, with a reason
        assert sentence(error).startswith(f"[{failure.code}")
        assert "plc: " in sentence(error)
        assert c.commands_executed() == []
        assert c.world.belt_starts == 0
        assert c.world.valve_changes == [True]  # what hangs on the cup must not fall


# -- P1, P2: the link is down --------------------------------------------------------------------------------------


async def test_the_plc_sees_our_silence_and_stops_belt_and_robot_but_keeps_the_vacuum() -> None:
    silences: dict[str, Provoke] = {"cable out": lambda c: c.proxy.unplug(), "stall": lambda c: c.proxy.stall("up")}
    await together((name, silence_is_heeded(silence)) for name, silence in silences.items())


async def silence_is_heeded(silence: Provoke) -> None:
    async with wired() as c:
        await c.plc.vacuum(True, within_s=1)
        c.world.supply = False
        bring = asyncio.create_task(c.plc.bring_base(within_s=1))
        await eventually(c.world.conveyor_moving)
        assert c.world.robot_enable
        began_s = time.monotonic()
        silence(c)
        await eventually(lambda: not c.world.robot_enable and not c.world.conveyor_moving())
        assert WATCHDOG_S - 0.1 < time.monotonic() - began_s < WATCHDOG_S + SLACK_S

        with pytest.raises(DeviceError):
            await bring
        assert c.world.valve_changes == [True]


async def test_a_link_that_comes_back_is_resumed_and_nothing_moves_before_a_person_resets() -> None:
    losses: dict[str, Provoke] = {"cable": lambda c: c.proxy.unplug(), "stall": lambda c: c.proxy.stall(), "gone": gone}
    await together((name, link_comes_back(loss)) for name, loss in losses.items())


async def link_comes_back(loss: Provoke) -> None:
    async with wired() as c:
        loss(c)
        _, error = await c.trouble_within(1)
        await eventually(lambda: not c.world.robot_enable)
        seen_s = time.monotonic()
        if loss is gone:
            await c.proxy.start()
        c.proxy.go_on()
        c.proxy.plug_in()
        await c.plc.ready(within_s=3)
        await asyncio.sleep(0.1)

        assert isinstance(error, LinkLost | NoAnswer)
        assert "robot enable was lost for a moment" in await c.plc.unsafe()
        assert c.commands_sent_since(seen_s) == set()
        assert c.world.belt_starts == 0
        await c.plc.reset_latches(within_s=1)
        assert (await c.plc.bring_base(within_s=3)).sequence == c.world.brought == 1


async def test_a_stall_shorter_than_the_bound_disturbs_nothing() -> None:
    async with wired() as c:
        rounds = late_rounds = 0
        while rounds < 5:
            began_s = time.monotonic()
            c.proxy.stall("down")
            await asyncio.sleep(0.1)
            stalled_s = time.monotonic() - began_s
            if stalled_s < 0.15:
                assert c.truth_age_s(c.plc.image) < STALE_S
            c.proxy.go_on()
            await asyncio.sleep(0.05)
            if time.monotonic() - began_s < 0.25:
                rounds += 1
            else:
                late_rounds += 1  # this computer was busy: the stall was longer than meant
                await c.plc.ready(within_s=3)

        assert c.proxy.counts["connections"] <= 1 + late_rounds
        assert c.world.robot_enable or late_rounds


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
        while time.monotonic() < ends_s:
            await asyncio.sleep(0.004)
            with contextlib.suppress(DeviceError):
                image = c.plc.image
                assert c.truth_age_s(image) < STALE_S + 0.02
                assert 0 <= (image.heartbeat - last) & 0xFFFF < 0x8000  # never an older one after a newer one
                pictures, last = pictures + 1, image.heartbeat
    assert pictures > 5
    assert c.proxy.counts["down late"] + c.proxy.counts["down stale"] > 0 or trouble.jitter_s


# -- P4: answers that are not right --------------------------------------------------------------------------------


@pytest.mark.parametrize("request_of", [read(100, 32), write(0, range(16)), read_write(100, 32, 0, range(16))])
def test_no_bit_of_an_answer_s_frame_can_turn_unnoticed(request_of: tuple[bytes, bytes, int]) -> None:
    question = Question(0x1234, 1, request_of)  # type: ignore[arg-type]
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
        await c.plc.ready(within_s=3)

        assert c.proxy.counts["down flip"] > 3
        assert c.proxy.counts["connections"] > 1
        assert c.commands_executed() == []
        assert c.world.belt_starts == 0


# -- P5: another program -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shift", [-1, 1, 16])
async def test_a_register_map_that_is_shifted_is_refused_and_nothing_is_written(shift: int) -> None:
    bank = Bank(holding=range(200))
    bank.tables[Table.HOLDING].update({100 + shift: 7, 101 + shift: 0x0100, 103 + shift: 1, 104 + shift: 15})
    async with serving(bank) as server, running(Plc("127.0.0.1", server.port)) as plc:
        with pytest.raises((Mismatch, Garbled), match="load the PLC program of this cellctl"):
            await plc.ready(within_s=0.3)

        assert not {5, 6, 15, 16, 22, 23} & server.functions.keys()


# -- P6: the PLC restarts ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("during", ["bring", "release"])
async def test_a_plc_that_restarts_during_a_command_does_not_get_it_again(during: str) -> None:
    async with wired() as c:
        arrival = await c.plc.bring_base(within_s=3)
        if during == "bring":
            await c.plc.release(arrival.carrier_id, good=True, within_s=3)
            c.world.supply = False
            command = asyncio.create_task(c.plc.bring_base(within_s=3))
        else:
            command = asyncio.create_task(c.plc.release(arrival.carrier_id, good=True, within_s=3))
        await eventually(c.world.conveyor_moving)
        before, boot = c.commands_executed(), c.plc.image.boot
        c.world.inject("reboot")
        with pytest.raises(NoAnswer, match=r"PLC restarted .*not repeated"):
            await command
        await c.plc.ready(within_s=3)
        await asyncio.sleep(0.2)

        assert c.commands_executed() == before
        assert not c.world.conveyor_moving()
        assert c.plc.image.boot != boot


# -- P9, P10: switch and belt --------------------------------------------------------------------------------------


async def test_a_switch_that_is_stuck_off_lets_no_base_through_unseen() -> None:
    async with wired(speed=100.0) as c:
        c.world.inject("photo_stuck", value=False)
        with pytest.raises(Refused, match=r"timed out|fault"):
            await c.plc.bring_base(within_s=5)

        assert c.plc.image.arrival_seq == 0
        assert not c.world.conveyor_moving()


async def test_a_switch_that_is_stuck_on_brings_no_base_that_is_not_there() -> None:
    async with wired(speed=100.0) as c:
        c.world.supply = False
        c.world.inject("photo_stuck", value=True)
        with pytest.raises((Refused, NoAnswer)):
            await c.plc.bring_base(within_s=5)

        assert c.plc.image.arrival_seq == 0
        assert not c.world.conveyor_moving()
