"""What goes wrong with a V4L2 camera: the right error in time, never a wrong or stale picture."""

import asyncio
import random
import sys
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.camera import Region, Setup, State, Trigger
from drivers.camera_reopening import keep_open
from drivers.errors import FrameLost, LinkLost, NoAnswer, Refused
from drivers.v4l2 import V4l2Camera
from simulators.v4l2.fuse_mount import unmount
from tests.benchmarks.camera_v4l2 import soak
from tests.v4l2_rig import FRONTS, FULL, SMALL, armed, needs_fuse, rig, until, where


def driver_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("camera 1")]


# What goes wrong


@pytest.mark.parametrize("fault", ["error_flag", "wrong_size"])
async def test_a_damaged_picture_that_was_triggered_is_lost_and_the_next_is_good(fault: str):
    async with rig() as r, r.open_camera() as camera:
        r.server.inject(fault)
        with pytest.raises(FrameLost, match="picture 0"):
            await camera.grab()
        assert r.scene.number_of((await camera.grab()).pixels) == 2
        assert camera.counters.incomplete == 1


@pytest.mark.parametrize("fault", ["error_flag", "wrong_size"])
async def test_a_damaged_picture_of_free_run_is_passed_over(fault: str):
    async with rig(speed=2, triggers=False) as r, r.open_camera() as camera:
        r.server.inject(fault, count=2)
        assert r.scene.was_seen_in(await camera.grab())


async def test_a_stale_picture_is_never_delivered():
    async with rig() as r, r.open_camera() as camera:
        await camera.grab()
        r.server.inject("stale")
        assert r.scene.number_of((await camera.grab()).pixels) == 2
        r.server.inject("stale", alone=True)
        with pytest.raises(NoAnswer, match="2 stale"):
            await camera.grab(within_s=0.3)
        assert r.scene.number_of((await camera.grab()).pixels) == 4


async def test_pictures_that_got_lost_are_counted():
    async with armed(Trigger.FREE, speed=2, triggers=False) as (r, camera):
        await camera.next_frame()
        r.server.inject("drop", count=3)
        await until(lambda: r.server.counts.dropped == 3)
        gaps = 0
        while not gaps:
            frame = await camera.next_frame()
            gaps = camera.counters.gaps
        assert gaps == 3
        assert r.scene.was_seen_in(frame)


async def test_picture_numbers_that_do_not_go_up_are_no_gap():
    async with rig() as r, r.open_camera() as camera:
        await camera.grab()
        r.server.inject("stuck_sequence")
        frames = [await camera.grab() for _ in range(3)]
        assert [frame.gap for frame in frames] == [0, 0, 0]
        assert [r.scene.number_of(frame.pixels) for frame in frames][-1] == 4
        assert camera.counters.gaps == 0


async def test_a_trigger_without_effect_and_a_frozen_camera_give_no_answer_within_the_deadline():
    async with rig() as r, r.open_camera() as camera:
        for fault, params in (("ignore_trigger", {}), ("freeze", {"on": True})):
            r.server.inject(fault, **params)
            began_s = time.monotonic()
            with pytest.raises(NoAnswer, match=r"no picture came in 0\.2 s"):
                await camera.grab(within_s=0.2)
            assert 0.15 < time.monotonic() - began_s < 2.0
            r.server.inject("clear")
        assert r.scene.was_seen_in(await camera.grab())


@pytest.mark.parametrize("front", FRONTS)
async def test_an_unplugged_camera_is_lost_at_once_and_is_there_again_after_a_new_opening(front: str, tmp_path: Path):
    async with rig(path=where(front, tmp_path)) as r, r.open_camera() as camera:
        await camera.grab()
        asyncio.get_running_loop().call_later(0.1, r.server.inject, "unplug")
        began_s = time.monotonic()
        r.server.inject("ignore_trigger")
        with pytest.raises(LinkLost):
            await camera.grab(within_s=5.0)
        assert time.monotonic() - began_s < 3.0
        assert camera.state.state is State.FAULTED
        with pytest.raises(LinkLost, match="open it again"):
            await camera.grab()
        with pytest.raises(LinkLost):
            await camera.open()
        r.server.inject("unplug", on=False)
        await camera.open()
        assert r.scene.was_seen_in(await camera.grab())


@asynccontextmanager
async def program(path: Path) -> AsyncIterator[asyncio.subprocess.Process]:
    """`cellctl simulate camera --v4l2`, from when it is ready until the block is left."""
    arguments = f"-m simulators camera --v4l2 {path} --serial SN1 --width 640 --height 480".split()
    running = await asyncio.create_subprocess_exec(sys.executable, *arguments, stdout=asyncio.subprocess.PIPE)
    try:
        assert running.stdout is not None
        while b"Ctrl-C" not in await asyncio.wait_for(running.stdout.readline(), 20):
            pass
        yield running
    finally:
        if running.returncode is None:
            running.kill()
        await running.wait()
        unmount(path)  # what was killed cannot do it


async def test_a_camera_that_is_kept_open_comes_back_by_itself_with_its_exposure():
    async with rig() as r, r.open_camera() as camera:
        await camera.configure(exposure_us=3000)
        keeper = asyncio.create_task(keep_open(camera, first_s=0.02, longest_s=0.1))
        try:
            r.server.inject("unplug")
            await until(lambda: camera.state.state is not State.ARMED)
            await asyncio.sleep(0.1)
            r.server.inject("unplug", on=False)
            await until(lambda: camera.state.state is State.ARMED)
            frame = await camera.grab()
        finally:
            keeper.cancel()
            await asyncio.wait([keeper])
        assert r.scene.was_seen_in(frame)
        assert frame.exposure_us == 3000


