"""`cellctl camera ...` against simulated cameras and folders."""

import asyncio
import json
import os
import re
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from cellctl.desk.live_view import STRIP_PX
from cellctl.pictures.files import read_picture
from tests.command_line import Ended, run
from tests.gige_rig import SMALL, Rig, fresh_ip, rig, setup

CELL = Path(__file__).parent.parent / "deploy" / "simulated-cell.toml"


class Desk(NamedTuple):
    """A cell.toml whose camera 1 is a simulated camera, and commands that use it."""

    config: Path
    r: Rig

    async def camera(self, *arguments: object) -> Ended:
        return await asyncio.to_thread(run, "camera", *arguments, "--config", self.config)


def cell(folder: Path, *changes: tuple[str, str]) -> Path:
    text = CELL.read_text()
    folders = [("../build/simulated-cell", str(folder)), ("../recipes", str(CELL.parent.parent / "recipes"))]
    small = [("= 2592", f"= {SMALL[0]}"), ("= 1944", f"= {SMALL[1]}"), ("mm_per_px = 0.007333", "mm_per_px = 0.03")]
    for old, new in [*folders, *small, *changes]:
        assert old in text
        text = text.replace(old, new)
    path = folder / "cell.toml"
    path.write_text(text)
    return path


@asynccontextmanager
async def desk(folder: Path, *changes: tuple[str, str], absent: bool = False) -> AsyncIterator[Desk]:
    async with rig(SMALL, speed=50) as r:
        address = fresh_ip() if absent else r.server.ip
        serial = ('serial = "SIM-CAM-1"', 'serial = "SN1"')
        elsewhere = ('"127.0.0.3"', f'"{fresh_ip()}"')
        config = cell(folder, ('"127.0.0.2"', f'"{address}"'), serial, elsewhere, *changes)
        yield Desk(config, r)


async def test_list_shows_who_is_there_and_which_of_the_cells_cameras_is_missing(tmp_path: Path):
    async with desk(tmp_path) as d:
        shown = await d.camera("list")
        told = json.loads((await d.camera("list", "--json")).out)
    assert re.search(rf"^{re.escape(d.r.server.ip)} +SN1 +Cellctl +CellSim .* lo .* camera 1$", shown.out, re.MULTILINE)
    assert "camera 2 of the cell does not answer at" in shown.out
    assert shown.code == 1
    assert told["missing"] == ["camera 2"]
    (mine,) = [each for each in told["cameras"] if each["address"] == d.r.server.ip]
    assert (mine["serial"], mine["cell"]) == ("SN1", "camera 1")


async def test_info_tells_formats_and_region_while_another_program_is_at_work(tmp_path: Path):
    async with desk(tmp_path) as d, d.r.open_camera() as camera:
        told = json.loads((await d.camera("info", 1, "--json")).out)
        shown = await d.camera("info", 1)
        assert d.r.scene.was_seen_in(await camera.grab())
    assert (told["serial"], told["sensor_width_px"], told["exposure_us"]) == ("SN1", 640, 1000)
    assert "Mono12p" in told["pixel_formats"]
    assert told["free"] is False
    assert re.search(r"^free +no, another program controls it$", shown.out, re.MULTILINE)
    assert re.search(r"^temperature +41\.5 C$", shown.out, re.MULTILINE)
    assert shown.code == 0


async def test_snap_writes_what_the_sensor_saw(tmp_path: Path):
    async with desk(tmp_path) as d:
        ended = await d.camera("snap", 1, "--out", tmp_path / "one.png", "--exposure-us", 850, "--gain-db", 2, "--json")
        assert np.array_equal(read_picture(tmp_path / "one.png").pixels, d.r.scene.newest)
        told = json.loads(ended.out)
        assert (told["camera"], told["exposure_us"], told["gain_db"]) == ("SN1", 850, 2)
        again = await d.camera("snap", 1, "--out", tmp_path / "one.png")
        assert (again.code, again.err) == (1, f"{tmp_path / 'one.png'}: is there already (--force replaces it)\n")
        two = await d.camera("snap", 1, "--out", tmp_path / "one.png", "--force", "--count", 2)
        assert two.code == 0
    assert {name for name in os.listdir(tmp_path) if name.endswith("png")} == {"one.png", "one-001.png", "one-002.png"}


