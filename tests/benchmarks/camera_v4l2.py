"""What the V4L2 driver costs, and whether it ever gives a wrong picture; parts of the camera benchmark.

`latency` runs the driver, `peer` OpenCV, each in a process of its own, on the same simulated camera (a FUSE file, in a
process of its own, that sends one stored picture at its rate). `soak` triggers thousands of times while pictures are
lost, damaged, doubled, delayed. `python -m tests.benchmarks.camera_v4l2` prints all and writes build/bench-v4l2.json.
"""

import argparse
import asyncio
import json
import resource
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera import Region, Setup, Trigger
from drivers.errors import FrameLost, NoAnswer
from drivers.v4l2 import V4l2Camera
from simulators.clock import Clock
from simulators.gige import Exposure
from simulators.v4l2 import Device, Timing, V4l2CameraServer, why_not
from simulators.v4l2.fuse_mount import unmount

OUT = Path("build/bench-v4l2.json")
FULL = (2592, 1944)
TINY = (64, 48)
AT_ONCE = Timing(read_out_s=0.0, link_s_per_byte=0.0)
RATE_HZ = 30.0
FAULTS = ("drop", "error_flag", "wrong_size", "stale", "ignore_trigger")
FAULTY = 0.1  # part of the triggers that something happens to
SERIAL = "BENCH"
PEER = """
import json, resource, sys, time
import cv2
camera = cv2.VideoCapture(sys.argv[1], cv2.CAP_V4L2)
camera.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter_fourcc(*"GREY"))
camera.set(cv2.CAP_PROP_FRAME_WIDTH, 2592)
camera.set(cv2.CAP_PROP_FRAME_HEIGHT, 1944)
camera.set(cv2.CAP_PROP_CONVERT_RGB, 0)
for _ in range(5):
    camera.read()
late, before = [], time.process_time()
for _ in range(int(sys.argv[2])):
    camera.read()
    late.append(time.monotonic() * 1e3 - camera.get(cv2.CAP_PROP_POS_MSEC))
print(json.dumps({"ms": late, "cpu_ms": (time.process_time() - before) * 1e3 / len(late)}))
"""


@contextmanager
def camera_process() -> Iterator[str]:
    """A camera that sends a stored picture, as a file; the file's path."""
    if reason := why_not():
        raise SystemExit(f"the V4L2 benchmark needs FUSE: {reason}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video0"
        command = [sys.executable, "-m", "tests.benchmarks.camera_v4l2", "--serve", str(path)]
        server = subprocess.Popen(command, stdout=subprocess.PIPE)
        try:
            assert server.stdout is not None
            server.stdout.readline()
            yield str(path)
        finally:
            server.kill()
            server.wait()
            server.stdout.close()
            unmount(path)


async def serve(path: Path) -> None:
    """The camera of `camera_process`, until it is killed."""
    picture = np.random.default_rng(1).integers(0, 256, FULL[::-1], dtype=np.uint8)
    device = Device(SERIAL, FULL, formats=("GREY",), triggers=False, rate_hz=RATE_HZ)
    async with V4l2CameraServer(device, lambda exposure: picture, Clock(), path=path, timing=AT_ONCE):
        print("ready", flush=True)
        await asyncio.Event().wait()


def figures(times_ms: list[float], cpu_ms: float) -> dict[str, float]:
    """From the start of the exposure to pixels in Python."""
    p50, p99 = np.percentile(times_ms, (50, 99))
    return {"p50_ms": round(float(p50), 2), "p99_ms": round(float(p99), 2), "cpu_ms_per_frame": round(cpu_ms, 2)}


async def stream(path: str, frames: int) -> dict[str, Any]:
    """The driver in free run at the camera's full rate: latency, processor time, lateness of the loop."""
    camera = V4l2Camera("camera", path, Setup(SERIAL, Region(0, 0, *FULL)))
    await camera.open()
    try:
        await camera.arm(Trigger.FREE)
        await times_of(camera, 5)
        before_s, at_first = time.process_time(), camera.counters
        told: dict[str, Any] = figures(await times_of(camera, frames), 0.0)
        told["cpu_ms_per_frame"] = round((time.process_time() - before_s) * 1e3 / frames, 2)
        told["missed"] = camera.counters.gaps - at_first.gaps + camera.counters.overrun - at_first.overrun
        told["loop_late_p99_ms"] = await lateness_ms(camera, frames)
        told["copies_per_frame"] = await copies(camera)
        return told
    finally:
        await camera.close()


async def times_of(camera: V4l2Camera, frames: int) -> list[float]:
    """From the start of the exposure to pixels in our hands, ms."""
    times_ms = []
    for _ in range(frames):
        frame = await camera.next_frame()
        times_ms.append((time.monotonic_ns() - frame.exposure_start_ns) / 1e6)
    return times_ms


async def lateness_ms(camera: V4l2Camera, frames: int) -> float:
    """99 of 100 things that are due on the event loop meanwhile are done within this time."""
    late_ms: list[float] = []
    watching = asyncio.create_task(watch_loop(late_ms))
    try:
        await times_of(camera, frames)
    finally:
        watching.cancel()
        await asyncio.wait([watching])
    return round(float(np.percentile(late_ms, 99)), 2)


async def copies(camera: V4l2Camera) -> float:
    """Memory that one picture takes at most until it is in our hands, in sizes of a picture."""
    tracemalloc.start()
    try:
        held = []
        for _ in range(5):
            before = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
            held.append(await camera.next_frame())
            peak = tracemalloc.get_traced_memory()[1] - before
        return round(peak / held[-1].payload.nbytes, 3)
    finally:
        tracemalloc.stop()


async def watch_loop(late_ms: list[float]) -> None:
    """How late the event loop does what is due."""
    while True:
        due_s = time.monotonic() + 0.002
        await asyncio.sleep(0.002)
        late_ms.append((time.monotonic() - due_s) * 1e3)


def latency(frames: int) -> dict[str, Any]:
    """The driver's figures, measured in a process of its own."""
    with camera_process() as path:
        command = [sys.executable, "-m", "tests.benchmarks.camera_v4l2", "--stream", path, "--frames", str(frames)]
        return dict(json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout))


