"""Pictures with too little in them, and pictures in a bad light."""

from dataclasses import replace

import cv2
import numpy as np

from simulators.render import Disks, Polygon, Scene, Shape, render
from tests.hostile_shown import Hostile, either_way, finder_for, plain_camera, some_corner
from tests.vision_regimes import IDEAL, base_case, battery_case, lit
from tests.vision_scenes import base_view, battery_view, some_place


def covered(rng: np.random.Generator) -> Hostile:
    """Most of the hole's rim, or of the edge, is hidden."""
    if rng.random() < 0.5:
        y = rng.uniform(-1.5, 3.2)
        lid = Polygon(np.array([[-4.5, -4.5], [4.5, -4.5], [4.5, y], [-4.5, y]]), float(rng.uniform(60.0, 200.0)))
    else:
        left = rng.uniform(-7.0, 0.0)
        right = left + rng.uniform(9.5, 14.0)
        lid = Polygon(np.array([[left, 4.5], [right, 4.5], [right, 7.0], [left, 7.0]]), float(rng.uniform(20.0, 200.0)))
    return Hostile("covered", base_view(rng, plain_camera(rng), some_place(rng), over=[lid]), "base", True)


def cut_off(rng: np.random.Generator) -> Hostile:
    """The part is only partly in the picture."""
    view = (
        base_view(rng, plain_camera(rng), some_place(rng))
        if rng.random() < 0.5
        else battery_view(rng, plain_camera(rng), some_place(rng), some_corner(rng))
    )
    height, width = view.pixels.shape
    shift = np.array([either_way(rng, 0.25, 0.6) * width, either_way(rng, 0.25, 0.6) * height]).astype(int)
    pixels = np.full_like(view.pixels, 45)
    rows, columns = (slice(max(0, s), min(n, n + s)) for s, n in ((shift[1], height), (shift[0], width)))
    back = tuple(slice(max(0, -s), min(n, n - s)) for s, n in ((shift[1], height), (shift[0], width)))
    pixels[rows, columns] = view.pixels[back]
    return Hostile("cut off", view._replace(pixels=pixels), finder_for(view), False)


def badly_lit(rng: np.random.Generator) -> Hostile:
    exposure = float(rng.choice([rng.uniform(0.0, 0.15), rng.uniform(2.2, 4.0)]))
    camera = replace(plain_camera(rng), exposure=exposure)
    name = "dark" if exposure < 1.0 else "over-exposed"
    if rng.random() < 0.5:
        return Hostile(name, base_view(rng, camera, some_place(rng)), "base", True)
    return Hostile(name, battery_view(rng, camera, some_place(rng), some_corner(rng)), "battery", True)


def blurred(rng: np.random.Generator) -> Hostile:
    case, sigma = base_case(rng, IDEAL) if rng.random() < 0.5 else battery_case(rng, IDEAL), rng.uniform(3.5, 12.0)
    soft = np.asarray(cv2.GaussianBlur(case.view.pixels, (0, 0), sigma), np.uint8)
    return Hostile("blurred", case.view._replace(pixels=soft), finder_for(case.view), True)


def shaken(rng: np.random.Generator) -> Hostile:
    """Two exposures on top of each other: the robot had not settled."""
    place = some_place(rng)
    moved = place._replace(x_mm=place.x_mm + either_way(rng, 0.07, 0.3), y_mm=place.y_mm + either_way(rng, 0.07, 0.3))
    camera = plain_camera(rng)
    one, two = base_view(rng, camera, place), base_view(rng, camera, moved)
    pixels = ((one.pixels.astype(np.uint16) + two.pixels) // 2).astype(np.uint8)
    return Hostile("shaken", one._replace(pixels=pixels), "base", False)


def empty(rng: np.random.Generator) -> Hostile:
    view = base_view(rng, plain_camera(rng)) if rng.random() < 0.5 else battery_view(rng, plain_camera(rng))
    finder = finder_for(view)
    pixels = render(Scene(float(rng.uniform(5.0, 120.0)), []), view.optics, rng)
    return Hostile("empty", view._replace(pixels=pixels), finder, False)


def texture(rng: np.random.Generator) -> Hostile:
    """A rough surface, spots and scratches, but no part."""
    view = base_view(rng, plain_camera(rng)) if rng.random() < 0.5 else battery_view(rng, plain_camera(rng))
    finder = finder_for(view)
    square = np.array([[-40.0, -60.0], [40.0, -60.0], [40.0, 60.0], [-40.0, 60.0]])
    spots = view.optics.mm_from_px(rng.uniform((0.0, 0.0), (2592.0, 1944.0), (12, 2)))
    shapes: list[Shape] = [
        Polygon(square, 120.0, texture=2.5),
        Disks(spots, rng.uniform(0.3, 3.0, 12), float(rng.uniform(30.0, 200.0))),
    ]
    return Hostile(
        "texture and spots", view._replace(pixels=render(Scene(120.0, shapes), view.optics, rng)), finder, False
    )


def noise(rng: np.random.Generator) -> Hostile:
    """Random pixels, coarse or fine, or stripes of a broken camera."""
    view = base_view(rng, plain_camera(rng)) if rng.random() < 0.5 else battery_view(rng, plain_camera(rng))
    finder = finder_for(view)
    grain = int(rng.choice([1, 8, 64]))
    small = rng.integers(0, 256, (1944 // grain + 1, 2592 // grain + 1), dtype=np.uint8)
    if rng.random() < 0.3:
        small[:] = small[:, :1]
    pixels = np.repeat(np.repeat(small, grain, axis=0), grain, axis=1)[:1944, :2592]
    return Hostile("noise", view._replace(pixels=np.ascontiguousarray(pixels)), finder, False)


def glared(rng: np.random.Generator) -> Hostile:
    """Large soft light over much of the part."""
    case = base_case(rng, IDEAL) if rng.random() < 0.5 else battery_case(rng, IDEAL)
    finder, pixels = finder_for(case.view), case.view.pixels
    for _ in range(int(rng.integers(2, 5))):
        pixels = lit(
            pixels,
            rng.uniform((0.0, 0.0), pixels.shape[::-1]),
            float(rng.uniform(150.0, 500.0)),
            float(rng.uniform(60.0, 250.0)),
        )
    return Hostile("glare", case.view._replace(pixels=pixels), finder, True)