async def test_the_program_shows_a_plate_and_when_it_is_killed_the_camera_is_lost(tmp_path: Path):
    needs_fuse()
    path = tmp_path / "video0"
    camera = V4l2Camera("camera 1", str(path), Setup("SN1", Region(0, 0, *SMALL)))
    async with program(path) as running:
        await camera.open()
        try:
            frame = await camera.grab()
            assert frame.pixels.shape == (480, 640)
            assert frame.pixels.std() > 10
            running.kill()
            await running.wait()
            with pytest.raises(LinkLost):
                await camera.grab()
        finally:
            await camera.close()


# Line and free run


async def test_pictures_by_the_line_come_in_order_and_too_many_of_them_are_counted():
    async with armed(Trigger.LINE) as (r, camera):
        for number in range(1, 7):
            r.server.inject("pulse")
            await until(lambda number=number: r.server.counts.delivered == number)
            await asyncio.sleep(0.01)
        seen = [r.scene.number_of((await camera.next_frame()).pixels) for _ in range(4)]
        assert seen == [3, 4, 5, 6]
        assert camera.counters.overrun == 2
        with pytest.raises(NoAnswer):
            await camera.next_frame(within_s=0.05)


async def test_a_camera_without_trigger_refuses_to_be_armed_by_the_line():
    async with rig(triggers=False) as r, r.open_camera() as camera:
        with pytest.raises(Refused, match="no trigger by line"):
            await camera.arm(Trigger.LINE)
        assert camera.state.state is State.READY
        await camera.arm(Trigger.SOFTWARE)
        assert r.scene.was_seen_in(await camera.grab())


async def test_free_run_gives_the_newest_picture_and_grab_is_refused_meanwhile():
    async with armed(Trigger.FREE, speed=2) as (r, camera):
        await until(lambda: r.server.counts.delivered >= 5)
        frame = await camera.next_frame()
        assert (r.scene.number_of(frame.pixels) or 0) >= 4
        with pytest.raises(Refused, match="armed for free"):
            await camera.grab()


async def test_who_waits_for_the_line_is_told_when_the_camera_is_armed_anew_or_closed():
    async with armed(Trigger.LINE) as (r, camera):
        for change in (lambda: camera.arm(Trigger.LINE), camera.close):
            waiting = asyncio.create_task(camera.next_frame(within_s=5.0))
            await asyncio.sleep(0.01)
            await change()
            with pytest.raises(LinkLost):
                await waiting
        await camera.open()
        assert r.scene.was_seen_in(await camera.grab())


async def test_a_picture_of_an_earlier_arming_is_never_given():
    async with armed(Trigger.LINE, speed=50) as (r, camera):
        for number in range(1, 20):
            waiting = asyncio.create_task(camera.next_frame(within_s=5.0))
            await asyncio.sleep(0)
            r.server.inject("pulse")
            await asyncio.sleep(0.002 * (number % 5))
            await camera.arm(Trigger.LINE)
            try:
                frame = await waiting
            except LinkLost:
                continue
            assert r.scene.was_seen_in(frame)


# Breaking off


async def test_a_grab_that_is_broken_off_at_any_moment_leaves_the_camera_as_it_was():
    chance = random.Random(1)
    async with rig(speed=5) as r, r.open_camera() as camera:
        for _ in range(30):
            task = asyncio.create_task(camera.grab())
            await asyncio.sleep(chance.uniform(0, 0.012))
            task.cancel()
            await asyncio.wait([task])
        number = len(r.scene.exposures)
        frame = await camera.grab()
        assert (r.scene.number_of(frame.pixels) or 0) > number - 1
        assert sorted(b.idle for b in r.server.device.buffers._all) == [False] * 8  # the camera has all buffers again


async def test_closing_ends_the_thread_and_may_be_done_twice():
    async with rig() as r:
        camera = r.camera()
        await camera.open()
        assert driver_threads()
        await camera.close()
        await camera.close()
        await until(lambda: not driver_threads())
        with pytest.raises(LinkLost, match="is not open"):
            await camera.grab()


async def test_exposed_is_told_before_the_picture_is_there_when_the_camera_has_a_trigger():
    async with rig(FULL, speed=1) as r, r.open_camera() as camera:
        await camera.configure(exposure_us=2000)
        exposed, began_s = asyncio.Event(), time.monotonic()
        grab = asyncio.create_task(camera.grab(exposed=exposed))
        await exposed.wait()
        assert time.monotonic() - began_s >= 0.004
        assert not grab.done()
        await grab
        assert r.scene.exposures[-1].exposure_us == 2000


async def test_states_and_health_tell_how_the_camera_is():
    async with rig() as r:
        camera = r.camera()
        assert not (await camera.health()).answers
        await camera.open()
        await camera.grab()
        health = await camera.health()
        assert (health.state, health.answers) == (State.ARMED, True)
        assert health.last_picture_s is not None
        assert health.last_picture_s < 5
        await camera.disarm()
        assert camera.state.state is State.READY
        await camera.close()
        assert camera.state.state is State.OFFLINE


@pytest.mark.parametrize("triggered", [True, False])
async def test_hundreds_of_requests_while_pictures_go_astray_give_no_wrong_and_no_stale_one(triggered: bool):
    told = await soak(150, triggered=triggered)
    assert (told["wrong"], told["stale_given"]) == (0, 0)
    assert told["good"] + told["lost"] + told["late"] == 150
    assert told["good"] > 50
