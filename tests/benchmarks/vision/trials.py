"""Our finders alone over many pictures, in two processes: are their errors as large as they say, and do they refuse?"""

import itertools
import sys
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, NamedTuple

import cv2
import numpy as np

from cellctl.vision import NotFound
from tests.benchmarks.vision.contest import QUANTITIES, Contest
from tests.hostile_shown import error_of, is_wrong
from tests.vision_hostile import hostile
from tests.vision_regimes import REGIMES, base_case, battery_case

PROCESSES, PACK = 2, 20


class Scores(NamedTuple):
    """Normalised errors by regime and quantity, refusals and pictures by regime."""

    normalised: dict[str, dict[str, list[float]]]
    refused: Counter[str]
    shown: Counter[str]
    checks: Counter[str]


def calibrated(pictures: int) -> dict[str, Any]:
    """Variance of error / own sigma, and of the squared Mahalanobis distance per degree of freedom."""
    normalised: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    refused: Counter[str] = Counter()
    shown: Counter[str] = Counter()
    checks: Counter[str] = Counter()
    for scores in _in_packs(_score_pack, pictures, "calibrated"):
        for regime, quantities in scores.normalised.items():
            for quantity, values in quantities.items():
                normalised[regime][quantity] += values
                normalised["all"][quantity] += values
        refused, shown, checks = refused + scores.refused, shown + scores.shown, checks + scores.checks
    variance = {
        regime: {quantity: float(np.mean(np.square(values))) for quantity, values in quantities.items()}
        for regime, quantities in normalised.items()
    }
    good, out = shown["ideal"] + shown["nuisance"], refused["ideal"] + refused["nuisance"]
    return {
        "pictures": sum(shown.values()),
        "variance of error over sigma": variance,
        "refused by regime": {name: refused[name] / shown[name] for name in shown},
        "good pictures refused": out / good if good else 0.0,
        "refused by check": dict(checks.most_common()),
    }


def refusals(pictures: int) -> dict[str, Any]:
    """Hostile pictures by kind: refused, measured rightly, measured wrongly; and the checks that refused."""
    outcome: dict[str, Counter[str]] = defaultdict(Counter)
    wrong: list[str] = []
    for results in _in_packs(_hostile_pack, pictures, "hostile"):
        for number, kind, said in results:
            outcome[kind]["refused" if said.startswith("no: ") else said] += 1
            if said == "wrong":
                wrong.append(f"{kind} (picture {number})")
    return {
        "pictures": sum(sum(count.values()) for count in outcome.values()),
        "wrong": len(wrong),
        "which": wrong,
        "by kind": {kind: dict(count) for kind, count in sorted(outcome.items())},
    }


def _in_packs(work: Callable[[range], Any], pictures: int, name: str) -> Iterator[Any]:
    packs = [range(first, min(first + PACK, pictures)) for first in range(0, pictures, PACK)]
    if len(packs) < 2:
        yield from map(work, packs)
        return
    with ProcessPoolExecutor(PROCESSES, get_context("spawn")) as pool:
        for done, result in enumerate(pool.map(work, packs), 1):
            print(f"\r{name}: {min(done * PACK, pictures)} of {pictures}", end="", file=sys.stderr, flush=True)
            yield result
    print(file=sys.stderr)


def _score_pack(numbers: range) -> Scores:
    """A third of the pictures of each regime, alternately bases and batteries."""
    cv2.setNumThreads(1)
    scores = Scores({}, Counter(), Counter(), Counter())
    for number in numbers:
        rng, regime = np.random.default_rng([3, number]), REGIMES[number % 3]
        contest = Contest({}, {})
        if number // 3 % 2:
            contest.our_base(base_case(rng, regime))
        else:
            contest.our_battery(battery_case(rng, regime))
        _count(scores, contest, regime.name)
    return scores


def _count(scores: Scores, contest: Contest, regime: str) -> None:
    scores.shown[regime] += 1
    scores.refused[regime] += len(contest.refusals)
    scores.checks.update(refusal.split(":")[1].strip() for refusal in contest.refusals)
    mine = scores.normalised.setdefault(regime, {})
    for quantity, method in itertools.product(QUANTITIES, ("ours",)):
        errors = contest.errors[quantity][method]
        mine.setdefault(quantity, []).extend(np.divide(errors.error, errors.sigma).tolist())
    mine.setdefault("Mahalanobis", []).extend(contest.distances)


def _hostile_pack(numbers: range) -> list[tuple[int, str, str]]:
    cv2.setNumThreads(1)
    results = []
    for number in numbers:
        shown = hostile(np.random.default_rng([5, number]))
        try:
            said = "wrong" if is_wrong(error_of(shown)) else "right"
        except NotFound as refusal:
            said = f"no: {refusal.check}"
        results.append((number, shown.name, said))
    return results
