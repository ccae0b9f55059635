"""The V4L2 driver against the simulated camera: the right picture, from the right camera, set as it was asked for."""

import asyncio
import time
from pathlib import Path

import numpy as np
import pytest

from cellctl.pictures.jpeg import luma
from drivers import pixels
from drivers.camera import Region, Setup, Trigger
from drivers.errors import FrameLost, LinkLost, Mismatch, Refused
from drivers.v4l2 import V4l2Camera
from drivers.v4l2_facts import facts
from drivers.v4l2_node import serial_number
from simulators.v4l2.controls import AUTO_GAIN, EXPOSURE_ABSOLUTE, EXPOSURE_AUTO, GAIN, MANUAL, MIRRORED, UPSIDE_DOWN
from tests.v4l2_rig import FRONTS, FULL, SMALL, needs_fuse, rig, where

# Pictures


@pytest.mark.parametrize("front", FRONTS)
async def test_five_megapixel_pictures_arrive_byte_for_byte_and_read_only(front: str, tmp_path: Path):
    async with rig(FULL, speed=50, path=where(front, tmp_path)) as r, r.open_camera() as camera:
        frames = []
        for number in range(1, 4):
            frames.append(await camera.grab())
            assert r.scene.number_of(frames[-1].pixels) == number
        assert not frames[0].pixels.flags.writeable
        with pytest.raises(ValueError, match="read-only"):
            frames[0].pixels[0, 0] = 1
        assert np.array_equal(frames[0].pixels, r.scene.pictures[1])  # later pictures leave the first as it was
        assert [frame.frame_id for frame in frames] == [0, 1, 2]
        assert camera.counters.delivered == 3


@pytest.mark.parametrize("front", FRONTS)
async def test_a_camera_without_trigger_gives_the_first_picture_exposed_after_the_request(front: str, tmp_path: Path):
    options = {"triggers": False, "rate_hz": 60.0, "path": where(front, tmp_path)}
    async with rig(speed=1, **options) as r, r.open_camera() as camera:
        for _ in range(5):
            await asyncio.sleep(0.02)
            asked_ns = time.monotonic_ns()
            frame = await camera.grab()
            assert frame.exposure_start_ns >= asked_ns - 1000  # stamps are in microseconds
            assert r.scene.was_seen_in(frame)
        assert camera.counters.stale >= 1


async def test_a_time_stamp_of_the_pictures_end_is_counted_back_to_the_earliest_start_of_its_exposure():
    options = {"triggers": False, "rate_hz": 60.0, "start_of_exposure": False}
    async with rig(speed=1, **options) as r, r.open_camera() as camera:
        await camera.configure(exposure_us=4000)
        for _ in range(5):
            before = len(r.scene.exposures)
            frame = await camera.grab()
            assert (r.scene.number_of(frame.pixels) or 0) > before
            assert frame.device_ns - frame.exposure_start_ns >= 4_000_000


async def test_the_usb_driver_calls_the_first_packet_the_start_of_exposure_and_is_not_believed():
    async with rig(speed=1, triggers=False, rate_hz=60.0) as r:
        r.server.device.driver = "uvcvideo"
        async with r.open_camera() as camera:
            await camera.configure(exposure_us=3000)
            frame = await camera.grab()
            assert frame.device_ns - frame.exposure_start_ns >= 3_000_000


async def test_a_camera_whose_time_stamps_are_by_another_clock_is_refused():
    async with rig() as r:
        r.server.device.monotonic = False
        camera = r.camera()
        with pytest.raises(Mismatch, match="does not stamp pictures by the host's clock"):
            await camera.open()
        await camera.close()


FOURCCS = [
    ("GREY", pixels.MONO8),
    ("Y10 ", pixels.MONO10),
    ("Y12 ", pixels.MONO12),
    ("Y16 ", pixels.MONO16),
    ("Y10P", pixels.RAW10P),
    ("YUYV", pixels.YUYV),
]


