"""What the fuzz runs of both sides of the robot's line share: options, table, JSON, and when a run has failed."""

import argparse
import asyncio
import json
import resource
import sys

DIALECTS = ("rcx3", "rcx2")
SLOW_MS, GROWTH_MIB = 50.0, 64.0


def resident_mib():
    """The most that this process has ever held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run(about, fuzzed, counts, out):
    """Fuzz both dialects and show `counts` (heading -> figure of a result); 1 when anything was wrong."""
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=20261122)
    given = parser.parse_args()
    results = [asyncio.run(fuzzed(dialect, given.inputs // 2, given.seed)) for dialect in DIALECTS]
    print(
        f"{'generation':<10} " + "".join(f"{name:>14}" for name in counts) + "  crashes  slowest ms  growth MiB  took s"
    )
    for r in results:
        figures = "".join(f"{figure(r):>14,}" for figure in counts.values())
        print(
            f"{r['dialect']:<10} {figures} {len(r['crashes']):>8} {r['slowest_ms']:>11} {r['growth_mib']:>11} "
            f"{r['took_s']:>7}"
        )
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps({"seed": given.seed, "results": results}, indent=1) + "\n", encoding="utf-8")
    wrong = [fault for r in results for fault in faults(r)]
    for line in wrong[:20]:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


def faults(result):
    """What must not be: crashes, an input that took long, memory that grows."""
    wrong = list(result["crashes"])
    if result["slowest_ms"] > SLOW_MS:
        wrong.append(f"{result['dialect']}: {result.get('slowest_input', 'an input')} took {result['slowest_ms']} ms")
    if result["growth_mib"] > GROWTH_MIB:
        wrong.append(f"{result['dialect']} grew by {result['growth_mib']} MiB")
    return wrong
