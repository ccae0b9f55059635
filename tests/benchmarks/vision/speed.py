"""Wall time on one core, 5 MP pictures; the pictures change all the time, so that none is in the cache."""

import time
from collections.abc import Callable, Sequence

import numpy as np

from cellctl.vision.annotate import annotate
from simulators.parts import BaseDrawing, BatteryDrawing, PlateDrawing, base, battery, dot_plate
from simulators.place import Place
from simulators.render import Scene, placed, render
from tests.vision_regimes import IDEAL, NUISANCE, base_case, battery_case
from tests.vision_scenes import View

PICTURES, ROUNDS = 16, 12


def times() -> dict[str, dict[str, float]]:
    """Median and 99th percentile by work."""
    rng = np.random.default_rng(1)
    timed: dict[str, dict[str, float]] = {}
    for regime in (IDEAL, NUISANCE):
        bases, batteries = (_views(make, regime, rng) for make in (base_case, battery_case))
        timed[f"find_base {regime.name}"] = _timing([view.base for view in bases])
        timed[f"find_battery {regime.name}"] = _timing([view.battery for view in batteries])
    view, seen = bases[0], bases[0].base()
    timed["annotate"] = _timing([lambda: annotate(view.pixels, seen, view.features, "unit 17 base")])
    for name, scene in _scenes().items():
        timed[f"render {name}"] = _timing([lambda s=scene: render(s, view.optics, rng)])
    return timed


def _views(make: Callable, regime: object, rng: np.random.Generator) -> list[View]:
    return [make(rng, regime).view for _ in range(PICTURES)]


def _scenes() -> dict[str, Scene]:
    here = Place(0.2, 0.1, 0.5)
    return {
        "a base": Scene(45.0, placed(base(BaseDrawing()), here)),
        "a battery corner": Scene(40.0, placed(battery(BatteryDrawing()), Place(25.0, 40.0, 0.5))),
        "a dot plate": Scene(60.0, placed(dot_plate(PlateDrawing()), Place(-4.8, -1.6, 3.0))),
    }


def _timing(works: Sequence[Callable[[], object]]) -> dict[str, float]:
    rounds = max(ROUNDS, 40 // len(works))
    spent = []
    for number in range(rounds + 1):
        for work in works:
            start = time.perf_counter()
            work()
            if number:  # the first round makes tables
                spent.append(1e3 * (time.perf_counter() - start))
    return {"median_ms": float(np.median(spent)), "p99_ms": float(np.quantile(spent, 0.99))}
