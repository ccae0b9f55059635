"""Recipes from pictures: how often the features are recognised without knowing anything, and how well they are taught.

Then the watch over focus and light: how soon it warns of slow wear, and how often for nothing. Run `make bench-recipe`;
the figures are left in build/bench-recipe.json.
"""

import argparse
import json
import math
import statistics
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from cellctl.monitoring.light import Trend, after, growth, warnings
from cellctl.vision import Appearance, NotFound
from cellctl.vision.lesson import Pointed, first_base, first_battery
from cellctl.vision.recognise import Undecided, away_px
from tests.vision_scenes import BASE, UM_PER_PX, Camera, View, base_view, battery_view, clutter, some_camera, some_place

OUT = Path("build/bench-recipe.json")
REGIMES = ("clean", "hard", "dirty")
RIGHT_PX = 2.0  # features further off are wrong ones
TAUGHT = Appearance(1.1, 100.0, 2.7, 35.0, 135.0, 0.0)
SCATTER = np.array([0.03, 1.5, 0.15, 1.0, 1.5, 0.0])  # from picture to picture, one sigma
LEAST_CONTRAST = 40.0
LONGEST = 400


class Row(NamedTuple):
    """One picture: right, asked (a person must point), refused or wrong; errors of what was measured, um."""

    verdict: str
    errors_um: tuple[float, ...]
    ms: float


def main(pictures: int, quiet: int, out: Path = OUT, regimes: Sequence[str] = REGIMES) -> None:
    cv2.setNumThreads(1)
    result: dict[str, Any] = {"recognised": {}, "watch": {}}
    for regime in regimes:
        for part, look in (("base", base_row), ("battery", battery_row)):
            rows = [look(regime, number) for number in _shown(f"{regime} {part}", pictures)]
            result["recognised"][f"{regime} {part}"] = summary(rows)
    result["watch"] = watch_figures(quiet)
    print_tables(result)
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def _shown(name: str, count: int) -> Iterator[int]:
    """Numbers, with progress on standard error."""
    for number in range(count):
        yield number
        end = "\n" if number + 1 == count else ""
        print(f"\r\033[K{name}: {number + 1} of {count}", end=end, file=sys.stderr, flush=True)


# -- recognition -------------------------------------------------------------------------------------------


def camera_of(regime: str, rng: np.random.Generator) -> Camera:
    camera = some_camera(rng)
    if regime == "clean":
        return camera
    noise, light, blur = (float(rng.uniform(*limits)) for limits in ((2.0, 6.0), (0.5, 1.3), (0.8, 2.2)))
    return replace(camera, noise=noise, exposure=light, blur_px=blur)


def base_row(regime: str, number: int) -> Row:
    """A base of any hole from 1.4 to 6.4 mm, lying and mounted anyhow, half of the pictures with bright holes."""
    rng = np.random.default_rng([number, 1])
    radius_mm = float(rng.uniform(0.7, 3.2))
    drawing = replace(BASE, hole_radius_mm=radius_mm, edge_distance_mm=float(rng.uniform(radius_mm + 1.6, 6.4)))
    camera, place = camera_of(regime, rng), some_place(rng, 1.2, 5.0)
    view = base_view(rng, camera, place, drawing)
    if regime == "dirty":
        view = base_view(rng, camera, place, drawing, clutter(rng, view.optics))
    view = view._replace(pixels=255 - view.pixels) if number % 2 else view

    def errors(view: View) -> list[float]:
        lesson = first_base(view.pixels, Pointed())
        circle, (_, edge) = lesson.seen.circle, lesson.expected
        ends = [away_px(edge, point) for point in view.truth[1:]]
        radius = circle.radius_px - radius_mm * view.optics.px_per_mm
        return [math.dist(circle.centre, view.truth[0]), abs(radius), max(ends)]

    return judged(view, errors)