@pytest.mark.parametrize(("fourcc", "pixel_format"), FOURCCS)
@pytest.mark.parametrize("padding_bytes", [0, 24])
async def test_every_format_arrives_as_the_grey_levels_that_the_sensor_saw(
    fourcc: str, pixel_format: pixels.PixelFormat, padding_bytes: int
):
    async with rig(padding_bytes=padding_bytes) as r, r.open_camera(pixel_format=pixel_format) as camera:
        frame = await camera.grab()
        assert r.server.device.readout.format.fourcc == fourcc
        assert r.scene.was_seen_in(frame)
        assert frame.payload.size == pixel_format.bytes_for(*SMALL)
        assert frame.pixel_format == pixel_format
        assert np.array_equal(frame.deep() >> (pixel_format.bits - 8), frame.pixels)


async def test_jpeg_pictures_are_decoded_and_a_broken_one_is_lost():
    async with rig() as r, r.open_camera(decode=luma) as camera:
        r.scene.pictures[:] = np.arange(SMALL[0], dtype=np.uint16).astype(np.uint8) // 4  # what JPEG hardly changes
        frame = await camera.grab()
        assert np.abs(frame.pixels.astype(int) - r.scene.pictures[0].astype(int)).max() <= 3
        r.server.inject("wrong_size")
        with pytest.raises(FrameLost, match="JPEG"):
            await camera.grab()


async def test_a_region_is_read_from_its_place_on_the_sensor():
    async with rig() as r, r.open_camera(region=Region(64, 32, 320, 200)) as camera:
        frame = await camera.grab()
        assert frame.pixels.shape == (200, 320)
        assert np.array_equal(frame.pixels, r.scene.pictures[1][32:232, 64:384])


# Settings


async def test_exposure_and_gain_are_set_read_back_and_kept_for_the_next_opening():
    async with rig() as r, r.open_camera(gain_db_per_step=0.1) as camera:
        await camera.configure(exposure_us=2500, gain_db=6.0)
        frame = await camera.grab()
        assert (frame.exposure_us, frame.gain_db) == (2500, 6.0)
        assert (r.scene.exposures[-1].exposure_us, r.scene.exposures[-1].gain_db) == (2500, pytest.approx(6.0))
        r.server.device.controls.set((GAIN).to_bytes(4, "little") + bytes(4))
        await camera.open()
        assert (await camera.grab()).gain_db == pytest.approx(6.0)


async def test_automatic_exposure_and_gain_are_turned_off():
    async with rig() as r, r.open_camera() as camera:
        await camera.configure(exposure_us=2000)
        values = {number: r.server.device.controls.find(number).value for number in (EXPOSURE_AUTO, AUTO_GAIN)}
        assert values == {EXPOSURE_AUTO: MANUAL, AUTO_GAIN: 0}


async def test_an_exposure_that_the_camera_does_not_take_is_refused():
    async with rig() as r, r.open_camera() as camera:
        with pytest.raises(Refused, match="2050 us and 0 dB, it set 2000 us"):
            await camera.configure(exposure_us=2050)
        with pytest.raises(Refused, match="goes from 1 to 10000"):
            await camera.configure(exposure_us=2_000_000)
        r.server.inject("stuck_exposure")
        with pytest.raises(Refused, match="it set 2000 us"):
            await camera.configure(exposure_us=3000)
        assert r.server.device.controls.find(EXPOSURE_ABSOLUTE).value == 20


async def test_a_trigger_that_the_camera_does_not_take_is_refused():
    async with rig() as r, r.open_camera() as camera:
        r.server.inject("stuck_trigger")
        with pytest.raises(Refused, match="Trigger Mode was set to 0 and is 1"):
            await camera.arm(Trigger.FREE)


async def test_a_gain_in_db_is_refused_without_the_size_of_a_step():
    async with rig() as r, r.open_camera() as camera:
        with pytest.raises(Refused, match="gain_db_per_step"):
            await camera.configure(exposure_us=2000, gain_db=3.0)


