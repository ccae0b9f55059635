"""Points and directions in a picture. Pure."""

from __future__ import annotations

import math

from cellctl.geometry import Px


def direction(start: Px, end: Px) -> Px:
    """Unit vector from start to end. Raises ValueError when they are one point."""
    length = math.dist(start, end)
    if length <= 0.0:
        raise ValueError(f"an edge from {start} to {end} has no direction")
    return Px((end.u - start.u) / length, (end.v - start.v) / length)


def ahead(point: Px, along: Px, distance: float) -> Px:
    """The point `distance` px further along a unit vector."""
    return Px(point.u + along.u * distance, point.v + along.v * distance)


def middle(start: Px, end: Px) -> Px:
    """The point half way."""
    return Px((start.u + end.u) / 2, (start.v + end.v) / 2)


def cross(a: Px, b: Px) -> float:
    """Positive when b is to the right of a on the screen (v runs down)."""
    return a.u * b.v - a.v * b.u


def angle_deg(a: Px, b: Px) -> float:
    """From a to b, in the sense from u to v."""
    return math.degrees(math.atan2(cross(a, b), a.u * b.u + a.v * b.v))
