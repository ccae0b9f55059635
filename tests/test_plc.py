"""The PLC driver against the simulated PLC over real TCP; judged by what the belt, the valve and the wire truly did."""

import asyncio
import random
import time
from contextlib import suppress
from typing import Any

import pytest

from drivers.errors import DeviceError, Garbled, LinkLost, Mismatch, NoAnswer, Refused
from drivers.modbus import ModbusLink
from drivers.plc import Plc
from drivers.plc_registers import CellWords, Command
from simulators.plc import PlcServer
from tests.plc_belt import Belt, Cell, cell, eventually, powered, running, write_record

# -- what the verbs do ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("exchange", ["fc23", "fc3+fc16"])
async def test_units_come_and_go_in_both_exchange_modes(exchange: str) -> None:
    async with cell(exchange=exchange) as c:
        for number in range(1, 4):
            arrival = await c.plc.bring_base(within_s=3)
            assert (arrival.sequence, arrival.carrier_id) == (number, 500 + number)
            assert c.world.carrier_clamped()
            assert not c.world.conveyor_moving()
            await eventually(lambda n=number: c.register(7) == n)
            await c.plc.release(arrival.carrier_id, good=number != 2, within_s=3)

        assert c.world.left == [(501, True), (502, False), (503, True)]


async def test_ready_means_served_and_enabled() -> None:
    async with cell() as c:
        assert c.plc.image.session == c.register(1) == c.register(102) != 0
        assert c.world.robot_enable
        assert c.plc.image.robot_enable
        assert c.plc.image.boot == 1
        assert 0 <= c.plc.image.cycle_ms < 1000


async def test_at_a_hundred_times_the_speed_a_busy_computer_misses_no_carrier() -> None:
    async def hiccups() -> None:
        while True:
            time.sleep(0.02)  # noqa: ASYNC251  (two world seconds in which nobody can look at the belt)
            await asyncio.sleep(0.004)

    async with cell(speed=100.0) as c:
        busy = asyncio.create_task(hiccups())
        for number in range(1, 9):
            arrival = await c.plc.bring_base(within_s=3)
            assert arrival.sequence == c.world.brought == number
            await c.plc.release(arrival.carrier_id, good=True, within_s=3)

        assert len(c.world.left) == 8
        busy.cancel()


async def test_a_wrong_carrier_is_not_released() -> None:
    async with cell() as c:
        arrival = await c.plc.bring_base(within_s=3)
        with pytest.raises(Refused, match=r"release good \(command 2, argument 99, .*wrong state") as caught:
            await c.plc.release(99, good=True, within_s=3)

        assert caught.value.code == "result 1"
        assert c.world.carrier_id() == arrival.carrier_id
        assert c.world.left == []


async def test_an_empty_line_is_a_timed_out_bring_and_not_a_plc_fault() -> None:
    async with cell(speed=20.0) as c:
        c.world.supply = False
        with pytest.raises(Refused, match="timed out") as caught:
            await c.plc.bring_base(within_s=3)
        assert caught.value.code == "result 3"
        assert not c.world.conveyor_moving()

        c.world.supply = True
        assert (await c.plc.bring_base(within_s=3)).sequence == 1


async def test_vacuum_waits_for_the_switch_both_ways() -> None:
    async with cell() as c:
        await c.plc.vacuum(True, within_s=1)
        assert c.world.vacuum_kpa() < -40
        assert c.plc.image.vacuum_kpa < -35
        await c.plc.vacuum(False, within_s=1)
        assert c.world.vacuum_kpa() > -36
        assert c.world.valve_changes == [True, False]


async def test_a_cup_that_does_not_seal_is_told_with_its_pressure() -> None:
    async with cell() as c:
        c.world.sealed = False
        with pytest.raises(NoAnswer, match=r"did not go on, vacuum \(register 115\) is -6\.0 kPa"):
            await c.plc.vacuum(True, within_s=0.2)


