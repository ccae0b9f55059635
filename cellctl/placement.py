"""How sure we are of a placement: small errors of poses, carried to the corners of the battery. Pure.

A small error of a pose is a shift and a turn of the frame that the pose describes, (x mm, y mm, turn rad). `Errors`
holds one column per independent source of one sigma, so sums, lever arms and correlations are all linear algebra: a
source that acts twice is one column, and what two measurements have in common cancels by itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Mm, Pose

Floats: TypeAlias = NDArray[np.float64]
Rows: TypeAlias = Floats | Sequence[Sequence[float]]

DIRECTIONS = 256
LARGEST_RADIUS = 8.0  # sigmas; beyond lie 3e-14 of all errors in space
MEAN_RADIUS = 2.0 * math.sqrt(2.0 / math.pi)  # mean length of a standard normal vector in space


class Errors(NamedTuple):
    """What independent sources of one sigma do: `columns` (rows, sources), a name per source. Rows are mm and rad."""

    names: tuple[str, ...]
    columns: Floats

    @classmethod
    def of(cls, name: str, covariance: Rows) -> Errors:
        """Sources that together have this covariance (rows, rows); it may be singular, and its rows of any units."""
        matrix = np.asarray(covariance, np.float64)
        sd = np.sqrt(np.diag(matrix))
        units = np.where(sd > 0.0, sd, 1.0)
        variances, axes = np.linalg.eigh(matrix / np.outer(units, units))
        return cls((name,) * len(variances), units[:, None] * axes * np.sqrt(np.maximum(variances, 0.0)))

    @classmethod
    def none(cls, rows: int) -> Errors:
        """Nothing errs."""
        return cls((), np.zeros((rows, 0)))

    @property
    def covariance(self) -> Floats:
        """Of the rows."""
        return self.columns @ self.columns.T

    def and_of(self, other: Errors) -> Errors:
        """The same rows, erring for other reasons as well."""
        return Errors(self.names + other.names, np.hstack([self.columns, other.columns]))

    def mapped(self, matrix: Rows) -> Errors:
        """Rows that depend linearly on these."""
        return Errors(self.names, np.asarray(matrix, np.float64) @ self.columns)

    def seen_from(self, frame: Pose) -> Errors:
        """A pose's error (3 rows) as an error of `frame`, when the pose is seen from that frame and both move as one.

        `frame` is outer_from_inner: an error of inner becomes the error of outer.
        """
        return self.mapped(_adjoint(frame))

    def scaled(self, factors: Mapping[str, float], otherwise: float) -> Errors:
        """Each source times the factor of its name."""
        return Errors(self.names, self.columns * [factors.get(name, otherwise) for name in self.names])

    def named(self, name: str) -> Errors:
        """All under one name."""
        return Errors((name,) * len(self.names), self.columns)


def beside(*groups: Errors) -> Errors:
    """The rows of independent groups one below the other."""
    columns = np.zeros((sum(len(g.columns) for g in groups), sum(len(g.names) for g in groups)))
    row = column = 0
    for group in groups:
        rows, sources = group.columns.shape
        columns[row : row + rows, column : column + sources] = group.columns
        row, column = row + rows, column + sources
    return Errors(tuple(name for group in groups for name in group.names), columns)


class Learnt(NamedTuple):
    """An estimate improved by something else that was seen: how much to subtract, and what error is left."""

    error: Floats
    left: Errors


def learn(errors: Errors, seen: Errors, by: Floats) -> Learnt:
    """What the difference `by` = (what was seen) - (what was expected) says about the error of an estimate.

    `errors` are those of the estimate, `seen` those of the difference, by the same sources. The best linear unbiased
    estimate: E[error | difference] of jointly normal errors.
    """
    gain = errors.columns @ seen.columns.T @ np.linalg.pinv(seen.covariance, hermitian=True)
    return Learnt(gain @ by, Errors(errors.names, errors.columns - gain @ seen.columns))


class WorstCorner:
    """The distribution of the largest distance by which any of the corners misses its place.

    All corners are moved by one normal (x, y, turn). Along one direction of that space the largest distance grows
    with the radius, whose distribution is known in closed form; so only the directions are summed over.
    """

    def __init__(self, errors: Errors, corners: Sequence[Mm]) -> None:
        variances, axes = np.linalg.eigh(errors.covariance)
        x, y, turn = (axes * np.sqrt(np.maximum(variances, 0.0))) @ _directions()
        points = np.array(corners)
        dx, dy = x - points[:, 1:] * turn, y + points[:, :1] * turn
        self._reach_mm: Floats = np.sqrt((dx * dx + dy * dy).max(axis=0))  # per direction, at radius 1

    @property
    def mean_mm(self) -> float:
        """Expected distance."""
        return MEAN_RADIUS * float(self._reach_mm.mean())

    def within(self, distance_mm: float) -> float:
        """Probability of at most this distance."""
        radius, share = _radii()
        return float(np.interp(distance_mm / np.maximum(self._reach_mm, 1e-300), radius, share).mean())

    def quantile_mm(self, probability: float) -> float:
        """The distance that is kept with this probability, to 0.1 %."""
        low, high = 0.0, LARGEST_RADIUS * float(self._reach_mm.max())
        while high - low > 1e-3 * high:
            middle = (low + high) / 2
            low, high = (low, middle) if self.within(middle) >= probability else (middle, high)
        return (low + high) / 2


class Prediction(NamedTuple):
    """What is expected of a placement."""

    expected_mm: float  # mean of the worst corner
    p99_mm: float  # 99 of 100 such placements have all corners within this
    limit_mm: float  # needed
    shares: Mapping[str, float]  # of the variance at the corner that varies most, by name of source, largest first

    @property
    def good(self) -> bool:
        """Whether the battery may be placed."""
        return self.p99_mm <= self.limit_mm

    @property
    def largest(self) -> str:
        """The source with the largest share."""
        return next(iter(self.shares), "none")

    @property
    def sentence(self) -> str:
        """For the log and the record."""
        return (
            f"expected {self.expected_mm * 1000:.0f} um, p99 {self.p99_mm * 1000:.0f} um of "
            f"{self.limit_mm * 1000:.0f} um, largest share: {self.largest} ({self.shares.get(self.largest, 0.0):.0%})"
        )

    def as_dict(self) -> dict[str, object]:
        """For the record of a unit."""
        return {
            "sentence": self.sentence,
            "expected_mm": round(self.expected_mm, 6),
            "p99_mm": round(self.p99_mm, 6),
            "limit_mm": self.limit_mm,
            "shares": {name: round(share, 4) for name, share in self.shares.items()},
        }


def predict(errors: Errors, corners: Sequence[Mm], limit_mm: float) -> Prediction:
    """The worst corner of a battery whose pose has these errors (3 rows: x mm, y mm, turn rad of its frame)."""
    worst = WorstCorner(errors, corners)
    return Prediction(worst.mean_mm, worst.quantile_mm(0.99), limit_mm, shares(errors, corners))


def shares(errors: Errors, corners: Sequence[Mm]) -> dict[str, float]:
    """Each source's part of the variance at the corner that varies most, largest first."""
    by_source = max((_variances(errors, corner) for corner in corners), key=lambda variances: float(variances.sum()))
    total, parts = float(by_source.sum()), dict.fromkeys(errors.names, 0.0)
    for name, variance in zip(errors.names, by_source.tolist(), strict=True):
        parts[name] += variance / total if total else 0.0
    return dict(sorted(parts.items(), key=lambda part: -part[1]))


