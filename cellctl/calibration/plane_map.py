"""A camera that looks at one plane, through a telecentric or a pinhole lens.

    flat = (A @ mm + b) / (1 + g @ mm),  px = centre + distort(flat - centre)      (distort: `distortion.py`, in px)

Without perspective, g = 0, this is Steger's and Ulrich's telecentric area camera reduced to one plane. A pinhole
camera at a fixed height over a plane is exactly this as well; its focal length is not needed and cannot be seen.
For a camera on the tool mm are in the tool frame, for a fixed camera in the robot frame, so that no separate
"camera in mm" frame exists.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellctl.calibration import distortion
from cellctl.calibration.disks import disk_centres
from cellctl.geometry import Mm, Px

FloatArray = NDArray[np.float64]
Pair = tuple[float, float]
Lens = Literal["telecentric", "pinhole"]

SCALE_RANGE_PX_PER_MM = (5.0, 5000.0)
LEAST_SQUEEZE = 0.8  # ratio of the two scales; a plane tilted by 37 deg has 0.8
MOST_BENT = 0.3  # part of the radius that one term of the distortion may amount to at the picture's corner
SHAPES: dict[str, tuple[int, ...]] = {
    "matrix_px_per_mm": (2, 2),
    "offset_px": (2,),
    "k1_per_px2": (),
    "distortion_centre_px": (2,),
    "perspective_per_mm": (2,),
    "k2_per_px4": (),
    "k3_per_px6": (),
    "p1_per_px": (),
    "p2_per_px": (),
}
ALWAYS = ("matrix_px_per_mm", "offset_px", "k1_per_px2", "distortion_centre_px")


@dataclass(frozen=True, slots=True)
class PlaneMap:
    """Maps mm of one plane to px of one camera and back, exactly (to 1e-9).

    Raises ValueError for values that are not finite or that no camera of such a cell can have.
    """

    matrix_px_per_mm: tuple[Pair, Pair]  # A
    offset_px: Pair  # b
    k1_per_px2: float
    distortion_centre_px: Pair  # about the picture's centre
    perspective_per_mm: Pair = (0.0, 0.0)  # g
    k2_per_px4: float = 0.0
    k3_per_px6: float = 0.0
    p1_per_px: float = 0.0
    p2_per_px: float = 0.0

    def __post_init__(self) -> None:
        numbers = [*self.matrix_px_per_mm[0], *self.matrix_px_per_mm[1], *self.offset_px, *self.perspective_per_mm]
        numbers += [*self.distortion_centre_px, *self.coefficients.tolist()]
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError(f"plane map: every number must be finite (got {numbers})")
        self._check_distortion()
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

    def _check_distortion(self) -> None:
        corner_px = math.hypot(*self.distortion_centre_px)
        named = zip(distortion.COEFFICIENTS, self.coefficients.tolist(), (2, 4, 6, 1, 1), strict=True)
        for name, value, power in named:
            if abs(value) * corner_px**power > MOST_BENT:
                limit = MOST_BENT / corner_px**power
                raise ValueError(f"plane map: {name} must be within +-{limit:.2g} per px^{power} (got {value:g})")

    @classmethod
    def from_arrays(cls, matrix: ArrayLike, offset: ArrayLike, k1: float, centre: ArrayLike) -> PlaneMap:
        """The same from arrays: (2, 2) px/mm, (2,) px, per px^2, (2,) px."""
        (a, b), (c, d) = np.asarray(matrix, float).tolist()
        (e, f), (g, h) = np.asarray(offset, float).tolist(), np.asarray(centre, float).tolist()
        return cls(((a, b), (c, d)), (e, f), float(k1), (g, h))

    @classmethod
    def from_dict(cls, table: Mapping[str, Any]) -> PlaneMap:
        """Read what `as_dict` wrote. Raises ValueError for a missing, unknown or wrong entry."""
        if not set(ALWAYS) <= set(table) <= set(SHAPES):
            raise ValueError(
                f"plane map: keys must be {sorted(ALWAYS)}, and may be {sorted(set(SHAPES) - set(ALWAYS))} "
                f"(got {sorted(map(str, table))})"
            )
        return cls(**{key: _numbers(key, value, SHAPES[key]) for key, value in table.items()})

    def as_dict(self) -> dict[str, Any]:
        """Only floats and lists, for a file; `from_dict` reads it back without loss."""
        return {
            key: np.array(getattr(self, key)).tolist() if shape else getattr(self, key) for key, shape in SHAPES.items()
        }

    @property
    def matrix(self) -> FloatArray:
        """A as (2, 2) array, px/mm."""
        return np.array(self.matrix_px_per_mm)

    @property
    def coefficients(self) -> FloatArray:
        """Distortion (5,), in `distortion.py`'s order, px."""
        return np.array([self.k1_per_px2, self.k2_per_px4, self.k3_per_px6, self.p1_per_px, self.p2_per_px])

    @property
    def mm_per_px(self) -> float:
        """Mean scale (square root of the area ratio) at the lens' centre."""
        return 1.0 / math.sqrt(abs(float(np.linalg.det(self._central))))

    @property
    def rotation_deg(self) -> float:
        """Direction of the picture's u axis in the mm frame, counter-clockwise from +x, at the lens' centre."""
        (a, b), (c, d) = self._central.tolist()
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
        return bool(np.linalg.det(self._central) < 0)

    def px_from_mm(self, points_mm: ArrayLike) -> FloatArray:
        """Where points (N, 2) of the plane appear in the picture, (N, 2). ValueError if far outside the lens."""
        return self.distorted_px(self._flat(_points(points_mm)))

    def mm_from_px(self, points_px: ArrayLike) -> FloatArray:
        """Which points (N, 2) of the plane appear at these px, (N, 2). ValueError if far outside the lens."""
        flat = self.undistorted_px(_points(points_px))
        matrices = self.matrix - flat[:, :, None] * np.array(self.perspective_per_mm)
        mm: FloatArray = np.linalg.solve(matrices, (flat - np.array(self.offset_px))[..., None])[..., 0]
        self._check_in_front(mm)
        return mm

    def distorted_px(self, flat_px: FloatArray) -> FloatArray:
        """Apply the lens' distortion to points (..., 2). ValueError beyond the radius where the model folds over."""
        away = flat_px - np.array(self.distortion_centre_px)
        distortion.check_usable(away, self.coefficients, "px")
        return np.asarray(distortion.distort(away, self.coefficients) + np.array(self.distortion_centre_px), np.float64)

    def undistorted_px(self, seen_px: FloatArray) -> FloatArray:
        """Undo `distorted_px`."""
        centre = np.array(self.distortion_centre_px)
        return np.asarray(distortion.undistort(seen_px - centre, self.coefficients, "px") + centre, np.float64)

    def jacobian(self, points_mm: ArrayLike) -> FloatArray:
        """How px depend on mm at points (N, 2) of the plane, (N, 2, 2) px/mm."""
        points = _points(points_mm)
        flat = self._flat(points)
        affine = self._affine(points, flat)
        return distortion.jacobians(flat - np.array(self.distortion_centre_px), self.coefficients)[0] @ affine

    def dot_centres_px(self, points_mm: ArrayLike, diameters_mm: ArrayLike) -> FloatArray:
        """Where the centres of disks of these diameters (N,) around points (N, 2) appear to be, (N, 2)."""
        diameters = np.broadcast_to(np.asarray(diameters_mm, np.float64), len(_points(points_mm)))
        return disk_centres(self.px_from_mm, _points(points_mm), diameters)

    def px_at(self, point: Mm) -> Px:
        """One point, mm to px."""
        u, v = self.px_from_mm([point])[0].tolist()
        return Px(u, v)

    def mm_at(self, point: Px) -> Mm:
        """One point, px to mm."""
        x_mm, y_mm = self.mm_from_px([point])[0].tolist()
        return Mm(x_mm, y_mm)

    def _flat(self, points: FloatArray) -> FloatArray:
        """Without the lens' distortion."""
        self._check_in_front(points)
        affine = points @ self.matrix.T + np.array(self.offset_px)
        return np.asarray(affine / self._depth(points)[:, None], np.float64)

    def _depth(self, points: FloatArray) -> FloatArray:
        """Distance of points (N, 2) from the camera over that of the frame's origin."""
        return np.asarray(1 + points @ np.array(self.perspective_per_mm), np.float64)

    def _check_in_front(self, points: FloatArray) -> None:
        if not np.all(self._depth(points) > 0):
            raise ValueError("plane map: a point lies beyond the camera's horizon")

    def _affine(self, points: FloatArray, flat: FloatArray) -> FloatArray:
        """Derivative of `_flat`."""
        affine = self.matrix - flat[:, :, None] * np.array(self.perspective_per_mm)
        return np.asarray(affine / self._depth(points)[:, None, None], np.float64)

    @property
    def _central(self) -> FloatArray:
        """Derivative of px by mm at the lens' centre, where the lens does not distort, (2, 2)."""
        centre = np.array([self.distortion_centre_px])
        affine = self.matrix - centre[0][:, None] * np.array(self.perspective_per_mm)
        with np.errstate(all="ignore"):  # no such point: nan or inf, which no scale can be
            mm = np.linalg.lstsq(affine, centre[0] - np.array(self.offset_px), rcond=None)[0]
        return np.asarray(affine / (1 + mm @ np.array(self.perspective_per_mm)), np.float64)

    def _scales(self) -> Pair:
        """Singular values of the central derivative, the smaller first."""
        (a, b), (c, d) = self._central.tolist()
        turn, mirror = math.hypot(a + d, b - c) / 2, math.hypot(a - d, b + c) / 2
        return abs(turn - mirror), turn + mirror


def _points(points: ArrayLike) -> FloatArray:
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"plane map: points must be an (N, 2) array (got shape {array.shape})")
    if not np.isfinite(array).all():
        raise ValueError("plane map: points must be finite")
    return array


def _numbers(key: str, value: object, shape: tuple[int, ...]) -> Any:
    """A float, or tuples of floats, of the right shape."""
    flat = [value]
    for _ in shape:
        flat = [item for inner in flat for item in (inner if isinstance(inner, (list, tuple)) else [None])]
    right = all(isinstance(item, (int, float)) and not isinstance(item, bool) for item in flat)
    if not right or len(flat) != math.prod(shape):
        raise ValueError(f"plane map: {key} must be numbers of shape {shape} (got {value!r})")
    table = np.array(flat, dtype=np.float64).reshape(shape).tolist()
    return tuple(tuple(row) if isinstance(row, list) else row for row in table) if shape else table