async def test_lights_and_blow_off_are_on_when_the_verb_returns() -> None:
    async with cell() as c:
        await c.plc.light(1, True)
        assert c.world.lights == {1: True, 2: False}
        await c.plc.light(2, True)
        await c.plc.light(1, False)
        assert c.world.lights == {1: False, 2: True}
        await c.plc.blow_off(True)
        assert c.world.blowing
        await c.plc.blow_off(False)
        assert not c.world.blowing


async def test_show_reaches_tower_and_registers() -> None:
    async with cell() as c:
        c.plc.show(machine_state=6, good=65_537, rejected=2, red=False, amber=True, green=True, buzzer=False)
        await eventually(lambda: c.world.tower == (False, True, True, False))
        assert [c.register(at) for at in (2, 8, 9)] == [6, 1, 2]
        c.plc.show(machine_state=9, good=65_537, rejected=2, red=True, amber=False, green=False, buzzer=True)
        await eventually(lambda: c.world.tower == (True, False, False, True))


async def test_a_short_press_of_a_button_is_counted() -> None:
    async with cell() as c:
        for button in ("start", "start", "stop"):
            c.world.inject("press", button=button, for_s=0.02)
            await asyncio.sleep(0.05)
        await eventually(lambda: (c.plc.image.start_presses, c.plc.image.stop_presses) == (2, 1))
        assert not c.plc.image.start_button


# -- exactly once ----------------------------------------------------------------------------------------------


async def test_the_plc_executes_a_repeated_number_once_and_an_unknown_command_never() -> None:
    async with powered() as (world, server):
        link = ModbusLink("test", "127.0.0.1", server.port)
        await link.open()
        await asyncio.sleep(0.1)

        async def write(**fields: int) -> list[int]:
            nonlocal beat
            beat += 1
            return await link.read_write(107, 3, 0, CellWords(heartbeat=beat, session=77, **fields).encode())

        beat = 0
        await write()
        for _ in range(25):
            handshake = await write(sequence=9, command=Command.BRING_BASE)
            await asyncio.sleep(0.005)
        assert handshake == [9, 9, 0]
        assert await write(sequence=9, command=Command.RELEASE_GOOD, argument=501) == [9, 9, 0]
        assert await write(sequence=8, command=6) == [8, 8, 2]
        assert (world.brought, world.belt_starts, world.left) == (1, 1, [])
        link.close()


async def test_a_cancelled_bring_is_finished_and_its_arrival_is_taken_by_the_next_one() -> None:
    async with cell() as c:
        bring = asyncio.create_task(c.plc.bring_base(within_s=3))
        await eventually(c.world.conveyor_moving)
        bring.cancel()
        with pytest.raises(asyncio.CancelledError):
            await bring
        await eventually(c.world.carrier_clamped)

        arrival = await c.plc.bring_base(within_s=3)

        assert arrival.sequence == c.world.brought == c.world.belt_starts == 1
        await c.plc.release(arrival.carrier_id, good=True, within_s=3)
        assert (await c.plc.bring_base(within_s=3)).sequence == 2


async def test_the_command_after_a_cancelled_one_waits_until_that_is_finished() -> None:
    async with cell() as c:
        bring = asyncio.create_task(c.plc.bring_base(within_s=3))
        await eventually(c.world.conveyor_moving)
        bring.cancel()

        await c.plc.release(501, good=False, within_s=3)

        assert c.world.left == [(501, False)]


async def test_an_arrival_whose_carrier_was_taken_away_is_not_delivered_later() -> None:
    async with cell() as c:
        bring = asyncio.create_task(c.plc.bring_base(within_s=3))
        await eventually(c.world.conveyor_moving)
        bring.cancel()
        await c.plc.release(501, good=False, within_s=3)

        arrival = await c.plc.bring_base(within_s=3)

        assert (arrival.sequence, arrival.carrier_id) == (2, 502)


