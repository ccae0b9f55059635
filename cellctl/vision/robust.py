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
LEAST_SPREAD_PX = 0.01  # keeps a perfect picture from rejecting itself
NEAR_PX = 2.5  # a caliper hit this close to a hypothesis supports it
DRAWS = 72
RIDGE = 1e-12  # keeps the normal equations solvable


class Fit(NamedTuple):
    """Parameters, final weights and residuals of the equations, and the residuals' robust spread."""

    parameters: Floats
    weights: Floats
    residuals: Floats
    spread: float


def tukey_fit(design: Floats, values: Floats, weights: Floats, rounds: int) -> Fit:
    """Weighted fit with Tukey's biweight: the rejection limit anneals from wide to TUKEY robust sigmas.

    `weights` (n,) are those the equations start with; an equation of weight 0 stays out.
    """
    parameters: Floats = np.zeros(design.shape[1])
    spread = LEAST_SPREAD_PX
    used = np.flatnonzero(weights)
    a, y, start = (design, values, weights) if used.size == values.size else (design[used], values[used], weights[used])
    now, limit, ridge = start, math.inf, RIDGE * np.identity(design.shape[1])
    for _ in range(rounds):
        weighted = a.T * now
        parameters = _solved(weighted @ a + ridge, weighted @ y)
        residuals = y - a @ parameters
        spread = 1.4826 * middle(np.abs(residuals)) + LEAST_SPREAD_PX
        limit = max(TUKEY * spread, 0.5 * limit) if math.isfinite(limit) else TUKEY * spread
        now = _biweight(residuals, limit) * start
        if not now.any():
            break
    final = np.zeros_like(weights)
    final[used] = now
    return Fit(parameters, final, values - design @ parameters, spread)


def _solved(matrix: Floats, right: Floats) -> Floats:
    """Solution of a regular system; the frequent 2 x 2 one is solved in place of ten times slower LAPACK."""
    if right.size != 2:
        return np.asarray(np.linalg.solve(matrix, right), np.float64)
    (a, b), (c, d) = matrix.tolist()
    p, q = right.tolist()
    det = a * d - b * c
    return np.array([(d * p - b * q) / det, (a * q - c * p) / det])


def _biweight(residuals: Floats, limit: float) -> Floats:
    z = residuals / limit
    z *= -z
    z += 1.0
    np.maximum(z, 0.0, out=z)
    z *= z
    return z


def middle(values: Floats | Singles) -> float:
    """The (upper) median, several times faster than numpy's for short arrays; 0 of nothing."""
    return float(np.partition(values, values.size // 2)[values.size // 2]) if values.size else 0.0


def covariance(design: Floats, fit: Fit, weights: Floats) -> Floats:
    """Covariance of the parameters: asymptotic for Tukey's estimator, widened by the neighbours' correlation.

    Huber's sandwich: the bread is the derivative of the influence, the meat the squared influence.
    """
    z2 = (fit.residuals / (TUKEY * fit.spread)) ** 2
    inside = z2 < 1.0
    slope = weights * np.where(inside, (1.0 - z2) * (1.0 - 5.0 * z2), 0.0)
    bread = np.linalg.inv((design.T * slope) @ design + RIDGE * np.identity(design.shape[1]))
    influence = design * (fit.weights * fit.residuals)[:, None]
    count = int(np.count_nonzero(fit.weights))
    few = count / max(1, count - design.shape[1])
    return np.asarray(bread @ (influence.T @ influence) @ bread * few * _widening(fit))


def _widening(fit: Fit) -> float:
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
