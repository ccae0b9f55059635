"""A whole cell whose PLC, or the wire to it, goes wrong; judged by the world, the wire and the records."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

from cellctl.daemon import build_devices
from cellctl.machine import State
from drivers.plc_registers import Command, Output
from simulators.modbus_frames import HEADER_SIZE
from tests.fault_proxy import FaultProxy, Passed, proxied
from tests.plc_wire import commands_sent, words_sent, written
from tests.whole_cell import Bench, running, simulated
from tests.wire_trouble import Trouble, modbus_frames

SLOW = 5.0  # so that a quarter of a second is about one move of the arm
STALE_MS = 500  # on a line 250, but here the world is rendered in the same process; before the PLC's own watchdog
STOPPED_WITHIN_S = 1.0  # the bound of the line is tested on the driver alone


@contextlib.asynccontextmanager
async def wired_cell(
    folder: Path, learnt: Path, *, stale_after_ms: int | None = None, **options: Any
) -> AsyncIterator[tuple[Bench, FaultProxy]]:
    """A running cell whose wire to the PLC goes through a proxy."""
    async with simulated(folder, learnt=learnt, **options) as bench:
        plc = bench.config.plc
        async with proxied(plc.port, host=plc.host, messages=modbus_frames) as proxy:
            wired = plc.model_copy(update={"port": proxy.port, "stale_after_ms": stale_after_ms or plc.stale_after_ms})
            bench.devices = build_devices(bench.config.model_copy(update={"plc": wired}))
            async with running(bench):
                yield bench, proxy


def travelling(bench: Bench) -> bool:
    """The arm moves with a battery that has left the table."""
    world = bench.world
    now_s = world.clock.now()
    return world.held is not None and world.arm.moving_at(now_s) and world.arm.tool_at(now_s).z_mm < 61.0


async def stopped_within(bench: Bench, within_s: float) -> None:
    """The cell aborts so soon, and from then on the arm stands and keeps what it holds."""
    began_s = last_s = time.monotonic()
    late_s = 0.0  # of this busy computer
    while bench.cell.state not in {State.ABORTING, State.ABORTED} or bench.world.arm.moving_at(bench.world.clock.now()):
        await asyncio.sleep(0.005)
        late_s, last_s = max(late_s, time.monotonic() - last_s), time.monotonic()
    assert last_s - began_s < within_s + late_s
    before = bench.world.tool()
    await asyncio.sleep(0.1)
    assert bench.world.tool() == before
    assert bench.world.held is not None


async def test_a_lost_plc_stops_the_arm_and_its_unit_is_the_only_one_lost(learnt: Path, tmp_path: Path) -> None:
    async with wired_cell(tmp_path, learnt, speed=SLOW, stale_after_ms=STALE_MS) as (bench, proxy):
        await bench.ready()
        await bench.start(1)
        await bench.when(lambda: travelling(bench))
        proxy.unplug()
        await stopped_within(bench, STOPPED_WITHIN_S)
        assert bench.cell.message.startswith("[D2] plc: ")
        await bench.when(lambda: not bench.world.robot_enable)  # by the PLC, which hears nothing of us
        seen_s = time.monotonic()
        proxy.plug_in()
        await bench.until(State.ABORTED)
        await asyncio.sleep(0.3)
        assert commands_sent(proxy, seen_s) <= {Command.STOP_CONVEYOR}

        (placed,) = await bench.produce(1)
        (lost, _) = bench.records(2)
        assert (lost["verdict"], placed["verdict"]) == ("lost", "placed")
        assert [verdict.released_good for verdict in bench.world.verdicts] == [False, True]


async def test_after_an_emergency_stop_nothing_that_moves_leaves_until_a_person_clears_and_resets(
    learnt: Path, tmp_path: Path
) -> None:
    async with wired_cell(tmp_path, learnt, speed=SLOW) as (bench, proxy):
        await bench.ready()
        await bench.start(1)
        await bench.when(lambda: travelling(bench))
        bench.world.inject("safety", "estop")
        await bench.when(lambda: bench.cell.state in {State.ABORTING, State.ABORTED})
        seen_s, motions = time.monotonic(), len(bench.robot_log.of("moves"))
        await bench.until(State.ABORTED)
        bench.world.inject("safety", "estop", on=False)  # which alone must start nothing
        await asyncio.sleep(0.3)

        assert bench.cell.message.startswith("[S1] ")
        assert len(bench.robot_log.of("moves")) == motions
        assert commands_sent(proxy, seen_s) <= {Command.STOP_CONVEYOR}
        assert all(w.outputs & Output.VACUUM for w in words_sent(proxy, seen_s))
        assert bench.world.held is not None
        await bench.ready()
        await bench.start(1)
        await bench.when(lambda: len(bench.robot_log.of("moves")) > motions)


async def test_a_plc_that_restarts_in_the_middle_of_a_unit_is_reconciled(learnt: Path, tmp_path: Path) -> None:
    async with wired_cell(tmp_path, learnt, speed=SLOW) as (bench, _):
        await bench.ready()
        await bench.start(1)
        await bench.when(lambda: travelling(bench))
        bench.world.inject("plc", "reboot")
        await stopped_within(bench, STOPPED_WITHIN_S)
        assert bench.cell.message.startswith(("[D1] plc: ", "[D2] plc: "))  # restarted, or not serving us yet
        await bench.until(State.ABORTED)
        (placed,) = await bench.produce(1)
        (lost, _) = bench.records(2)
        assert (lost["verdict"], placed["verdict"]) == ("lost", "placed")
        assert [verdict.released_good for verdict in bench.world.verdicts] == [False, True]


async def test_a_release_whose_answer_is_lost_makes_no_unit_twice_and_loses_none(learnt: Path, tmp_path: Path) -> None:
    async with wired_cell(tmp_path, learnt, stale_after_ms=STALE_MS) as (bench, proxy):

        def lose_the_answer(passed: Passed) -> None:
            sent = written(passed.message[HEADER_SIZE:]) if passed.direction == "up" else None
            if sent is not None and sent.command == Command.RELEASE_GOOD and not proxy.counts["down lose"]:
                proxy.down = Trouble(lose=1, count=1)

        await bench.ready()
        proxy.listener = lose_the_answer
        await bench.start(2)
        await bench.when(lambda: bench.cell.state in {State.ABORTED, State.COMPLETE})
        if bench.cell.state is State.ABORTED:
            await bench.produce(1)

        assert proxy.counts["down lose"] == 1
        records = bench.records(5)
        assert [record["verdict"] for record in records] == ["placed", "placed"]
        assert [verdict.released_good for verdict in bench.world.verdicts] == [True, True]


async def test_a_wire_that_jitters_below_the_bound_only_costs_time(learnt: Path, tmp_path: Path) -> None:
    async with wired_cell(tmp_path, learnt) as (bench, proxy):
        proxy.down = Trouble(jitter_s=0.08, split_bytes=20)
        proxy.up = Trouble(jitter_s=0.03)
        records = await bench.produce(2)

        assert [record["verdict"] for record in records] == ["placed", "placed"]
        assert all(verdict.fit is not None and verdict.fit.good for verdict in bench.world.verdicts)
        assert proxy.counts["connections"] == 1
