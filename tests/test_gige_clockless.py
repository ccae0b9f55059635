"""A GigE Vision camera whose clock cannot be read: still never a picture of an earlier trigger."""

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import numpy as np
import pytest

from drivers.camera import Trigger
from drivers.errors import FrameLost, NoAnswer
from drivers.gige import GigeCamera
from drivers.gige_inbox import Inbox, Reading
from drivers.gige_receiver import Received
from tests.gige_rig import SMALL, Rig, rig, setup


@asynccontextmanager
async def clockless(*, speed: float = 20.0) -> AsyncIterator[tuple[Rig, GigeCamera]]:
    async with rig(speed=speed) as r, r.camera() as camera:
        r.server.inject("clock_stands")
        await camera.open()
        yield r, camera


async def test_its_pictures_arrive_and_say_that_they_are_dated_by_their_arrival():
    async with clockless() as (r, camera):
        for _ in range(5):
            called_ns = time.monotonic_ns()
            frame = await camera.grab()
            assert r.scene.was_seen_in(frame)
            assert called_ns < frame.exposure_start_ns < frame.received_ns
            assert frame.device_ns == 0
        assert (await camera.health()).has_clock is False


async def test_a_camera_with_a_clock_says_so():
    async with rig() as r, r.open_camera() as camera:
        assert (await camera.health()).has_clock is True


async def test_a_picture_that_comes_too_late_is_not_the_next_ones():
    async with clockless(speed=1.0) as (r, camera):
        r.server.inject("link", mbps=20)  # a picture takes 0.13 s
        for within_s in (0.02, 0.08, 0.12):
            with pytest.raises(NoAnswer, match="no picture came"):
                await camera.grab(within_s=within_s)
            frame = await camera.grab()
            assert r.scene.was_seen_in(frame)


async def test_a_cancelled_grabs_picture_is_not_the_next_ones():
    async with clockless(speed=1.0) as (r, camera):
        r.server.inject("link", mbps=20)
        for delay_s in (0.0, 0.001, 0.01, 0.1):
            grab = asyncio.create_task(camera.grab())
            await asyncio.sleep(delay_s)
            grab.cancel()
            with suppress(asyncio.CancelledError):
                await grab
            assert r.scene.was_seen_in(await camera.grab())


async def test_after_a_broken_picture_the_next_is_its_own():
    async with clockless() as (r, camera):
        for _ in range(3):
            r.server.inject("drop_packets", packets=[2])
            r.server.inject("drop_resends", ratio=1.0)
            with pytest.raises(FrameLost):
                await camera.grab()
            r.server.inject("clear")
            r.server.inject("clock_stands")
            assert r.scene.was_seen_in(await camera.grab())


async def test_by_the_line_and_in_free_run_only_pictures_with_the_new_exposure_come():
    async with clockless() as (r, camera):
        for trigger in (Trigger.LINE, Trigger.FREE):
            await camera.arm(trigger)
            for exposure_us in (500, 900):
                r.server.pulse_line()
                await camera.configure(exposure_us=exposure_us)
                r.server.pulse_line()
                assert (await camera.next_frame(within_s=2.0)).exposure_us == exposure_us


@pytest.mark.parametrize(("numbers", "kept"), [([1, 2, 3], 3), ([5, 4, 6], 2), ([7, 7, 8], 2), ([65_535, 1, 2], 3)])
async def test_numbers_that_do_not_go_up_are_stale(numbers: list[int], kept: int):
    now_ns = time.monotonic_ns()
    box = Inbox("camera 1", setup(SMALL), Trigger.LINE, Reading(now_ns, now_ns), has_clock=False)
    pixels = np.zeros(SMALL[::-1], np.uint8)
    for number in numbers:
        box.take(Received(number, 0, now_ns + 1_000_000, "", pixels, pixels.reshape(-1), (1000.0, 0.0)))
    for _ in range(kept):
        await box.next_frame()
    assert box.counters.stale == len(numbers) - kept
