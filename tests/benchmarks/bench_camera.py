"""What a picture costs: from the trigger to numpy, beside the bare wire time and beside other people's clients.

`python -m tests.benchmarks.bench_camera` prints a table and writes build/bench-camera.json. Cameras are simulated, each
in a process of its own, 5 megapixels; so are the clients: the driver, and viva-genicam (GigE Vision) or OpenCV (V4L2)
on the same camera. The GigE camera takes as long as a real one: 1 ms of exposure, 3 ms until the first line is read
out, and the time of a gigabit link, whose last packet leaves when a real link would have delivered it. "wire" is that
sum. The V4L2 camera of `camera_v4l2` has no wire: its time is from the start of the exposure, without one.
"""

import argparse
import asyncio
import json
import os
import subprocess
import sys
import time
import tracemalloc
from collections.abc import Iterator
from contextlib import AsyncExitStack, ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera import Region, Setup, Trigger
from drivers.gige import GigeCamera
from simulators.clock import Clock
from simulators.gige import GigeCameraServer
from simulators.gige_imaging import READ_OUT_S
from simulators.gvsp import PACKET_OVERHEAD
from tests.benchmarks import camera_v4l2
from tests.benchmarks.camera_v4l2 import watch_loop
from tests.benchmarks.soak_camera import resident_kib
from tests.gige_peers import heard_at_home

OUT = Path("build/bench-camera.json")
MODULE = "tests.benchmarks.bench_camera"
FULL, SMALL = (2592, 1944), (640, 480)
SERIAL = "BENCH"
EXPOSURE_S = 0.001
GIGABIT = 1000.0  # Mb/s: packets as far apart as on a real link
ETHERNET_BYTES = 38  # of a packet on the wire beside IP: preamble, header, checksum, gap
FULL_RATE_US = 43_000  # 5 MP as fast as a gigabit link takes them
FAST_US, FAST_SPEED = 5_000, 2.0  # a picture each 2.5 ms
WARM_UP = 5
VIVA = """
import json, sys, time
import viva_genicam
ip, frames = sys.argv[1], int(sys.argv[2])
(found,) = [each for each in viva_genicam.discover(1000, all=True) if each.ip == ip]
times, seen = [], 0
with viva_genicam.connect_gige(found, iface="127.0.0.1") as camera:
    camera.enable_trigger("FrameStart", "Software")
    with camera.stream(iface="127.0.0.1", packet_size=int(sys.argv[3])) as stream:
        camera.acquisition_start()
        for number in range(frames + 5):
            if number == 5:
                cpu_s = time.process_time()
            began_s = time.monotonic()
            camera.trigger_software()
            frame = stream.next_frame(timeout_ms=1000)
            pixels = frame.to_numpy() if frame is not None else None
            if number >= 5 and pixels is not None:
                times.append((time.monotonic() - began_s) * 1e3)
        cpu_s = time.process_time() - cpu_s
        camera.acquisition_stop()
print(json.dumps({"ms": times, "cpu_ms": cpu_s * 1e3 / frames}))
"""


def fresh_ip(number: int) -> str:
    """An address of this run alone."""
    return f"127.78.{os.getpid() & 255}.{number}"


@contextmanager
def camera_process(ip: str, packet_bytes: int, *, quick: bool = False) -> Iterator[None]:
    """A GigE Vision camera that sends a stored picture, until the block is left; `quick`: a small one, unpaced."""
    size, period_us, speed, mbps = (SMALL, FAST_US, FAST_SPEED, 0.0) if quick else (FULL, FULL_RATE_US, 1.0, GIGABIT)
    words = ["--serve", ip, "--packet", packet_bytes, "--size", *size, "--period-us", period_us, "--speed", speed]
    words += ["--mbps", mbps]
    server = subprocess.Popen([sys.executable, "-m", MODULE, *map(str, words)], stdout=subprocess.PIPE)
    try:
        assert server.stdout is not None
        if not server.stdout.readline():
            raise SystemExit(f"the simulated camera at {ip} did not start")
        yield
    finally:
        server.kill()
        server.wait()
        if server.stdout is not None:
            server.stdout.close()


async def serve(given: argparse.Namespace) -> None:
    """The camera of `camera_process`, until it is killed."""
    size = tuple(given.size)
    picture = np.random.default_rng(1).integers(0, 256, size[::-1], dtype=np.uint8)
    clock = Clock(given.speed)
    server = GigeCameraServer(given.serve, SERIAL, lambda e: picture, clock, sensor=size, largest_packet=given.packet)
    server.registers["FramePeriodUs"] = given.period_us
    async with server, heard_at_home(server):
        server.inject("link", mbps=given.mbps)
        print("ready", flush=True)
        await asyncio.Event().wait()


