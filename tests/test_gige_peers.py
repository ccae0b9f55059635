"""Other people's GigE Vision programs: three clients at the simulated camera, another simulated one at the driver."""

import asyncio
import hashlib
import importlib.util
import json
import os
import re
import sys

import numpy as np
import pytest

from drivers import gige_facts
from drivers.camera import Region, Setup, Trigger
from drivers.gige import GigeCamera
from drivers.gige_discovery import discover
from tests.gige_client import AT, OK, SENSOR, served
from tests.gige_peers import HOME, heard_at_home, output_of, program, running
from tests.gige_rig import SMALL, Rig, rig, until

FAKE = ("arv-fake-gv-camera-0.8", "aravis-tools")
FAKE_SIZE = (512, 512)
VIVA_GRABS = """
import hashlib, json, sys
import viva_genicam
(found,) = [each for each in viva_genicam.discover(500, all=True) if each.ip == sys.argv[1]]
told = {"model": found.model, "hashes": [], "whole": []}
with viva_genicam.connect_gige(found, iface="127.0.0.1") as camera:
    told["skipped"] = len(camera.skipped())
    camera.set_exposure_time(1234.0)
    told["exposure_us"] = camera.exposure_time()
    camera.enable_trigger("FrameStart", "Software")
    with camera.stream(iface="127.0.0.1", auto_packet_size=True) as stream:
        camera.acquisition_start()
        for _ in range(int(sys.argv[2])):
            camera.trigger_software()
            frame = stream.next_frame(timeout_ms=1000)
            told["whole"].append(frame is not None and frame.is_complete)
            if told["whole"][-1]:
                told["hashes"].append(hashlib.sha256(frame.to_numpy().tobytes()).hexdigest())
        camera.acquisition_stop()
        told["recovered"] = stream.stats().resend_recovered
print(json.dumps(told))
"""
VIVA_WATCHES = """
import json, sys
import viva_genicam
(found,) = [each for each in viva_genicam.discover(500, all=True) if each.ip == sys.argv[1]]
with viva_genicam.connect_gige(found, iface="127.0.0.1", monitor=True) as camera:
    told = {"width": camera.get_integer("Width")}
    try:
        camera.set_exposure_time(900.0)
    except viva_genicam.GenicamError as error:
        told["refused"] = str(error)
try:
    viva_genicam.connect_gige(found, iface="127.0.0.1").close()
except viva_genicam.GenicamError as error:
    told["no_control"] = str(error)
print(json.dumps(told))
"""
VIVA_ACTS = """
import sys
import viva_genicam
print(viva_genicam.send_action(0xC0FFEE, 7, 2, destination=sys.argv[1]))
"""


def needs_viva() -> None:
    if importlib.util.find_spec("viva_genicam") is None:
        reason = "viva-genicam is not installed (PyPI)"
        pytest.fail(reason) if os.environ.get("CELLCTL_STRICT") else pytest.skip(reason)


async def told_by_viva(script: str, *arguments: str) -> dict[str, object]:
    said = await output_of(sys.executable, "-c", script, *arguments)
    try:
        return dict(json.loads(said.splitlines()[-1]))
    except (ValueError, IndexError):
        pytest.fail(f"viva-genicam: {said}")


def hashes(r: Rig) -> set[str]:
    return {hashlib.sha256(picture.tobytes()).hexdigest() for picture in r.scene.pictures}


# -- clients at our camera ----------------------------------------------------------------------------------------


async def test_arv_tool_finds_the_camera_reads_its_features_and_sets_them():
    tool = program("arv-tool-0.8", "aravis-tools-cli")
    async with served(name="left") as (server, _client):
        assert f"({server.ip})" in await output_of(tool, server.ip)
        values = await output_of(tool, "-a", server.ip, "values")
        for line in ("'DeviceID' = 'SN7'", "'Width' = 640", "'ExposureTime' = 1000 us", "'PayloadSize' = 307200"):
            assert line in values
        wanted = ["Width=320", "ExposureTime=1234.5", "Gain=3.3", "AcquisitionFrameRate=12.5", "DeviceUserID=right"]
        await output_of(tool, "-a", server.ip, "control", *wanted)
        registers = server.registers
        assert (registers["Width"], registers["ExposureNs"]) == (320, 1_234_500)
        assert (registers["GainMillidB"], registers["FramePeriodUs"]) == (3_300, 80_000)
        assert b"right" in registers.discovery()


