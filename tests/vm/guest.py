"""What runs inside the virtual machine: vivid shows our picture at its input, the driver must deliver that, exactly.

vivid is the kernel's own test driver. What is written to its output (/dev/video1) arrives at its input (/dev/video0).
Prints lines "RESULT {json}", one per pixel format.
"""

import asyncio
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from drivers import pixels
from drivers.camera import Region, Setup, Trigger
from drivers.errors import DeviceError, LinkLost, NoAnswer
from drivers.v4l2 import V4l2Camera

INPUT, OUTPUT = "/dev/video0", "/dev/video1"
WIDTH, HEIGHT = 2592, 1944
TIMINGS = f"cvt,width={WIDTH},height={HEIGHT},fps=60,reduced-blanking=1"
SERIAL = "vivid-000"
FORMATS = {"GREY": pixels.MONO8, "Y10 ": pixels.MONO10, "Y12 ": pixels.MONO12, "Y16 ": pixels.MONO16}
WITHIN_S = 60.0  # emulation takes a second for what takes a millisecond
SETTLE_S = 30.0
OPENINGS = 10


def control(*arguments: str) -> None:
    """v4l2-ctl; what it says is shown when it fails."""
    done = subprocess.run(["v4l2-ctl", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        print(f"v4l2-ctl {' '.join(arguments)}: {done.stdout}{done.stderr}", flush=True)


def prepare(fourcc: str) -> None:
    """Input and output alike, no text in the picture, what is written to the output is seen at the input."""
    for device in (INPUT, OUTPUT):
        control("-d", device, "--set-dv-bt-timings", TIMINGS)
    size = f"width={WIDTH},height={HEIGHT},pixelformat={fourcc}"
    control("-d", INPUT, "--set-fmt-video", size)
    control("-d", OUTPUT, "--set-fmt-video-out", size)
    control("-d", INPUT, "-c", "osd_text_mode=2")
    control("-d", INPUT, "-c", "loop_video=1")


@contextmanager
def shown_at_input(fourcc: str) -> Iterator[np.ndarray]:
    """A random picture in the format's depth, on the output until the block is left."""
    pixel_format = FORMATS[fourcc]
    kind = np.uint8 if pixel_format.bits == 8 else np.uint16
    shown = np.random.default_rng(1).integers(0, pixel_format.white + 1, (HEIGHT, WIDTH), dtype=kind)
    prepare(fourcc)
    file = Path("/run/shown.raw")
    file.write_bytes(shown.tobytes())
    command = ["v4l2-ctl", "-d", OUTPUT, "--stream-out-mmap=3", f"--stream-from={file}", "--stream-loop"]
    feeding = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield shown
    finally:
        feeding.terminate()
        feeding.wait()


async def opened(camera: V4l2Camera) -> None:
    """Open it; the emulated machine may be too slow for the driver's deadline, so several times."""
    for left in reversed(range(OPENINGS)):
        try:
            return await camera.open()
        except (NoAnswer, LinkLost):
            if not left:
                raise


async def run(fourcc: str, frames: int, shown: np.ndarray) -> dict[str, object]:
    """So many pictures of one format: how many are ours, bit by bit."""
    setup = Setup(SERIAL, Region(0, 0, WIDTH, HEIGHT), FORMATS[fourcc])
    camera = V4l2Camera("vivid", INPUT, setup)
    try:
        await opened(camera)
        return await judged(camera, shown, fourcc, frames)
    except DeviceError as error:
        return {"format": fourcc.strip(), "frames": frames, "exact": 0, "error": str(error)}
    finally:
        await camera.close()


async def judged(camera: V4l2Camera, shown: np.ndarray, fourcc: str, frames: int) -> dict[str, object]:
    """Half of the pictures on request, half of free run."""
    exact = late = 0
    began_s = time.monotonic()
    while not np.array_equal((await camera.grab(within_s=WITHIN_S)).deep(), shown):  # the output is not there yet
        if time.monotonic() - began_s > SETTLE_S:
            break
    for number in range(frames):
        if number == frames // 2:
            await camera.arm(Trigger.FREE)
        asked_ns = time.monotonic_ns()
        free = number >= frames // 2
        frame = await (camera.next_frame(within_s=WITHIN_S) if free else camera.grab(within_s=WITHIN_S))
        exact += np.array_equal(frame.deep(), shown)
        late += not free and frame.exposure_start_ns < asked_ns
    counted = camera.counters
    return {
        "format": fourcc.strip(), "frames": frames, "exact": exact, "exposed_too_early": late,
        "stale": counted.stale, "gaps": counted.gaps, "damaged": counted.incomplete,
        "took_s": round(time.monotonic() - began_s, 1),
    }  # fmt: skip


def main(frames: int) -> None:
    """All formats."""
    for fourcc in FORMATS:
        with shown_at_input(fourcc) as shown:
            result = asyncio.run(run(fourcc, frames, shown))
        print("RESULT " + json.dumps(result), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
