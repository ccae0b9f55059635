"""Least squares with some shared parameters and some of each picture's own, by Levenberg's and Marquardt's method.

Each picture touches only its own parameters, so these are eliminated picture by picture (Schur complement). What is
left is a small system: a solution takes milliseconds, and the inverse of that system is the covariance.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MOST_STEPS = 30
ENOUGH = 1e-6  # part of the cost, and squared sigmas: a smaller gain means nothing
DAMPING = (1e-9, 1e9)  # first, last


class Normal(NamedTuple):
    """Normal equations at one point: `s` the S shared parameters, `p` the P own ones of each of n pictures."""

    cost: float
    ss: FloatArray  # (S, S)
    sp: FloatArray  # (n, S, P)
    pp: FloatArray  # (n, P, P)
    s: FloatArray  # gradient (S,)
    p: FloatArray  # gradient (n, P)

    @property
    def _size(self) -> FloatArray:
        """What the shared parameters are scaled by: their mix of units cannot be solved as it is."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.ss), 1e-200)), np.float64)

    def step(self, damping: float) -> FloatArray:
        """The change of all unknowns that minimises, damped as Marquardt does: shared ones, then picture by picture."""
        pp_inverse = np.linalg.inv(self.pp + damping * self.pp * np.eye(self.pp.shape[-1]))
        carried = self.sp @ pp_inverse
        shared = self.ss + damping * self.ss * np.eye(len(self.ss)) - (carried @ self.sp.transpose(0, 2, 1)).sum(0)
        right = self.s - (carried @ self.p[..., None]).sum(0)[:, 0]
        size = self._size
        by_shared = -np.linalg.lstsq(shared / np.outer(size, size), right / size, rcond=None)[0] / size
        by_picture = -np.einsum("nij,nj->ni", pp_inverse, self.p + by_shared @ self.sp)
        return np.concatenate([by_shared, by_picture.ravel()])

    def covariance(self) -> FloatArray:
        """Of the shared parameters (S, S), the pictures' own ones marginalised."""
        size = self._size
        left = self.ss - (self.sp @ np.linalg.inv(self.pp) @ self.sp.transpose(0, 2, 1)).sum(0)
        inverse: FloatArray = np.linalg.inv(left / np.outer(size, size)) / np.outer(size, size)
        return inverse

    def own_covariances(self) -> FloatArray:
        """Of each picture's own parameters (n, P, P), the shared ones marginalised."""
        pp_inverse = np.linalg.inv(self.pp)
        carried = self.sp @ pp_inverse
        whole: FloatArray = pp_inverse + carried.transpose(0, 2, 1) @ self.covariance() @ carried
        return whole


class Adjustment(Protocol):
    """What is minimised: a sum of squares in sigmas of the unknowns x, the shared ones first."""

    def cost(self, x: FloatArray, /) -> float:
        """The sum of squares at `x`."""

    def normal(self, x: FloatArray, /) -> Normal:
        """The normal equations at `x`."""


def minimise(problem: Adjustment, x: FloatArray, *, most_steps: int = MOST_STEPS, enough: float = ENOUGH) -> FloatArray:
    """The unknowns at the minimum next to `x`."""
    damping, last = DAMPING
    with np.errstate(over="ignore", invalid="ignore"):  # a step too far is not taken
        normal = problem.normal(x)
        for _ in range(most_steps):
            trial = x + normal.step(damping)
            gain = normal.cost - problem.cost(trial)
            if gain > 0:
                x, damping = trial, max(damping / 10, DAMPING[0])
                if gain < enough * (1.0 + normal.cost):
                    break
                normal = problem.normal(x)
            else:
                damping = max(damping * 100, 1e-3)
                if damping > last or abs(gain) < enough:
                    break
    return x
