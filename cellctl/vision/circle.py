"""One circle of known radius: caught by radial calipers near its rough centre, measured by sectors of a ring. Pure."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Px
from cellctl.vision.features import Circle, ExpectedCircle, Floats, Limits, NotFound, Pixels, Singles
from cellctl.vision.gates import accept_outline
from cellctl.vision.line import PASSES, step_response
from cellctl.vision.profile import (
    START_BLUR_PX,
    Offsets,
    block_offsets,
    block_weights,
    estimate_blur,
    typical_height,
)
from cellctl.vision.robust import Fit, circle_consensus, covariance, tukey_fit

RAYS = 72
RAY_PX = 30  # to either side of the outline
SECTORS = 128
BAND_PX = 7.0
FEWEST_SECTORS = 12
GROWTH_PX = 24.0  # a circle is caught, and its radius then refused, up to this much beside its radius
SPARE_PX = 4


class _Rays(NamedTuple):
    """Radial calipers about a pixel: steps to their pixels in the flat picture (3, rays, px), design (rays, 3)."""

    places: NDArray[np.intp]
    design: Floats


class _Ring(NamedTuple):
    """Pixels in a band about a circle: steps in the flat picture and coordinates (sectors, px), design (sectors, 3)."""

    places: NDArray[np.intp]
    du: Singles
    dv: Singles
    design: Floats

    def thinned(self, every: int) -> _Ring:
        """Only one of so many sectors."""
        return _Ring(self.places[::every], self.du[::every], self.dv[::every], self.design[::every])


@lru_cache(maxsize=8)
def _rays(radius: int, width: int) -> _Rays:
    phi = np.linspace(0.0, 2.0 * math.pi, RAYS, endpoint=False)
    c, s = np.cos(phi)[:, None], np.sin(phi)[:, None]
    r, beside = radius + np.arange(-RAY_PX, RAY_PX + 1), np.array([-1.5, 0.0, 1.5])[:, None, None]
    du, dv = np.rint(c * r - s * beside), np.rint(s * r + c * beside)
    return _Rays((dv * width + du).astype(np.intp), _harmonics(phi))


@lru_cache(maxsize=8)
def _ring(radius: int, width: int) -> _Ring:
    m = math.ceil(radius + BAND_PX)
    v, u = np.mgrid[-m : m + 1, -m : m + 1]
    inside = np.abs(np.hypot(u, v) - radius) <= BAND_PX
    u, v = u[inside], v[inside]
    phi = np.arctan2(v, u)
    order = np.argsort(phi, kind="stable")
    order = order[np.linspace(0, order.size - 1, order.size // SECTORS * SECTORS).astype(np.intp)]
    u, v = (a[order].reshape(SECTORS, -1) for a in (u, v))
    places = (v * width + u).astype(np.intp)
    return _Ring(
        places, u.astype(np.float32), v.astype(np.float32), _harmonics(phi[order].reshape(SECTORS, -1).mean(axis=1))
    )


def _harmonics(phi: Floats) -> Floats:
    """Radial shift by a shift of the centre and a growth."""
    return np.stack([np.cos(phi), np.sin(phi), np.ones_like(phi)], axis=1)


class RoughCircle(NamedTuple):
    """A circle good to about a pixel."""

    centre: Px
    radius_px: float


def catch_circle(pixels: Pixels, centre: Px, expected: ExpectedCircle, min_contrast: float) -> RoughCircle:
    """The circle that most radial calipers about a rough centre agree on. Raises NotFound when they do not."""
    rays = _rays(round(expected.radius_px), pixels.shape[1])
    u, v = round(centre.u), round(centre.v)
    _inside(pixels, u, v, expected.radius_px + RAY_PX)
    profile = pixels.reshape(-1).take(rays.places + (v * pixels.shape[1] + u)).sum(axis=0, dtype=np.float32)
    hit, height = step_response(profile / np.float32(3.0), 1.0 if expected.dark_inside else -1.0)
    strong = height > 0.5 * min_contrast
    d, design = (hit - RAY_PX)[strong], rays.design[strong]
    together = circle_consensus(design, d, GROWTH_PX)
    if together is None or np.count_nonzero(together) < FEWEST_SECTORS:
        raise NotFound("hole", f"no round outline near ({centre.u:.0f}, {centre.v:.0f}) px")
    shift = tukey_fit(design, d, together.astype(np.float64), 2).parameters
    return RoughCircle(Px(u + float(shift[0]), v + float(shift[1])), round(expected.radius_px) + float(shift[2]))


def measure_circle(pixels: Pixels, rough: RoughCircle, expected: ExpectedCircle, limits: Limits) -> Circle:
    """Measure a circle from a start good to some pixels. Raises NotFound when a limit is not kept."""
    outward = 1.0 if expected.dark_inside else -1.0
    if abs(rough.radius_px - expected.radius_px) > limits.radius_px + 2.0:
        raise _wrong_radius(rough.radius_px, expected, limits)
    ring = _ring(round(rough.radius_px), pixels.shape[1])
    centre, radius, blur = rough.centre, rough.radius_px, START_BLUR_PX
    for every, rounds in PASSES:
        part = ring.thinned(every)
        levels, distance = _band(pixels, part, centre, radius, outward)
        offsets = block_offsets(levels, distance, blur)
        weights = block_weights(offsets, 0.5 * limits.min_contrast)
        if np.count_nonzero(weights) < FEWEST_SECTORS // every:
            raise NotFound("hole", f"{np.count_nonzero(weights)} of {len(weights)} sectors see its outline")
        fit = tukey_fit(part.design, -outward * offsets.shift, weights, rounds)
        du, dv, growth = (float(p) for p in fit.parameters)
        centre, radius = Px(centre.u + du, centre.v + dv), radius + growth
        blur = estimate_blur(levels, distance, offsets, fit.weights) or blur if every > 1 else blur
    circle = _circle(centre, radius, fit, covariance(ring.design, fit, weights), offsets, blur, limits)
    accept_outline(circle.contrast, circle.inliers, circle.residual_px, levels, limits, "hole")
    if abs(radius - expected.radius_px) > limits.radius_px:
        raise _wrong_radius(radius, expected, limits)
    return circle


def _band(pixels: Pixels, ring: _Ring, centre: Px, radius: float, outward: float) -> tuple[Singles, Singles]:
    """Levels and signed distances (towards the bright side) of the pixels of a ring about a centre."""
    u, v = round(centre.u), round(centre.v)
    _inside(pixels, u, v, radius + BAND_PX)
    levels = pixels.reshape(-1).take(ring.places + (v * pixels.shape[1] + u)).astype(np.float32)
    distance = np.square(ring.du - np.float32(centre.u - u))
    distance += np.square(ring.dv - np.float32(centre.v - v))
    np.sqrt(distance, out=distance)
    distance -= np.float32(radius)
    distance *= np.float32(outward)
    return levels, distance


def _inside(pixels: Pixels, u: int, v: int, reach: float) -> None:
    """Raises NotFound when a circle about (u, v) leaves the picture."""
    height, width = pixels.shape
    r = reach + SPARE_PX
    if not (r <= u < width - r and r <= v < height - r):
        raise NotFound("view", f"the hole at ({u}, {v}) px is not wholly in the picture")


def _circle(
    centre: Px, radius: float, fit: Fit, spread: Floats, offsets: Offsets, blur: float, limits: Limits
) -> Circle:
    return Circle(
        centre=centre,
        radius_px=radius,
        sd_px=math.sqrt(max(0.0, float(spread[0, 0] + spread[1, 1]) / 2.0)),
        blur_px=blur,
        contrast=typical_height(offsets, 0.5 * limits.min_contrast),
        inliers=float(np.mean(fit.weights > 0.0)),
        residual_px=fit.spread,
    )


def _wrong_radius(radius: float, expected: ExpectedCircle, limits: Limits) -> NotFound:
    detail = f"{radius:.1f} px, expected are {expected.radius_px:.1f} +- {limits.radius_px:.1f}"
    return NotFound("hole radius", detail)
