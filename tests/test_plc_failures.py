"""What goes wrong between cellctl and the PLC: seen in time, told in a sentence, and nothing done that was not ordered.

The failures P1..P12 of the failure catalogue. Judged by what was on the wire (the proxy's record), what the PLC
executed (its server's) and what the belt did, never by what the driver says of itself. Of the twelve, a switch that
bounces or sees something for a moment (P7, P8) is in test_plc.py, a carrier without a base (P11) in
test_whole_faults.py, late and damaged answers also in test_plc_answers.py, lost ones in test_plc_exactly_once.py. Cases
that only wait run together.
"""

import asyncio
import time
from pathlib import Path
from typing import NamedTuple

import pytest

from cellctl.faults import sentence
from drivers.errors import DeviceError, Garbled, LinkLost, Mismatch, NoAnswer, Refused
from drivers.plc import Plc
from drivers.plc_scan import STEADY_S
from simulators.plc import PlcServer
from simulators.product import load_product
from simulators.world import World
from tests.plc_belt import eventually, running
from tests.plc_wire import READY_S, Provoke, WiredCell, commands_sent, down, together, wired
from tests.wire_trouble import Trouble

ROOT = Path(__file__).resolve().parent.parent
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
    Failure("P1 nobody listens", gone, LINK_S, (LinkLost,), "D1"),
    Failure("P1 cable out", lambda c: c.proxy.unplug(), LINK_S, (NoAnswer,), "D2"),
    Failure("P1 requests vanish", lambda c: setattr(c.proxy, "up", Trouble(lose=1)), LINK_S, (NoAnswer,), "D2"),
    Failure("P2 answers stall", lambda c: c.proxy.stall("down"), STALE_S, (NoAnswer,), "D2"),
    Failure("P2 requests stall", lambda c: c.proxy.stall("up"), STALE_S, (NoAnswer,), "D2"),
    Failure("P2 answers late", down(delay_s=0.4), STALE_S, (NoAnswer,), "D2"),
    Failure("P2 answers crawl", down(split_bytes=1, split_gap_s=0.01), STALE_S, (NoAnswer,), "D2"),
    Failure("P3 the answer before", down(stale=1), STALE_S, (Garbled, NoAnswer), "D"),
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
        await asyncio.sleep(STEADY_S + 0.1)  # a link that has just come up gets no second try

        failure.provoke(c)
        after_s, error = await c.trouble_within(5)
        async with asyncio.timeout(2):
            why = await watch

        assert after_s < failure.within_s + SLACK_S + c.late_s
        assert isinstance(error, failure.kinds)
        assert why  # and the watch that aborts the cell has ended, with a reason
        assert sentence(error).startswith(f"[{failure.code}")
        assert "plc: " in sentence(error)
        assert c.commands_executed() == []
        assert c.world.belt_starts == 0
        assert c.world.valve_changes == [True]  # what hangs on the cup must not fall


ONCE: dict[str, Provoke] = {
    "P1 reset once": lambda c: c.proxy.reset(),
    "P1 hung up once": lambda c: c.proxy.hang_up(),
    "P4 noise once": down(noise=1, count=1),
    "P4 the answer before, once": down(stale=1, count=1),
    "P12 one answer lost": down(lose=1, count=1),
}


async def test_one_lost_or_broken_answer_is_tried_again_before_anybody_hears_of_it() -> None:
    await together((name, is_bridged(provoke)) for name, provoke in ONCE.items())


async def is_bridged(provoke: Provoke) -> None:
    async with wired() as c:
        watch = asyncio.create_task(c.plc.unsafe())
        await asyncio.sleep(STEADY_S + 0.1)
        before = c.proxy.counts["connections"]
        provoke(c)
        await asyncio.sleep(2 * STALE_S)
        assert c.proxy.counts["connections"] == before + 1
        assert not watch.done() or c.late_s > STALE_S - 0.2
        watch.cancel()
        await asyncio.wait([watch])


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
        assert WATCHDOG_S - 0.1 < time.monotonic() - began_s < WATCHDOG_S + SLACK_S + c.late_s

        with pytest.raises(DeviceError):
            await bring
        assert c.world.valve_changes == [True]


async def test_a_link_that_comes_back_is_resumed_and_nothing_moves_before_a_person_resets() -> None:
    losses: dict[str, Provoke] = {"cable": lambda c: c.proxy.unplug(), "stall": lambda c: c.proxy.stall(), "gone": gone}
    await together((name, link_comes_back(loss)) for name, loss in losses.items())


async def link_comes_back(loss: Provoke) -> None:
    async with wired() as c:
        loss(c)
        _, error = await c.trouble_within(5)
        await eventually(lambda: not c.world.robot_enable)
        seen_s = time.monotonic()
        if loss is gone:
            await c.proxy.start()
        c.proxy.go_on()
        c.proxy.plug_in()
        await c.plc.ready(within_s=READY_S)
        await asyncio.sleep(0.1)

        assert isinstance(error, LinkLost | NoAnswer)
        assert "robot enable was lost for a moment" in await c.plc.unsafe()
        assert commands_sent(c.proxy, seen_s) == set()
        assert c.world.belt_starts == 0
        await c.plc.reset_latches(within_s=1)
        assert (await c.plc.bring_base(within_s=3)).sequence == c.world.brought == 1


async def test_a_stall_shorter_than_the_bound_disturbs_nothing() -> None:
    async with wired() as c:
        for _ in range(5):
            c.proxy.stall("down")
            await asyncio.sleep(0.1)
            c.proxy.go_on()
            await asyncio.sleep(0.05)

        if c.late_s < 0.05:  # else a stall was longer than meant
            assert c.proxy.counts["connections"] == 1
            assert c.plc.image.robot_enable


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
        await c.plc.ready(within_s=READY_S)
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


async def test_a_belt_that_turns_when_it_must_not_is_a_fault_that_ends_all_motion() -> None:
    world = World(1, load_product(ROOT / "recipes" / "x85.toml"), speed=20.0)
    server = PlcServer(world)
    await server.start()
    try:
        async with running(Plc("127.0.0.1", server.port)) as plc:
            await plc.ready(within_s=READY_S)
            await plc.bring_base(within_s=5)
            watch = asyncio.create_task(plc.unsafe())
            world.inject("conveyor", "creeps")
            async with asyncio.timeout(2):
                assert "fault 4: the motor is off and the belt turns" in await watch
            with pytest.raises((Refused, NoAnswer)):
                await plc.bring_base(within_s=0.5)
            assert world.carrier_clamped()  # the clamp holds against the belt
    finally:
        await server.close()
