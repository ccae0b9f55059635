"""The GigE Vision driver: what it sets and refuses, the other triggers, states, health and counters."""

import asyncio
import time
from contextlib import aclosing

import numpy as np
import pytest

from drivers import gige_inbox
from drivers.camera import Region, Setup, State, Trigger
from drivers.errors import FrameLost, LinkLost, NoAnswer, Refused
from drivers.pixels import BY_NAME, RAW10P
from simulators import genicam
from simulators.genicam import PIXEL_FORMATS, Register
from simulators.gige import Exposure
from tests.gige_rig import SMALL, rig, setup, until

DEEP = np.random.default_rng(7).integers(0, 1 << 16, SMALL[::-1], dtype=np.uint16)


@pytest.mark.parametrize("name", sorted(PIXEL_FORMATS))
async def test_pictures_of_every_pixel_format_arrive_exact(name: str):
    pixel_format = BY_NAME[name]
    async with rig() as r:
        r.server._imaging._picture = lambda _exposure: DEEP
        async with r.open_camera(setup(SMALL, pixel_format=pixel_format)) as camera:
            frame = await camera.grab()
    values = DEEP >> (16 - pixel_format.bits)
    assert np.array_equal(frame.deep(), values)
    step = 1 << (pixel_format.bits - 8)
    assert np.array_equal(frame.pixels, np.minimum((values.astype(int) + step // 2) // step, 255))
    assert frame.pixels.dtype == np.uint8
    assert frame.pixel_format == pixel_format
    assert not frame.pixels.flags.writeable
    assert not frame.payload.flags.writeable


async def test_a_part_of_the_sensor_is_read_out():
    region = Region(64, 32, 320, 240)
    async with rig() as r:
        exposures: list[Exposure] = []

        def cut(exposure: Exposure) -> np.ndarray:
            exposures.append(exposure)
            whole, (left, top, width, height) = r.scene.pictures[0], exposure[3:]
            return whole[top : top + height, left : left + width]

        r.server._imaging._picture = cut
        async with r.open_camera(Setup("SN1", region)) as camera:
            frame = await camera.grab()
        assert frame.region == region
        assert Region(*exposures[0][3:]) == region
        assert np.array_equal(frame.pixels, r.scene.pictures[0][32:272, 64:384])


async def test_a_part_that_the_sensor_cannot_read_out_is_refused():
    async with rig() as r, r.camera(Setup("SN1", Region(62, 0, 320, 240))) as camera:
        with pytest.raises(Refused, match=r"asked for 320 x 240 px at 62, 0, it set|camera SN1 at"):
            await camera.open()


async def test_a_format_that_the_camera_does_not_have_is_refused_with_those_it_has():
    async with rig() as r, r.camera(setup(SMALL, pixel_format=RAW10P)) as camera:
        with pytest.raises(Refused, match="no pixel format Y10P, but Mono8, Mono10"):
            await camera.open()


async def test_a_mirrored_picture_is_switched_back():
    async with rig() as r:
        r.server.registers["ReverseX"] = r.server.registers["ReverseY"] = 1
        async with r.open_camera() as camera:
            assert r.scene.was_seen_in(await camera.grab())


@pytest.mark.parametrize(("feature", "kept"), [("BinningHorizontal", 2), ("BinningVertical", 2), ("ReverseX", 1)])
async def test_a_camera_that_bins_or_mirrors_for_good_is_refused(feature: str, kept: int):
    async with rig() as r, r.camera() as camera:
        at = r.server.registers.table[feature].address
        r.server.registers._by_address[at] = Register(at, kept, kept, kept)
        r.server.registers[feature] = kept
        with pytest.raises(Refused, match=rf"{feature} (cannot be set to|must be) (1|False)"):
            await camera.open()
        assert camera.state.state is State.OFFLINE


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("shorter", "640 x 480 px, format 0x1080001, 307140 bytes, not 640 x 480 Mono8 of 307240 bytes"),
        ("wider", "1280 x 240 px"),
        ("deeper", "format 0x1100003"),
    ],
)
async def test_a_picture_that_is_not_what_was_set_is_lost_before_anybody_looks_at_it(kind: str, says: str):
    changes = {
        "shorter": lambda sent: sent._replace(data=sent.data[:-100]),
        "wider": lambda sent: sent._replace(width=2 * sent.width, height=sent.height // 2),
        "deeper": lambda sent: sent._replace(pixel_format=PIXEL_FORMATS["Mono10"]),
    }
    async with rig() as r, r.open_camera() as camera:
        right = r.server._imaging._as_sent
        r.server._imaging._as_sent = lambda shot: changes[kind](right(shot))
        with pytest.raises(FrameLost, match=says):
            await camera.grab()
        r.server._imaging._as_sent = right
        assert r.scene.was_seen_in(await camera.grab())


async def test_bytes_after_the_end_of_a_picture_change_nothing():
    async with rig() as r, r.open_camera() as camera:
        right = r.server._imaging._as_sent

        def longer(shot):
            sent = right(shot)
            return sent._replace(data=np.concatenate([sent.data, 255 - sent.data]))

        r.server._imaging._as_sent = longer
        for _ in range(5):
            try:
                frame = await camera.grab()
            except FrameLost:
                continue
            assert r.scene.was_seen_in(frame)
            assert frame.payload.nbytes == SMALL[0] * SMALL[1]


async def test_a_picture_says_itself_how_it_was_exposed():
    async with rig() as r, r.open_camera() as camera:
        await camera.configure(exposure_us=900.0, gain_db=1.5)
        frame = await camera.grab()
        assert (frame.exposure_us, frame.gain_db) == (900.0, 1.5)
        r.server.registers["ExposureNs"], r.server.registers["GainMillidB"] = 777_000, 3_000  # by nobody's order
        frame = await camera.grab()
        assert (frame.exposure_us, frame.gain_db) == (777.0, 3.0)
        assert r.scene.was_seen_in(frame)
        assert frame.payload.nbytes == SMALL[0] * SMALL[1]


async def test_a_picture_whose_exposure_is_damaged_is_lost():
    async with rig() as r, r.open_camera() as camera:
        right = r.server._imaging._as_sent

        def damaged(shot):
            sent = right(shot)
            sent.data[-40:] = 0
            return sent

        r.server._imaging._as_sent = damaged
        with pytest.raises(FrameLost, match="without the exposure time and gain that belong to it"):
            await camera.grab()


async def test_a_camera_that_cannot_say_it_with_the_picture_is_believed_at_its_word(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(genicam.CHOICES, "ChunkSelector", {"LineStatusAll": 0, "CounterValue": 1})
    async with rig() as r:
        r.server.registers["ChunkModeActive"] = 1
        async with r.open_camera() as camera:
            await camera.configure(exposure_us=900.0)
            frame = await camera.grab()
            assert r.server.registers["ChunkModeActive"] == 0
    assert frame.exposure_us == 900.0
    assert r.scene.was_seen_in(frame)


async def test_a_picture_dated_by_another_clock_is_lost():
    async with rig() as r, r.open_camera() as camera:
        right = r.server._imaging._as_sent
        r.server._imaging._as_sent = lambda shot: right(shot)._replace(ticks=shot.ticks + 3_000_000_000)
        with pytest.raises(FrameLost, match=r"dated 3\.0 s after it came|dated 2\.9 s after it came"):
            await camera.grab()
        await camera.arm(Trigger.LINE)
        r.server.pulse_line()
        with pytest.raises(FrameLost, match="the camera dates by another clock"):
            await camera.next_frame()


async def test_a_camera_waits_between_packets_as_it_is_told():
    async with rig(largest_packet=1500) as r, r.open_camera(packet_delay_us=20) as camera:
        assert r.server.registers["GevSCPD"] == 20_000
        assert r.scene.was_seen_in(await camera.grab())


# Hardware line


async def test_pictures_by_the_line_come_in_order_and_none_without_a_pulse():
    async with rig() as r, r.open_camera() as camera:
        await camera.arm(Trigger.LINE)
        with pytest.raises(NoAnswer, match=r"no picture came in 0\.2 s"):
            await camera.next_frame(within_s=0.2)
        began_ns = time.monotonic_ns()
        for count in (1, 2, 3):
            r.server.pulse_line()
            await until(lambda count=count: r.server.counts.frames == count)
        frames = [await camera.next_frame() for _ in range(3)]
        assert [frame.frame_id for frame in frames] == [1, 2, 3]
        assert [frame.gap for frame in frames] == [0, 0, 0]
        assert r.scene.was_seen_in(frames[-1])
        assert began_ns < frames[0].exposure_start_ns < frames[1].exposure_start_ns < frames[2].exposure_start_ns
        assert all(abs(frame.exposure_start_ns - frame.device_ns) < 5_000_000 for frame in frames)
        assert camera.counters.delivered == 3


async def test_of_pictures_that_nobody_asks_for_the_newest_four_are_kept_and_the_rest_counted():
    async with rig() as r, r.open_camera() as camera:
        await camera.arm(Trigger.LINE)
        for count in range(1, 7):
            r.server.pulse_line()
            await until(lambda count=count: r.server.counts.frames == count)
        await until(lambda: camera.counters.overrun == 2)
        assert [(await camera.next_frame()).frame_id for _ in range(4)] == [3, 4, 5, 6]


async def test_a_lost_picture_of_the_line_is_told_in_its_turn():
    async with rig() as r, r.open_camera() as camera:
        await camera.arm(Trigger.LINE)
        r.server.inject("drop_packets", packets=[2])
        r.server.inject("resend_unavailable")
        r.server.pulse_line()
        with pytest.raises(FrameLost, match="picture 1 came incomplete"):
            await camera.next_frame()
        r.server.inject("clear")
        r.server.pulse_line()
        assert (await camera.next_frame()).frame_id == 2


async def test_pictures_that_the_camera_counted_and_never_sent_are_a_gap():
    async with rig() as r, r.open_camera() as camera:
        await camera.grab()
        r.server._imaging.link.block_number += 3
        frame = await camera.grab()
        assert frame.gap == 3
        assert camera.counters.gaps == 3


async def test_a_picture_number_that_begins_anew_is_no_gap():
    async with rig() as r, r.open_camera() as camera:
        r.server._imaging.link.block_number = 0xFFFE
        numbers, gaps = [], []
        for _ in range(3):
            frame = await camera.grab()
            numbers.append(frame.frame_id)
            gaps.append(frame.gap)
        assert numbers == [0xFFFF, 1, 2]
        assert gaps == [0, 0, 0]


# Free run


async def test_free_run_gives_the_newest_picture_and_no_old_one():
    async with rig() as r, r.open_camera() as camera:
        r.server.registers["FramePeriodUs"] = 1_000_000  # of the world, twenty times as fast
        await camera.arm(Trigger.FREE)
        first = await camera.next_frame()
        await asyncio.sleep(0.3)
        called_ns = time.monotonic_ns()
        second = await camera.next_frame()
        assert second.frame_id > first.frame_id + 1
        assert called_ns - second.received_ns < gige_inbox.FRESH_NS
        assert camera.counters.overrun > 0


async def test_a_picture_of_free_run_that_waited_too_long_is_not_given_out(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gige_inbox, "FRESH_NS", 50_000_000)
    async with rig() as r, r.open_camera() as camera:
        await camera.arm(Trigger.FREE)
        await camera.next_frame()
        r.server.inject("mute")
        await asyncio.sleep(0.3)
        with pytest.raises(NoAnswer):
            await camera.next_frame(within_s=0.1)
        r.server.inject("mute", on=False)


async def test_after_configure_only_pictures_with_the_new_exposure_come():
    async with rig() as r, r.open_camera() as camera:
        await camera.arm(Trigger.FREE)
        await camera.next_frame()
        await camera.configure(exposure_us=2345.0)
        configured_ns = time.monotonic_ns()
        frame = await camera.next_frame()
        assert frame.exposure_us == 2345.0
        assert frame.device_ns > configured_ns - 20_000_000
        assert any(exposure.exposure_us == 2345.0 for exposure in r.scene.exposures)


# Arming


async def test_each_verb_needs_its_own_arming():
    async with rig() as r, r.open_camera() as camera:
        with pytest.raises(Refused, match="armed for software, this needs line or free"):
            await camera.next_frame()
        await camera.arm(Trigger.LINE)
        with pytest.raises(Refused, match="armed for line, this needs software"):
            await camera.grab()
        await camera.disarm()
        with pytest.raises(Refused, match="it is not armed"):
            await camera.grab()
        for _ in range(3):  # numbers begin anew each time, and no picture is taken for an old one
            await camera.arm()
            assert r.scene.was_seen_in(await camera.grab())


async def test_a_trigger_line_that_the_camera_does_not_have_is_refused():
    async with rig() as r, r.open_camera(setup(SMALL, line="Line7")) as camera:
        with pytest.raises(Refused, match="no trigger source Line7, but Software, Line0"):
            await camera.arm(Trigger.LINE)
        await camera.arm()
        assert r.scene.was_seen_in(await camera.grab())


async def test_arming_that_is_cancelled_leaves_a_camera_that_must_be_opened_again():
    async with rig() as r, r.open_camera() as camera:
        r.server.inject("pending_ack", delay_ms=20)
        arming = asyncio.create_task(camera.arm(Trigger.LINE))
        await asyncio.sleep(0.01)
        arming.cancel()
        with pytest.raises(asyncio.CancelledError):
            await arming
        r.server.inject("clear")
        with pytest.raises(LinkLost, match="interrupted while it was being set; open it again"):
            await camera.grab()
        await camera.open()
        assert r.scene.was_seen_in(await camera.grab())


# States and health


async def test_the_states_are_told_in_order():
    seen: list[State] = []
    async with rig() as r, r.camera() as camera:

        async def follow() -> None:
            async with aclosing(camera.states()) as states:
                async for change in states:
                    seen.append(change.state)

        following = asyncio.create_task(follow())
        await asyncio.sleep(0)
        await camera.open()
        await camera.arm(Trigger.FREE)
        r.server.inject("release_control")
        await until(lambda: camera.state.state is State.FAULTED, within_s=5.0)
        assert "control" in camera.state.why
        await camera.open()
        await camera.close()
        await asyncio.sleep(0)
        following.cancel()
        await asyncio.wait([following])
    armed = [State.CONNECTING, State.ARMED]
    assert seen == [
        State.OFFLINE,
        *armed,
        State.READY,
        State.ARMED,
        State.FAULTED,
        State.OFFLINE,
        *armed,
        State.OFFLINE,
    ]


async def test_whoever_waits_for_the_line_is_told_when_the_camera_is_lost():
    async with rig() as r, r.open_camera() as camera:
        await camera.arm(Trigger.LINE)
        waiting = asyncio.create_task(camera.next_frame(within_s=10.0))
        await asyncio.sleep(0.05)
        r.server.inject("release_control")
        with pytest.raises(LinkLost, match="lost control, or it is gone"):
            await waiting


async def test_whoever_waits_for_the_line_keeps_nobody_from_asking_and_is_told_when_it_is_disarmed():
    async with rig() as r, r.open_camera() as camera:
        await camera.arm(Trigger.LINE)
        waiting = asyncio.create_task(camera.next_frame(within_s=10.0))
        await asyncio.sleep(0.05)
        assert (await camera.health()).answers
        await camera.disarm()
        with pytest.raises(Refused, match="it was disarmed"):
            await waiting
        assert camera.state.state is State.READY


async def test_health_tells_temperature_packets_and_the_age_of_the_newest_picture():
    async with rig() as r, r.open_camera() as camera:
        await camera.grab()
        health = await camera.health()
        assert (health.state, health.answers, health.temperature_c) == (State.ARMED, True, 41.5)
        assert health.packet_bytes == camera.packet_size
        assert health.last_picture_s is not None
        assert 0 <= health.last_picture_s < 1
        await camera.close()
        health = await camera.health()
        assert (health.state, health.why, health.answers) == (State.OFFLINE, "was closed", False)
        assert r.server.counts.triggers == 1


async def test_a_camera_that_is_silent_is_not_healthy(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("drivers.gige.CONTROL_WITHIN_S", 0.3)
    async with rig() as r, r.open_camera() as camera:
        r.server.inject("mute")
        assert not (await camera.health()).answers
        r.server.inject("mute", on=False)
