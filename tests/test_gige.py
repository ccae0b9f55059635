"""The GigE Vision driver against the simulated camera: the right picture, whole, or the right error."""

import asyncio
import socket
import struct
import threading
import time

import numpy as np
import pytest

from drivers import aravis, aravis_library, gige, gige_setup
from drivers.errors import FrameLost, LinkLost, Mismatch, NoAnswer, Refused, Unavailable
from drivers.gige import GigeCamera
from simulators.clock import Clock
from simulators.gige import Exposure, GigeCameraServer
from tests.gige_rig import FULL, SMALL, Scene, driver_threads, fresh_ip, rig, setup, until, until_threads_end


async def test_five_megapixel_pictures_arrive_byte_for_byte_and_read_only():
    async with rig(FULL, speed=50) as r, r.open_camera() as camera:
        frames = []
        for _ in range(3):
            frames.append(await camera.grab())
            assert r.scene.was_seen_in(frames[-1])
        assert not frames[0].pixels.flags.writeable
        with pytest.raises(ValueError, match="read-only"):
            frames[0].pixels[0, 0] = 1
        # Frames are owned by the receiver: later pictures leave the first as it was.
        assert np.array_equal(frames[0].pixels, r.scene.pictures[1])
        assert camera.packet_size > 9000


async def test_ordinary_packets_work_where_the_network_takes_no_larger_ones():
    async with rig(largest_packet=1500) as r, r.open_camera() as camera:
        assert r.scene.was_seen_in(await camera.grab())
        assert camera.packet_size == 1500


async def test_a_stock_receive_buffer_loses_no_packet():
    async with rig(FULL, speed=50) as r, r.open_camera(socket_buffer_bytes=212_992) as camera:
        for _ in range(10):
            assert r.scene.was_seen_in(await camera.grab())
        assert camera.counters.packets_resent == 0


async def test_exposure_gain_and_times_come_with_the_frame():
    async with rig() as r, r.open_camera() as camera:
        await camera.configure(exposure_us=850.5, gain_db=2.5)
        called_ns = time.monotonic_ns()
        frame = await camera.grab()
        assert (frame.exposure_us, frame.gain_db, frame.camera_id) == (850.5, 2.5, "SN1")
        assert called_ns < frame.exposure_start_ns < frame.received_ns < time.monotonic_ns()
        assert (r.scene.exposures[-1].exposure_us, r.scene.exposures[-1].gain_db) == (850.5, 2.5)


async def test_the_exposure_is_dated_by_the_cameras_own_clock():
    async with rig() as r, r.open_camera() as camera:
        frame = await camera.grab()
        # The simulated camera's clock is the host's monotonic clock, so the mapped time can be judged.
        assert abs(frame.exposure_start_ns - frame.device_ns) < 5_000_000
        assert r.server.counts.triggers == 1


async def test_two_cameras_take_pictures_at_the_same_time():
    clock = Clock(50)
    scenes = [Scene(FULL, seed) for seed in (1, 2)]
    servers = [GigeCameraServer(fresh_ip(), f"SN{i}", scenes[i], clock) for i in range(2)]
    cameras = [GigeCamera(f"camera {i}", servers[i].ip, setup(serial=f"SN{i}")) for i in range(2)]

    async def take(i: int) -> None:
        await cameras[i].open()
        for _ in range(5):
            assert scenes[i].was_seen_in(await cameras[i].grab())

    async with servers[0], servers[1]:
        try:
            async with asyncio.TaskGroup() as group:
                for i in range(2):
                    group.create_task(take(i))
        finally:
            for camera in cameras:
                await camera.close()


async def test_lost_packets_are_asked_for_again():
    async with rig() as r, r.open_camera() as camera:
        r.server.inject("drop_packets", packets=[0, 3, 7], frames=3)  # 0 is the leader
        for _ in range(3):
            assert r.scene.was_seen_in(await camera.grab())
        assert r.server.counts.packets_resent >= 9
        assert camera.counters.packets_resent >= 9


async def test_random_loss_reordering_and_doubled_packets_do_no_harm():
    async with rig(largest_packet=1500) as r, r.open_camera() as camera:
        r.server.inject("drop_ratio", ratio=0.02)
        r.server.inject("reorder")
        r.server.inject("duplicate", ratio=0.05)
        for _ in range(5):
            assert r.scene.was_seen_in(await camera.grab())
        assert r.server.faults.packets_dropped > 0