async def test_what_was_given_up_before_it_was_sent_is_never_executed() -> None:
    async with cell() as c:
        c.world.inject("mute")
        with pytest.raises(DeviceError):
            await c.plc.bring_base(within_s=0.25)
        c.world.inject("mute", on=False)
        await c.plc.ready(within_s=3)
        await asyncio.sleep(0.1)

        assert c.world.belt_starts == 0
        assert (await c.plc.bring_base(within_s=3)).sequence == 1


async def test_what_was_cancelled_in_the_same_breath_is_never_executed() -> None:
    async with cell(scan_period_s=0.05) as c:
        bring = asyncio.create_task(c.plc.bring_base(within_s=3))
        await asyncio.sleep(0)
        bring.cancel()
        with pytest.raises(asyncio.CancelledError):
            await bring
        await asyncio.sleep(0.15)

        assert c.world.belt_starts == 0


def spoil_the_answer_to(command: Command, c: Cell, fault: str) -> None:
    """The first exchange that carries this command is executed, and its answer is lost."""
    scan = c.server.modbus.bank.after_write

    def then(*block: Any) -> None:
        scan(*block)
        if c.register(4) == command:
            c.server.modbus.bank.after_write = scan
            c.world.inject(fault)

    c.server.modbus.bank.after_write = then


@pytest.mark.parametrize("exchange", ["fc23", "fc3+fc16"])
@pytest.mark.parametrize("fault", ["cut_answer", "drop_answer"])
async def test_a_command_whose_answer_is_lost_is_resumed_and_executed_once(exchange: str, fault: str) -> None:
    async with cell(exchange=exchange) as c:
        spoil_the_answer_to(Command.BRING_BASE, c, fault)
        arrival = await c.plc.bring_base(within_s=3)
        spoil_the_answer_to(Command.RELEASE_GOOD, c, fault)
        await c.plc.release(arrival.carrier_id, good=True, within_s=3)

        assert arrival.sequence == c.world.brought == 1
        assert c.world.left == [(501, True)]
        assert c.world.belt_starts == 2
        assert c.register(107) == c.register(108)


async def test_a_command_waits_until_the_plc_serves_us_again() -> None:
    async with cell() as c:
        c.world.inject("mute")
        bring = asyncio.create_task(c.plc.bring_base(within_s=3))
        await asyncio.sleep(0.25)
        c.server.program.machine["client.served"] = 0  # type: ignore[attr-defined]
        await eventually(lambda: c.register(102) == 0)
        c.world.inject("mute", on=False)

        assert (await bring).sequence == c.world.belt_starts == 1


async def test_a_command_is_given_up_when_somebody_else_has_commanded_meanwhile() -> None:
    async with cell() as c:
        c.world.inject("mute")
        bring = asyncio.create_task(c.plc.bring_base(within_s=3))
        await asyncio.sleep(0.25)
        for register in (107, 108):
            c.server._override(register, 4000)
        c.world.inject("mute", on=False)

        with pytest.raises(NoAnswer, match=r"somebody else \(register 107 is 4000\) during bring base"):
            await bring
        for register in (107, 108):
            c.server._override(register, None)
        await c.plc.ready(within_s=3)
        assert c.world.belt_starts == 0
        assert (await c.plc.bring_base(within_s=3)).sequence == 1


async def test_through_broken_connections_at_random_times_every_unit_comes_and_goes_once() -> None:
    source = random.Random(4)
    async with cell(speed=40.0) as c:

        async def trouble() -> None:
            while True:
                await asyncio.sleep(source.uniform(0.0, 0.05))
                await c.plc.ready(within_s=5)
                c.world.inject(source.choice(("cut_answer", "cut_answer", "drop_answer")))

        nuisance = asyncio.create_task(trouble())
        seen = []
        for _ in range(5):
            arrival = await c.plc.bring_base(within_s=5)
            seen.append(arrival.sequence)
            await c.plc.release(arrival.carrier_id, good=True, within_s=5)
        nuisance.cancel()

        assert seen == list(range(1, 6))
        assert c.world.left == [(500 + number, True) for number in seen]
        assert c.world.brought == 5
        assert c.world.belt_starts == 10


