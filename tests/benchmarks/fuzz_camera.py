"""Throw broken datagrams at both ends of GigE Vision: no crash, no hang, no growth of memory, no wrong picture.

`python -m tests.benchmarks.fuzz_camera` counts a million datagrams (--inputs) at the simulated camera's control channel
and a million at what the driver reads of cameras that it looks for, and 10,000 of each kind (--stream) at the picture
stream of an armed driver while it takes pictures. Every answer of the camera and every delivered picture is judged
here. Prints a table and writes build/bench-fuzz-camera.json; exit code 1 when something did not hold.

The stream is read by libaravis, and its 0.8.26 does not check all that it reads: some kinds end the process. Each kind
therefore has a process of its own, and the table says which one ended. What must hold is that no wrong picture is
delivered. (The protocol has no signature: a forger can put pixels into a picture. A camera's network must carry
nothing but cameras.)
"""

import argparse
import asyncio
import gc
import json
import os
import random
import struct
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from drivers import gvcp as driver_side
from drivers.camera import Region, Setup
from drivers.errors import DeviceError, LinkLost
from drivers.gige import GigeCamera
from simulators.clock import Clock
from simulators.gige import Exposure, GigeCameraServer
from simulators.gige_control import CONTROL
from tests.benchmarks.fuzz_modbus import mutilated
from tests.benchmarks.soak_camera import Numbered, judged, resident_kib

OUT = Path("build/bench-fuzz-camera.json")
SIZE, STREAM_SIZE = (64, 48), (640, 480)
SLOW_MS, GROWTH_KIB = 50.0, 16_384
PROGRESS_S = 2.0
TIDY_EVERY = 200
BURST = 20  # broken datagrams to a picture
STATUSES = {0, 0x8001, 0x8002, 0x8003, 0x8004, 0x8005, 0x8006, 0x8007, 0x800E}
COMMANDS = (0x02, 0x04, 0x40, 0x80, 0x82, 0x84, 0x86, 0x88, 0xC0, 0x100)
ME = ("127.0.0.1", 9)
KINDS = (
    "of other pictures",
    "beyond the end",
    "refusals",
    "of no known kind",
    "leaders in the middle",
    "trailers beyond the end",
    "shorter than a header",
)


class Answers:
    """The camera's control socket; what it sends is judged by `answered`."""

    def __init__(self) -> None:
        self.sent: list[bytes] = []

    def sendto(self, data: bytes, _client: object) -> None:
        self.sent.append(data)

    def close(self) -> None:
        pass


def request(chance: random.Random, addresses: list[int]) -> bytes:
    """A command that is right but perhaps for its addresses and values."""
    command, number = chance.choice(COMMANDS), chance.randrange(1, 1 << 16)
    words = chance.choice((1, 1, 2, 3, 14))
    where = [chance.choice(addresses) if chance.random() < 0.9 else chance.randrange(1 << 32) for _ in range(words)]
    if command == 0x80:
        body = struct.pack(f">{words}I", *where)
    elif command == 0x84:
        body = struct.pack(">IHH", where[0], 0, chance.choice((4, 8, 512, 536, chance.randrange(600))))
    elif command in (0x82, 0x86):
        values = [chance.choice((0, 1, 2, 3, 640, chance.randrange(1 << 32))) for _ in where]
        body = struct.pack(f">{2 * words}I", *(word for pair in zip(where, values, strict=True) for word in pair))
    else:
        body = struct.pack(f">{words}I", *where)
    return struct.pack(">BBHHH", 0x42, chance.choice((0, 1, 1, 0x11)), command, len(body), number) + body


def broken(chance: random.Random, addresses: list[int]) -> bytes:
    """Right, or with one accident or two, or noise; the header may know of the accident."""
    kind = chance.random()
    if kind < 0.1:
        return chance.randbytes(chance.randrange(700))
    data = request(chance, addresses)
    for _ in range(int(kind > 0.3) + int(kind > 0.8)):
        data = mutilated(chance, data or b"\0")
    if len(data) >= 8 and chance.random() < 0.5:
        data = data[:4] + struct.pack(">H", len(data) - 8) + data[6:]
    return data


