"""How far two maps of the same camera lie apart, at the middle and at the corners of its picture."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellctl.calibration.plane_map import PlaneMap


class Difference(NamedTuple):
    """What one map says of a place in the picture minus what the other says, um in the maps' plane."""

    place: str
    dx_um: float
    dy_um: float

    @property
    def um(self) -> float:
        """Its length."""
        return math.hypot(self.dx_um, self.dy_um)


def differences(this: PlaneMap, other: PlaneMap, picture_px: tuple[int, int]) -> tuple[Difference, ...]:
    """`this` minus `other` at five places. Raises ValueError for a place beyond a lens model's range."""
    right, bottom = picture_px[0] - 1, picture_px[1] - 1
    places = {
        "middle": (right / 2, bottom / 2),
        "top left": (0, 0),
        "top right": (right, 0),
        "bottom left": (0, bottom),
        "bottom right": (right, bottom),
    }
    points = np.array(list(places.values()), dtype=np.float64)
    away_um = (this.mm_from_px(points) - other.mm_from_px(points)) * 1000
    return tuple(Difference(place, *away) for place, away in zip(places, away_um.tolist(), strict=True))


def worst_um(found: tuple[Difference, ...]) -> float:
    """The largest of them."""
    return max(difference.um for difference in found)