async def test_counters_wrap_around_like_any_others() -> None:
    async with powered() as (world, server):
        machine = server.program.machine  # type: ignore[attr-defined]
        machine["accepted"] = machine["finished"] = 0xFFFD
        machine["conveyor.arrivals"] = 0xFFFE
        async with running(Plc("127.0.0.1", server.port)) as plc:
            await plc.ready(within_s=2)
            seen = []
            for _ in range(3):
                arrival = await plc.bring_base(within_s=3)
                seen.append(arrival.sequence)
                await plc.release(arrival.carrier_id, good=True, within_s=3)

        assert seen == [0xFFFF, 0, 1]
        assert world.brought == len(world.left) == 3
        assert server.memory[107] == 4


async def test_a_gap_in_the_arrival_counter_is_told_and_the_newest_can_still_be_taken() -> None:
    async with cell() as c:
        await c.plc.bring_base(within_s=3)
        c.server._override(110, 3)
        await eventually(lambda: c.plc.image.arrival_seq == 3)
        with pytest.raises(Garbled, match=r"register 110\) went from 1 to 3: 1 passed unseen"):
            await c.plc.bring_base(within_s=1)

        assert (await c.plc.bring_base(within_s=1)).sequence == 3


async def test_stop_conveyor_overtakes_a_bring_and_the_line_goes_on_afterwards() -> None:
    async with cell() as c:
        bring = asyncio.create_task(c.plc.bring_base(within_s=3))
        await eventually(c.world.conveyor_moving)
        await c.plc.stop_conveyor(within_s=1)

        assert not c.world.conveyor_moving()
        with pytest.raises(Refused, match="was ended by stop conveyor"):
            await bring
        await asyncio.gather(c.plc.stop_conveyor(within_s=1), c.plc.stop_conveyor(within_s=1))
        assert (await c.plc.bring_base(within_s=3)).sequence == 1


# -- who is on the other side ----------------------------------------------------------------------------------


async def test_no_plc_is_link_lost_with_its_address_and_the_scan_counter_moves_on() -> None:
    async with powered() as (_, server):
        port = server.port
    async with running(Plc("127.0.0.1", port)) as plc:
        with pytest.raises(LinkLost, match=f"127.0.0.1:{port}"):
            await plc.ready(within_s=0.3)
        with pytest.raises(LinkLost):
            _ = plc.image
        scans = plc.scans
        await eventually(lambda: plc.scans > scans)


async def test_another_map_version_is_a_mismatch_and_nothing_is_ever_written() -> None:
    async with powered() as (world, server), running(Plc("127.0.0.1", server.port)) as plc:
        world.inject("map_version", value=0x0203)
        with pytest.raises(Mismatch, match=r"map version \(register 101\) is 0x0203, needed is 0x0100"):
            await plc.ready(within_s=0.4)
        assert server.memory[1] == 0

        world.inject("map_version", on=False)
        await plc.ready(within_s=3)


async def test_a_second_client_is_refused_disturbs_nothing_and_follows_when_the_first_is_silent() -> None:
    async with powered() as (world, server):
        second = Plc("127.0.0.1", server.port)
        async with running(Plc("127.0.0.1", server.port)) as first:
            await first.ready(within_s=2)
            await first.vacuum(True, within_s=1)
            sessions = write_record(server)
            late = asyncio.create_task(second.run())
            with pytest.raises(Mismatch, match="end the other client"):
                await second.bring_base(within_s=0.3)
            assert sessions == {first.image.session}
            assert (await first.bring_base(within_s=3)).sequence == 1
        await second.ready(within_s=3)
        await second.release(501, good=True, within_s=3)
        late.cancel()
        await asyncio.wait([late])
        assert world.valve_changes == [True]
        assert world.belt_starts == 2


