"""Other people's V4L2 clients read from the simulated camera: OpenCV, and ffmpeg's as PyAV carries it."""

import asyncio
import hashlib
import itertools
import json
import os
import sys
from pathlib import Path

import pytest

from tests.v4l2_rig import Rig, needs_fuse, rig

FRAMES = 5
OPENCV = """
import hashlib, json, sys
import cv2
camera = cv2.VideoCapture(sys.argv[1], cv2.CAP_V4L2)
camera.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter_fourcc(*"GREY"))
camera.set(cv2.CAP_PROP_CONVERT_RGB, 0)
seen = [camera.read()[1].tobytes() for _ in range(int(sys.argv[2]))]
camera.release()
print(json.dumps([hashlib.sha256(one).hexdigest() for one in seen]))
"""
PYAV = """
import hashlib, json, sys
import av
options = {"input_format": "gray", "video_size": "640x480"}
with av.open(sys.argv[1], format="video4linux2", options=options) as container:
    frames = container.decode(video=0)
    seen = [next(frames).to_ndarray(format="gray").tobytes() for _ in range(int(sys.argv[2]))]
print(json.dumps([hashlib.sha256(one).hexdigest() for one in seen]))
"""


async def seen_by(client: str, path: Path) -> list[str]:
    """Hashes of the pictures that a program in a process of its own gets."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-c",
        client,
        str(path),
        str(FRAMES),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    try:
        out, err = await asyncio.wait_for(process.communicate(), 40)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode == 0, err.decode()
    return list(json.loads(out.decode().splitlines()[-1]))


def shown_by(r: Rig) -> list[str]:
    return [hashlib.sha256(picture.tobytes()).hexdigest() for picture in r.scene.pictures]


@pytest.mark.parametrize("client", ["opencv", "pyav"])
async def test_another_client_reads_every_picture_bit_by_bit(client: str, tmp_path: Path):
    needs_fuse()
    if client == "pyav" and not os.environ.get("CELLCTL_STRICT"):
        pytest.importorskip("av", reason="PyAV is not installed")
    path = tmp_path / "video0"
    async with rig(speed=1, path=path, triggers=False) as r:
        seen = await seen_by(OPENCV if client == "opencv" else PYAV, path)
        shown = shown_by(r)
        assert len(seen) == FRAMES
        assert set(seen) <= set(shown)
        order = [shown.index(one) for one in seen]
        assert all((new - old) % 4 for old, new in itertools.pairwise(order))  # no picture comes twice
        assert not r.server.device.streaming  # the client has let go, which is told
