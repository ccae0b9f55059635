"""Throw broken replies at everything of the robot driver that reads: no crash, no growth of memory, no wrong value.

`python -m tests.benchmarks.fuzz_robot_driver` counts a million inputs (--inputs), half of them for each generation,
prints a table and writes build/bench-fuzz-robot-driver.json. An input is a piece of what a line could bring: mutilated
replies, telnet commands, noise. Each goes byte by byte through the splitter, and what it completes to every parser and
to a question, a file and an operation that wait. A value that is read must be one that is written in the line.
"""

import contextlib
import gc
import math
import random
import sys
import time
from collections import Counter
from pathlib import Path

from drivers import rcx
from drivers.exchange import FileOut, Operation, Question
from drivers.link_lines import LONGEST_LINE, LineSplitter
from drivers.rcx import Kind, classify
from drivers.rcx3 import parse_alarm, parse_flag
from drivers.rcx_points import parse_point, parse_points
from drivers.robot import DIALECTS
from drivers.robot_files import parse_task
from tests.benchmarks.fuzz_run import resident_mib, run

OUT = Path("build/bench-fuzz-robot-driver.json")
COUNTS = {
    "inputs": lambda r: r["inputs"],
    "lines": lambda r: r["lines"],
    "values read": lambda r: sum(r["read"].values()),
}
PROGRESS_S = 2.0
EVERY = 500

REPLIES = {
    "rcx3": (
        *("OK", "RUN", "END", "READY", "BEGIN", "", "Welcome to RCX340", "NG=6.204", "NG=06.204", "NG=12.600", "0.0"),
        *("2", "0", "1 1,1,1,1", "0 1,1,0,1", "12.600", "100", "R3,4,R,32", "PROG,12,S,32", "OFF", "H1", "-385506"),
        *("250.000 0.000 0.000 0.000 0.000 0.000 1 0 0", "133446 -290357 16384 40189 0 0", "1.000 2 3 4 5 6"),
        *("P5=250.500 -20.250 30.000 40.000 0.000 0.000 1 0 0", "P6=1000 2000 3000 4000 0 0", "1,PROG,17"),
    ),
    "rcx2": (
        *("OK", "READY", "END", "5.30:\xbc\xb7\xcd\xde\xc2\xbc", "NG=5.30", "12.1:Emergency stop on", "AUTO", "MANUAL"),
        *("ON,99991111", "OFF,99990000", "COMPLETE", "INCOMPLETE,99990111", "ON", "OFF", "11", "100,50", "100/50,20"),
        *(
            "[POS]  250.00    0.00    0.00    0.00    0.00    0.00",
            "[POS]  133446 -290357   16384   40189       0       0",
        ),
        *("RIGHTY", "LEFTY", "V8.02,R1021-V5.10-V1.01", "P5=  250.50  -20.25   30.00   40.00    0.00    0.00"),
    ),
}
NOISE = (
    b"\xff\xfd\x01",
    b"\xff\xfa\x18\x00\xff\xf0",
    b"\xff\xff",
    b"\0",
    b"\r",
    b"\n",
    b"\r\n",
    b"\xb1\xb2",
    b"nan",
    b"1e9",
)
NUMBERS = (b"0", b"-1", b"255", b"256", b"99999999999", b".", b"-", b"+.", b"1_0", b"\xb2", b"0x1", b"inf")
PARSERS = {
    "failure": rcx.parse_failure,
    "position": rcx.parse_position,
    "pulses": rcx.parse_pulses,
    "integer": rcx.parse_integer,
    "leading integer": rcx.parse_leading_integer,
    "byte": rcx.parse_byte,
    "bit": rcx.parse_flag_alone,
    "hand": rcx.parse_hand,
    "flag": parse_flag,
    "alarm": parse_alarm,
    "point": parse_point,
    "task": parse_task,
}


def broken(rng, dialect):
    """One input."""
    data = bytearray(rng.choice(REPLIES[dialect]).encode("latin-1") + b"\r\n")
    if rng.random() < 0.1:
        data[:] = rng.randbytes(rng.randrange(1, 100)) + b"\n"
    for _ in range(rng.randrange(0, 4)):
        at, kind = rng.randrange(len(data) + 1), rng.randrange(5)
        if kind == 0 and data:
            data[at % len(data)] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del data[at : at + rng.randrange(1, 6)]
        elif kind == 2:
            data[at:at] = rng.choice(NOISE)
        elif kind == 3:
            data[at:at] = rng.choice(NUMBERS)
        else:
            data += data[at:]
    return bytes(data)


