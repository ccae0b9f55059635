"""The true camera: a telecentric lens before a flat sensor, tilted, turned, mirrored and distorted as it is. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Points: TypeAlias = NDArray[np.float64]  # (..., 2): x and y in mm, or u and v in px
PX_PER_MM = 136.36


@dataclass(frozen=True)
class Light:
    """Uneven illumination, as parts of the full level: gained towards right and bottom, lost towards the corners."""

    slope_u: float = 0.02
    slope_v: float = -0.015
    bowl: float = 0.03


@dataclass(frozen=True, eq=False)
class Optics:
    """The true camera: undistorted px = matrix @ mm + offset; px = undistorted + (undistorted - centre) * k1 * r^2."""

    matrix: Points  # (2, 2), px per mm
    offset_px: Points  # (2,)
    width: int = 2592
    height: int = 1944
    k1: float = 0.0  # 1 / px^2
    centre_px: Points = field(default_factory=lambda: np.array([1295.5, 971.5]))  # of the distortion
    blur_px: float = 1.1  # sigma of the Gaussian point spread
    noise: float = 2.5  # grey levels, one sigma
    black: float = 6.0  # grey level of no light
    light: Light = Light()
    lean: tuple[float, float] = (0.0, 0.0)  # mm by which a thing seems to be off per mm that it is nearer than in focus

    @classmethod
    def aimed(
        cls,
        at_mm: tuple[float, float],
        *,
        looks: Literal["down", "up"],
        turn_deg: float = 0.0,
        px_per_mm: float = PX_PER_MM,
        width: int = 2592,
        height: int = 1944,
    ) -> Optics:
        """A camera that has `at_mm` in the middle of its picture; at turn 0, u is +X and v is -Y (down) or +Y (up)."""
        c, s = math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
        matrix = px_per_mm * np.array([[c, s], [s, -c]] if looks == "down" else [[c, s], [-s, c]])
        centre = np.array([(width - 1) / 2, (height - 1) / 2])
        return cls(matrix, centre - matrix @ at_mm, width, height, centre_px=centre)

    @property
    def px_per_mm(self) -> float:
        """Mean scale."""
        return math.sqrt(abs(float(np.linalg.det(self.matrix))))

    def px_from_mm(self, points: Points) -> Points:
        """Where points (..., 2) of the object plane appear in the picture."""
        q = np.asarray(points, float) @ self.matrix.T + (self.offset_px - self.centre_px)
        q *= (1.0 + self.k1 * (q[..., 0] ** 2 + q[..., 1] ** 2))[..., None]
        q += self.centre_px
        return np.asarray(q)

    def mm_from_px(self, points: Points) -> Points:
        """The exact inverse of `px_from_mm`, by Newton's method on the radius."""
        p = np.asarray(points, float) - self.centre_px
        seen = np.linalg.norm(p, axis=-1, keepdims=True)
        r = seen.copy()
        for _ in range(5):
            r -= (r + self.k1 * r**3 - seen) / (1.0 + 3.0 * self.k1 * r * r)
        p *= r / np.where(seen > 0.0, seen, 1.0)
        return np.asarray((p + self.centre_px - self.offset_px) @ np.linalg.inv(self.matrix).T)

    def traced(self, points: Points, directions: Points) -> tuple[Points, Points]:
        """`px_from_mm` of points, and how directions in mm at these points run in the picture (px per mm)."""
        q = points @ self.matrix.T + (self.offset_px - self.centre_px)
        t = directions @ self.matrix.T
        grown = (1.0 + self.k1 * (q[..., 0] ** 2 + q[..., 1] ** 2))[..., None]
        turned = (2.0 * self.k1 * (q[..., 0] * t[..., 0] + q[..., 1] * t[..., 1]))[..., None]
        return q * grown + self.centre_px, t * grown + q * turned
