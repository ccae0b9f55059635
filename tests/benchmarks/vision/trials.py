"""Our finders alone over many pictures: are their errors as large as they say, and do they refuse what is wrong?"""

import math
from collections import Counter, defaultdict
from functools import partial
from typing import Any

import cv2
import numpy as np

from cellctl.vision import NotFound
from tests.benchmarks.vision.contest import OURS, QUANTITIES, Contest
from tests.benchmarks.vision.packs import in_packs
from tests.hostile_shown import error_of, is_wrong
from tests.vision_hostile import hostile
from tests.vision_regimes import REGIMES, base_case, battery_case

JOINT = "Mahalanobis"
Sums = dict[str, float]  # of one quantity: how many, and sums of squares of error, bound and error / own sigma


def calibrated(pictures: int) -> dict[str, Any]:
    """Errors against their own sigma and against the bound, by regime and quantity; and good pictures refused."""
    sums: dict[str, dict[str, Sums]] = defaultdict(lambda: defaultdict(_nothing))
    refused: Counter[str] = Counter()
    shown: Counter[str] = Counter()
    checks: Counter[str] = Counter()
    for pack in in_packs(_score_pack, pictures, "calibrated"):
        for regime, scores in pack.items():
            shown[regime] += scores["shown"]
            refused[regime] += len(scores["refused"])
            checks.update(scores["refused"])
            for quantity, more in scores["sums"].items():
                for into in (sums[regime][quantity], sums["all"][quantity]):
                    _add(into, more)
    good, out = shown["ideal"] + shown["nuisance"], refused["ideal"] + refused["nuisance"]
    return {
        "pictures": sum(shown.values()),
        "by regime": {name: {q: _figures(each) for q, each in mine.items()} for name, mine in sorted(sums.items())},
        "refused by regime": {name: refused[name] / shown[name] for name in shown},
        "good pictures refused": out / good if good else 0.0,
        "refused by check": dict(checks.most_common()),
    }


def _nothing() -> Sums:
    return {"count": 0, "error": 0.0, "bound": 0.0, "normalised": 0.0, "worst": 0.0, "worst picture": -1, "beyond": 0}


def _add(into: Sums, more: Sums) -> None:
    worse = more["worst"] > into["worst"]
    for key in ("worst", "worst picture"):
        into[key] = more[key] if worse else into[key]
    for key in ("count", "error", "bound", "normalised", "beyond"):
        into[key] += more[key]


def _figures(sums: Sums) -> dict[str, float]:
    count = max(1.0, sums["count"])
    figures = {
        "variance of error over sigma": sums["normalised"] / count,
        "share beyond 3 sigma": sums["beyond"] / count,
        "count": sums["count"],
    }
    if sums["bound"] > 0.0:
        figures["rms"] = math.sqrt(sums["error"] / count)
        figures["ratio to the bound"] = math.sqrt(sums["error"] / sums["bound"])
        figures["worst"], figures["worst picture"] = sums["worst"], sums["worst picture"]
    return figures


def _score_pack(numbers: range) -> dict[str, Any]:
    """A third of the pictures of each regime, alternately bases and batteries."""
    cv2.setNumThreads(1)
    scores: dict[str, Any] = {}
    for number in numbers:
        rng, regime = np.random.default_rng([3, number]), REGIMES[number % 3]
        contest = Contest({}, {})
        if number // 3 % 2:
            contest.our_base(base_case(rng, regime))
        else:
            contest.our_battery(battery_case(rng, regime))
        mine = scores.setdefault(regime.name, {"shown": 0, "refused": [], "sums": {}})
        mine["shown"] += 1
        mine["refused"] += [refusal.split(":")[1].strip() for refusal in contest.refusals]
        for quantity, more in _sums_of(contest, number).items():
            _add(mine["sums"].setdefault(quantity, _nothing()), more)
    return scores


def _sums_of(contest: Contest, number: int) -> dict[str, Sums]:
    found = {}
    for quantity in QUANTITIES:
        errors = contest.errors[quantity][OURS]
        if errors.error:
            error, bound, sigma = (np.array(a) for a in (errors.error, errors.bound, errors.sigma))
            found[quantity] = {
                **_normalised(error / sigma),
                "error": float(error @ error),
                "bound": float(bound @ bound),
                "worst": float(np.abs(error).max()),
                "worst picture": number,
            }
    if contest.distances:
        found[JOINT] = _nothing() | _normalised(np.array(contest.distances))
    return found


def _normalised(score: np.ndarray) -> Sums:
    beyond = np.count_nonzero(np.abs(score) > 3.0)
    return {"count": score.size, "normalised": float(score @ score), "beyond": int(beyond)}


def refusals(pictures: int) -> dict[str, Any]:
    """Hostile pictures by kind: refused, measured rightly, measured wrongly; and the checks that refused."""
    outcome: dict[str, Counter[str]] = defaultdict(Counter)
    wrong: list[str] = []
    for results in in_packs(_hostile_pack, pictures, "hostile"):
        for number, kind, said in results:
            outcome[kind]["refused" if said.startswith("no: ") else said] += 1
            if said == "wrong":
                wrong.append(f"{kind} (picture {number})")
    return {
        "pictures": sum(sum(count.values()) for count in outcome.values()),
        "wrong": len(wrong),
        "which": sorted(wrong),
        "by kind": {kind: dict(count) for kind, count in sorted(outcome.items())},
    }


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


def compared(pictures: int) -> dict[str, Contest]:
    """Everybody on the same pictures, by regime."""
    contests = {}
    for seed, regime in enumerate(REGIMES):
        contest = contests[regime.name] = Contest({}, {})
        for pack in in_packs(partial(_contest_pack, seed), pictures, f"contest {regime.name}"):
            contest.add(pack)
    return contests


def _contest_pack(seed: int, numbers: range) -> dict[str, Any]:
    from tests.benchmarks.vision import peers

    cv2.setNumThreads(1)
    contest = Contest(peers.CIRCLES, peers.LINES)
    contest.run(REGIMES[seed], numbers, seed)
    return contest.plain()