def peer(frames: int) -> dict[str, Any]:
    """OpenCV's on the same camera. It has read() only: no trigger, no numbers of pictures, no error flags."""
    with camera_process() as path:
        command = [sys.executable, "-c", PEER, path, str(frames)]
        told = json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)
    return figures(told["ms"], told["cpu_ms"])


class Numbered:
    """Every exposure gives a picture of its own."""

    def __init__(self) -> None:
        self.taken = 0
        self._noise = np.random.default_rng(1).integers(0, 256, TINY[::-1], dtype=np.uint8)

    def __call__(self, exposure: Exposure) -> np.ndarray:
        self.taken += 1
        return self.picture(self.taken)

    def picture(self, number: int) -> np.ndarray:
        """Of the exposure with this number."""
        picture = self._noise.copy()
        picture[0, :8] = np.frombuffer(number.to_bytes(8, "little"), np.uint8)
        return picture


async def soak(triggers: int, *, triggered: bool = True) -> dict[str, Any]:
    """So many grabs, something happening to a tenth of them: every picture is judged by the sensor's own truth."""
    scene, rng = Numbered(), np.random.default_rng(2)
    device = Device(SERIAL, TINY, triggers=triggered, rate_hz=60.0)
    counts = {
        "triggers": triggers,
        "good": 0,
        "lost": 0,
        "late": 0,
        "wrong": 0,
        "stale_given": 0,
        "triggered": triggered,
    }
    before_kb = after_first_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    async with V4l2CameraServer(device, scene, Clock(50.0), timing=AT_ONCE) as server:
        camera = V4l2Camera("camera", "/dev/video0", Setup(SERIAL, Region(0, 0, *TINY)), open_node=server.open_here)
        await camera.open()
        began_s = time.monotonic()
        for number in range(triggers):
            if rng.random() < FAULTY:
                server.inject(str(rng.choice(FAULTS)))
            before = scene.taken
            try:
                frame = await camera.grab(within_s=0.06)
            except FrameLost:
                counts["lost"] += 1
                continue
            except NoAnswer:
                counts["late"] += 1
                continue
            shown = int.from_bytes(frame.pixels[0, :8].tobytes(), "little")
            counts["wrong"] += not np.array_equal(frame.pixels, scene.picture(shown))
            counts["stale_given"] += shown <= before
            counts["good"] += 1
            if number == triggers // 10:
                after_first_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        took_s = time.monotonic() - began_s
        await camera.close()
    grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - max(before_kb, after_first_kb)
    return counts | {"memory_grown_kb": grown_kb, "took_s": round(took_s, 1)}


def _table(rows: dict[str, dict[str, Any]]) -> None:
    for name, row in rows.items():
        print(f"{name:<22}" + "   ".join(f"{key} {value}" for key, value in row.items()))


def main() -> None:
    """Run all parts, or what a parent asks for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--triggers", type=int, default=10_000)
    parser.add_argument("--serve", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--stream", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve is not None:
        asyncio.run(serve(options.serve))
    elif options.stream is not None:
        print(json.dumps(asyncio.run(stream(options.stream, options.frames))))
    else:
        _all(options.frames, options.triggers)


def _all(frames: int, triggers: int) -> None:
    rows: dict[str, dict[str, Any]] = {}
    for name, part in (("driver, 5 MP, 30 Hz", latency), ("OpenCV, 5 MP, 30 Hz", peer)):
        print(f"{name}: {frames} pictures", file=sys.stderr)
        rows[name] = part(frames)
    for triggered in (True, False):
        name = "soak, trigger" if triggered else "soak, free run"
        print(f"{name}: {triggers} requests", file=sys.stderr)
        rows[name] = asyncio.run(soak(triggers, triggered=triggered))
    _table(rows)
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