@pytest.mark.parametrize("loss", [0.0, 0.005])
async def test_arv_camera_test_gets_every_picture_whole(loss: float):
    tester = program("arv-camera-test-0.8", "aravis-tools")
    async with rig() as r:
        r.server.inject("drop_ratio", ratio=loss)
        said = await output_of(
            tester, "-n", r.server.ip, "-o", "25", "-i", "1500", "--no-packet-socket", "-a", "--duration=2"
        )
        counted = {name: int(number) for name, number in re.findall(r"^n_(\w+) += (\d+)", said, re.MULTILINE)}
        assert counted["completed_buffers"] >= 20, said
        assert counted["failures"] == counted["size_mismatch_errors"] == counted["aborted"] == 0, said
        assert (counted["resent_packets"] > 0) == (r.server.faults.packets_dropped > 0) == (loss > 0)


@pytest.mark.parametrize("loss", [0.0, 0.02])
async def test_viva_genicam_gets_exact_pictures_and_has_lost_packets_sent_again(loss: float):
    needs_viva()
    async with rig(largest_packet=1500) as r, heard_at_home(r.server):
        r.server.inject("drop_ratio", ratio=loss)
        told = await told_by_viva(VIVA_GRABS, r.server.ip, "12")
        assert (told["model"], told["exposure_us"], told["skipped"]) == ("CellSim", 1234.0, 0)
        assert set(told["hashes"]) <= hashes(r)
        # It does not ask again for a leader or a trailer that was lost.
        assert sum(told["whole"]) >= (12 if not loss else 8)
        assert (told["recovered"] > 0) == (loss > 0)


async def test_viva_genicam_may_watch_a_camera_that_the_driver_controls_and_no_more():
    needs_viva()
    async with rig() as r, heard_at_home(r.server), r.open_camera() as camera:
        told = await told_by_viva(VIVA_WATCHES, r.server.ip)
        assert told["width"] == SMALL[0]
        assert "refused" in told
        assert "no_control" in told
        assert r.scene.was_seen_in(await camera.grab())


async def test_viva_genicams_action_command_starts_the_camera():
    needs_viva()
    async with served() as (server, client):
        await client.arm()
        keys = {"ActionDeviceKey": 0xC0FFEE, "ActionGroupKey": 7, "ActionGroupMask": 2, "TriggerSource": 2}
        for name, value in keys.items():
            assert await client.write(AT[name], value) == OK
        said = await output_of(sys.executable, "-c", VIVA_ACTS, server.ip)
        assert "1" in said
        _leader, pixels = await client.picture()
        assert pixels.shape == SENSOR[::-1]
        assert server.counts.triggers == 1


# -- another simulated camera at our driver -----------------------------------------------------------------------


def fakes_picture(number: int) -> np.ndarray:
    """Its test picture: a ramp along both sides that moves with the picture's number."""
    v, u = np.mgrid[: FAKE_SIZE[1], : FAKE_SIZE[0]]
    return ((u + v + number) % 255).astype(np.uint8)


async def test_the_driver_takes_exact_pictures_of_the_aravis_fake_camera_which_has_no_clock():
    async with running(program(*FAKE), "-i", HOME, "-s", "GV42"):
        camera = GigeCamera("camera 1", HOME, Setup("GV42", Region(0, 0, *FAKE_SIZE)))
        await until_there()
        assert "GV42" in {each.camera.serial for each in await discover(addresses=[HOME])}
        facts = await gige_facts.facts("camera 1", HOME)
        assert (facts["vendor"], facts["clock"]) == ("Aravis", "none")
        try:
            await camera.open()
            await camera.configure(exposure_us=10_000.0)
            assert (await camera.health()).has_clock is False
            numbers = []
            for _ in range(6):
                frame = await camera.grab()
                numbers.append(frame.frame_id)
                assert np.array_equal(frame.pixels, fakes_picture(frame.frame_id))
                assert frame.exposure_us == 10_000.0
            assert numbers == list(range(numbers[0], numbers[0] + 6))
            await camera.arm(Trigger.FREE)
            for _ in range(3):
                frame = await camera.next_frame()
                assert np.array_equal(frame.pixels, fakes_picture(frame.frame_id))
        finally:
            await camera.close()


async def test_packets_that_the_aravis_fake_camera_loses_cost_pictures_and_never_break_one():
    async with running(program(*FAKE), "-i", HOME, "-s", "GV42", "-r", "2"):
        await until_there()
        camera = GigeCamera("camera 1", HOME, Setup("GV42", Region(0, 0, *FAKE_SIZE)))
        try:
            await camera.open()
            await camera.arm(Trigger.FREE)
            for _ in range(10):
                frame = await camera.next_frame(within_s=5.0)
                assert np.array_equal(frame.pixels, fakes_picture(frame.frame_id))
            await until(lambda: camera.counters.incomplete > 0, within_s=10.0)
        finally:
            await camera.close()


async def until_there() -> None:
    async with asyncio.timeout(5.0):
        while not await discover(addresses=[HOME], within_s=0.1):
            pass
