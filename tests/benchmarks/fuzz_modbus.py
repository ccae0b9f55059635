"""Throw broken frames at both Modbus parsers: no crash, no hang, no growth of memory, no answer that is not one.

`python -m tests.benchmarks.fuzz_modbus` counts a million frames (--frames) for each side, prints a table and writes
build/bench-fuzz-modbus.json. Both are fed as their sockets would feed them: the server with requests of a client, the
driver's link with answers to its questions; mutilated, in pieces and out of turn. Every answer of the server and every
answer that the driver takes is judged here, byte by byte.
"""

import argparse
import asyncio
import gc
import json
import random
import struct
import sys
import time
from collections import Counter
from pathlib import Path

from drivers import modbus_frames
from drivers.errors import DeviceError
from drivers.modbus import ModbusLink
from simulators.modbus import ModbusServer, _Client
from simulators.modbus_bank import Bank, Table
from tests.benchmarks.fuzz_run import resident_mib
from tests.modbus_wire import bank, frame

OUT = Path("build/bench-fuzz-modbus.json")
SLOW_MS, GROWTH_MIB, GROWTH_BLOCKS = 50.0, 16.0, 3000
TIDY_EVERY, PROGRESS_S = 2000, 2.0
LONGEST_ANSWER = 260
QUESTIONS = (
    modbus_frames.read(100, 32),
    modbus_frames.read(100, 32, 4),
    modbus_frames.write(0, range(16)),
    modbus_frames.read_write(100, 32, 0, range(16)),
)


class Nowhere(asyncio.Transport):
    """The socket of a fuzzed side; the fuzzer is its other end."""

    def __init__(self):
        super().__init__({"peername": ("127.0.0.1", 1), "socket": self})
        self.written = bytearray()
        self.closed = False

    def setsockopt(self, *arguments):
        pass

    def write(self, data):
        self.written += data

    def is_closing(self):
        return self.closed

    def abort(self):
        self.closed = True


def plausible(chance: random.Random) -> bytes:
    """A request that is right but perhaps for its addresses."""
    address, count, values = chance.randrange(120), chance.randrange(1, 12), chance.randbytes(40)
    function = chance.choice((1, 2, 3, 4, 5, 6, 15, 16, 22, 23, 43))
    if function in (1, 2, 3, 4):
        body = struct.pack(">HH", address, count)
    elif function == 5:
        body = struct.pack(">HH", address, chance.choice((0, 0xFF00)))
    elif function in (6, 22):
        body = struct.pack(">H", address) + values[: 2 if function == 6 else 4]
    elif function == 15:
        body = struct.pack(">HHB", address, count, (count + 7) // 8) + values[: (count + 7) // 8]
    elif function == 16:
        body = struct.pack(">HHB", address, count, 2 * count) + values[: 2 * count]
    elif function == 23:
        body = struct.pack(">HHHHB", address, count, 0, count, 2 * count) + values[: 2 * count]
    else:
        body = bytes((14, chance.randrange(1, 5), chance.randrange(4)))
    return bytes([function]) + body


def mutilated(chance: random.Random, data: bytes) -> bytes:
    """One accident."""
    at, kind = chance.randrange(len(data) + 1), chance.randrange(5)
    if kind == 0:
        at = min(at, len(data) - 1)
        return data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]
    if kind == 1:
        return data[:at] + data[at + chance.randrange(1, 6) :]
    if kind == 2:
        return data[:at] + chance.randbytes(chance.randrange(1, 6)) + data[at:]
    if kind == 3:
        return data + data[at:]
    return data[:at] + struct.pack(">H", chance.choice((0, 1, 125, 126, 255, 2000, 0xFFFF))) + data[at + 2 :]


def pieces(chance: random.Random, data: bytes) -> list[bytes]:
    """As a network may cut it."""
    if chance.random() < 0.7:
        return [data]
    cuts = sorted(chance.randrange(len(data) + 1) for _ in range(chance.randrange(1, 4)))
    return [data[start:end] for start, end in zip([0, *cuts], [*cuts, len(data)], strict=True) if start < end]


class ServerSide:
    """The server's connections, one after the other as it closes them."""

    name = "server, requests"

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.bank: Bank = bank()
        self.server = ModbusServer(self.bank)
        self.outcomes: Counter[str] = Counter()
        self._addresses = {table: set(values) for table, values in self.bank.tables.items()}
        self._connect()

    def _connect(self) -> None:
        self.transport, self.client = Nowhere(), _Client(self.server)
        self.client.connection_made(self.transport)

    def one(self, number: int) -> None:
        """One frame, perhaps broken."""
        chance = self.chance
        pdu = chance.randbytes(chance.randrange(1, 254)) if chance.random() < 0.2 else plausible(chance)
        pdu = mutilated(chance, pdu) if chance.random() < 0.4 else pdu
        data = frame(number & 0xFFFF, pdu)
        if chance.random() < 0.1:
            data = mutilated(chance, data)
        for piece in pieces(chance, data):
            self._receive(piece)

    def _receive(self, data: bytes) -> None:
        while data and not self.transport.closed:
            room = self.client.get_buffer(-1)
            size = min(len(room), len(data))
            room[:size] = data[:size]
            self.client.buffer_updated(size)
            data = data[size:]
        self._judge()
        if self.transport.closed:
            self.outcomes["closed"] += 1
            self.client.connection_lost(None)
            self._connect()

    def _judge(self) -> None:
        answers, at = bytes(self.transport.written), 0
        self.transport.written.clear()
        while at < len(answers):
            _, protocol, length = struct.unpack_from(">HHH", answers, at)
            end = at + 6 + length
            assert protocol == 0
            assert 9 <= end - at <= LONGEST_ANSWER
            function, code = answers[at + 7], answers[at + 8]
            assert function < 0x80 or (length == 3 and code in (1, 2, 3, 11)), answers[at:end].hex()
            self.outcomes["answered" if function < 0x80 else f"exception {code}"] += 1
            at = end
        assert at == len(answers)

    def close(self) -> None:
        """Whatever came, the bank has its addresses and holds words."""
        self.client.connection_lost(None)
        assert {table: set(values) for table, values in self.bank.tables.items()} == self._addresses
        assert all(0 <= word <= 0xFFFF for word in self.bank.tables[Table.HOLDING].values())


