"""A telecentric camera that looks at one plane: affine map plus one radial distortion term.

distorted = undistorted + (undistorted - centre) * k1 * r^2,  undistorted = A @ mm + b  (px; r from the centre).
For a camera on the tool mm are in the tool frame, for a fixed camera in the robot frame, so that no separate
"camera in mm" frame exists. The model: Steger's and Ulrich's telecentric area camera reduced to one plane.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellctl.geometry import Mm, Px

FloatArray = NDArray[np.float64]
Pair = tuple[float, float]

SCALE_RANGE_PX_PER_MM = (5.0, 5000.0)
LEAST_SQUEEZE = 0.8  # ratio of the two scales; a plane tilted by 37 deg has 0.8
MOST_K1_PER_PX2 = 5e-9  # 1.3 % at 1,620 px; telecentric lenses stay below 0.1 %
USABLE_FOLD = 0.9  # part of the radius where a barrel distortion folds over that may be used


@dataclass(frozen=True, slots=True)
class PlaneMap:
    """Maps mm of one plane to px of one camera and back, exactly (to 1e-9).

    Raises ValueError for values that are not finite or that no camera of such a cell can have.
    """

    matrix_px_per_mm: tuple[Pair, Pair]
    offset_px: Pair
    k1_per_px2: float
    distortion_centre_px: Pair

    def __post_init__(self) -> None:
        numbers = [*self.matrix_px_per_mm[0], *self.matrix_px_per_mm[1], *self.offset_px]
        numbers += [self.k1_per_px2, *self.distortion_centre_px]
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError(f"plane map: every number must be finite (got {numbers})")
        smaller, larger = self._scales()
        low, high = SCALE_RANGE_PX_PER_MM
        if not (low <= smaller <= larger <= high):
            raise ValueError(
                f"plane map: scale must be {low:g} to {high:g} px/mm (got {smaller:.4g} and {larger:.4g}); "
                "check the board's pitch and the units"
            )
        if smaller < LEAST_SQUEEZE * larger:
            raise ValueError(
                f"plane map: the two scales {smaller:.4g} and {larger:.4g} px/mm differ too much for one camera"
            )
        if abs(self.k1_per_px2) > MOST_K1_PER_PX2:
            raise ValueError(f"plane map: k1 must be within +-{MOST_K1_PER_PX2:g} per px^2 (got {self.k1_per_px2:g})")

    @classmethod
    def from_arrays(cls, matrix: ArrayLike, offset: ArrayLike, k1: float, centre: ArrayLike) -> PlaneMap:
        """The same from arrays: (2, 2) px/mm, (2,) px, per px^2, (2,) px."""
        (a, b), (c, d) = np.asarray(matrix, float).tolist()
        (e, f), (g, h) = np.asarray(offset, float).tolist(), np.asarray(centre, float).tolist()
        return cls(((a, b), (c, d)), (e, f), float(k1), (g, h))

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> PlaneMap:
        """Read what `as_dict` wrote. Raises ValueError for a missing, unknown or wrong entry."""
        wanted = {"matrix_px_per_mm": (2, 2), "offset_px": (2,), "k1_per_px2": (), "distortion_centre_px": (2,)}
        if set(table) != set(wanted):
            raise ValueError(f"plane map: keys must be {sorted(wanted)} (got {sorted(map(str, table))})")
        values = [_numbers(key, table[key], shape) for key, shape in wanted.items()]
        return cls.from_arrays(values[0], values[1], float(values[2]), values[3])

    def as_dict(self) -> dict[str, Any]:
        """Only floats and lists, for a file; `from_dict` reads it back without loss."""
        return {
            "matrix_px_per_mm": [list(row) for row in self.matrix_px_per_mm],
            "offset_px": list(self.offset_px),
            "k1_per_px2": self.k1_per_px2,
            "distortion_centre_px": list(self.distortion_centre_px),
        }

    @property
    def matrix(self) -> FloatArray:
        """A as (2, 2) array, px/mm."""
        return np.array(self.matrix_px_per_mm)

    @property
    def mm_per_px(self) -> float:
        """Mean scale (square root of the area ratio)."""
        (a, b), (c, d) = self.matrix_px_per_mm
        return 1.0 / math.sqrt(abs(a * d - b * c))

    @property
    def rotation_deg(self) -> float:
        """Direction of the picture's u axis in the mm frame, counter-clockwise from +x."""
        (a, b), (c, d) = self.matrix_px_per_mm
        v_sign = -1.0 if self.mirrored() else 1.0
        return math.degrees(math.atan2(b - v_sign * c, a + v_sign * d))

    @property
    def squeeze(self) -> float:
        """Smaller scale over larger one: 1 when the camera looks squarely at the plane with square pixels."""
        smaller, larger = self._scales()
        return smaller / larger

    @property
    def tilt_deg(self) -> float:
        """Tilt of the optical axis against the plane if it alone causes the squeeze; its sign cannot be seen."""
        return math.degrees(math.acos(min(1.0, self.squeeze)))

    def mirrored(self) -> bool:
        """True for a camera that looks down at the plane (u right, v down, plane seen from above)."""
        (a, b), (c, d) = self.matrix_px_per_mm
        return a * d - b * c < 0

    def px_from_mm(self, points_mm: ArrayLike) -> FloatArray:
        """Where points (N, 2) of the plane appear in the picture, (N, 2). ValueError if far outside the lens."""
        undistorted = _points(points_mm) @ self.matrix.T + np.array(self.offset_px)
        return distort(undistorted, self.k1_per_px2, np.array(self.distortion_centre_px))

    def mm_from_px(self, points_px: ArrayLike) -> FloatArray:
        """Which points (N, 2) of the plane appear at these px, (N, 2). ValueError if far outside the lens."""
        centre = np.array(self.distortion_centre_px)
        undistorted = undistort(_points(points_px), self.k1_per_px2, centre)
        return np.linalg.solve(self.matrix, (undistorted - np.array(self.offset_px)).T).T

    def px_at(self, point: Mm) -> Px:
        """One point, mm to px."""
        u, v = self.px_from_mm([point])[0].tolist()
        return Px(u, v)

    def mm_at(self, point: Px) -> Mm:
        """One point, px to mm."""
        x_mm, y_mm = self.mm_from_px([point])[0].tolist()
        return Mm(x_mm, y_mm)

    def _scales(self) -> Pair:
        """Singular values of A, the smaller first."""
        (a, b), (c, d) = self.matrix_px_per_mm
        turn, mirror = math.hypot(a + d, b - c) / 2, math.hypot(a - d, b + c) / 2
        return abs(turn - mirror), turn + mirror