def battery_row(regime: str, number: int) -> Row:
    rng = np.random.default_rng([number, 2])
    camera, place = camera_of(regime, rng), some_place(rng, 1.2, 5.0)
    corner = (-1 if number % 2 else 1, -1 if number // 2 % 2 else 1)
    view = battery_view(rng, camera, place, corner)
    if regime == "dirty":
        view = battery_view(rng, camera, place, corner, clutter(rng, view.optics))

    def errors(view: View) -> list[float]:
        lesson = first_battery(view.pixels, Pointed())
        return [math.dist(lesson.seen.corner, view.truth[0])]

    return judged(view, errors)


def judged(view: View, errors: Any) -> Row:
    began_s = time.perf_counter()
    try:
        found = errors(view)
        verdict = "right" if max(found) < RIGHT_PX else "wrong"
    except Undecided:
        found, verdict = [], "asked"
    except NotFound:
        found, verdict = [], "refused"
    return Row(verdict, tuple(error * UM_PER_PX for error in found), (time.perf_counter() - began_s) * 1e3)


def summary(rows: Sequence[Row]) -> dict[str, float]:
    count = Counter(row.verdict for row in rows)
    worst = [max(row.errors_um) for row in rows if row.verdict == "right"]
    return {
        **{verdict: count[verdict] for verdict in ("right", "asked", "refused", "wrong")},
        "median_error_um": round(statistics.median(worst), 3) if worst else math.nan,
        "worst_error_um": round(max(worst), 3) if worst else math.nan,
        "median_ms": round(statistics.median(row.ms for row in rows), 1),
    }


# -- focus and light ---------------------------------------------------------------------------------------


def watch_figures(quiet: int) -> dict[str, Any]:
    rng = np.random.default_rng(5)
    wear = {
        "blur +1 % per picture": lambda n: TAUGHT._replace(blur_px=1.1 * 1.01**n),
        "light -1 % per picture": lambda n: TAUGHT._replace(contrast=100.0 * 0.99**n, bright=35 + 100 * 0.99**n),
        "blur and light, 0.5 % each": lambda n: TAUGHT._replace(blur_px=1.1 * 1.005**n, contrast=100.0 * 0.995**n),
    }
    return {
        "quiet_pictures": quiet,
        "false_warnings": false_warnings(rng, quiet),
        "wear": {name: warned_at(rng, looks) for name, looks in wear.items()},
    }


def seen(rng: np.random.Generator, about: Appearance) -> Appearance:
    return Appearance(*np.maximum(0.0, rng.normal(about, SCATTER)).tolist())


def due(trend: Trend) -> bool:
    return any(warn.severity >= 1.0 for warn in warnings(trend, LEAST_CONTRAST))


def false_warnings(rng: np.random.Generator, pictures: int) -> int:
    trend, false = Trend(), 0
    for _ in range(pictures):
        trend = after(trend, seen(rng, TAUGHT))
        false += due(trend)
    return false


def warned_at(rng: np.random.Generator, looks: Any) -> dict[str, float]:
    """When the warning comes, and by how much the noise of a place has truly grown by then."""
    trend = Trend(taught=TAUGHT)
    for number in range(LONGEST):
        trend = after(trend, seen(rng, looks(number)))
        if due(trend):
            return {"pictures": number, "noise_growth": round(growth(TAUGHT, looks(number)).total, 3)}
    return {"pictures": LONGEST, "noise_growth": math.nan}


def print_tables(result: dict[str, Any]) -> None:
    print("\nfeatures recognised without knowing place, size, direction or polarity")
    print(f"{'':<16} right  asked  refused  wrong  error um: median   worst      ms")
    for name, row in result["recognised"].items():
        print(
            f"{name:<16} {row['right']:5d}  {row['asked']:5d}  {row['refused']:7d}  {row['wrong']:5d}"
            f"  {row['median_error_um']:16.3f} {row['worst_error_um']:7.3f} {row['median_ms']:7.0f}"
        )
    watch = result["watch"]
    print(f"\nfocus and light: {watch['false_warnings']} warnings in {watch['quiet_pictures']} pictures without wear")
    for name, row in watch["wear"].items():
        print(f"{name:<28} warned after {row['pictures']:3d} pictures, noise of a place x {row['noise_growth']:.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=int, default=200, help="of either part in each regime")
    parser.add_argument("--quiet", type=int, default=100_000, help="pictures without wear")
    arguments = parser.parse_args()
    main(arguments.pictures, arguments.quiet)
