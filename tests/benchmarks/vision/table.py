"""The figures of the comparison as numbers for a file and as tables for people."""

from typing import Any

import numpy as np

from tests.benchmarks.vision.contest import ANGLE, CORNER, CORNER_ANGLE, HOLE, OFFSET, OURS, QUANTITIES, Contest
from tests.benchmarks.vision.errors import Errors

Table = dict[str, dict[str, dict[str, float]]]
TIMED_BY = {HOLE: "hole", OFFSET: "edge", ANGLE: "edge", CORNER: "corner", CORNER_ANGLE: "corner"}
HEAD = f"{'':20s}{'':32s}{'noise':>10s}{'bias':>9s}{'worst':>10s}{'failed':>8s}{'ms':>8s}{'x bound':>9s}{'x ours':>8s}"


def contest_table(contest: Contest) -> Table:
    """By quantity and method: noise, bias, worst, share of failures, ms, ratio to the bound and to ours."""
    table: Table = {}
    for quantity in QUANTITIES:
        rows = {method: _row(errors) for method, errors in contest.errors[quantity].items()}
        for method, row in rows.items():
            row["median_ms"] = _ms(contest, quantity, method)
            row["ratio to ours"] = row["noise"] / rows[OURS]["noise"]
        table[quantity] = rows
    return table


def _row(errors: Errors) -> dict[str, float]:
    error, bound = np.array(errors.error or [np.nan]), np.array(errors.bound or [np.nan])
    asked = len(errors.error) + errors.failures
    rms = float(np.sqrt(np.mean(error**2)))
    return {
        "noise": float(error.std()),
        "bias": float(error.mean()),
        "worst": float(np.abs(error).max()),
        "pictures": asked,
        "failed": errors.failures / max(1, asked),
        "ratio to the bound": rms / float(np.sqrt(np.mean(bound**2))),
    }


def _ms(contest: Contest, quantity: str, method: str) -> float:
    feature = TIMED_BY[quantity]
    if method == OURS:
        feature = "battery" if feature == "corner" else "base"
    each = contest.ms[feature][method]
    return float(np.median(each)) * (2.0 if feature == "corner" else 1.0)


def print_contest(regime: str, table: Table) -> None:
    pictures = int(table[OFFSET][OURS]["pictures"])
    print(f"\n{regime}: {pictures} bases and {pictures} batteries; ms: ours finds the whole part, others one feature")
    print(HEAD)
    for quantity, rows in table.items():
        for method, row in rows.items():
            figures = f"{row['noise']:10.4f}{row['bias']:+9.3f}{row['worst']:10.3f}{row['failed']:8.1%}"
            ratios = f"{row['median_ms']:8.2f}{row['ratio to the bound']:9.2f}{row['ratio to ours']:8.1f}"
            print(f"{quantity:20s}{method:32s}{figures}{ratios}")


def print_times(timed: dict[str, dict[str, float]]) -> None:
    for name, ms in timed.items():
        print(f"{name:28s} median {ms['median_ms']:6.2f} ms   p99 {ms['p99_ms']:6.2f} ms")


def print_calibrated(result: dict[str, Any]) -> None:
    print(f"\nerror against own sigma and against the bound, {result['pictures']} pictures")
    columns = "".join(f"{name:>12s}" for name in ("variance", "> 3 sigma", "x bound", "rms", "worst", "picture"))
    print(f"{'':12s}{'':22s}{columns}")
    for regime, quantities in result["by regime"].items():
        for quantity, row in quantities.items():
            figures = f"{row['variance of error over sigma']:12.2f}{row['share beyond 3 sigma']:12.2%}"
            if "rms" in row:
                figures += f"{row['ratio to the bound']:12.2f}{row['rms']:12.4f}{row['worst']:12.3f}"
                figures += f"{row['worst picture']:12.0f}"
            print(f"{regime:12s}{quantity:22s}{figures}")
    shares = ", ".join(f"{name} {share:.2%}" for name, share in result["refused by regime"].items())
    print(f"refused: {shares}; good pictures {result['good pictures refused']:.2%}; {result['refused by check']}")


def print_hostile(result: dict[str, Any]) -> None:
    print(f"\n{result['pictures']} hostile pictures, {result['wrong']} wrong poses accepted {result['which'] or ''}")
    for kind, count in result["by kind"].items():
        print(f"{kind:28s}" + "   ".join(f"{name} {number}" for name, number in sorted(count.items())))