async def test_a_deep_picture_keeps_its_bits_in_the_file_and_measures_alike(tmp_path: Path):
    deep = np.random.default_rng(3).integers(0, 1 << 16, SMALL[::-1], dtype=np.uint16)
    async with desk(tmp_path, ('lens = "telecentric" ', 'pixel_format = "Mono12p"\nlens = "telecentric" ')) as d:
        d.r.server._imaging._picture = lambda _exposure: deep
        assert (await d.camera("snap", 1, "--out", tmp_path / "deep.png", "--deep")).code == 0
        assert (await d.camera("snap", 1, "--out", tmp_path / "seen.png")).code == 0
    stored = cv2.imread(str(tmp_path / "deep.png"), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(stored >> 4, deep >> 4)
    assert np.array_equal(read_picture(tmp_path / "deep.png").pixels, read_picture(tmp_path / "seen.png").pixels)


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (["snap", "1", "--out", "x.jpg"], 1, "written as PNG, so its name must end in .png"),
        (["snap", "3"], 2, "'3' is not one of '1', '2'"),
        (["snap", "1", "--gain-db", "3"], 2, "--gain-db needs --exposure-us"),
        (["info", "2"], 1, "camera 2: 127."),
    ],
)
async def test_what_cannot_be_done_is_said_in_a_sentence(tmp_path: Path, arguments: list[str], code: int, says: str):
    async with desk(tmp_path) as d:
        ended = await d.camera(*arguments)
    assert ended.code == code
    assert says in ended.err
    assert "Traceback" not in ended.err


async def test_a_camera_that_the_daemon_owns_is_left_to_it(tmp_path: Path):
    async with desk(tmp_path) as d:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as daemon:
            daemon.bind(str(tmp_path / "control.sock"))
            daemon.listen(4)
            snapped = await d.camera("snap", 1, "--out", tmp_path / "x.png")
            checked = await d.camera("check", 1)
        assert d.r.server.counts.triggers == 0
    assert "the daemon runs and owns camera 1: stop it first (`systemctl stop cellctl`)" in snapped.err
    assert snapped.code == 1
    assert "no trial pictures: the daemon runs and owns the cameras" in checked.out
    assert checked.code == 0


async def test_set_address_moves_a_camera_and_says_how_to_keep_it_there(tmp_path: Path):
    async with desk(tmp_path) as d:
        serial = f"M-{d.r.server.ip.replace('.', '-')[-12:]}"
        d.r.server.registers._memory[216:232] = serial.encode().ljust(16, b"\0")
        there, elsewhere = fresh_ip(), fresh_ip()
        moved = await asyncio.to_thread(run, "camera", "set-address", serial, there)
        async with d.r.open_camera(setup(SMALL, serial)) as camera:
            assert d.r.scene.was_seen_in(await camera.grab())
            kept = await asyncio.to_thread(run, "camera", "set-address", serial, elsewhere)
        back = await asyncio.to_thread(run, "camera", "set-address", serial, elsewhere, "--json")
        assert d.r.server.ip == elsewhere
    assert moved.code == 0
    assert f"camera {serial} answers at {there} until it is switched off" in moved.out
    assert f"network ip={there} mask=255.0.0.0" in moved.out
    assert (kept.code, "a camera that a program controls keeps its address" in kept.err) == (1, True)
    assert json.loads(back.out)["address"] == elsewhere


@pytest.mark.parametrize(
    ("serial", "address", "says"),
    [
        ("NOBODY", "127.0.0.9", "no camera NOBODY answers on any network"),
        (None, "1.2.3", "1.2.3: must be an IPv4 address"),
        (None, "10.0.0.1", "10.0.0.1 is not in 127.0.0.0/8, the network of lo"),
        (None, "127.0.0.1", "127.0.0.1 is no address that a camera can have"),
    ],
)
async def test_an_address_that_cannot_be_set_is_refused(tmp_path: Path, serial: str | None, address: str, says: str):
    async with desk(tmp_path) as d:
        mine = f"M-{d.r.server.ip.replace('.', '-')[-12:]}"
        d.r.server.registers._memory[216:232] = mine.encode().ljust(16, b"\0")
        ended = await asyncio.to_thread(run, "camera", "set-address", serial or mine, address)
    assert (ended.code, says in ended.err) == (1, True), ended.err


