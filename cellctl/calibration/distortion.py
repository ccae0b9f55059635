"""How a lens bends a picture: Brown's and Conrady's model about a centre, in any unit of length.

    bent = a (1 + k1 r^2 + k2 r^4 + k3 r^6) + (2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y),  a = (x, y)

a is the way from the lens' centre: in px for a plane, in units of the focal length for a pinhole camera, whose
coefficients are then the usual ones. Coefficients (5,) are ordered k1, k2, k3, p1, p2.
Source: D. C. Brown, Decentering distortion of lenses, 1966; signs and names as in OpenCV.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

COEFFICIENTS = ("k1", "k2", "k3", "p1", "p2")
USABLE_FOLD = 0.9  # part of the radius where a barrel distortion folds over that may be used
MOST_STEPS = 50
NO_TERM = 1e-12  # a term this small beside the others folds nothing over


def distort(away: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Bend points (..., 2), given as ways from the centre. Not checked: see `usable_radius`."""
    _, _, _, p1, p2 = coefficients.tolist()
    x, y = away[..., 0], away[..., 1]
    square = x * x + y * y
    bent = away * _radial(square, coefficients)[..., None]
    bent[..., 0] += 2 * p1 * x * y + p2 * (square + 2 * x * x)
    bent[..., 1] += p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return np.asarray(bent, np.float64)


def undistort(bent: FloatArray, coefficients: FloatArray, unit: str) -> FloatArray:
    """Undo `distort` by Newton's method. Raises ValueError (lengths in `unit`) where no usable point is bent to."""
    away, tiny = bent.copy(), 1e-15 * (1 + float(np.abs(bent).max(initial=0.0)))
    with np.errstate(all="ignore"):  # a point outside runs away and is refused below
        for _ in range(MOST_STEPS):
            step = _solved(jacobians(away, coefficients)[0], distort(away, coefficients) - bent)
            away = away - step
            if np.all(np.abs(step) <= tiny):
                break
        missed = np.abs(distort(away, coefficients) - bent)
    check_usable(np.where(missed <= 1e-9 * (1 + np.abs(bent)), away, math.inf), coefficients, unit)
    return away


def jacobians(away: FloatArray, coefficients: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of `distort` by the point (..., 2, 2) and by the coefficients (..., 2, 5)."""
    k1, k2, k3, p1, p2 = coefficients.tolist()
    x, y = away[..., 0], away[..., 1]
    square = x * x + y * y
    radial, growth = _radial(square, coefficients), 2 * (k1 + square * (2 * k2 + square * 3 * k3))
    by_point = np.empty((*away.shape, 2))
    by_point[..., 0, 0] = radial + growth * x * x + 2 * p1 * y + 6 * p2 * x
    by_point[..., 1, 1] = radial + growth * y * y + 6 * p1 * y + 2 * p2 * x
    by_point[..., 0, 1] = by_point[..., 1, 0] = growth * x * y + 2 * p1 * x + 2 * p2 * y
    by_coefficient = np.empty((*away.shape, 5))
    for power in (1, 2, 3):
        by_coefficient[..., power - 1] = away * (square**power)[..., None]
    by_coefficient[..., 0, 3] = by_coefficient[..., 1, 4] = 2 * x * y
    by_coefficient[..., 1, 3], by_coefficient[..., 0, 4] = square + 2 * y * y, square + 2 * x * x
    return by_point, by_coefficient


def usable_radius(coefficients: FloatArray) -> float:
    """Up to which way from the centre the model may be used: a lens does not fold the picture over."""
    terms = [
        (factor * k, power) for k, factor, power in zip(coefficients[:3].tolist(), (3, 5, 7), (2, 4, 6), strict=True)
    ]
    lengths = [abs(term) ** (-1 / power) for term, power in terms if term]
    if not lengths:
        return math.inf
    unit = min(lengths)  # where the first term reaches 1: the polynomial's numbers are about 1 in this unit
    slope = [(1.0 if term > 0 else -1.0) * (abs(term) ** (1 / power) * unit) ** power for term, power in terms]
    roots = np.roots([0.0 if abs(term) < NO_TERM else term for term in reversed(slope)] + [1.0])  # of d(bent)/dr
    folds = roots.real[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)]
    return USABLE_FOLD * unit * math.sqrt(float(folds.min())) if len(folds) else math.inf


def check_usable(away: FloatArray, coefficients: FloatArray, unit: str) -> None:
    """Raise ValueError (lengths in `unit`) when a point lies further from the centre than the model may be used."""
    limit = usable_radius(coefficients)
    worst = float(np.hypot(away[..., 0], away[..., 1]).max(initial=0.0))
    if not worst <= limit or math.isinf(worst):
        raise ValueError(
            f"lens: a point lies {worst:.4g} {unit} from the distortion centre, but a lens with k1, k2, k3 = "
            f"{', '.join(f'{k:g}' for k in coefficients[:3].tolist())} is described up to {limit:.4g} {unit} only"
        )


def _radial(square: FloatArray, coefficients: FloatArray) -> FloatArray:
    k1, k2, k3 = coefficients[:3].tolist()
    return np.asarray(1 + square * (k1 + square * (k2 + square * k3)), np.float64)


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve 2 x 2 systems (..., 2, 2); nan where there is no solution."""
    determinant = matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]
    first = matrix[..., 1, 1] * right[..., 0] - matrix[..., 0, 1] * right[..., 1]
    second = matrix[..., 0, 0] * right[..., 1] - matrix[..., 1, 0] * right[..., 0]
    return np.asarray(np.stack([first, second], axis=-1) / determinant[..., None], np.float64)