async def test_a_foreign_session_is_a_mismatch_with_both_numbers() -> None:
    async with cell() as c:
        ours = c.register(1)
        c.world.inject("foreign_session", session=0xBEEF)
        await eventually(lambda: c.register(102) == 0xBEEF)
        with pytest.raises(Mismatch, match=f"is 0xbeef, ours is {ours:#06x}"):
            await c.plc.bring_base(within_s=0.3)
        assert "register 102" in await c.plc.unsafe()
        assert c.world.belt_starts == 0


async def test_what_an_unserved_client_wrote_is_refused_and_not_executed_when_it_becomes_served() -> None:
    async with cell() as c:
        link = ModbusLink("other", "127.0.0.1", c.server.port)
        await link.open()
        words = CellWords(heartbeat=1, session=c.register(1) ^ 0x5555, sequence=4321, command=Command.BRING_BASE)
        assert await link.read_write(107, 3, 0, words.encode()) == [4321, 4321, 5]
        await c.plc.light(1, True)
        assert c.world.lights[1]
        assert c.world.belt_starts == 0

    async with powered() as (world, server):
        link = ModbusLink("other", "127.0.0.1", server.port)
        await link.open()
        for beat in range(25):
            handshake = await link.read_write(107, 3, 0, words._replace(heartbeat=beat).encode())
            await asyncio.sleep(0.005)
        assert handshake == [4321, 4321, 5]
        assert world.belt_starts == 0
        link.close()


async def test_a_restarted_plc_ends_the_command_and_does_not_get_it_again() -> None:
    async with cell() as c:
        await c.plc.vacuum(True, within_s=1)
        watch = asyncio.create_task(c.plc.unsafe())
        bring = asyncio.create_task(c.plc.bring_base(within_s=3))
        await eventually(c.world.conveyor_moving)
        c.world.inject("reboot")
        with pytest.raises(NoAnswer, match=r"register 117 went from 1 to 2\) during bring base .*not repeated"):
            await bring
        await c.plc.ready(within_s=3)
        await asyncio.sleep(0.1)

        assert c.world.belt_starts == 1
        assert not c.world.conveyor_moving()
        assert await watch
        assert c.world.valve_changes == [True]
        assert (await c.plc.bring_base(within_s=3)).sequence == 1


async def test_a_restarted_cellctl_keeps_the_vacuum_and_the_counters() -> None:
    async with powered() as (world, server):
        async with running(Plc("127.0.0.1", server.port)) as before:
            await before.ready(within_s=2)
            await before.vacuum(True, within_s=1)
            await before.bring_base(within_s=3)
            await asyncio.sleep(0.03)
        async with running(Plc("127.0.0.1", server.port)) as after:
            await after.ready(within_s=3)
            await after.release(501, good=True, within_s=3)
            assert (await after.bring_base(within_s=3)).sequence == 2
        assert world.valve_changes == [True]


# -- heartbeats, age, late and bad answers -------------------------------------------------------------------------


@pytest.mark.parametrize("fault", ["heartbeat_freeze", "program_stop"])
async def test_a_plc_heartbeat_that_stands_still_is_no_answer(fault: str) -> None:
    async with cell() as c:
        c.world.inject(fault)
        started_s = time.monotonic()
        said = await c.plc.unsafe()
        took_s = time.monotonic() - started_s

        assert "heartbeat (register 100) stands at" in said
        assert 0.4 < took_s < 0.8
        with pytest.raises(NoAnswer, match="register 100"):
            _ = c.plc.image
        assert c.world.robot_enable is (fault == "heartbeat_freeze")
        c.world.inject(fault, on=False)
        await c.plc.ready(within_s=3)


async def test_when_cellctl_falls_silent_the_plc_drops_enable_and_belt_but_keeps_the_vacuum() -> None:
    async with powered(speed=1.0) as (world, server):
        async with running(Plc("127.0.0.1", server.port)) as plc:
            await plc.ready(within_s=2)
            await plc.vacuum(True, within_s=1)
            world.supply = False
            bring = asyncio.create_task(plc.bring_base(within_s=0.3))
            await eventually(world.conveyor_moving)
            with pytest.raises(NoAnswer, match="no base came"):
                await bring
        ended_s = time.monotonic()
        await eventually(lambda: not world.robot_enable)
        assert 0.4 < time.monotonic() - ended_s < 0.7
        await eventually(lambda: not world.conveyor_moving())

        assert server.memory[103] == 3
        assert server.memory[106] == 0b1000
        assert world.valve_changes == [True]


