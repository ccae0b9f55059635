"""A folder of pictures as a camera."""

import asyncio
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.cameras import build_camera
from cellctl.config_camera import CameraConfig
from drivers.camera import Camera, State, Trigger
from drivers.errors import FrameLost, LinkLost, NoAnswer, Refused

SIZE = (96, 80)


def picture(seed: int, size: tuple[int, int] = SIZE, kind: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, np.iinfo(kind).max, size[::-1], dtype=kind, endpoint=True)


def album(folder: Path, **files: np.ndarray | bytes) -> Path:
    for name, content in files.items():
        path = folder / name.replace("_", ".")
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            assert cv2.imwrite(str(path), content)
    return folder


def camera(folder: Path, **changed: object) -> Camera:
    values = {
        "driver": "files",
        "address": f"file:{folder}",
        "serial": "CAM-7",
        "mm_per_px": 0.01,
        "view_width_px": SIZE[0],
        "view_height_px": SIZE[1],
    }
    return build_camera("camera 1", CameraConfig(**(values | changed)))


async def test_pictures_are_given_out_in_order_each_once_and_read_only(tmp_path: Path):
    taken = camera(album(tmp_path, p10_png=picture(10), p2_png=picture(2), p9_tiff=picture(9)))
    await taken.open()
    await taken.configure(exposure_us=500, gain_db=1.0)
    frames = [await taken.grab() for _ in range(3)]
    assert [np.array_equal(frame.pixels, picture(seed)) for frame, seed in zip(frames, (2, 9, 10), strict=True)]
    assert [frame.frame_id for frame in frames] == [1, 2, 3]
    assert {frame.camera_id for frame in frames} == {"CAM-7"}
    assert (frames[0].exposure_us, frames[0].gain_db) == (500, 1.0)
    assert not frames[0].pixels.flags.writeable
    assert frames[0].exposure_start_ns <= frames[0].received_ns < frames[1].received_ns
    with pytest.raises(NoAnswer, match=r"all 3 pictures of .* were given out"):
        await taken.grab()
    await taken.open()  # begins anew
    assert np.array_equal((await taken.grab()).pixels, picture(2))
    assert taken.counters.delivered == 4
    await taken.close()


async def test_a_deep_file_is_brought_to_eight_bit_by_the_bits_of_its_format(tmp_path: Path):
    values = picture(1, kind=np.uint16) >> 4
    taken = camera(album(tmp_path, p_png=values), pixel_format="Mono12")
    await taken.open()
    assert np.array_equal((await taken.grab()).pixels, np.minimum((values.astype(int) + 8) // 16, 255))


async def test_files_that_cannot_be_used_are_lost_pictures_and_the_next_is_given_out(tmp_path: Path):
    broken = cv2.imencode(".png", picture(1))[1].tobytes()[:-20]
    album(tmp_path, p1_png=broken, p2_png=picture(2, (64, 64)), p3_png=picture(3))
    taken = camera(tmp_path)
    await taken.open()
    with pytest.raises(FrameLost, match=r"p1\.png: is cut off"):
        await taken.grab()
    with pytest.raises(FrameLost, match=r"p2\.png is 64 x 64 px, not 96 x 80"):
        await taken.grab()
    assert np.array_equal((await taken.grab()).pixels, picture(3))
    assert (taken.counters.incomplete, taken.counters.delivered) == (2, 1)


@pytest.mark.parametrize("empty", [True, False])
async def test_a_folder_without_pictures_or_that_is_not_there_is_link_lost(tmp_path: Path, empty: bool):
    taken = camera(tmp_path if empty else tmp_path / "nowhere")
    with pytest.raises(LinkLost, match="there is no picture in it" if empty else "there is no such file or folder"):
        await taken.open()
    assert taken.state.state is State.OFFLINE
    assert not (await taken.health()).answers


async def test_verbs_before_open_and_of_another_arming_say_so(tmp_path: Path):
    taken = camera(album(tmp_path, p1_png=picture(1), p2_png=picture(2)))
    with pytest.raises(LinkLost, match="is not open"):
        await taken.grab()
    await taken.open()
    with pytest.raises(Refused, match="a folder has no trigger line"):
        await taken.arm(Trigger.LINE)
    await taken.arm(Trigger.FREE)
    assert np.array_equal((await taken.next_frame()).pixels, picture(1))
    with pytest.raises(Refused, match="armed for free, this needs software"):
        await taken.grab()
    await taken.disarm()
    with pytest.raises(Refused, match="it is not armed"):
        await taken.next_frame()
    await taken.close()
    await taken.close()
    assert taken.state.why == "was closed"


async def test_whoever_waits_for_the_exposure_is_not_held_up(tmp_path: Path):
    taken = camera(album(tmp_path, p1_png=picture(1)))
    await taken.open()
    exposed = asyncio.Event()
    await taken.grab(exposed=exposed)
    assert exposed.is_set()


async def test_a_file_that_goes_away_meanwhile_is_a_lost_picture(tmp_path: Path):
    taken = camera(album(tmp_path, p1_png=picture(1)))
    await taken.open()
    os.remove(tmp_path / "p1.png")
    with pytest.raises(FrameLost, match="there is no such file"):
        await taken.grab()


@given(content=st.binary(max_size=400), kind=st.sampled_from(["png", "tiff"]))
@settings(max_examples=40, deadline=None)
def test_what_is_no_picture_is_lost(tmp_path_factory: pytest.TempPathFactory, content: bytes, kind: str):
    folder = tmp_path_factory.mktemp("album")
    head = b"\x89PNG\r\n\x1a\n" if kind == "png" else b"II*\0"
    taken = camera(album(folder, **{f"p_{kind}": head + content}))

    async def grab() -> None:
        await taken.open()
        with pytest.raises(FrameLost):
            await taken.grab()

    asyncio.run(grab())