async def test_pictures_that_may_have_the_old_exposure_are_not_given_after_a_change():
    async with rig(speed=1, triggers=False, rate_hz=60.0) as r, r.open_camera() as camera:
        for exposure_us in (1000.0, 5000.0, 2000.0):
            await camera.configure(exposure_us=exposure_us)
            frame = await camera.grab()
            number = r.scene.number_of(frame.pixels)
            assert number is not None
            assert r.scene.exposures[number - 1].exposure_us == exposure_us == frame.exposure_us


async def test_a_format_or_size_that_the_camera_does_not_have_is_refused_with_what_it_has():
    async with rig(formats=("GREY", "YUYV")) as r:
        for options, says in (
            ({"pixel_format": pixels.MONO16}, "has no Y16 ; it has GREY, YUYV"),
            ({"pixel_format": pixels.MONO12P}, "no format Mono12p"),
            ({"region": Region(0, 0, 642, 480)}, "asked for 642 x 480 GREY, it set 640 x 480"),
            ({"region": Region(2, 0, 320, 200)}, "it reads 320 x 200 px at 0, 0"),
        ):
            camera = r.camera(**options)
            with pytest.raises(Refused, match=says):
                await camera.open()
            await camera.close()


async def test_a_camera_that_was_left_mirrored_is_set_right_at_opening():
    async with rig() as r:
        for number in (MIRRORED, UPSIDE_DOWN):
            r.server.device.controls.find(number).value = 1
        async with r.open_camera() as camera:
            assert r.scene.was_seen_in(await camera.grab())


# Which camera


async def test_another_serial_number_is_refused():
    async with rig() as r:
        camera = r.camera(serial="SN2")
        with pytest.raises(Mismatch, match="serial number 'SN1', not 'SN2'"):
            await camera.open()
        await camera.close()


@pytest.mark.parametrize(
    ("bus", "serial"),
    [
        ("platform:3f801000.csi", "3f801000.csi"),
        ("PCI:0000:05:00.0", "0000-05-00.0"),
        ("usb-0000:00:14.0-1", "0000-00-14.0-1"),
    ],
)
def test_a_camera_without_usb_serial_number_is_known_by_its_place(bus: str, serial: str):
    assert serial_number("/dev/null", bus) == serial


async def test_what_is_no_camera_is_refused_and_what_is_not_there_is_lost(tmp_path: Path):
    setup = Setup("SN1", Region(0, 0, *SMALL))
    with pytest.raises(Mismatch, match="no V4L2 camera"):
        await V4l2Camera("camera 1", "/dev/null", setup).open()
    with pytest.raises(LinkLost, match="No such file"):
        await V4l2Camera("camera 1", str(tmp_path / "video9"), setup).open()


@pytest.mark.parametrize("front", FRONTS)
async def test_a_camera_that_another_program_uses_is_refused_until_that_lets_go(front: str, tmp_path: Path):
    async with rig(path=where(front, tmp_path)) as r, r.open_camera() as first:
        second = r.camera()
        with pytest.raises(Refused, match="another program is using"):
            await second.open()
        await first.close()
        await second.open()
        assert r.scene.was_seen_in(await second.grab())
        await second.close()


async def test_a_camera_tells_of_itself_while_another_program_streams_from_it(tmp_path: Path):
    needs_fuse()
    path = tmp_path / "video0"
    async with rig(path=path, formats=("GREY", "MJPG")) as r, r.open_camera() as camera:
        told = await facts("camera 1", str(path))
        assert (told["serial"], told["model"]) == ("SN1", "Simulated camera")
        assert (told["width_px"], told["height_px"], told["pixel_format"]) == (*SMALL, "GREY")
        assert (told["pixel_formats"], told["pictures_per_s"]) == (["GREY", "MJPG"], 15)
        assert (told["exposure_us"], told["software_trigger"]) == (2000, True)
        assert r.scene.was_seen_in(await camera.grab())
        r.server.inject("unplug")
        with pytest.raises(LinkLost):
            await facts("camera 1", str(path))
