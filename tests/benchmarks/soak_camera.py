"""Thousands of triggers over a network that loses packets: is every picture that is delivered whole, and the right one?

`python -m tests.benchmarks.soak_camera` triggers the simulated GigE Vision camera 10,000 times (--triggers). Of all
packets, also of those that are sent again, 0.5 % are lost; after one trigger in a hundred the camera sends the previous
picture first. Every exposure gives a picture of its own, so that each delivered one can be judged byte by byte. Prints
a table and writes build/bench-soak-camera.json; exit code 1 when one delivered picture was not the right one.
"""

import argparse
import asyncio
import json
import os
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from drivers.camera import Region, Setup
from drivers.errors import DeviceError, LinkLost
from drivers.gige import GigeCamera
from simulators.clock import Clock
from simulators.gige import Exposure, GigeCameraServer

OUT = Path("build/bench-soak-camera.json")
SIZE = (640, 480)
SPEED = 50.0  # of the camera's world, so that exposure and wire take little time
LOSS = 0.005
STALE_EVERY = 100
PACKET_BYTES = 1500
PROGRESS_S = 2.0
PAGE_KIB = os.sysconf("SC_PAGE_SIZE") // 1024


class Numbered:
    """Every exposure gives a picture that no other gives."""

    def __init__(self) -> None:
        self.taken = 0
        self._noise = np.random.default_rng(1).integers(0, 256, SIZE[::-1], dtype=np.uint8)

    def __call__(self, exposure: Exposure) -> np.ndarray:
        self.taken += 1
        return self.picture(self.taken)

    def picture(self, number: int) -> np.ndarray:
        """Of the exposure with this number."""
        picture = np.roll(self._noise, number, axis=1)
        picture[0, :8] = np.frombuffer(number.to_bytes(8, "little"), np.uint8)
        return picture


def judged(scene: Numbered, before: int, pixels: np.ndarray) -> str:
    """What a delivered picture is. `before`: exposures that were made before its trigger."""
    number = int.from_bytes(pixels[0, :8].tobytes(), "little")
    if not np.array_equal(pixels, scene.picture(number)):
        return "broken"
    return "exact" if number == scene.taken > before else "stale"


async def soak(triggers: int, *, loss: float = LOSS, seed: int = 1, progress: bool = False) -> dict[str, Any]:
    """So many grabs; what became of each, and what the camera and the driver counted."""
    scene, outcomes, times_ms = Numbered(), Counter[str](), []
    ip = f"127.77.{os.getpid() >> 8 & 255}.{os.getpid() & 255 or 1}"
    rng = np.random.default_rng(seed)
    server = GigeCameraServer(ip, "SOAK", scene, Clock(SPEED), sensor=SIZE, rng=rng, largest_packet=PACKET_BYTES)
    async with server:
        camera = GigeCamera("camera 1", ip, Setup("SOAK", Region(0, 0, *SIZE)))
        await camera.open()
        server.inject("drop_ratio", ratio=loss)
        server.inject("drop_resends", ratio=loss)
        warm_kib, told_s = 0, time.monotonic()
        for number in range(triggers):
            if number % STALE_EVERY == STALE_EVERY - 1:
                server.inject("stale_frame")
            began_s = time.monotonic()
            outcomes[await one(camera, scene)] += 1
            times_ms.append((time.monotonic() - began_s) * 1e3)
            warm_kib = resident_kib() if number == triggers // 10 else warm_kib
            if progress and time.monotonic() > told_s + PROGRESS_S:
                told_s = time.monotonic()
                print(f"\r{number + 1} of {triggers}, {dict(outcomes)}", end="", file=sys.stderr, flush=True)
        counters = camera.counters
        await camera.close()
    p50_ms, p99_ms, most_ms = np.percentile(times_ms, (50, 99, 100)).round(1)
    return {
        "triggers": triggers,
        "exact": outcomes.pop("exact", 0),
        "broken": outcomes.pop("broken", 0),
        "stale": outcomes.pop("stale", 0),
        "errors": dict(outcomes),
        "counted_incomplete": counters.incomplete,
        "stale_kept_back": counters.stale,
        "packets_sent": server.counts.packets,
        "packets_lost": server.faults.packets_dropped,
        "packets_sent_again": server.counts.packets_resent,
        "grab_p50_ms": float(p50_ms),
        "grab_p99_ms": float(p99_ms),
        "grab_most_ms": float(most_ms),
        "memory_grown_kib": resident_kib() - warm_kib,
    }


async def one(camera: GigeCamera, scene: Numbered) -> str:
    """Trigger once; what came of it. A camera that was lost is opened again."""
    before = scene.taken
    try:
        frame = await camera.grab()
    except DeviceError as error:
        if isinstance(error, LinkLost) or "not acknowledged" in str(error):
            await camera.open()
        return type(error).__name__
    return judged(scene, before, frame.pixels)


def resident_kib() -> int:
    """Memory of this process."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * PAGE_KIB


def main() -> int:
    """Soak, print, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--triggers", type=int, default=10_000)
    result = asyncio.run(soak(parser.parse_args().triggers, progress=True))
    print(file=sys.stderr)
    for name, value in result.items():
        print(f"{name:<20}{value}")
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    return int(result["broken"] + result["stale"] > 0)


if __name__ == "__main__":
    sys.exit(main())
