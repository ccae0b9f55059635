"""What the two lens models have in common, and the adjustment of either to the points seen in many pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration.adjustment import Normal
from cellctl.calibration.plane_map import Lens

FloatArray = NDArray[np.float64]


class Views(NamedTuple):
    """Points of one board in n pictures."""

    board_mm: FloatArray  # (m, 2)
    points_px: FloatArray  # (n, m, 2)
    seen: NDArray[np.bool_]  # (n, m); where not seen `points_px` means nothing
    picture_px: tuple[int, int]  # width, height
    diameters_mm: FloatArray | None = None  # (m,) when the points are dots

    def only(self, keep: NDArray[np.intp] | list[int]) -> Views:
        """The same with fewer pictures."""
        return self._replace(points_px=self.points_px[keep], seen=self.seen[keep])

    @property
    def middle_px(self) -> FloatArray:
        """Centre of the pictures, (2,)."""
        return (np.array(self.picture_px, float) - 1) / 2


class Prior(NamedTuple):
    """What is taken for granted of the shared parameters before anything is seen: values and sigmas, inf = nothing."""

    value: FloatArray
    sd: FloatArray


class LensModel(Protocol):
    """A camera: how the shared parameters (S,) and each picture's own (n, P) make px out of a board's mm."""

    @property
    def lens(self) -> Lens:
        """Its name."""

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the shared parameters, with their units."""

    @property
    def own(self) -> tuple[str, ...]:
        """Names of a picture's own parameters, with their units."""

    def start(self, views: Views) -> FloatArray:
        """All unknowns from closed formulas, shared first. Raises LensRefused when there are none."""

    def prior(self, views: Views, start: FloatArray) -> Prior:
        """What is taken for granted, of the shared parameters."""

    def see(self, shared: FloatArray, own: FloatArray, board_mm: FloatArray) -> FloatArray:
        """Where board points (m, 2) appear, (n, m, 2) px."""

    def jacobian(self, shared: FloatArray, own: FloatArray, board_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of `see` by shared (n, m, 2, S) and own parameters (n, m, 2, P)."""

    def at_pixels(self, shared: FloatArray, points_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How points (G, 2) of a picture shift with the shared parameters (G, 2, S), and when the camera is turned
        or moved as no picture can tell (G, 2, F). Raises ValueError outside of the lens."""


@dataclass(frozen=True)
class LensAdjustment:
    """The unknowns of a model against what was seen, as a sum of squares in sigmas."""

    model: LensModel
    views: Views
    weights: FloatArray  # (n, m); 0 for points that do not count
    sd_px: float  # of a point, per axis
    prior: Prior
    own_sd: FloatArray  # (P,): how far a picture's own parameters may be from 0
    shared_fixed: bool = False  # only the pictures' own parameters are free

    def split(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Shared parameters (S,) and own ones (n, P)."""
        count = len(self.model.parameters)
        return x[:count], x[count:].reshape(-1, len(self.model.own))

    def off_px(self, x: FloatArray) -> FloatArray:
        """Expected minus seen, (n, m, 2); 0 where a point was not seen."""
        off = self.model.see(*self.split(x), self.views.board_mm) - self.views.points_px
        return np.where(self.views.seen[..., None], off, 0.0)

    def cost(self, x: FloatArray) -> float:
        """Sum of squares in sigmas: points and what was taken for granted."""
        shared, own = self.split(x)
        points = float((self.weights[..., None] * self.off_px(x) ** 2).sum()) / self.sd_px**2
        return points + float((self._granted(shared) ** 2).sum() + ((own / self.own_sd) ** 2).sum())

    def normal(self, x: FloatArray) -> Normal:
        """The normal equations at `x`."""
        shared, own = self.split(x)
        by_shared, by_own = self.model.jacobian(shared, own, self.views.board_mm)
        scale = np.sqrt(self.weights)[..., None] / self.sd_px
        off = (self.off_px(x) * scale).reshape(len(own), -1, 1)
        a = (by_shared * scale[..., None]).reshape(len(own), -1, len(shared))
        b = (by_own * scale[..., None]).reshape(len(own), -1, own.shape[1])
        flat, turned, precision = a.reshape(-1, len(shared)), b.transpose(0, 2, 1), 1 / self.prior.sd
        return Normal(
            cost=self.cost(x),
            ss=np.eye(len(shared)) if self.shared_fixed else flat.T @ flat + np.diag(precision**2),
            sp=a.transpose(0, 2, 1) @ b * (not self.shared_fixed),
            pp=turned @ b + np.diag(self.own_sd**-2.0),
            s=(flat.T @ off.ravel() + self._granted(shared) * precision) * (not self.shared_fixed),
            p=(turned @ off)[..., 0] + own * self.own_sd**-2.0,
        )

    def _granted(self, shared: FloatArray) -> FloatArray:
        return np.asarray((shared - self.prior.value) / self.prior.sd, np.float64)