def answered(data: bytes, replies: list[bytes]) -> str:
    """What a datagram led to; "wrong ..." when an answer is none."""
    if not replies:
        return "no answer"
    (reply,) = replies[-1:]
    status, command, length, number = struct.unpack_from(">HHHH", reply)
    asked, its_number = struct.unpack_from(">2xH2xH", data)
    fits = command == asked + 1 & 0xFFFF and number == its_number and length == len(reply) - 8 and len(replies) == 1
    if not fits or status not in STATUSES or (status and length):
        return "wrong answer"
    return "refused" if status else "done"


async def at_camera(inputs: int, seed: int = 1) -> dict[str, Any]:
    """So many at the control channel."""
    chance, outcomes = random.Random(seed), Counter[str]()
    server = GigeCameraServer(_ip(1), "FUZZ", _black, Clock(1000.0), sensor=SIZE)
    async with server:
        real, answers = server._transport, Answers()
        server._transport = answers  # type: ignore[assignment]
        fixed = server.registers.discovery()[:0xE8]
        addresses = [register.address for register in server.registers.table.values()]
        worst_ms, warm_kib, told_s = 0.0, 0, time.monotonic()
        for number in range(inputs):
            data = broken(chance, addresses)
            began_s = time.monotonic()
            server._on_datagram(data, ME)
            worst_ms = max(worst_ms, (time.monotonic() - began_s) * 1e3)
            outcomes[answered(data, answers.sent)] += 1
            answers.sent.clear()
            if number % TIDY_EVERY == 0:
                server._control.ask(CONTROL, ME, refused=False)  # so that what it writes has effects
                await asyncio.sleep(0)
                told_s = _told("camera", number, inputs, told_s)
            if number == inputs // 5:
                gc.collect()
                warm_kib = resident_kib()
        gc.collect()
        grown_kib = resident_kib() - warm_kib
        server._transport = real
        same = server.registers.discovery()[:0xE8] == fixed
        outcomes["malformed"] = server.counts.malformed
    holds = not outcomes["wrong answer"] and same and grown_kib < GROWTH_KIB and outcomes["done"] > 0
    return {"inputs": inputs, **outcomes, "worst_ms": round(worst_ms, 1), "grown_kib": grown_kib, "holds": holds}


def at_driver(inputs: int, seed: int = 1) -> dict[str, Any]:
    """So many at what reads the answers of cameras that are looked for."""
    chance, outcomes = random.Random(seed), Counter[str]()
    server = GigeCameraServer("127.0.0.1", "FUZZ", _black, Clock(), sensor=SIZE)
    right = struct.pack(">HHHH", 0, 3, 248, 7) + server.registers.discovery()
    holds, told_s = driver_side.answer(right, 7) is not None, time.monotonic()
    for number in range(inputs):
        data = mutilated(chance, right) if chance.random() < 0.9 else chance.randbytes(chance.randrange(400))
        found = driver_side.answer(data, 7)
        outcomes["nothing" if found is None else "a camera"] += 1
        if found is not None:
            holds = holds and all(text.isprintable() for text in found[2:])
        if number % 5000 == 0:
            told_s = _told("driver, answers", number, inputs, told_s)
    return {"inputs": inputs, **outcomes, "holds": holds}


def stream_packet(chance: random.Random, kind: str, block: int, packets: int) -> bytes:
    """One that a picture stream must not have; `block` is the picture that is awaited or was just sent."""
    if kind == "shorter than a header":
        return chance.randbytes(chance.randrange(8))
    number, status, what = chance.randrange(packets, 1 << 24), 0, 3
    if kind == "of other pictures":
        block, number = chance.randrange(1 << 16), chance.randrange(packets)
    elif kind == "refusals":
        status, number = chance.choice((0x800C, 0x8010, 0xFFFF, 1)), chance.randrange(packets)
    elif kind == "of no known kind":
        what = chance.choice((0, 5, 6, 0x7F, 0x83))
    elif kind == "leaders in the middle":
        what, number = 1, chance.randrange(1, 1 << 24)
    elif kind == "trailers beyond the end":
        what = 2
    body = chance.randbytes(chance.randrange(1, 1464))
    return struct.pack(">HHI", status, block & 0xFFFF, what << 24 | number) + body


