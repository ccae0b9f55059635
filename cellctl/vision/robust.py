"""Robust straight and harmonic fits to offsets, and how sure they are. Pure and deterministic."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.features import Floats, Singles

Bools: TypeAlias = NDArray[np.bool_]

TUKEY = 4.685  # rejection at so many sigmas: 95 % efficient on Gaussian noise
LEAST_SPREAD_PX = 0.003  # keeps a perfect picture from rejecting itself
NEAR_PX = 2.5  # a caliper hit this close to a hypothesis supports it
DRAWS = 72
DIRT = 2.0  # where much was rejected, some of what was kept is dirty too: so much more variance when all was
RIDGE = 1e-12  # keeps the normal equations solvable


class Fit(NamedTuple):
    """Parameters, final weights and residuals of the equations, and the residuals' robust spread."""

    parameters: Floats
    weights: Floats
    residuals: Floats
    spread: float


def tukey_fit(design: Floats, values: Floats, weights: Floats, rounds: int) -> Fit:
    """Weighted fit of two or three parameters with Tukey's biweight: `design` (n, parameters).

    The rejection limit anneals from wide to TUKEY robust sigmas. `weights` (n,) are those the equations start with;
    an equation of weight 0 stays out.
    """
    everything = np.concatenate([design.T, values[None]])
    used = np.flatnonzero(weights)
    system, start = (everything, weights) if used.size == values.size else (everything[:, used], weights[used])
    now, limit, spread, left = start, math.inf, LEAST_SPREAD_PX, np.zeros(len(everything))
    for _ in range(rounds):
        left = np.array([*(-p for p in _solved(((system * now) @ system.T).tolist())), 1.0])
        residuals = left @ system
        spread = 1.4826 * middle(np.abs(residuals)) + LEAST_SPREAD_PX
        limit = max(TUKEY * spread, 0.5 * limit) if math.isfinite(limit) else TUKEY * spread
        now = _biweight(residuals, limit) * start
        if not now.any():
            break
    final = np.zeros_like(weights)
    final[used] = now
    return Fit(-left[:-1], final, left @ everything, spread)


def _solved(normal: list[list[float]]) -> tuple[float, ...]:
    """Solution of two or three normal equations, their right hand in the last column; by Cramer, ten times LAPACK."""
    if len(normal) == 3:
        (a, b, p), (_, d, q), _ = normal
        det = a * d - b * b + RIDGE
        return (d * p - b * q) / det, (a * q - b * p) / det
    (a, b, c, p), (_, d, e, q), (_, _, f, r), _ = normal
    g, h, i = d * f - e * e, c * e - b * f, b * e - c * d
    j, k, m = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * g + b * h + c * i + RIDGE
    return (g * p + h * q + i * r) / det, (h * p + j * q + k * r) / det, (i * p + k * q + m * r) / det


def _biweight(residuals: Floats, limit: float) -> Floats:
    z = residuals / limit
    z *= z
    np.subtract(1.0, z, out=z)
    np.maximum(z, 0.0, out=z)
    z *= z
    return z


def middle(values: Floats | Singles) -> float:
    """The (upper) median, several times faster than numpy's for short arrays; 0 of nothing."""
    return quantile(values, 0.5)


def quantile(values: Floats | Singles, share: float) -> float:
    """The value that about this share of the values is below; 0 of nothing."""
    if not values.size:
        return 0.0
    at = int(share * values.size)
    part = values.copy()
    part.partition(at)
    return float(part[at])


def covariance(design: Floats, fit: Fit, weights: Floats) -> Floats:
    """Covariance of the parameters: asymptotic for Tukey's estimator, widened by the neighbours' correlation.

    Huber's sandwich: the bread is the derivative of the influence, the meat the squared influence.
    """
    moved = influences(design, fit, weights)
    rejected = 1.0 - np.count_nonzero(fit.weights) / fit.weights.size
    return np.asarray(moved @ moved.T * (widening(fit) * (1.0 + DIRT * rejected**2)))


def influences(design: Floats, fit: Fit, weights: Floats) -> Floats:
    """How far each equation's own error has moved the parameters: (parameters, equations)."""
    z2 = (fit.residuals / (TUKEY * fit.spread)) ** 2
    inside = z2 < 1.0
    slope = weights * np.where(inside, (1.0 - z2) * (1.0 - 5.0 * z2), 0.0)
    bread = np.linalg.inv((design.T * slope) @ design + RIDGE * np.identity(design.shape[1]))
    count = int(np.count_nonzero(fit.weights))
    few = count / max(1, count - design.shape[1])
    return np.asarray(math.sqrt(few) * bread @ (design.T * (fit.weights * fit.residuals)))


def widening(fit: Fit) -> float:
    """(1 + c) / (1 - c) for the correlation c of neighbouring residuals: texture and form error span blocks."""
    r = np.sqrt(fit.weights) * fit.residuals
    power = float(r @ r)
    c = min(max(float(r[1:] @ r[:-1]) / power, 0.0), 0.9) if power > 0.0 else 0.0
    return (1.0 + c) / (1.0 - c)


@lru_cache(maxsize=32)
def _draws(count: int, size: int) -> NDArray[np.intp]:
    """The same random samples for the same number of equations: (DRAWS, size)."""
    return np.random.default_rng(7).integers(0, count, (DRAWS, size))


def line_consensus(t: Floats, n: Floats) -> Bools | None:
    """Which of the points (t, n) lie on one line: the best of many lines through two of them."""
    if t.size < 6:
        return None
    i, j = _draws(t.size, 2).T
    apart = np.abs(t[i] - t[j]) > 0.15 * np.ptp(t)
    i, j = i[apart], j[apart]
    if i.size == 0:
        return None
    slope = (n[j] - n[i]) / (t[j] - t[i])
    away = np.abs(n - n[i, None] - slope[:, None] * (t - t[i, None]))
    return np.asarray(away[_best(away)] < NEAR_PX)


def circle_consensus(design: Floats, d: Floats, growth_px: float) -> Bools | None:
    """Which radial offsets d agree on one shifted circle: design (n, 3) is (cos, sin, 1) of each ray."""
    if d.size < 8:
        return None
    drawn = _draws(d.size, 3)
    system = design[drawn]
    usable = np.abs(np.linalg.det(system)) > 0.3
    if not usable.any():
        return None
    guess = np.linalg.solve(system[usable], d[drawn[usable]][..., None])[..., 0]
    guess = guess[np.abs(guess[:, 2]) < growth_px]
    if guess.size == 0:
        return None
    away = np.abs(d - guess @ design.T)
    return np.asarray(away[_best(away)] < NEAR_PX)


def _best(away: Floats) -> int:
    """The hypothesis (row) with the least truncated distance."""
    return int(np.argmin(np.minimum(away, NEAR_PX).sum(axis=1)))