def straight_fit(length_mm: float, sd_mm: float, correlation_mm: float) -> Floats:
    """What form error does to a straight line fitted to an edge: covariance (2, 2) of offset mm and slope rad.

    Both at the middle of the fitted length. Form error: sigma `sd_mm` about the ideal straight edge, correlation
    exp(-(distance / correlation_mm)^2) along it.
    """
    return sd_mm**2 * np.array(_fit_of_unit_form(length_mm, correlation_mm))


@lru_cache(maxsize=32)
def _fit_of_unit_form(length_mm: float, correlation_mm: float) -> tuple[tuple[float, float], tuple[float, float]]:
    count = 24 + math.ceil(4 * length_mm / correlation_mm)
    along = (np.arange(count) + 0.5) / count * length_mm - length_mm / 2
    form = np.exp(-(((along[:, None] - along) / correlation_mm) ** 2))
    mean, slope = np.full(count, 1.0 / count), along / float(along @ along)
    return (float(mean @ form @ mean), 0.0), (0.0, float(slope @ form @ slope))


def _variances(errors: Errors, corner: Mm) -> Floats:
    x, y, turn = errors.columns
    moved: Floats = (x - corner.y_mm * turn) ** 2 + (y + corner.x_mm * turn) ** 2
    return moved


def _adjoint(frame: Pose) -> Floats:
    c, s = math.cos(math.radians(frame.t_deg)), math.sin(math.radians(frame.t_deg))
    return np.array([[c, -s, frame.y_mm], [s, c, -frame.x_mm], [0.0, 0.0, 1.0]])


@lru_cache(maxsize=1)
def _directions() -> Floats:
    """Unit vectors (3, DIRECTIONS), evenly over half the sphere: a Fibonacci spiral (opposite ones are alike)."""
    number = np.arange(DIRECTIONS) + 0.5
    up = 1.0 - number / DIRECTIONS
    around = np.pi * (1.0 + math.sqrt(5.0)) * number
    level = np.sqrt(1.0 - up * up)
    return np.stack([level * np.cos(around), level * np.sin(around), up])


@lru_cache(maxsize=1)
def _radii() -> tuple[Floats, Floats]:
    """Lengths of a standard normal vector in space, and the probability of at most each: chi with 3 freedoms."""
    radius = np.linspace(0.0, LARGEST_RADIUS, 4001)
    density = math.sqrt(2.0 / math.pi) * radius**2 * np.exp(-(radius**2) / 2)
    below = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2) * (radius[1] - radius[0])])
    return radius, below / below[-1]
