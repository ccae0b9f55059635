"""Parts that are not the one that is looked for, or lie where none may lie."""

import math

import numpy as np

from simulators.parts import BaseDrawing
from tests.hostile_shown import Hostile, either_way, plain_camera, some_corner
from tests.vision_regimes import IDEAL, base_case, battery_case
from tests.vision_scenes import EDGE_MM, HOLE_MM, base_view, battery_view, some_place


def wrong_radius(rng: np.random.Generator) -> Hostile:
    drawing = BaseDrawing(hole_radius_mm=HOLE_MM + either_way(rng, 0.10, 0.6))
    return Hostile("wrong radius", base_view(rng, plain_camera(rng), some_place(rng), drawing), "base", False)


def wrong_distance(rng: np.random.Generator) -> Hostile:
    drawing = BaseDrawing(edge_distance_mm=EDGE_MM + either_way(rng, 0.13, 0.8))
    return Hostile("wrong distance", base_view(rng, plain_camera(rng), some_place(rng), drawing), "base", False)


def other_phone(rng: np.random.Generator) -> Hostile:
    drawing = BaseDrawing(hole_radius_mm=2.5, edge_distance_mm=5.0)
    return Hostile("another phone's base", base_view(rng, plain_camera(rng), some_place(rng), drawing), "base", False)


def wrong_camera(rng: np.random.Generator) -> Hostile:
    base, battery = base_case(rng, IDEAL).view, battery_case(rng, IDEAL).view
    if rng.random() < 0.5:
        return Hostile("base shown to camera 2", battery._replace(pixels=base.pixels), "battery", False)
    return Hostile("battery shown to camera 1", base._replace(pixels=battery.pixels), "base", False)


def not_square(rng: np.random.Generator) -> Hostile:
    view = battery_view(rng, plain_camera(rng), some_place(rng), some_corner(rng))
    one, two = view.features
    skew = math.tan(math.radians(either_way(rng, 0.4, 3.0)))
    way = two.end.u - two.start.u, two.end.v - two.start.v
    moved = two._replace(end=type(two.end)(two.end.u - skew * way[1], two.end.v + skew * way[0]))
    return Hostile("corner not square", view._replace(features=(one, moved)), "battery", False)


def too_far(rng: np.random.Generator) -> Hostile:
    place = some_place(rng)._replace(x_mm=either_way(rng, 2.6, 4.0))
    return Hostile("base far away", base_view(rng, plain_camera(rng), place), "base", False)


def turned(rng: np.random.Generator) -> Hostile:
    place = some_place(rng)._replace(t_deg=either_way(rng, 5.0, 20.0))
    if rng.random() < 0.5:
        return Hostile("base turned", base_view(rng, plain_camera(rng), place), "base", True)
    return Hostile("battery turned", battery_view(rng, plain_camera(rng), place, some_corner(rng)), "battery", True)