class Fuzz:
    """What a driver has that reads, under fire."""

    def __init__(self, dialect, seed):
        self.dialect = DIALECTS[dialect]
        self.rng = random.Random(seed)
        self.splitter = LineSplitter(telnet=True)
        self.answers = [""] * len(self.dialect.status_queries)
        self.inputs = self.lines = self.answered = 0
        self.read, self.crashes = Counter(), []
        self.slowest_ms = 0.0
        self._wait_anew()

    def run(self, inputs):
        """So many inputs; what goes wrong is kept."""
        told = time.monotonic()
        gc.disable()
        for _ in range(inputs):
            data = broken(self.rng, self.dialect.name)
            began = time.thread_time()
            try:
                self._take(data)
            except Exception as error:
                self.crashes.append(f"input {self.inputs}: {data!r}: {error!r}")
            self.slowest_ms = max(self.slowest_ms, (time.thread_time() - began) * 1e3)
            self.inputs += 1
            if self.inputs % EVERY == 0:
                self._wait_anew()
                gc.collect(0)
                if time.monotonic() - told > PROGRESS_S:
                    told = time.monotonic()
                    print(f"\r{self.dialect.name} {self.inputs:9,} of {inputs:,}", end="", file=sys.stderr)
        gc.enable()
        print("\r", end="", file=sys.stderr)

    def _take(self, data):
        cut = self.rng.randrange(len(data) + 1)
        for piece in (data[:cut], data[cut:]):
            lines, refusals = self.splitter.feed(piece)
            assert len(refusals) % 3 == 0
            for line in lines:
                self.lines += 1
                self._read(line)
        if self.splitter.overlong:
            self.splitter = LineSplitter(telnet=True)

    def _read(self, line):
        text = line.translate(rcx.CONTROL).strip()
        assert len(text) <= LONGEST_LINE or self.splitter.overlong
        kind = classify(text)
        for name, parse in PARSERS.items():
            if (value := parse(text)) is not None:
                self.read[name] += 1
                check(name, value, text)
        self.answers = [*self.answers[1:], text]
        status = self.dialect.status([*self.answers, *[text] * len(self.dialect.more_queries(self.answers))])
        self.read["status"] += status is not None
        with contextlib.suppress(ValueError):
            self.read["point table"] += len(parse_points([text]))
        for waiting in self.waiting:
            self.answered += waiting.takes(kind, text)
        self.operation.take(kind, run_before_end=self.dialect.grammar.run_before_end)

    def _wait_anew(self):
        self.waiting = [
            Question("@?", Kind.OK),
            Question("@?", Kind.DATA),
            Question("@READ", Kind.END),
            FileOut("@WRITE"),
        ]
        self.operation = Operation("@MOVE")


def check(name, value, text):
    """What was read is written there."""
    if name == "position":
        assert all(math.isfinite(number) for number in value.point)
        assert value.hand in (0, 1, 2)
        fields = text.removeprefix("[POS]").split()
        assert [float(field) for field in fields[:4]] == list(value.point)
    elif name == "pulses":
        assert [int(field) for field in text.removeprefix("[POS]").split()[:4]] == list(value)
    elif name in ("integer", "byte"):
        assert int(text) == value
    elif name == "failure":
        assert f"{value.group}.".lstrip("0") in text or value.group == 0
    elif name == "point":
        assert all(math.isfinite(number) for number in value.values)


async def fuzzed(dialect, inputs, seed):
    """The figures of one generation."""
    began = time.monotonic()
    warm = Fuzz(dialect, seed)
    warm.run(min(inputs // 10, 50_000))
    settled_mib = resident_mib()
    fuzz = Fuzz(dialect, seed + 1)
    fuzz.run(inputs - warm.inputs)
    return {
        "dialect": dialect,
        "inputs": warm.inputs + fuzz.inputs,
        "lines": warm.lines + fuzz.lines,
        "read": dict(sorted((warm.read + fuzz.read).items())),
        "crashes": warm.crashes + fuzz.crashes,
        "slowest_ms": round(max(warm.slowest_ms, fuzz.slowest_ms), 2),
        "growth_mib": round(resident_mib() - settled_mib, 1),
        "took_s": round(time.monotonic() - began, 1),
    }


if __name__ == "__main__":
    sys.exit(run(__doc__.partition("\n")[0], fuzzed, COUNTS, OUT))
