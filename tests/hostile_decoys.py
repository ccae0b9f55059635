"""Good parts, and beside their outlines others that could be taken for them."""

import math

import numpy as np

from simulators.render import Polygon, Ring, Shape, disk
from tests.hostile_shown import Hostile, either_way, plain_camera, some_corner
from tests.vision_scenes import EDGE_MM, HOLE_MM, base_view, battery_view, some_place


def decoy_circles(rng: np.random.Generator) -> Hostile:
    over: list[Shape] = []
    for _ in range(int(rng.integers(1, 4))):
        phi, far = rng.uniform(-math.pi, math.pi), rng.uniform(0.3, 5.0)
        radius = HOLE_MM + either_way(rng, 0.15, 1.5)
        over.append(
            Ring((far * math.cos(phi), far * math.sin(phi)), radius - 0.15, radius, float(rng.uniform(20.0, 200.0)))
        )
    return Hostile("decoy circles", base_view(rng, plain_camera(rng), some_place(rng), over=over), "base", True)


def decoy_hole(rng: np.random.Generator) -> Hostile:
    """The true hole is filled; another one, somewhat off, is there."""
    far, phi = rng.uniform(0.3, 1.4), rng.uniform(-math.pi, math.pi)
    at = (far * math.cos(phi), far * math.sin(phi))
    over = [disk((0.0, 0.0), HOLE_MM + 0.3, 130.0), disk(at, HOLE_MM + either_way(rng, 0.12, 0.4), 30.0)]
    return Hostile("decoy hole", base_view(rng, plain_camera(rng), some_place(rng), over=over), "base", False)


def glare_ring(rng: np.random.Generator) -> Hostile:
    at = float(rng.normal(0.0, 0.1)), float(rng.normal(0.0, 0.1))
    width, away = rng.uniform(0.1, 0.5), math.hypot(*at) + rng.uniform(0.03, 0.3)
    inner = HOLE_MM + away if rng.random() < 0.5 else HOLE_MM - away - width  # beside the rim, never over it
    over = [Ring(at, inner, inner + width, float(rng.uniform(180.0, 255.0)))]
    return Hostile("glare ring", base_view(rng, plain_camera(rng), some_place(rng), over=over), "base", True)


def decoy_edges(rng: np.random.Generator) -> Hostile:
    over: list[Shape] = []
    for _ in range(int(rng.integers(1, 4))):
        wide, tilt = rng.uniform(0.1, 0.6), 14.0 * math.tan(math.radians(rng.normal(0.0, 0.5)))
        beside = rng.uniform(0.05, 0.9) + max(0.0, -tilt)
        near = EDGE_MM + (beside if rng.random() < 0.5 else -beside - wide - abs(tilt))  # never over the edge
        left, right = rng.uniform(-9.0, -3.0), rng.uniform(3.0, 9.0)
        outline = np.array([[left, near], [right, near + tilt], [right, near + tilt + wide], [left, near + wide]])
        over.append(Polygon(outline, float(rng.uniform(20.0, 200.0))))
    return Hostile("decoy edges", base_view(rng, plain_camera(rng), some_place(rng), over=over), "base", True)


def decoy_battery_edges(rng: np.random.Generator) -> Hostile:
    corner, over = some_corner(rng), []
    mark = np.array([corner[0] * 26.5, corner[1] * 42.5])
    for _ in range(int(rng.integers(1, 4))):
        wide = rng.uniform(0.1, 0.5)
        inward = -rng.uniform(0.05, 0.9) if rng.random() < 0.5 else wide + rng.uniform(0.05, 1.0)  # never over the edge
        if rng.random() < 0.5:
            x0, y0 = mark[0] + corner[0] * 2.0, mark[1] - corner[1] * inward
            outline = np.array([[x0, y0], [mark[0] - corner[0] * 13.0, y0]])
            far = np.array([0.0, corner[1] * wide])
        else:
            x0, y0 = mark[0] - corner[0] * inward, mark[1] + corner[1] * 2.0
            outline = np.array([[x0, y0], [x0, mark[1] - corner[1] * 9.0]])
            far = np.array([corner[0] * wide, 0.0])
        over.append(Polygon(np.concatenate([outline, outline[::-1] + far]), float(rng.uniform(20.0, 200.0))))
    return Hostile(
        "decoy battery edges", battery_view(rng, plain_camera(rng), some_place(rng), corner, over=over), "battery", True
    )
