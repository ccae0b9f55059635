"""How fast and how exact vision and the renderer are: `python -m tests.benchmarks.bench_vision [pictures]`.

Prints one table and writes build/bench-vision.json. Noise is the error against the rendered truth on clean pictures
(no texture), and its ratio to the Cramer-Rao bound of each picture.
"""

import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from cellctl.vision.annotate import annotate
from simulators.parts import BaseDrawing, BatteryDrawing, PlateDrawing, base, battery, dot_plate
from simulators.place import Place
from simulators.render import Optics, Scene, placed, render
from tests.vision_scenes import UM_PER_PX, View, base_view, battery_view, line_error, some_camera, some_place

OUT = Path("build/bench-vision.json")
CLEAN = 0.0
REPEATS = 60


def main(pictures: int) -> None:
    cv2.setNumThreads(1)
    result = {"ms": times(), "noise": noise(pictures)}
    for name, ms in result["ms"].items():
        print(f"{name:26s} median {ms['median']:6.2f} ms   p99 {ms['p99']:6.2f} ms")
    for name, figures in result["noise"].items():
        print(f"{name:26s} " + "   ".join(f"{key} {value:.4g}" for key, value in figures.items()))
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def times() -> dict[str, dict[str, float]]:
    """Wall time on one core, 5 MP pictures with texture."""
    rng = np.random.default_rng(1)
    view, held = base_view(rng, place=some_place(rng)), battery_view(rng, place=some_place(rng))
    seen = view.base()
    plate = Scene(60.0, placed(dot_plate(PlateDrawing()), Place(-4.8, -1.6, 3.0)))
    scenes = {
        "render a base": (Scene(45.0, placed(base(BaseDrawing()), Place(0.2, 0.1, 0.5))), view.optics),
        "render a battery corner": (Scene(40.0, placed(battery(BatteryDrawing()), Place(0.2, 0.1, 0.5))), held.optics),
        "render a dot plate": (plate, view.optics),
    }
    timed = {
        "find_base": timing(view.base),
        "find_battery": timing(held.battery),
        "annotate": timing(lambda: annotate(view.pixels, seen, view.features, "unit 17 base")),
    }
    for name, (scene, optics) in scenes.items():
        timed[name] = timing(lambda s=scene, o=optics: render(s, o, rng))
    return timed


def timing(work: Callable[[], object]) -> dict[str, float]:
    for _ in range(3):
        work()
    spent = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        work()
        spent.append(1e3 * (time.perf_counter() - start))
    return {"median": float(np.median(spent)), "p99": float(np.quantile(spent, 0.99))}


def noise(pictures: int) -> dict[str, dict[str, float]]:
    """Errors over random poses, mountings and blurs, with the bound of each picture beside them."""
    rng = np.random.default_rng(2)
    errors: dict[str, list[tuple[float, float]]] = {
        name: [] for name in ("hole um", "line um", "angle mdeg", "corner um")
    }
    for _ in range(pictures):
        camera = replace(some_camera(rng), noise=float(rng.uniform(2.0, 5.0)))
        measure_base(base_view(rng, camera, some_place(rng), texture=CLEAN), errors)
        level = replace(camera, turn_deg=float(rng.uniform(-3.0, 3.0)))
        measure_battery(battery_view(rng, level, some_place(rng), texture=CLEAN), errors)
    return {name: summary(np.array(pairs)) for name, pairs in errors.items()}


def measure_base(view: View, errors: dict[str, list[tuple[float, float]]]) -> None:
    seen = view.base()
    rim = 2.0 * math.pi * seen.circle.radius_px
    bound = math.sqrt(2.0 / (information(view.optics, seen.circle.contrast) * rim)) * UM_PER_PX
    for found, true in zip(seen.circle.centre, view.truth[0], strict=True):
        errors["hole um"].append(((found - true) * UM_PER_PX, bound))
    offset, turn = line_error(seen.edge, *view.truth[1:])
    length, known = math.dist(seen.edge.start, seen.edge.end) + 16.0, information(view.optics, seen.edge.contrast)
    errors["line um"].append((offset * UM_PER_PX, UM_PER_PX / math.sqrt(known * length)))
    errors["angle mdeg"].append((turn * 1e3, 1e3 * math.degrees(math.sqrt(12.0 / (known * length**3)))))


def measure_battery(view: View, errors: dict[str, list[tuple[float, float]]]) -> None:
    seen = view.battery()
    variance = 0.0
    for edge in (seen.edge_1, seen.edge_2):
        length, known = math.dist(edge.start, edge.end) + 16.0, information(view.optics, edge.contrast)
        lever = math.dist(seen.corner, ((edge.start.u + edge.end.u) / 2, (edge.start.v + edge.end.v) / 2))
        variance += (1.0 + 12.0 * (lever / length) ** 2) / (known * length)
    for found, true in zip(seen.corner, view.truth[0], strict=True):
        errors["corner um"].append(((found - true) * UM_PER_PX, math.sqrt(variance / 2.0) * UM_PER_PX))


def information(optics: Optics, contrast: float) -> float:
    """Of one pixel of edge length about its offset: contrast^2 / (2 sqrt(pi) blur noise^2), 8-bit rounding included."""
    blur = math.hypot(optics.blur_px, math.sqrt(1.0 / 12.0))
    return contrast**2 / (2.0 * math.sqrt(math.pi) * blur * (optics.noise**2 + 1.0 / 12.0))


def summary(pairs: np.ndarray) -> dict[str, float]:
    error, bound = pairs[:, 0], pairs[:, 1]
    rms = float(np.sqrt(np.mean(error**2)))
    return {
        "rms": rms,
        "worst": float(np.abs(error).max()),
        "mean": float(error.mean()),
        "ratio to the bound": float(rms / np.sqrt(np.mean(bound**2))),
    }


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 60)