async def test_check_finds_a_good_camera_good(tmp_path: Path):
    async with desk(tmp_path) as d:
        ended = await d.camera("check", 1, "--pictures", 3)
        told = [json.loads(line) for line in (await d.camera("check", 1, "--pictures", 2, "--json")).out.splitlines()]
    assert ended.code == 0
    assert "ok     camera 1  camera    Cellctl CellSim, serial SN1" in ended.out
    assert "3 of 3 whole, median" in ended.out
    assert {each["topic"] for each in told} >= {"buffer", "network", "camera", "packets", "warmth", "picture"}


async def test_check_counts_pictures_that_are_lost(tmp_path: Path):
    async with desk(tmp_path) as d:
        d.r.server.inject("drop_packets", packets=[5], frames=1)
        d.r.server.inject("resend_unavailable")
        ended = await d.camera("check", 1, "--pictures", 3)
    assert ended.code == 1
    assert re.search(r"^FAILED camera 1  picture   2 of 3 whole", ended.out, re.MULTILINE)


async def test_check_says_where_a_camera_is_that_is_not_where_it_should_be(tmp_path: Path):
    async with desk(tmp_path, absent=True) as d:
        d.r.server.registers._memory[216:232] = b"SN1-ELSEWHERE".ljust(16, b"\0")
        d.config.write_text(d.config.read_text().replace('"SN1"', '"SN1-ELSEWHERE"'))
        ended = await d.camera("check", 1)
    assert ended.code == 1
    assert f"the camera with this serial number answers at {d.r.server.ip}" in ended.out
    assert "`cellctl camera set-address SN1-ELSEWHERE 127." in ended.out
    assert "picture" not in ended.out


async def test_a_folder_is_a_camera_too(tmp_path: Path):
    folder = tmp_path / "pictures"
    folder.mkdir()
    pictures = np.random.default_rng(5).integers(0, 256, (2, *SMALL[::-1]), dtype=np.uint8)
    for number, pixels in enumerate(pictures):
        cv2.imwrite(str(folder / f"{number}.png"), pixels)
    changes = ('driver = "gige"\naddress = "127.0.0.2"', 'driver = "files"\naddress = "file:pictures"')
    config = cell(tmp_path, changes)
    ended = await asyncio.to_thread(run, "camera", "snap", 1, "--out", tmp_path / "x.png", "--config", config)
    assert ended.code == 0
    assert np.array_equal(read_picture(tmp_path / "x.png").pixels, pictures[0])
    told = await asyncio.to_thread(run, "camera", "info", 1, "--json", "--config", config)
    assert json.loads(told.out) == {"folder": str(folder), "pictures": 2}
    ended = await asyncio.to_thread(run, "camera", "check", 1, "--pictures", 3, "--config", config)
    assert "FAILED camera 1  picture   all 2 pictures of" in ended.out


async def test_live_in_the_terminal_ends_after_so_many_pictures(tmp_path: Path):
    async with desk(tmp_path) as d:
        ended = await d.camera("live", 1, "--terminal", "--pictures", 2, "--per-s", 30)
        assert d.r.server.counts.triggers == 2
    assert ended.code == 0
    assert ended.out.count("\x1b[H") == 2
    assert "sharpness" in ended.out


async def test_live_serves_the_camera_to_a_browser_of_this_computer(tmp_path: Path):
    port = free_port()
    async with desk(tmp_path) as d:
        watching = asyncio.create_task(d.camera("live", 1, "--port", port, "--pictures", 12, "--per-s", 10, "--json"))
        content = await page(port, "/picture.jpg")
        ended = await watching
    shown = cv2.imdecode(np.frombuffer(content.partition(b"\r\n\r\n")[2], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert shown.shape == (SMALL[1] + STRIP_PX, SMALL[0])
    assert json.loads(ended.out) == {"url": f"http://127.0.0.1:{port}/"}


async def test_live_says_when_its_port_is_taken(tmp_path: Path):
    async with desk(tmp_path) as d:
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            ended = await d.camera("live", 1, "--port", taken.getsockname()[1])
    assert (ended.code, "take another one (--port)" in ended.err) == (1, True)


def free_port() -> int:
    with socket.socket() as any_socket:
        any_socket.bind(("127.0.0.1", 0))
        return int(any_socket.getsockname()[1])


async def page(port: int, path: str, within_s: float = 10.0) -> bytes:
    """A page, as soon as it is served."""
    async with asyncio.timeout(within_s):
        while True:
            try:
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
            except ConnectionRefusedError:
                await asyncio.sleep(0.05)
                continue
            writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
            content = await reader.read()
            writer.close()
            return content
