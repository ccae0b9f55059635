"""Shapes of the object plane, in mm, and their outlines as samples with directions. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulators.optics import Points
from simulators.place import Place

Floats: TypeAlias = NDArray[np.float64]
Contour: TypeAlias = tuple[Points, Points]  # samples and directions, (..., k, 2), the inside on the left
SMOOTH_DEG = 8.0  # a vertex that turns less than this is no corner


def _samples(radius_px: float) -> int:
    """Samples of a full circle, so that the parabola between two of them is true to 0.001 px."""
    return 16 * max(3, math.ceil(math.sqrt(radius_px)))


def _circle(centres: Points, radii: Floats, px_per_mm: float) -> Contour:
    """Circles counter-clockwise: samples and directions (n, k, 2)."""
    t = np.linspace(0.0, 2.0 * math.pi, _samples(float(radii.max()) * px_per_mm), endpoint=False)
    out = np.stack([np.cos(t), np.sin(t)], axis=-1)
    points = centres[:, None, :] + radii[:, None, None] * out
    return points, np.broadcast_to(np.stack([-out[:, 1], out[:, 0]], axis=-1), points.shape)


def _turned(place: Place, points: Points) -> Points:
    """Points (n, 2) of a frame that stands at `place`, seen from its parent."""
    t = math.radians(place.t_deg)
    rotation = np.array([[math.cos(t), -math.sin(t)], [math.sin(t), math.cos(t)]])
    return np.asarray(np.asarray(points, float) @ rotation.T + (place.x_mm, place.y_mm))


@dataclass(frozen=True, eq=False)
class Polygon:
    """A filled polygon (n, 2) in mm, either way round; `radius_mm` rounds every vertex that turns noticeably."""

    points: Points
    level: float
    radius_mm: float = 0.0
    texture: float = 0.0  # grey levels, one sigma

    def moved(self, place: Place) -> Polygon:
        """The same polygon on a frame at `place`."""
        return replace(self, points=_turned(place, self.points))

    def contours(self, px_per_mm: float) -> list[Contour]:
        """Its outline; a sharp vertex is sampled twice, with the direction in and the direction out."""
        p = np.asarray(self.points, float)
        x, y = p[:, 0], p[:, 1]
        p = p if np.dot(x, np.roll(y, -1)) > np.dot(y, np.roll(x, -1)) else p[::-1]
        step = np.roll(p, -1, axis=0) - p
        unit = step / np.linalg.norm(step, axis=1, keepdims=True)
        ends = [self._vertex(p[i], unit[i - 1], unit[i], px_per_mm) for i in range(len(p))]
        pairs = [_joined(ends[i], ends[(i + 1) % len(p)], px_per_mm) for i in range(len(p))]
        return [(np.concatenate([q for q, _ in pairs]), np.concatenate([d for _, d in pairs]))]

    def _vertex(self, at: Points, come: Points, go: Points, px_per_mm: float) -> Contour:
        """A vertex: its arc, or the bare point twice."""
        turn = math.atan2(come[0] * go[1] - come[1] * go[0], come @ go)
        if self.radius_mm <= 0.0 or abs(turn) < math.radians(SMOOTH_DEG):
            return np.stack([at, at]), np.stack([come, go])
        cut = self.radius_mm * math.tan(abs(turn) / 2.0)
        left = math.copysign(self.radius_mm, turn) * np.array([-come[1], come[0]])
        n = 2 + math.ceil(_samples(self.radius_mm * px_per_mm) * abs(turn) / (2.0 * math.pi))
        t = np.linspace(0.0, turn, n)[:, None]
        along = np.cos(t) * come + np.sin(t) * np.array([-come[1], come[0]])
        out = np.cos(t) * left + np.sin(t) * np.array([-left[1], left[0]])
        return at - cut * come + left - out, along


def _joined(here: Contour, there: Contour, px_per_mm: float) -> Contour:
    """A vertex's samples and those of the straight way to the next vertex (its first sample left out)."""
    start, end = here[0][-1], there[0][0]
    n = max(1, math.ceil(float(np.linalg.norm(end - start)) * px_per_mm / 128.0))
    way = start + (end - start) * (np.arange(1, n) / n)[:, None]
    return np.concatenate([here[0], way]), np.concatenate([here[1], np.repeat(here[1][-1:], n - 1, axis=0)])


@dataclass(frozen=True, eq=False)
class Disks:
    """Filled circles of one level: centres (n, 2) in mm, radii (n,) in mm."""

    centres: Points
    radii_mm: Floats
    level: float
    texture: float = 0.0

    def moved(self, place: Place) -> Disks:
        """The same disks on a frame at `place`."""
        return replace(self, centres=_turned(place, self.centres))

    def contours(self, px_per_mm: float) -> list[Contour]:
        """Their outlines."""
        return [_circle(np.asarray(self.centres, float), np.asarray(self.radii_mm, float), px_per_mm)]


def disk(centre: tuple[float, float], radius_mm: float, level: float) -> Disks:
    """One filled circle."""
    return Disks(np.array([centre], float), np.array([radius_mm]), level)


@dataclass(frozen=True, eq=False)
class Ring:
    """The area between two circles about one centre; the band should be 0.1 mm wide or wider."""

    centre: tuple[float, float]
    inner_mm: float
    outer_mm: float
    level: float
    texture: float = 0.0

    def moved(self, place: Place) -> Ring:
        """The same ring on a frame at `place`."""
        return replace(self, centre=place.point(*self.centre))

    def contours(self, px_per_mm: float) -> list[Contour]:
        """Its outlines, the inner one clockwise."""
        centre = np.array([self.centre], float)
        points, directions = _circle(centre, np.array([self.inner_mm]), px_per_mm)
        return [_circle(centre, np.array([self.outer_mm]), px_per_mm), (points[:, ::-1], -directions[:, ::-1])]


@dataclass(frozen=True, eq=False)
class Stroke:
    """A thin line along points (n, 2) in mm: a scratch, a seam, print."""

    points: Points
    width_mm: float
    level: float

    def moved(self, place: Place) -> Stroke:
        """The same stroke on a frame at `place`."""
        return replace(self, points=_turned(place, self.points))

    def contours(self, px_per_mm: float) -> list[Contour]:
        """Its centre line, open, every vertex sampled twice."""
        p = np.asarray(self.points, float)
        step = np.diff(p, axis=0)
        n = [max(1, math.ceil(s * px_per_mm / 128.0)) for s in np.linalg.norm(step, axis=1)]
        ways = [p[i] + step[i] * np.linspace(0.0, 1.0, n[i] + 1)[:, None] for i in range(len(n))]
        return [(np.concatenate(ways), np.repeat(step, [k + 1 for k in n], axis=0))]


Shape: TypeAlias = Polygon | Disks | Ring | Stroke


def placed(shapes: Sequence[Shape], place: Place) -> list[Shape]:
    """The shapes of a thing's own frame, seen from the frame in which it stands at `place`."""
    return [shape.moved(place) for shape in shapes]