class DriverSide:
    """The driver's link, a new one for each answer, as one that was fooled closes."""

    name = "driver, answers"

    def __init__(self, seed: int) -> None:
        self.chance = random.Random(seed)
        self.outcomes: Counter[str] = Counter()

    def one(self, number: int) -> None:
        """One question and what comes back, perhaps broken."""
        chance = self.chance
        link, ended = ModbusLink("plc", "127.0.0.1", 502, transaction=number & 0xFFFF), []
        link.connection_made(Nowhere())
        request = chance.choice(QUESTIONS)
        link.begin(request, lambda: ended.append(True))
        data = self._answer(link.transaction, request)
        received = b""
        for piece in pieces(chance, data):
            if not ended:
                received += piece
            link.data_received(piece)
        self._judge(link, request, received, ended)
        link.close()

    def _answer(self, transaction: int, request: modbus_frames.Request) -> bytes:
        chance = self.chance
        size = request.answer_size - len(request.answer_begins)
        right = frame(transaction, request.answer_begins + chance.randbytes(size))
        kind = chance.random()
        if kind < 0.3:
            return right
        if kind < 0.4:
            return frame(transaction, bytes((request.pdu[0] | 0x80, chance.randrange(256))))
        if kind < 0.5:
            return frame(transaction - chance.randrange(1, 4) & 0xFFFF, right[7:])
        if kind < 0.6:
            return chance.randbytes(chance.randrange(1, 300))
        return mutilated(chance, right)

    def _judge(self, link: ModbusLink, request: modbus_frames.Request, received: bytes, ended: list[bool]) -> None:
        assert len(ended) <= 1
        if not ended:
            self.outcomes["waits for more"] += 1
            return
        try:
            words = link.outcome()
        except DeviceError as error:
            self.outcomes[type(error).__name__] += 1
            return
        head = frame(link.transaction, request.answer_begins, length=request.answer_size + 1)
        assert received[: len(head)] == head, received.hex()
        assert len(received) == 7 + request.answer_size
        assert struct.pack(f">{len(words)}H", *words) in (received[len(head) :], b"")
        self.outcomes["taken"] += 1

    def close(self) -> None:
        """Nothing is left open."""


async def fuzzed(side, frames, *, warm=0):
    """The figures of one side after so many frames, `warm` of them before memory is looked at."""
    crashes, slowest_ms, settled = [], 0.0, (0, 0.0)
    began_s = told_s = time.monotonic()
    gc.disable()
    for number in range(frames):
        if number == warm:
            gc.collect()
            settled = sys.getallocatedblocks(), resident_mib()
        one_s = time.thread_time()
        try:
            side.one(number)
        except Exception as error:
            crashes.append(f"frame {number}: {error!r}")
        slowest_ms = max(slowest_ms, (time.thread_time() - one_s) * 1e3)
        if number % 50 == 0:
            await asyncio.sleep(0)
        if number % TIDY_EVERY == 0:
            gc.collect()  # here, so that it is no frame's fault
        if time.monotonic() - told_s > PROGRESS_S:
            told_s = time.monotonic()
            print(f"\r{side.name} {number:9,} of {frames:,}", end="", file=sys.stderr)
    print(f"\r{' ' * 60}\r", end="", file=sys.stderr)
    gc.enable()
    side.close()
    await asyncio.sleep(0)
    gc.collect()
    return {
        "side": side.name,
        "frames": frames,
        "outcomes": dict(side.outcomes.most_common()),
        "crashes": crashes,
        "slowest_ms": round(slowest_ms, 2),
        "growth_blocks": sys.getallocatedblocks() - settled[0],
        "growth_mib": round(resident_mib() - settled[1], 1),
        "took_s": round(time.monotonic() - began_s, 1),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--frames", type=int, default=1_000_000, help="for each side")
    parser.add_argument("--seed", type=int, default=20261122)
    given = parser.parse_args()
    sides = (ServerSide, DriverSide)
    results = [asyncio.run(fuzzed(side(given.seed), given.frames, warm=given.frames // 10)) for side in sides]
    print("parser                frames  crashes  slowest ms  growth blocks  growth MiB  took s")
    for r in results:
        print(
            f"{r['side']:<16} {r['frames']:>11,} {len(r['crashes']):>8} {r['slowest_ms']:>11} {r['growth_blocks']:>14} "
            f"{r['growth_mib']:>11} {r['took_s']:>7}"
        )
        print("   " + ", ".join(f"{name} {count:,}" for name, count in r["outcomes"].items()))
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps({"seed": given.seed, "results": results}, indent=1) + "\n", encoding="utf-8")
    wrong = [crash for r in results for crash in r["crashes"]]
    wrong += [f"{r['side']}: a frame took {r['slowest_ms']} ms" for r in results if r["slowest_ms"] > SLOW_MS]
    wrong += [f"{r['side']} grew by {r['growth_mib']} MiB" for r in results if r["growth_mib"] > GROWTH_MIB]
    wrong += [f"{r['side']} keeps {r['growth_blocks']} blocks" for r in results if r["growth_blocks"] > GROWTH_BLOCKS]
    for line in wrong[:20]:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
