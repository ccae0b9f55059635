"""A camera's states as a stream, and the task that keeps a camera open."""

import asyncio
from contextlib import aclosing

from drivers.camera import State
from drivers.camera_reopening import keep_open
from drivers.camera_states import KEPT, States
from tests.gige_rig import rig, until


async def test_a_reader_gets_the_present_state_and_then_each_change_once():
    states = States()
    states.to(State.CONNECTING)
    async with aclosing(states.follow()) as stream:
        assert (await anext(stream)).state is State.CONNECTING
        states.to(State.READY)
        states.to(State.READY)
        states.to(State.ARMED, "software")
        assert [(await anext(stream)).state for _ in range(2)] == [State.READY, State.ARMED]
        waiting = asyncio.create_task(anext(stream))
        await asyncio.sleep(0)
        states.to(State.FAULTED, "gone")
        assert (await waiting).why == "gone"


async def test_two_readers_do_not_take_changes_from_each_other():
    states = States()
    async with aclosing(states.follow()) as one, aclosing(states.follow()) as two:
        await anext(one)
        await anext(two)
        states.to(State.READY)
        assert (await anext(one)) == (await anext(two)) == states.now


async def test_a_slow_reader_misses_the_oldest_changes_only():
    states = States()
    async with aclosing(states.follow()) as stream:
        await anext(stream)
        for number in range(100):
            states.to(State.FAULTED, str(number))
        assert [(await anext(stream)).why for _ in range(KEPT)] == [str(number) for number in range(100 - KEPT, 100)]


async def test_a_reader_that_ends_is_forgotten():
    states = States()
    async with aclosing(states.follow()) as stream:
        await anext(stream)
    assert not states._readers


async def test_a_camera_that_goes_and_comes_back_is_open_again_without_anybody_asking():
    async with rig() as r, r.camera() as camera:
        keeping = asyncio.create_task(keep_open(camera, first_s=0.05, longest_s=0.1))
        await until(lambda: camera.state.state is State.ARMED)
        assert r.scene.was_seen_in(await camera.grab())
        r.server.inject("release_control")
        async with asyncio.timeout(5.0), aclosing(camera.states()) as states:
            seen = [(await anext(states)).state for _ in range(5)]
        assert seen == [State.ARMED, State.FAULTED, State.OFFLINE, State.CONNECTING, State.ARMED]
        assert r.scene.was_seen_in(await camera.grab())
        keeping.cancel()
        await asyncio.wait([keeping])


async def test_a_camera_that_cannot_be_opened_is_tried_again(tmp_path):
    async with rig() as r, r.camera() as camera:
        r.server.registers._memory[216:232] = b"OTHER".ljust(16, b"\0")
        keeping = asyncio.create_task(keep_open(camera, first_s=0.05, longest_s=0.1))
        await until(lambda: "has serial number 'OTHER'" in camera.state.why)
        r.server.registers._memory[216:232] = b"SN1".ljust(16, b"\0")
        await until(lambda: camera.state.state is State.ARMED)
        keeping.cancel()
        await asyncio.wait([keeping])