def distort(undistorted_px: FloatArray, k1: float, centre: FloatArray) -> FloatArray:
    """Apply the lens to points (..., 2). Raises ValueError beyond the radius where the model folds over."""
    away = undistorted_px - centre
    radius2 = (away**2).sum(-1, keepdims=True)
    _check_radius(radius2, _usable_radius(k1), k1)
    distorted: FloatArray = undistorted_px + away * (k1 * radius2)
    return distorted


def undistort(distorted_px: FloatArray, k1: float, centre: FloatArray) -> FloatArray:
    """Undo `distort`: solve s + k1 s^3 = r along the radius by Newton, which is monotone there."""
    away = distorted_px - centre
    radius2 = (away**2).sum(-1, keepdims=True)
    _check_radius(radius2, _usable_radius(k1) * (1 - USABLE_FOLD**2 / 3), k1)  # as far as `distort` can reach
    ratio = np.ones_like(radius2)  # s / r
    for _ in range(30):
        step = (ratio + k1 * radius2 * ratio**3 - 1) / (1 + 3 * k1 * radius2 * ratio**2)
        ratio -= step
        if np.all(np.abs(step) < 1e-15):
            break
    undistorted: FloatArray = centre + away * ratio
    return undistorted


def _usable_radius(k1: float) -> float:
    return USABLE_FOLD / math.sqrt(-3 * k1) if k1 < 0 else math.inf  # the fold is where 1 + 3 k1 r^2 = 0


def _check_radius(radius2: FloatArray, limit_px: float, k1: float) -> None:
    worst = math.sqrt(float(radius2.max(initial=0.0)))
    if not worst <= limit_px:
        raise ValueError(
            f"plane map: a point lies {worst:.0f} px from the distortion centre, but a lens with k1 = {k1:g} "
            f"is described up to {limit_px:.0f} px only"
        )


def _points(points: ArrayLike) -> FloatArray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"plane map: points must be an (N, 2) array (got shape {array.shape})")
    if not np.isfinite(array).all():
        raise ValueError("plane map: points must be finite")
    return array


def _numbers(key: str, value: object, shape: tuple[int, ...]) -> FloatArray:
    flat = [value]
    for _ in shape:
        flat = [item for inner in flat for item in (inner if isinstance(inner, (list, tuple)) else [None])]
    right = all(isinstance(item, (int, float)) and not isinstance(item, bool) for item in flat)
    if not right or len(flat) != math.prod(shape):
        raise ValueError(f"plane map: {key} must be numbers of shape {shape} (got {value!r})")
    return np.array(flat, dtype=np.float64).reshape(shape)
