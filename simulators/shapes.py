"""Shapes of the object plane, in mm, and their outlines as samples with directions. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulators.optics import PX_PER_MM, Points
from simulators.place import Place

Floats: TypeAlias = NDArray[np.float64]
STRAIGHT_MM = 1.0  # between samples of a straight line, which distortion may bend


class Contour(NamedTuple):
    """Lines of equal length: samples in mm and the directions there (any length), both (lines, k, 2).

    An area lies on the left of its lines, which are closed. Two samples on one spot are a sharp vertex.
    """

    points: Points
    directions: Points


def _samples(radius_mm: float) -> int:
    """Samples of a full circle, so that a parabola between two of them is true to 0.001 px."""
    return 16 * max(3, math.ceil(math.sqrt(radius_mm * PX_PER_MM)))


def _circles(centres: Points, radii: Floats) -> Contour:
    """Circles counter-clockwise."""
    t = np.linspace(0.0, 2.0 * math.pi, _samples(float(radii.max())), endpoint=False)
    out = np.stack([np.cos(t), np.sin(t)], axis=-1)
    points = centres[:, None, :] + radii[:, None, None] * out
    return Contour(points, np.broadcast_to(np.stack([-out[:, 1], out[:, 0]], axis=-1), points.shape))


@dataclass(frozen=True, eq=False)
class Polygon:
    """A filled polygon (n, 2) in mm, either way round; `radius_mm` rounds its vertices, texture is up to 2.5.

    `over`: the plain level of the area inside which it wholly lies. Then edges of that area which are nearer to its
    own than the blur reaches come out right as well.
    """

    points: Points
    level: float
    radius_mm: float = 0.0
    texture: float = 0.0  # grey levels, one sigma
    over: float | None = None

    @cached_property
    def contour(self) -> Contour:
        """Its outline; every vertex is an arc, a sharp one of no length: direction in, direction out."""
        p = np.asarray(self.points, float)
        x, y = p[:, 0], p[:, 1]
        p = p if x @ np.roll(y, -1) > y @ np.roll(x, -1) else p[::-1]
        go = np.roll(p, -1, axis=0) - p
        go /= np.hypot(go[:, 0], go[:, 1])[:, None]
        arcs, along = self._arcs(p, np.roll(go, 1, axis=0), go)
        step = np.roll(arcs[:, 0], -1, axis=0) - arcs[:, -1]
        n = max(1, math.ceil(float(np.abs(step).max()) / STRAIGHT_MM))
        ways = arcs[:, -1:] + step[:, None] * (np.arange(1, n) / n)[:, None]
        directions = np.concatenate([along, np.broadcast_to(go[:, None], ways.shape)], axis=1)
        return Contour(np.concatenate([arcs, ways], axis=1).reshape(1, -1, 2), directions.reshape(1, -1, 2))

    def _arcs(self, vertices: Points, come: Points, go: Points) -> tuple[Points, Points]:
        """The vertices as arcs: samples and directions (n, k, 2)."""
        turn = np.arctan2(come[:, 0] * go[:, 1] - come[:, 1] * go[:, 0], np.sum(come * go, axis=1))
        part = float(np.abs(turn).max()) / (2.0 * math.pi)
        n = 2 + (math.ceil(_samples(self.radius_mm) * part) if self.radius_mm > 0.0 else 0)
        angle = np.linspace(0.0, 1.0, n) * turn[:, None]
        c, s = np.cos(angle)[..., None], np.sin(angle)[..., None]
        side = np.stack([-come[:, 1], come[:, 0]], axis=1)
        bow = np.copysign(self.radius_mm, turn)[:, None, None]
        start = vertices - self.radius_mm * np.tan(np.abs(turn) / 2.0)[:, None] * come
        points = start[:, None] + bow * (s * come[:, None] + (1.0 - c) * side[:, None])
        return points, c * come[:, None] + s * side[:, None]


@dataclass(frozen=True, eq=False)
class Disks:
    """Filled circles of one level: centres (n, 2) in mm, radii (n,) in mm."""

    centres: Points
    radii_mm: Floats
    level: float
    texture: float = 0.0

    @cached_property
    def contour(self) -> Contour:
        """Their outlines."""
        return _circles(np.asarray(self.centres, float), np.asarray(self.radii_mm, float))


def disk(centre: tuple[float, float], radius_mm: float, level: float) -> Disks:
    """One filled circle."""
    return Disks(np.array([centre], float), np.array([radius_mm]), level)


@dataclass(frozen=True, eq=False)
class Ring:
    """The area between two circles about one centre; it should be 0.1 mm wide or wider."""

    centre: tuple[float, float]
    inner_mm: float
    outer_mm: float
    level: float
    texture: float = 0.0

    @cached_property
    def contour(self) -> Contour:
        """Its outlines, the inner one clockwise."""
        points, directions = _circles(np.array([self.centre] * 2, float), np.array([self.outer_mm, self.inner_mm]))
        return Contour(
            np.stack([points[0], points[1, ::-1]]),
            np.stack([directions[0], -directions[1, ::-1]]),
        )


@dataclass(frozen=True, eq=False)
class Stroke:
    """A thin line along points (n, 2) in mm: a scratch, a seam, print; up to 0.1 mm wide."""

    points: Points
    width_mm: float
    level: float
    texture: float = 0.0

    @cached_property
    def contour(self) -> Contour:
        """Its middle line, open, every vertex sampled twice."""
        p = np.asarray(self.points, float)
        step = np.diff(p, axis=0)
        n = max(1, math.ceil(float(np.abs(step).max()) / STRAIGHT_MM))
        ways = p[:-1, None] + step[:, None] * np.linspace(0.0, 1.0, n + 1)[:, None]
        directions = np.broadcast_to(step[:, None], ways.shape)
        return Contour(ways.reshape(1, -1, 2), directions.reshape(1, -1, 2))


Plain: TypeAlias = Polygon | Disks | Ring | Stroke


@dataclass(frozen=True, eq=False)
class Placed:
    """A shape of a frame that stands at `place`."""

    shape: Plain
    place: Place

    @property
    def contour(self) -> Contour:
        """The shape's outline seen from the parent."""
        t = math.radians(self.place.t_deg)
        rotation = np.array([[math.cos(t), math.sin(t)], [-math.sin(t), math.cos(t)]])
        points, directions = self.shape.contour
        return Contour(points @ rotation + (self.place.x_mm, self.place.y_mm), directions @ rotation)


Shape: TypeAlias = Plain | Placed


def placed(shapes: Sequence[Shape], place: Place) -> list[Shape]:
    """The shapes of a thing's own frame, seen from the frame in which it stands at `place`."""
    return [Placed(s.shape, place @ s.place) if isinstance(s, Placed) else Placed(s, place) for s in shapes]
