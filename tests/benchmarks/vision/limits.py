"""What the finders must keep, and whether they do: one line for every limit, met or not."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from tests.benchmarks.vision.contest import ANGLE, CORNER, CORNER_ANGLE, HOLE, OFFSET, OURS

BOUND = {"ideal": 1.3, "nuisance": 2.5, "strong": 5.0}  # errors (rms) against the Cramer-Rao bound
HOLE_BOUND = {**BOUND, "nuisance": 2.0}
PEER = 0.5  # noise against the best free peer's on the same pictures
MEDIAN_MS, P99_MS = 5.0, 10.0
VARIANCE = (0.8, 1.25)  # of error over own sigma
GOOD_REFUSED = 0.005
MOST_FAILED = 0.05  # a peer that fails more often is no peer: it measures easier pictures


class Limit(NamedTuple):
    """A figure and what it must be."""

    what: str
    figure: float
    least: float
    most: float

    @property
    def met(self) -> bool:
        return self.least <= self.figure <= self.most


def limits(result: dict[str, Any]) -> list[Limit]:
    """Of the parts that have been run."""
    return [
        *_times(result.get("time", {})),
        *_calibrated(result.get("calibrated")),
        *_contest(result.get("contest", {}), bounds="calibrated" not in result),
        *_hostile(result.get("hostile")),
    ]


def _times(timed: dict[str, dict[str, float]]) -> Iterator[Limit]:
    for name, ms in timed.items():
        if name.startswith("find_"):
            yield Limit(f"{name}, median ms", ms["median_ms"], 0.0, MEDIAN_MS)
            yield Limit(f"{name}, p99 ms", ms["p99_ms"], 0.0, P99_MS)


def _calibrated(part: dict[str, Any] | None) -> Iterator[Limit]:
    if part is None:
        return
    for regime, quantities in part["by regime"].items():
        for quantity, figures in quantities.items():
            if regime in BOUND and "ratio to the bound" in figures:
                yield _to_the_bound(regime, quantity, figures["ratio to the bound"])
            yield Limit(f"{regime}, {quantity}: variance of error / sigma", _variance(figures), *VARIANCE)
    yield Limit("good pictures refused", part["good pictures refused"], 0.0, GOOD_REFUSED)


def _variance(figures: dict[str, float]) -> float:
    return figures["variance of error over sigma"]


def _to_the_bound(regime: str, quantity: str, ratio: float) -> Limit:
    most = (HOLE_BOUND if quantity == HOLE else BOUND)[regime]
    return Limit(f"{regime}, {quantity}: error / Cramer-Rao bound", ratio, 0.0, most)


def _contest(contest: dict[str, Any], bounds: bool) -> Iterator[Limit]:
    for regime, quantities in contest.items():
        for quantity in (HOLE, OFFSET, ANGLE, CORNER, CORNER_ANGLE):
            rows = quantities[quantity]
            if bounds:
                yield _to_the_bound(regime, quantity, rows[OURS]["ratio to the bound"])
            peers = {name: row["noise"] for name, row in rows.items() if name != OURS and row["failed"] <= MOST_FAILED}
            if peers:
                best = min(peers, key=lambda name: peers[name])
                share = rows[OURS]["noise"] / peers[best]
                yield Limit(f"{regime}, {quantity}: noise / that of {best}", share, 0.0, PEER)


def _hostile(part: dict[str, Any] | None) -> Iterator[Limit]:
    if part is not None:
        yield Limit(f"wrong poses accepted in {part['pictures']} hostile pictures", part["wrong"], 0, 0)


def print_limits(found: list[Limit]) -> None:
    print(f"\n{sum(limit.met for limit in found)} of {len(found)} limits are met")
    for limit in found:
        least = f"{limit.least:g} to " if limit.least else "at most " if limit.most else ""
        met = "met" if limit.met else "NOT MET"
        print(f"{met:9s}{limit.what:72s}{limit.figure:9.3f}   must be {least}{limit.most:g}")
