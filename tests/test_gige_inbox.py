"""Which picture is given out, whatever comes: no I/O, no camera, any order."""

import asyncio
import itertools
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import gige_inbox
from drivers.camera import Counters, Frame, Region, Setup, Trigger
from drivers.errors import FrameLost, LinkLost
from drivers.gige_inbox import Inbox, Reading, Shot
from drivers.gige_receiver import Received

SETUP = Setup("SN1", Region(0, 0, 4, 2))
CLOCK = Reading(host_ns=time.monotonic_ns(), device_ns=10_000_000_000)
S = 1_000_000_000


def received(number: int, after_s: float, *, flaw: str = "", exposure: tuple[float, float] | None = None) -> Received:
    """Exposed so long after the clock was read, by the camera's clock, and come a tenth of a second later."""
    pixels = None if flaw else np.zeros((2, 4), np.uint8)
    device_ns = CLOCK.device_ns + int(after_s * S)
    came_ns = CLOCK.host_ns + int((after_s + 0.1) * S)
    return Received(number, device_ns, came_ns, flaw, pixels, np.zeros(8, np.uint8), exposure)


def inbox(trigger: Trigger) -> Inbox:
    made = Inbox("camera 1", SETUP, trigger, CLOCK)
    made.exposure = (500.0, 1.0)
    return made


def shot_of(box: Inbox) -> "asyncio.Future[Frame]":
    box.shot = Shot(asyncio.get_running_loop().create_future(), CLOCK, CLOCK.host_ns + 1000, acknowledged=True)
    return box.shot.picture


ARRIVALS = st.lists(
    st.builds(
        received,
        st.integers(1, 9) | st.sampled_from([0xFFFE, 0xFFFF]),
        st.floats(-3.0, 3.0),
        flaw=st.sampled_from(["", "", "", "came incomplete"]),
    ),
    max_size=12,
)


@given(ARRIVALS)
@settings(max_examples=80, deadline=None)
def test_a_grab_gets_a_whole_picture_of_its_own_trigger_or_an_error(arrivals: list[Received]):
    async def grab() -> None:
        box = inbox(Trigger.SOFTWARE)
        picture = shot_of(box)
        for each in arrivals:
            box.take(each)
        if picture.done() and picture.exception() is None:
            frame = picture.result()
            assert frame.device_ns >= CLOCK.device_ns
            assert CLOCK.host_ns + 1000 <= frame.exposure_start_ns <= frame.received_ns
            assert any(each.frame_id == frame.frame_id and not each.flaw for each in arrivals)
        counted = box.counters
        assert counted.delivered + counted.stale + counted.incomplete == len(arrivals)
        assert counted.delivered <= 1
        assert counted.incomplete <= 1
        if picture.done():
            picture.exception()

    asyncio.run(grab())


@given(ARRIVALS)
@settings(max_examples=80, deadline=None)
def test_by_the_line_every_picture_is_given_told_or_counted(arrivals: list[Received]):
    async def take_all() -> None:
        box = inbox(Trigger.LINE)
        given_out: list[int] = []
        for each in arrivals:
            box.take(each)
        box.end(LinkLost("camera 1", "over"))
        told = 0
        while True:
            try:
                frame = await box.next_frame()
            except FrameLost:
                told += 1
            except LinkLost:
                break
            else:
                assert frame.device_ns >= CLOCK.device_ns
                given_out.append(frame.frame_id)
        counted = box.counters
        assert counted.delivered == len(given_out) <= 4
        assert told <= counted.incomplete
        assert counted.delivered + told + counted.stale + counted.overrun == len(arrivals)

    asyncio.run(take_all())


@given(st.lists(st.integers(1, 0xFFFF), min_size=1, max_size=30))
@settings(max_examples=80, deadline=None)
def test_gaps_are_what_is_missing_between_numbers_that_go_up(numbers: list[int]):
    box = inbox(Trigger.LINE)
    for number in numbers:
        box.take(received(number, 0.1))
    expected = 0
    for before, after in itertools.pairwise(numbers):
        step = after - before
        if step < 0 and before > gige_inbox.NEAR_THE_END:
            step += 0xFFFF
        expected += max(step - 1, 0)
    assert box.counters.gaps == expected


async def test_an_incomplete_picture_without_a_time_counts_as_the_awaited_one():
    box = inbox(Trigger.SOFTWARE)
    picture = shot_of(box)
    assert box.shot is not None
    box.shot.clock = None
    box.take(received(1, 0.1, flaw="came incomplete")._replace(device_ns=0))
    with pytest.raises(FrameLost, match="came incomplete"):
        picture.result()


async def test_a_whole_picture_before_the_clock_was_read_is_stale():
    box = inbox(Trigger.SOFTWARE)
    picture = shot_of(box)
    assert box.shot is not None
    box.shot.clock = None
    box.take(received(1, 0.1))
    assert not picture.done()
    assert box.counters == Counters(stale=1)


async def test_the_exposure_of_the_picture_itself_comes_before_what_was_read_back():
    box = inbox(Trigger.LINE)
    box.take(received(1, 0.1))
    box.take(received(2, 0.2, exposure=(777.0, 3.0)))
    first, second = await box.next_frame(), await box.next_frame()
    assert (first.exposure_us, first.gain_db) == (500.0, 1.0)
    assert (second.exposure_us, second.gain_db) == (777.0, 3.0)


async def test_what_waits_is_dropped_when_the_exposure_is_set_anew():
    box = inbox(Trigger.LINE)
    box.take(received(1, 0.1))
    box.begin_anew(Reading(CLOCK.host_ns + S, CLOCK.device_ns + S))
    box.take(received(2, 0.5))
    box.take(received(3, 1.5))
    assert (await box.next_frame()).frame_id == 3
    assert box.counters == Counters(delivered=1, stale=2)