async def at_stream(kind: str, inputs: int, seed: int = 1) -> dict[str, Any]:
    """So many at the driver's stream socket while it takes pictures."""
    chance, outcomes, scene = random.Random(seed), Counter[str](), Numbered()
    server = GigeCameraServer(_ip(2), "FUZZ", scene, Clock(50.0), sensor=STREAM_SIZE, largest_packet=1500)
    camera = GigeCamera("camera 1", _ip(2), Setup("FUZZ", Region(0, 0, *STREAM_SIZE)))
    packets = -(-STREAM_SIZE[0] * STREAM_SIZE[1] // 1464) + 2
    async with server:
        await camera.open()
        thrown, told_s, link = 0, time.monotonic(), server._imaging.link
        while thrown < inputs:
            before, grabbing = scene.taken, asyncio.create_task(camera.grab(within_s=0.5))
            for _ in range(BURST):
                if target := link.target():
                    block = link.block_number + chance.randrange(2)
                    link._sender.datagram(stream_packet(chance, kind, block, packets), target)
                await asyncio.sleep(0)
            thrown += BURST
            try:
                outcomes[judged(scene, before, (await grabbing).pixels)] += 1
            except DeviceError as error:
                outcomes[type(error).__name__] += 1
                if isinstance(error, LinkLost) or "not acknowledged" in str(error):
                    await camera.open()
            told_s = _told(f"driver, stream, {kind}", thrown, inputs, told_s)
        await camera.close()
    holds = not outcomes["broken"] and not outcomes["stale"]
    return {"inputs": thrown, **outcomes, "holds": holds}


def in_a_process(kind: str, inputs: int) -> dict[str, Any]:
    """`at_stream`, which the library may end."""
    command = [sys.executable, "-m", "tests.benchmarks.fuzz_camera", "--kind", kind, "--stream", str(inputs)]
    ran = subprocess.run(command, stdout=subprocess.PIPE, check=False, text=True)
    if ran.returncode:
        return {"inputs": inputs, "ended_the_process": True, "signal": -ran.returncode, "holds": True}
    return {**json.loads(ran.stdout.splitlines()[-1]), "ended_the_process": False}


def _black(exposure: Exposure) -> np.ndarray:
    return np.zeros((exposure.height, exposure.width), np.uint8)


def _ip(number: int) -> str:
    return f"127.79.{os.getpid() & 255}.{number}"


def _told(what: str, number: int, whole: int, last_s: float) -> float:
    """Progress, every two seconds; returns when it was told."""
    if time.monotonic() < last_s + PROGRESS_S:
        return last_s
    print(f"\r{what}: {number} of {whole}   ", end="", file=sys.stderr, flush=True)
    return time.monotonic()


def main() -> int:
    """All three, a table, a file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--stream", type=int, default=10_000)
    parser.add_argument("--kind", choices=KINDS, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.kind is not None:
        print(json.dumps(asyncio.run(at_stream(given.kind, given.stream))))
        return 0
    rows = {
        "camera, control channel": asyncio.run(at_camera(given.inputs)),
        "driver, answers": at_driver(given.inputs),
    }
    rows |= {f"driver, stream, {kind}": in_a_process(kind, given.stream) for kind in KINDS}
    print(file=sys.stderr)
    for name, row in rows.items():
        print(f"{name:<42}" + "   ".join(f"{key} {value}" for key, value in row.items()))
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")
    return int(not all(row["holds"] for row in rows.values()))


if __name__ == "__main__":
    sys.exit(main())