@pytest.mark.parametrize("why", ["resends lost too", "not in memory any more"])
async def test_a_picture_that_cannot_be_completed_is_lost_and_the_next_is_good(why: str):
    async with rig() as r, r.open_camera() as camera:
        r.server.inject("drop_packets", packets=[2, 3])
        if why == "resends lost too":
            r.server.inject("drop_resends", ratio=1.0)
        else:
            r.server.inject("resend_unavailable")
        with pytest.raises(FrameLost, match=r"camera 1: picture 1 came incomplete: timeout, .* of 307240 bytes"):
            await camera.grab()
        r.server.inject("clear")
        assert r.scene.was_seen_in(await camera.grab())
        assert (camera.counters.incomplete, camera.counters.delivered) == (1, 1)


async def test_a_picture_of_another_size_is_not_delivered():
    async with rig() as r, r.open_camera() as camera:
        r.server.inject("wrong_size")
        with pytest.raises(FrameLost):
            await camera.grab()
        assert r.scene.was_seen_in(await camera.grab())


async def test_an_old_picture_is_never_delivered():
    async with rig() as r, r.open_camera() as camera:
        await camera.grab()
        r.server.inject("stale_frame")
        frame = await camera.grab()
        assert r.scene.was_seen_in(frame)
        assert camera.counters.stale == 1


async def test_an_old_picture_alone_is_no_answer():
    async with rig() as r, r.open_camera() as camera:
        await camera.grab()
        r.server.inject("stale_frame", alone=True)
        with pytest.raises(NoAnswer, match=r"no picture came in 0.3 s \(1 stale so far\)"):
            await camera.grab(within_s=0.3)
        assert r.scene.was_seen_in(await camera.grab())


async def test_an_ignored_trigger_is_no_answer_and_the_next_grab_works():
    async with rig() as r, r.open_camera() as camera:
        r.server.inject("ignore_trigger")
        with pytest.raises(NoAnswer):
            await camera.grab(within_s=0.2)
        assert r.scene.was_seen_in(await camera.grab())


async def test_a_lost_acknowledgement_does_not_trigger_twice():
    async with rig() as r, r.open_camera() as camera:
        await camera.grab()
        r.server.inject("lost_acks", count=3)  # latch, its reading, and the trigger are each asked twice
        frame = await camera.grab(within_s=3.0)
        assert r.scene.was_seen_in(frame)
        assert r.server.counts.triggers == 2
        assert len(r.scene.exposures) == 2


async def test_a_slow_control_channel_is_waited_for():
    async with rig() as r, r.open_camera() as camera:
        r.server.inject("pending_ack", delay_ms=40)
        assert r.scene.was_seen_in(await camera.grab())


async def test_cable_out_is_noticed_in_time_and_the_camera_can_be_opened_again():
    async with rig() as r, r.open_camera() as camera:
        await camera.configure(exposure_us=700)
        r.server.inject("mute")
        began_s = time.monotonic()
        with pytest.raises(NoAnswer, match="trigger not acknowledged"):
            await camera.grab()
        assert time.monotonic() - began_s < 1.5
        with pytest.raises(LinkLost, match="open it again"):
            await camera.grab()
        r.server.inject("mute", on=False)
        await camera.open()
        frame = await camera.grab()
        assert r.scene.was_seen_in(frame)
        assert frame.exposure_us == 700


async def test_a_cable_pulled_in_mid_picture_is_no_answer():
    async with rig() as r, r.open_camera() as camera:
        await camera.grab()
        seen = r.scene.__call__

        def pull(exposure: Exposure) -> np.ndarray:
            r.server.inject("mute")
            return seen(exposure)

        r.server._imaging._picture = pull
        with pytest.raises((NoAnswer, LinkLost)):
            await camera.grab(within_s=0.5)
        r.server.inject("mute", on=False)


async def test_closing_while_the_cable_is_out_does_not_wait_for_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gige, "CLOSE_WITHIN_S", 0.2)
    async with rig() as r, r.camera() as camera:
        await camera.open()
        r.server.inject("mute")
        began_s = time.monotonic()
        await camera.close()
        assert time.monotonic() - began_s < 0.5
        r.server.inject("mute", on=False)
        await until_threads_end(within_s=10)


async def test_a_camera_with_another_serial_number_is_refused_by_both_names():
    async with rig() as r, r.camera(setup(SMALL, "SN2")) as camera:
        with pytest.raises(Mismatch, match=f"{r.server.ip} has serial number 'SN1', not 'SN2'"):
            await camera.open()


async def test_a_smaller_sensor_than_configured_is_refused():
    async with rig((320, 240)) as r:
        camera = GigeCamera("camera 1", r.server.ip, setup(SMALL))
        with pytest.raises((Refused, Mismatch)):
            await camera.open()
        await camera.close()


