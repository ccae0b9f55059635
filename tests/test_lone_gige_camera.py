"""A simulated GigE Vision camera as a program of its own: the driver works with it, a person breaks it, it ends."""

import asyncio
import json
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.errors import NoAnswer
from drivers.gige import GigeCamera
from tests.gige_peers import output_of, running
from tests.gige_rig import SMALL, fresh_ip, setup

PROGRAM = (sys.executable, "-m", "simulators", "camera", "--width", "640", "--height", "480")


@asynccontextmanager
async def camera_program(ip: str, *options: str) -> AsyncIterator[asyncio.subprocess.Process]:
    async with running(*PROGRAM, "--gige", ip, "--serial", "SN1", *options) as process, asyncio.timeout(20):
        assert process.stdout is not None
        while b"stop with Ctrl-C" not in (line := await process.stdout.readline()):
            assert line, "it ended"
        yield process


async def tell(person: Path, **verb: object) -> dict[str, object]:
    reader, writer = await asyncio.open_unix_connection(person)
    writer.write(json.dumps(verb).encode() + b"\n")
    answer = json.loads(await reader.readline())
    writer.close()
    await writer.wait_closed()
    return dict(answer)


async def test_the_driver_takes_pictures_until_a_person_pulls_the_cable(tmp_path: Path):
    ip, person = fresh_ip(), tmp_path / "person"
    async with camera_program(ip, "--person", str(person), "--mtu", "1500", "--speed", "10") as process:
        camera = GigeCamera("camera 1", ip, setup(SMALL))
        try:
            await camera.open()
            first, second = await camera.grab(), await camera.grab()
            assert first.pixels.std() > 10
            assert (first.pixels != second.pixels).any()
            assert camera.packet_size == 1500
            assert (await tell(person, do="state"))["triggers"] == 2
            assert "has no fault" in str((await tell(person, do="inject", fault="unplug"))["error"])
            assert (await tell(person, do="inject", fault="mute"))["ok"]
            with pytest.raises(NoAnswer):
                await camera.grab(within_s=0.2)
            await tell(person, do="inject", fault="mute", on=False)
            await camera.open()
            await camera.grab()
        finally:
            await camera.close()
        process.send_signal(signal.SIGTERM)
        assert await process.wait() == 0


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--gige", "127.0.0.1.2"), "'127.0.0.1.2' is no address of 127.0.0.0/8"),
        (("--gige", "192.168.1.5"), "'192.168.1.5' is no address of 127.0.0.0/8"),
        (("--gige", "127.0.0.9", "--mtu", "100"), "--mtu must be from 220 to 16000"),
    ],
)
async def test_what_cannot_be_is_refused_in_one_sentence(options: tuple[str, ...], says: str):
    said = await output_of(*PROGRAM, *options)
    assert says in said
    assert "Traceback" not in said