async def test_no_picture_older_than_250_ms_is_ever_handed_out() -> None:
    async with cell() as c:
        c.world.inject("mute")
        muted_s = last_s = time.monotonic()
        while time.monotonic() - muted_s < 0.5:
            with suppress(DeviceError):
                assert c.plc.image
                last_s = time.monotonic()
            await asyncio.sleep(0.002)

        assert last_s - muted_s < 0.26
        with pytest.raises(NoAnswer, match="no answer within 200 ms"):
            _ = c.plc.image


async def test_a_driver_whose_scan_does_not_run_says_so() -> None:
    async with powered() as (_, server):
        plc = Plc("127.0.0.1", server.port)
        async with running(plc):
            await plc.ready(within_s=2)
            watch = asyncio.create_task(plc.unsafe())
            await asyncio.sleep(0.03)
            assert not watch.done()
        assert "the scan has ended" in await watch
        with pytest.raises(LinkLost, match="the scan has ended"):
            await plc.vacuum(True, within_s=0.05)


async def test_an_exception_answer_is_refused_with_code_and_name_and_heals() -> None:
    async with cell() as c:
        c.world.inject("exception", code=4)
        with pytest.raises(Refused, match="server device failure") as caught:
            await c.plc.bring_base(within_s=0.3)
        assert caught.value.code == "exception 4"

        c.world.inject("exception", on=False)
        await c.plc.ready(within_s=3)


async def test_late_answers_are_never_taken() -> None:
    async with cell() as c:
        await c.plc.light(1, True)
        c.world.inject("delay", delay_s=0.25)
        await asyncio.sleep(0.05)
        c.world.safety(air_ok=False)  # this picture is under way, late
        seen = []
        for _ in range(200):
            with suppress(DeviceError):
                seen.append(c.plc.image.air_ok)
            await asyncio.sleep(0.002)
        assert False not in seen

        c.world.inject("delay", on=False)
        await c.plc.ready(within_s=3)
        assert not c.plc.image.air_ok


async def test_a_wrong_unit_id_is_refused_with_a_remedy() -> None:
    async with powered(unit_id=7) as (_, server), running(Plc("127.0.0.1", server.port, unit_id=1)) as plc:
        with pytest.raises(Refused, match="check the configured unit id"):
            await plc.ready(within_s=0.3)


# -- safety ------------------------------------------------------------------------------------------------------


async def test_a_short_pulse_of_the_emergency_stop_is_latched_and_ends_the_watch() -> None:
    async with cell() as c:
        watch = asyncio.create_task(c.plc.unsafe())
        await asyncio.sleep(0.03)
        assert not watch.done()
        c.world.safety(estop_pressed=True)
        c.world.safety(estop_pressed=False)
        pressed_s = time.monotonic()

        said = await watch

        assert time.monotonic() - pressed_s < 0.1
        assert "emergency stop circuit" in said
        assert "register 106" in said
        assert await c.plc.unsafe() == said
        await c.plc.reset_latches(within_s=1)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(c.plc.unsafe(), 0.05)


@pytest.mark.parametrize(
    ("fact", "value", "said"),
    [
        ("estop_pressed", True, "emergency stop circuit is open, robot enable is off"),
        ("guard_open", True, "guard is open, robot enable is off"),
        ("air_ok", False, "air pressure is missing"),
    ],
)
async def test_a_safety_fact_that_stays_lost_is_named(fact: str, value: bool, said: str) -> None:
    async with cell() as c:
        watch = asyncio.create_task(c.plc.unsafe())
        c.world.safety(**{fact: value})
        assert said in await watch
        await c.plc.reset_latches(within_s=1)
        assert said in await c.plc.unsafe()


