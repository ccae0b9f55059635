"""The delivered PLC program for long: `python -m tests.benchmarks.bench_plc_program [commands]`.

Commands at random through a wire that loses, repeats and delays packets; after each the station's truth must be what
the commands say, each executed once. Then the time of a scan, and of compiling. Writes build/bench-plc-program.json.
"""

import json
import random
import sys
import time
from pathlib import Path

from simulators.plc_program import DELIVERED
from simulators.st.compiler import compile_program
from tests.plc_bench import BRING, RELEASE_GOOD, RELEASE_REJECT, RESET, STOP, Wire, live

OUT = Path("build/bench-plc-program.json")
COMMANDS = 10_000
MIX = (BRING, BRING, RELEASE_GOOD, RELEASE_GOOD, RELEASE_REJECT, STOP, RESET, 9)
WAYS = ("lose", "repeat", "late")
SCANS, PROGRESS_S = 20_000, 2.0


def soak(commands: int, seed: int = 1) -> dict[str, int | float]:
    """Run so many commands; AssertionError as soon as one was lost or executed twice."""
    chance = random.Random(seed)
    bench = live()
    wire = Wire(bench, chance)
    scans, packets, told_s = bench[100], 0, time.monotonic()
    for count in range(1, commands + 1):
        ways = chance.choices(WAYS, k=chance.randrange(6))
        wire.command(chance.choice(MIX), ways)
        scans += (bench[100] - scans) & 0xFFFF
        packets += len(ways)
        if time.monotonic() - told_s > PROGRESS_S:
            told_s = time.monotonic()
            print(f"    {count} of {commands} commands", file=sys.stderr)
    return {
        "commands": commands,
        "plc_scans": scans,
        "arrivals": wire.came,
        "releases": len(wire.left),
        "disturbed_packets": packets,
    }


def scan_times() -> dict[str, int | float]:
    """Of one scan with its wires and registers, and of compiling."""
    source = DELIVERED.read_text(encoding="utf-8")
    began_s = time.perf_counter()
    compile_program.__wrapped__(source)
    compile_ms = (time.perf_counter() - began_s) * 1000
    bench, took_us = live(), []
    for _ in range(SCANS):
        began_s = time.perf_counter()
        bench.beat()
        took_us.append((time.perf_counter() - began_s) * 1e6)
    took_us.sort()
    return {
        "source_lines": len(source.splitlines()),
        "compile_ms": round(compile_ms, 1),
        "scan_p50_us": round(took_us[SCANS // 2], 1),
        "scan_p99_us": round(took_us[SCANS * 99 // 100], 1),
    }


def main() -> int:
    """Print the figures and keep them."""
    figures = soak(int(sys.argv[1]) if sys.argv[1:] else COMMANDS) | scan_times()
    for name, value in figures.items():
        print(f"{name:18} {value:>12,}")
    print(f"each of {figures['commands']:,} commands was executed once")
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
