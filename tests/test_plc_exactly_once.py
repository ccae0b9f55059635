"""Whatever happens to answers and connections, a command is executed exactly once and no unit is lost or made twice."""

import asyncio
import contextlib
import random
from collections import Counter

import pytest

from drivers.errors import DeviceError, Refused
from drivers.plc import Arrival
from drivers.plc_registers import Command
from tests.plc_wire import Provoke, WiredCell, down, together, wired
from tests.wire_trouble import Trouble

ACCIDENTS: dict[str, Provoke] = {
    "lost": down(lose=1, count=1),
    "cut": down(cut=1, count=1),
    "late": down(late=1, late_s=0.3, count=1),
    "twice": down(duplicate=1, count=1),
    "turned": down(flip=1, count=1),
    "reset": lambda c: c.proxy.reset(),
    "cable out for a moment": lambda c: (c.proxy.unplug(), asyncio.get_running_loop().call_later(0.3, c.proxy.plug_in)),
}


@pytest.mark.parametrize("exchange", ["fc23", "fc3+fc16"])
async def test_a_command_whose_answer_goes_astray_is_executed_exactly_once(exchange: str) -> None:
    await together((name, is_executed_once(accident, exchange)) for name, accident in ACCIDENTS.items())


async def is_executed_once(accident: Provoke, exchange: str) -> None:
    async with wired(seed=2, exchange=exchange) as c:
        arrivals = []
        for good in (True, False):
            with c.at_the_next_command(lambda: accident(c)):
                arrivals.append(await c.plc.bring_base(within_s=5))
            with c.at_the_next_command(lambda: accident(c)):
                await c.plc.release(arrivals[-1].carrier_id, good=good, within_s=5)

        assert c.world.left == [(501, True), (502, False)]
        assert c.world.brought == 2
        assert [arrival.carrier_id for arrival in arrivals] == [501, 502]
        commands = [command for _, command in c.commands_executed()]
        assert commands == [Command.BRING_BASE, Command.RELEASE_GOOD, Command.BRING_BASE, Command.RELEASE_REJECT]


STORM = Trouble(late=0.03, late_s=0.25, duplicate=0.02, stale=0.02, lose=0.02, cut=0.01, noise=0.02, jitter_s=0.004)


async def test_through_a_storm_of_everything_every_unit_comes_and_goes_exactly_once() -> None:
    """I4 and I6: none lost, none twice, whatever was lost on the way; a person resets what the watchdog dropped."""
    accidents = Counter[str]()
    await together((f"seed {seed}", survives_a_storm(seed, accidents)) for seed in range(4))
    assert accidents.total() > 12


async def survives_a_storm(seed: int, accidents: Counter[str]) -> None:
    chance, released = random.Random(seed), []
    async with wired(seed=seed, speed=10.0) as c:
        c.proxy.haunted, c.proxy.down, c.proxy.up = True, STORM, Trouble(lose=0.01, cut=0.003, jitter_s=0.004)
        weather = asyncio.create_task(gusts(c, chance))
        try:
            for _ in range(3):
                arrival = await until_brought(c)
                released.append((arrival.carrier_id, chance.random() < 0.5))
                await until_released(c, *released[-1])
        finally:
            weather.cancel()

        assert c.world.left == released
        assert [carrier for carrier, _ in released] == [501, 502, 503]
        assert c.world.brought == 3
        accidents += c.proxy.counts


async def gusts(c: WiredCell, chance: random.Random) -> None:
    """Connections break now and then."""
    while True:
        await asyncio.sleep(0.1 + 0.5 * chance.random())
        chance.choice((c.proxy.reset, c.proxy.hang_up, c.proxy.reset))()


async def until_brought(c: WiredCell) -> Arrival:
    """As a person would: reset and start again until it works."""
    async with asyncio.timeout(30):
        while True:
            try:
                return await c.plc.bring_base(within_s=0.5)
            except DeviceError:
                with contextlib.suppress(DeviceError):
                    await c.plc.reset_latches(within_s=1)


async def until_released(c: WiredCell, carrier_id: int, good: bool) -> None:
    """Release it until the PLC says that it is gone."""
    async with asyncio.timeout(30):
        while True:
            try:
                await c.plc.release(carrier_id, good=good, within_s=0.5)
                return
            except Refused:
                if not c.plc.image.carrier_clamped:
                    return  # it had gone already, which the PLC could not say in time
            except DeviceError:
                pass
            with contextlib.suppress(DeviceError):
                await c.plc.reset_latches(within_s=1)
