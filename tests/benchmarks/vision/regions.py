"""What every method of the comparison is given: the region that can hold the feature, and where it is expected."""

import math
from typing import NamedTuple

import numpy as np

from cellctl.vision import ExpectedCircle, ExpectedEdge
from tests.vision_scenes import View

SEARCH_MM, SEARCH_DEG = 1.5, 2.0
MARGIN_PX = 24.0
Pair = tuple[float, float]


class CircleRegion(NamedTuple):
    """A piece of the picture, the place of its first pixel, and the expected radius."""

    pixels: np.ndarray
    left: int
    top: int
    radius_px: float


class LineRegion(NamedTuple):
    """A piece of the picture, the place of its first pixel, and the expected direction (unit vector)."""

    pixels: np.ndarray
    left: int
    top: int
    way: Pair


class Straight(NamedTuple):
    """A line through a point in a direction (any length, either sense)."""

    point: Pair
    way: Pair


def circle_region(view: View) -> CircleRegion:
    """The square in which the hole can lie."""
    circle = view.features[0]
    assert isinstance(circle, ExpectedCircle)
    far = circle.radius_px + SEARCH_MM * view.optics.px_per_mm + MARGIN_PX
    pixels, left, top = _cut(view.pixels, circle.centre, circle.centre, far)
    return CircleRegion(pixels, left, top, circle.radius_px)


def line_region(view: View, edge: ExpectedEdge, skip_px: float, search_mm: float = SEARCH_MM) -> LineRegion:
    """The box in which the edge can lie; the first `skip_px` of a battery's edge are its rounded corner."""
    length = math.dist(edge.start, edge.end)
    way = ((edge.end.u - edge.start.u) / length, (edge.end.v - edge.start.v) / length)
    start = (edge.start.u + skip_px * way[0], edge.start.v + skip_px * way[1])
    far = search_mm * view.optics.px_per_mm + 0.5 * length * math.tan(math.radians(SEARCH_DEG)) + MARGIN_PX
    across = (abs(way[1]) * far + MARGIN_PX, abs(way[0]) * far + MARGIN_PX)
    pixels, left, top = _cut(view.pixels, start, edge.end, across)
    return LineRegion(pixels, left, top, way)


def _cut(pixels: np.ndarray, one: Pair, two: Pair, far: float | Pair) -> tuple[np.ndarray, int, int]:
    du, dv = far if isinstance(far, tuple) else (far, far)
    height, width = pixels.shape
    left, right = max(0, int(min(one[0], two[0]) - du)), min(width, int(max(one[0], two[0]) + du) + 1)
    top, bottom = max(0, int(min(one[1], two[1]) - dv)), min(height, int(max(one[1], two[1]) + dv) + 1)
    return np.ascontiguousarray(pixels[top:bottom, left:right]), left, top