async def test_a_camera_that_is_not_there_is_link_lost():
    camera = GigeCamera("camera 1", fresh_ip(), setup())
    with pytest.raises(LinkLost, match="camera 1: camera SN1 at 127"):
        await camera.open()
    with pytest.raises(LinkLost, match="not open"):
        await camera.grab()
    await camera.close()


async def test_a_camera_that_another_program_controls_is_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(gige_setup, "HEARTBEAT_MARGIN_S", -1.0)
    async with rig() as r, r.open_camera() as first, r.camera() as second:
        r.server.registers["GevHeartbeatTimeout"] = 1500  # the library's heartbeat comes each second
        with pytest.raises(Refused, match="another program controls it"):
            await second.open()
        assert r.scene.was_seen_in(await first.grab())
        assert r.server.counts.controllers_refused > 0


async def test_a_camera_still_held_by_a_program_that_died_is_waited_for():
    async with rig() as r, r.camera() as camera:
        r.server.registers["GevHeartbeatTimeout"] = 500
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as dead:
            dead.sendto(struct.pack(">BBHHHII", 0x42, 1, 0x82, 8, 1, 0xA00, 2), (r.server.ip, 3956))
            await until(lambda: r.server.registers["GevCCP"] == 2)
        await camera.open()
        r.server.registers["GevHeartbeatTimeout"] = 3000
        assert r.scene.was_seen_in(await camera.grab())


async def test_a_camera_that_drops_its_controller_is_link_lost_until_opened_again():
    async with rig() as r, r.open_camera() as camera:
        await camera.grab()
        r.server.inject("release_control")
        with pytest.raises(LinkLost):
            await camera.grab()
        await camera.open()
        assert r.scene.was_seen_in(await camera.grab())


async def test_after_a_cancelled_grab_the_next_gets_its_own_picture():
    async with rig(speed=1.0) as r, r.open_camera() as camera:
        for delay_s in (0.0, 0.001, 0.002, 0.004):
            grab = asyncio.create_task(camera.grab())
            await asyncio.sleep(delay_s)
            grab.cancel()
            with pytest.raises(asyncio.CancelledError):
                await grab
            called_ns = time.monotonic_ns()
            frame = await camera.grab()
            assert frame.device_ns > called_ns
            assert r.scene.was_seen_in(frame)


async def test_grabs_take_turns():
    async with rig() as r, r.open_camera() as camera:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(camera.grab()) for _ in range(4)]
        starts = [task.result().exposure_start_ns for task in tasks]
        assert starts == sorted(starts)
        assert len({task.result().frame_id for task in tasks}) == 4
        assert r.server.counts.triggers == 4


async def test_an_exposure_that_the_camera_does_not_take_is_refused():
    async with rig() as r, r.open_camera() as camera:
        with pytest.raises(Refused):
            await camera.configure(exposure_us=2_000_000)
        r.server.inject("stuck_exposure")
        with pytest.raises(Refused, match="asked for 900 us and 0 dB, it set 1000 us"):
            await camera.configure(exposure_us=900)


async def test_verbs_before_open_and_after_close_say_so():
    async with rig() as r, r.camera() as camera:
        with pytest.raises(LinkLost, match="not open"):
            await camera.configure(exposure_us=1000)
        await camera.open()
        await camera.close()
        await camera.close()
        with pytest.raises(LinkLost, match="not open"):
            await camera.grab()
        await camera.open()
        assert r.scene.was_seen_in(await camera.grab())


async def test_open_can_be_cancelled():
    async with rig() as r, r.camera() as camera:
        opening = asyncio.create_task(camera.open())
        await asyncio.sleep(0.005)
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        await until_threads_end()
        await camera.open()
        assert r.scene.was_seen_in(await camera.grab())


async def test_nothing_is_left_running_after_close():
    async with rig() as r:
        async with r.open_camera() as camera:
            await camera.grab()
            assert driver_threads()
        await until_threads_end()
    assert asyncio.all_tasks() == {asyncio.current_task()}
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("simulated")]


async def test_a_missing_library_is_unavailable_and_names_the_package(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(aravis_library, "SONAME", "libaravis-missing.so.0")
    monkeypatch.setattr(aravis, "library", aravis_library.Library)
    camera = GigeCamera("camera 1", "127.0.0.1", setup())
    with pytest.raises(Unavailable, match=r"libaravis-0\.8-0"):
        await camera.open()
    await camera.close()
