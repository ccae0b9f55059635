"""Folders of picture files of rendered parts, as an engineer would save them from the cameras."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from simulators.parts import BaseDrawing
from simulators.place import Place
from simulators.render import Shape
from tests.vision_scenes import BASE, Camera, base_view, battery_view

MM_PER_PX = 1.0 / 136.36
FEW = 2
DOWN, UP = Camera(), Camera(looks="up")


def save(path: Path, pixels: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), pixels, [cv2.IMWRITE_PNG_COMPRESSION, 1] if path.suffix == ".png" else [])
    return path


def places(count: int, seed: int, within_mm: float = 0.4, within_deg: float = 0.5) -> list[Place]:
    rng = np.random.default_rng([seed, 1])
    drawn = rng.uniform(-1.0, 1.0, (count, 3)) * (within_mm, within_mm, within_deg)
    return [Place(*map(float, row)) for row in drawn]


def base_files(
    folder: Path,
    count: int = FEW,
    *,
    seed: int = 1,
    drawing: BaseDrawing = BASE,
    camera: Camera = DOWN,
    over: Sequence[Shape] = (),
) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    views = [
        base_view(np.random.default_rng([seed, n]), camera, place, drawing, over)
        for n, place in enumerate(places(count, seed))
    ]
    return [save(folder / f"base-{n}.png", view.pixels) for n, view in enumerate(views)]


def battery_files(
    folder: Path,
    count: int = FEW,
    *,
    seed: int = 2,
    corner: tuple[int, int] = (-1, -1),
    camera: Camera = UP,
) -> list[Path]:
    folder.mkdir(parents=True, exist_ok=True)
    views = [
        battery_view(np.random.default_rng([seed, n]), camera, place, corner)
        for n, place in enumerate(places(count, seed))
    ]
    return [save(folder / f"battery-{n}.tif", view.pixels) for n, view in enumerate(views)]
