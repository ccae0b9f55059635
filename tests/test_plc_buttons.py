"""Presses of the buttons at the PLC, through the wire: each one once, none from before our time, none late."""

import asyncio
from contextlib import suppress

import pytest

from drivers.plc import Plc
from drivers.plc_buttons import Button, Presses
from drivers.plc_registers import decode
from tests.plc_belt import Cell, cell, eventually, powered, running
from tests.test_plc_registers import picture


async def nothing_pressed(c: Cell, for_s: float = 0.1) -> None:
    with pytest.raises(TimeoutError):
        await asyncio.wait_for(c.plc.pressed(), for_s)


async def pressed(c: Cell, within_s: float = 1.0) -> Button:
    return await asyncio.wait_for(c.plc.pressed(), within_s)


async def press(c: Cell, button: str) -> None:
    """As briefly as a finger can, and let go again."""
    c.world.inject("press", button=button, for_s=0.1)
    await asyncio.sleep(0.15)


@pytest.mark.parametrize("button", list(Button))
async def test_a_short_press_is_told_once(button: Button) -> None:
    async with cell() as c:
        waiting = asyncio.create_task(c.plc.pressed())
        await press(c, button.value)

        assert await asyncio.wait_for(waiting, 5) is button
        await nothing_pressed(c)


async def test_two_quick_presses_are_two_also_when_nobody_was_waiting() -> None:
    async with cell() as c:
        await press(c, "start")
        await press(c, "start")

        assert [await pressed(c), await pressed(c)] == [Button.START, Button.START]
        await nothing_pressed(c)


async def test_presses_from_before_our_session_are_never_told() -> None:
    async with powered() as (world, server):
        world.inject("press", button="start", for_s=0.1)
        await asyncio.sleep(0.15)
        async with running(Plc("127.0.0.1", server.port)) as plc:
            await plc.ready(within_s=2)
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(plc.pressed(), 0.1)
            world.inject("press", button="reset", for_s=0.1)
            assert await asyncio.wait_for(plc.pressed(), 1) is Button.RESET


async def test_a_press_while_the_link_was_down_is_not_carried_out_late() -> None:
    async with cell() as c:
        waiting = asyncio.create_task(c.plc.pressed())
        c.world.inject("mute")
        await asyncio.sleep(0.25)
        await press(c, "start")
        c.world.inject("mute", on=False)
        await c.plc.ready(within_s=3)
        await asyncio.sleep(0.1)

        assert not waiting.done()
        await press(c, "stop")
        assert await asyncio.wait_for(waiting, 5) is Button.STOP


async def test_a_press_while_another_client_is_served_is_not_ours() -> None:
    async with cell() as c:
        c.world.inject("foreign_session", session=0xBEEF)
        await eventually(lambda: c.register(102) == 0xBEEF)
        await press(c, "start")
        c.world.inject("foreign_session", on=False)
        await c.plc.ready(within_s=3)
        await nothing_pressed(c)


async def test_a_cancelled_wait_takes_no_press_away() -> None:
    async with cell() as c:
        waiting = asyncio.create_task(c.plc.pressed())
        await asyncio.sleep(0.02)
        waiting.cancel()
        with suppress(asyncio.CancelledError):
            await waiting
        await press(c, "start")
        assert await pressed(c) is Button.START


def test_counters_wrap_around_and_of_several_stop_comes_first() -> None:
    presses = Presses()
    presses.drop(decode(picture(r118=0xFEFF, r119=0x00FF)))
    now = decode(picture(r118=0x0000, r119=0x0000))

    taken = []
    while (button := presses.waiting(now)) is not None:
        presses.take(button)
        taken.append(button)

    assert taken == [Button.STOP, Button.STOP, Button.RESET, Button.START]
