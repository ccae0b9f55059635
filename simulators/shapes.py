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
STRAIGHT_PX = 128.0  # between samples of a straight line, which distortion may bend


def _samples(radius_px: float) -> int:
    """Samples of a full circle, so that the parabola between two of them is true to 0.001 px."""
    return 16 * max(3, math.ceil(math.sqrt(radius_px)))


def _circle(centres: Points, radii: Floats, px_per_mm: float) -> Contour:
    """Circles counter-clockwise: samples and directions (n, k, 2)."""
    t = np.linspace(0.0, 2.0 * math.pi, _samples(float(radii.max()) * px_per_mm), endpoint=False)
    out = np.stack([np.cos(t), np.sin(t)], axis=-1)
    points = centres[:, None, :] + radii[:, None, None] * out
    return points, np.broadcast_to(np.stack([-out[:, 1], out[:, 0]], axis=-1), points.shape)


@dataclass(frozen=True, eq=False)
class Polygon:
    """A filled polygon (n, 2) in mm, either way round; `radius_mm` rounds its vertices."""

    points: Points
    level: float
    radius_mm: float = 0.0
    texture: float = 0.0  # grey levels, one sigma

    @cached_property
    def contour(self) -> Contour:
        """Its outline; every vertex is an arc, a sharp one of no length: direction in, direction out."""
        p = np.asarray(self.points, float)
        x, y = p[:, 0], p[:, 1]
        p = p if x @ np.roll(y, -1) > y @ np.roll(x, -1) else p[::-1]
        go = np.roll(p, -1, axis=0) - p
        go /= np.hypot(go[:, 0], go[:, 1])[:, None]
        come = np.roll(go, 1, axis=0)
        turn = np.arctan2(come[:, 0] * go[:, 1] - come[:, 1] * go[:, 0], np.einsum("ij,ij->i", come, go))
        arcs, along = self._arcs(p, come, turn, px_per_mm)
        step = np.roll(arcs[:, 0], -1, axis=0) - arcs[:, -1]
        n = max(1, math.ceil(float(np.abs(step).max()) * px_per_mm / STRAIGHT_PX))
        ways = arcs[:, -1:] + step[:, None] * (np.arange(1, n) / n)[:, None]
        points = np.concatenate([arcs, ways], axis=1)
        directions = np.concatenate([along, np.broadcast_to(go[:, None], ways.shape)], axis=1)
        return [(points.reshape(-1, 2), directions.reshape(-1, 2))]

    def _arcs(self, vertices: Points, come: Points, turn: Floats, px_per_mm: float) -> Contour:
        """The vertices as arcs: samples and directions (n, k, 2)."""
        part = float(np.abs(turn).max()) / (2.0 * math.pi)
        n = 2 + (math.ceil(_samples(self.radius_mm * px_per_mm) * part) if self.radius_mm > 0.0 else 0)
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

    @cached_property
    def contour(self) -> Contour:
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

    @cached_property
    def contour(self) -> Contour:
        """Its centre line, open, every vertex sampled twice."""
        p = np.asarray(self.points, float)
        step = np.diff(p, axis=0)
        n = [max(1, math.ceil(s * px_per_mm / STRAIGHT_PX)) for s in np.linalg.norm(step, axis=1)]
        ways = [p[i] + step[i] * np.linspace(0.0, 1.0, n[i] + 1)[:, None] for i in range(len(n))]
        return [(np.concatenate(ways), np.repeat(step, [k + 1 for k in n], axis=0))]


Shape: TypeAlias = Polygon | Disks | Ring | Stroke


def placed(shapes: Sequence[Shape], place: Place) -> list[Shape]:
    """The shapes of a thing's own frame, seen from the frame in which it stands at `place`."""
    return [shape.moved(place) for shape in shapes]