def wire_ms(packet_bytes: int) -> float:
    """Exposure, read-out and the bare time of all packets of a picture at 1 Gb/s."""
    pixels = FULL[0] * FULL[1]
    packets = -(-pixels // (packet_bytes - PACKET_OVERHEAD))
    on_wire = pixels + packets * (PACKET_OVERHEAD + ETHERNET_BYTES)
    return (EXPOSURE_S + READ_OUT_S) * 1e3 + on_wire * 8 / 1e6


def driver_at(ip: str, size: tuple[int, int]) -> GigeCamera:
    """The driver for one of the cameras."""
    return GigeCamera("camera 1", ip, Setup(SERIAL, Region(0, 0, *size)))


async def grabs(ip: str, frames: int) -> dict[str, Any]:
    """The driver: trigger to pixels, processor time, memory that one picture takes."""
    camera = driver_at(ip, FULL)
    await camera.open()
    try:
        await camera.configure(exposure_us=EXPOSURE_S * 1e6)
        await times_of(camera, WARM_UP)
        before_s = time.process_time()
        times_ms = await times_of(camera, frames)
        cpu_ms = (time.process_time() - before_s) * 1e3 / frames
        return {**figures(times_ms, cpu_ms), "packet_bytes": camera.packet_size, "copies": await copies(camera)}
    finally:
        await camera.close()


async def times_of(camera: GigeCamera, frames: int) -> list[float]:
    """Each grab's time, ms."""
    times_ms = []
    for _ in range(frames):
        began_s = time.monotonic()
        await camera.grab()
        times_ms.append((time.monotonic() - began_s) * 1e3)
    return times_ms


async def copies(camera: GigeCamera) -> float:
    """Memory that one picture takes at most until it is in our hands, in sizes of a picture."""
    tracemalloc.start()
    try:
        held, most = [], 0
        for _ in range(6):
            before = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
            held.append(await camera.grab())
            most = max(most, tracemalloc.get_traced_memory()[1] - before)
        return round(most / held[-1].payload.nbytes, 3)
    finally:
        tracemalloc.stop()


def figures(times_ms: list[float], cpu_ms: float) -> dict[str, float]:
    """Median and the worst of a hundred."""
    p50_ms, p99_ms = np.percentile(times_ms, (50, 99))
    return {"p50_ms": round(float(p50_ms), 2), "p99_ms": round(float(p99_ms), 2), "cpu_ms_per_frame": round(cpu_ms, 2)}


async def two_at_once(ips: list[str], frames: int) -> dict[str, Any]:
    """Two cameras in free run at full rate: how late the event loop does what is due, and what both cost."""
    async with AsyncExitStack() as stack:
        cameras = [driver_at(ip, FULL) for ip in ips]
        for camera in cameras:
            await camera.open()
            stack.push_async_callback(camera.close)
            await camera.arm(Trigger.FREE)
        await asyncio.gather(*(camera.next_frame() for camera in cameras))
        late_ms: list[float] = []
        watching = asyncio.create_task(watch_loop(late_ms))
        before_s, began_s = time.process_time(), time.monotonic()
        async with asyncio.TaskGroup() as group:
            for camera in cameras:
                group.create_task(follow(camera, frames))
        took_s, cpu_s = time.monotonic() - began_s, time.process_time() - before_s
        watching.cancel()
        await asyncio.wait([watching])
        p50_ms, p99_ms, most_ms = np.percentile(late_ms, (50, 99, 100)).round(2)
        return {
            "loop_late_p50_ms": float(p50_ms),
            "loop_late_p99_ms": float(p99_ms),
            "loop_late_most_ms": float(most_ms),
            "pictures_per_s_each": round(frames / took_s, 1),
            "cpu_percent_of_one_core": round(cpu_s / took_s * 100, 1),
            "lost": sum(camera.counters.incomplete + camera.counters.gaps for camera in cameras),
        }


async def follow(camera: GigeCamera, frames: int) -> None:
    """So many pictures, each once."""
    for _ in range(frames):
        await camera.next_frame()


async def memory(ip: str, frames: int) -> dict[str, Any]:
    """So many pictures in free run: what the process has grown by after the first tenth."""
    camera = driver_at(ip, SMALL)
    await camera.open()
    try:
        await camera.arm(Trigger.FREE)
        await follow(camera, frames // 10)
        before_kib = resident_kib()
        await follow(camera, frames - frames // 10)
        return {"frames": frames, "memory_grown_kib": resident_kib() - before_kib}
    finally:
        await camera.close()


def in_a_process(part: str, ips: list[str], frames: int) -> dict[str, Any]:
    """One of the parts above, by itself."""
    command = [sys.executable, "-m", MODULE, "--part", part, "--ips", *ips, "--frames", str(frames)]
    return dict(json.loads(subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True).stdout))


def viva(ip: str, frames: int, packet_bytes: int) -> dict[str, Any]:
    """viva-genicam on the same camera."""
    command = [sys.executable, "-c", VIVA, ip, str(frames), str(packet_bytes)]
    ran = subprocess.run(command, capture_output=True, check=False, text=True)
    if ran.returncode:
        return {"missing": (ran.stderr.strip().splitlines() or ["failed"])[-1]}
    told = json.loads(ran.stdout.splitlines()[-1])
    return {**figures(told["ms"], told["cpu_ms"]), "whole": len(told["ms"]), "packet_bytes": packet_bytes}


def measure(frames: int, long_run: int, packets: tuple[int, ...] = (1500, 8188)) -> dict[str, dict[str, Any]]:
    """All parts, one after the other."""
    rows: dict[str, dict[str, Any]] = {}
    for number, packet_bytes in enumerate(packets):
        ip = fresh_ip(10 + number)
        with camera_process(ip, packet_bytes):
            told(f"GigE, packets of {packet_bytes} bytes: {frames} triggers, twice")
            wire = {"wire_ms": round(wire_ms(packet_bytes), 2)}
            rows[f"GigE driver, {packet_bytes} B"] = wire | in_a_process("grabs", [ip], frames)
            rows[f"viva-genicam, {packet_bytes} B"] = wire | viva(ip, frames, packet_bytes)
    told(f"two GigE cameras at full rate: {frames} pictures each")
    with ExitStack() as stack:
        ips = [fresh_ip(20), fresh_ip(21)]
        for ip in ips:
            stack.enter_context(camera_process(ip, packets[-1]))
        rows["two at once"] = in_a_process("two_at_once", ips, frames)
    told(f"memory over {long_run} pictures")
    with camera_process(fresh_ip(30), packets[-1], quick=True):
        rows["long run"] = in_a_process("memory", [fresh_ip(30)], long_run)
    return rows


def v4l2_rows(frames: int) -> dict[str, dict[str, Any]]:
    """The same of the V4L2 driver, where there is FUSE."""
    if reason := camera_v4l2.why_not():
        return {"V4L2 driver": {"missing": reason}}
    told(f"V4L2: {frames} pictures, twice")
    return {"V4L2 driver": camera_v4l2.latency(frames), "OpenCV": camera_v4l2.peer(frames)}


def told(what: str) -> None:
    """Progress."""
    print(what, file=sys.stderr, flush=True)


def table(rows: dict[str, dict[str, Any]]) -> str:
    """For people."""
    width = max(map(len, rows))
    return "\n".join(f"{n:<{width}}  " + "   ".join(f"{k} {v}" for k, v in row.items()) for n, row in rows.items())


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--long-run", type=int, default=10_000)
    parser.add_argument("--serve", help=argparse.SUPPRESS)
    parser.add_argument("--packet", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--mbps", type=float, help=argparse.SUPPRESS)
    parser.add_argument("--size", type=int, nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--period-us", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--speed", type=float, help=argparse.SUPPRESS)
    parser.add_argument("--part", choices=("grabs", "two_at_once", "memory"), help=argparse.SUPPRESS)
    parser.add_argument("--ips", nargs="+", help=argparse.SUPPRESS)
    return parser.parse_args()


def _part(given: argparse.Namespace) -> dict[str, Any]:
    if given.part == "two_at_once":
        return asyncio.run(two_at_once(given.ips, given.frames))
    return asyncio.run((grabs if given.part == "grabs" else memory)(given.ips[0], given.frames))


def main() -> None:
    """Run all parts, or the one that a parent asks for."""
    given = _arguments()
    if given.serve is not None:
        asyncio.run(serve(given))
    elif given.part is not None:
        print(json.dumps(_part(given)))
    else:
        rows = measure(given.frames, given.long_run) | v4l2_rows(given.frames)
        print(table(rows))
        OUT.parent.mkdir(exist_ok=True)
        OUT.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