async def test_the_emergency_stop_ends_a_bring_and_no_other_starts() -> None:
    async with cell() as c:
        bring = asyncio.create_task(c.plc.bring_base(within_s=3))
        await eventually(c.world.conveyor_moving)
        c.world.safety(estop_pressed=True)
        assert not c.world.conveyor_moving()
        assert not c.world.robot_enable
        with pytest.raises(Refused, match=r"fault \(register 109 is 4, PLC state emergency stop"):
            await bring
        with pytest.raises(Refused, match="wrong state"):
            await c.plc.bring_base(within_s=1)


async def test_a_lost_connection_ends_the_watch() -> None:
    async with cell() as c:
        watch = asyncio.create_task(c.plc.unsafe())
        await c.server.close()
        assert f"127.0.0.1:{c.server.port}" in await asyncio.wait_for(watch, 1)


async def test_a_bouncing_switch_counts_one_and_a_short_pulse_none() -> None:
    async with cell(speed=2.0) as c:
        c.world.inject("short_pulse", pulse_ms=5)
        c.world.inject("bounce", edges=5, bounce_ms=30)
        arrival = await c.plc.bring_base(within_s=3)
        await asyncio.sleep(0.1)

        assert arrival.sequence == c.world.brought == c.plc.image.arrival_seq == 1
        assert 0 <= arrival.age_s < 0.1


# -- habits ------------------------------------------------------------------------------------------------------


async def test_the_scan_keeps_its_rate_and_leaves_no_task_behind() -> None:
    async with powered() as (_, server):
        before = asyncio.all_tasks()
        plc = Plc("127.0.0.1", server.port, scan_period_s=0.005)
        async with running(plc):
            await plc.ready(within_s=2)
            scans, started_s = plc.scans, time.monotonic()
            await asyncio.sleep(0.4)
            rate_hz = (plc.scans - scans) / (time.monotonic() - started_s)
        assert 60 < rate_hz < 210
        assert asyncio.all_tasks() == before


async def test_waiting_verbs_add_no_exchanges() -> None:
    async with cell(speed=1.0, scan_period_s=0.02) as c:
        requests = c.server.modbus.requests
        c.world.supply = False
        with pytest.raises(NoAnswer):
            await c.plc.bring_base(within_s=0.4)
        assert c.server.modbus.requests - requests < 30


async def test_another_program_can_be_loaded() -> None:
    class Echo:
        """Answers a command by taking its number, and does nothing."""

        def __init__(self, world: Belt, memory: dict[int, int], **wires: Any) -> None:
            self.memory = memory

        def scan(self, now_world_s: float, now_wall_s: float) -> None:
            beat, session, number = (self.memory[at] for at in (0, 1, 3))
            self.memory |= {100: beat, 101: 0x0100, 102: session, 103: 1, 107: number, 108: number, 117: 1}

        def halt(self) -> None:
            pass

    async with powered(program=Echo) as (world, server), running(Plc("127.0.0.1", server.port)) as plc:
        await plc.release(3, good=True, within_s=2)
        with pytest.raises(Garbled, match="bring base is done but the arrival counter"):
            await plc.bring_base(within_s=2)
        assert world.belt_starts == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"scan_period_s": 0.0}, "scan_period_s must be above 0"),
        ({"scan_period_s": 0.3}, "at most 0.1"),
        ({"exchange": "fc4"}, 'must be "fc23" or "fc3.fc16"'),
    ],
)
def test_bad_settings_are_refused_in_one_sentence(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Plc("127.0.0.1", 1, **options)


@pytest.mark.parametrize(
    ("fault", "params", "said"),
    [("melt", {}, "cannot inject plc melt"), ("delay", {"weeks": 2}, "weeks"), ("press", {"button": "x"}, "no button")],
)
def test_a_fault_that_does_not_exist_is_refused(fault: str, params: dict[str, Any], said: str) -> None:
    server = PlcServer(Belt(1.0))
    with pytest.raises(ValueError, match=said):
        server.inject(fault, **params)
