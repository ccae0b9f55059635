"""One circle of known radius: caught by radial calipers near its rough centre, measured by sectors of a ring. Pure."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Px
from cellctl.vision.covariance import as_matrix
from cellctl.vision.features import Circle, ExpectedCircle, Floats, Limits, NotFound, Pixels
from cellctl.vision.gates import accept_outline, check_seen
from cellctl.vision.line import ROUNDS
from cellctl.vision.profile import Blocks, appearance, beliefs, better_width, block_offsets
from cellctl.vision.robust import Fit, circle_consensus, covariance, middle, tukey_fit
from cellctl.vision.steps import PLATEAU_PX, Response, Steps, respond, true_steps
from cellctl.vision.strip import BAND_PX, Ring, Strip, check_inside, harmonics, ring, ring_strip

RAYS = 72
RAY_PX = 30  # to either side of the outline
FEWEST_SECTORS = 12
GROWTH_PX = 24.0  # a circle is caught, and its radius then refused, up to this much beside its radius


class _Rays(NamedTuple):
    """Radial calipers about a pixel: steps to their pixels in the flat picture (3, rays * px), design (rays, 3)."""

    places: NDArray[np.intp]
    design: Floats


@lru_cache(maxsize=8)
def _rays(radius: int, width: int) -> _Rays:
    phi = np.linspace(0.0, 2.0 * math.pi, RAYS, endpoint=False)
    c, s = np.cos(phi)[:, None], np.sin(phi)[:, None]
    reach = RAY_PX + PLATEAU_PX
    r, beside = radius + np.arange(-reach, reach + 1), np.array([-1.5, 0.0, 1.5])[:, None, None]
    du, dv = np.rint(c * r - s * beside), np.rint(s * r + c * beside)
    return _Rays((dv * width + du).astype(np.intp).reshape(3, -1), harmonics(phi))


class RoughCircle(NamedTuple):
    """A circle good to about a pixel."""

    centre: Px
    radius_px: float
    width_px: float  # of the blur, roughly
    rival: float  # share of its rays that see another circle's outline near its own


def catch_circle(pixels: Pixels, centre: Px, expected: ExpectedCircle, min_contrast: float) -> RoughCircle:
    """The circle that most radial calipers about a rough centre agree on. Raises NotFound when they do not."""
    radius, outward = round(expected.radius_px), 1 if expected.dark_inside else -1
    rays = _rays(radius, pixels.shape[1])
    u, v = round(centre.u), round(centre.v)
    check_inside(pixels, u, v, expected.radius_px + RAY_PX + PLATEAU_PX)
    taken = pixels.reshape(-1).take(rays.places + (v * pixels.shape[1] + u))
    profiles = taken.sum(axis=0, dtype=np.uint16).reshape(RAYS, -1)[:, ::outward].astype(np.float32)
    seen = respond(profiles)
    steps = true_steps(seen)
    strong = steps.height > 1.5 * min_contrast  # of the sum of three
    d = outward * (steps.place - (RAY_PX + PLATEAU_PX))
    together = circle_consensus(rays.design[strong], d[strong], GROWTH_PX)
    if together is None or np.count_nonzero(together) < FEWEST_SECTORS:
        raise NotFound("hole", f"no round outline near ({centre.u:.0f}, {centre.v:.0f}) px")
    used = steps.only(strong).only(together)
    shift = tukey_fit(rays.design[strong], d[strong], together.astype(np.float64), 2).parameters
    found = outward * (rays.design @ shift)
    beside = _beside(seen, found + (RAY_PX + PLATEAU_PX), rays.design, used)
    du, dv, growth = shift.tolist()
    rival = beside / np.count_nonzero(together)
    return RoughCircle(Px(u + du, v + dv), radius + growth, used.width(), rival)


def _beside(seen: Response, place: Floats, design: Floats, used: Steps) -> int:
    """How many rays see a second step of at least half the height that makes another circle."""
    other = true_steps(seen.without(place))
    strong = other.height > 0.5 * middle(used.height)
    together = circle_consensus(design[strong], (other.place - (RAY_PX + PLATEAU_PX))[strong], RAY_PX)
    return 0 if together is None else int(np.count_nonzero(together))


class _Measured(NamedTuple):
    """The last pass over a circle."""

    circle: RoughCircle
    about: Ring
    strip: Strip
    blocks: Blocks
    weights: Floats  # before the fit
    fit: Fit
    width_px: float


def measure_circle(pixels: Pixels, rough: RoughCircle, expected: ExpectedCircle, limits: Limits) -> Circle:
    """Measure a circle from a start good to some pixels. Raises NotFound when a limit is not kept."""
    if abs(rough.radius_px - expected.radius_px) > limits.radius_px + 2.0:
        raise _wrong_radius(rough.radius_px, expected, limits)
    if rough.rival > limits.max_rival:
        detail = f"{rough.rival:.0%} of it has another round outline at its side, allowed are {limits.max_rival:.0%}"
        raise NotFound("hole rival", detail)
    seen = _measured(pixels, rough, 1 if expected.dark_inside else -1, limits)
    circle = Circle(
        centre=seen.circle.centre,
        radius_px=seen.circle.radius_px,
        covariance_px2=as_matrix(covariance(seen.about.design, seen.fit, seen.weights)[:2, :2]),
        appearance=appearance(seen.strip, seen.blocks, seen.fit.weights, seen.width_px, 0.5 * limits.min_contrast),
        inliers=float(np.mean(seen.fit.weights > 0.0)),
        residual_px=seen.fit.spread,
    )
    accept_outline(circle.appearance, circle.inliers, circle.residual_px, limits, "hole")
    if abs(circle.radius_px - expected.radius_px) > limits.radius_px:
        raise _wrong_radius(circle.radius_px, expected, limits)
    return circle


def _measured(pixels: Pixels, rough: RoughCircle, outward: int, limits: Limits) -> _Measured:
    (centre, radius, width, _), whole = rough, round(rough.radius_px)
    about = ring(whole, pixels.shape[1])
    check_inside(pixels, round(centre.u), round(centre.v), whole + BAND_PX)
    strip = ring_strip(pixels, about, centre, radius - whole, outward)
    for rounds in ROUNDS:
        blocks = block_offsets(strip, width)
        weights = beliefs(strip, blocks, 0.5 * limits.min_contrast)
        check_seen(strip, weights, FEWEST_SECTORS, limits, "hole")
        fit = tukey_fit(about.design, -outward * blocks.shift, weights, rounds)
        du, dv, growth = fit.parameters.tolist()
        centre, radius = Px(centre.u + du, centre.v + dv), radius + growth
        width = better_width(blocks, fit.weights, width)
        strip = strip.moved(outward * (about.design @ fit.parameters))
    return _Measured(rough._replace(centre=centre, radius_px=radius), about, strip, blocks, weights, fit, width)


def _wrong_radius(radius: float, expected: ExpectedCircle, limits: Limits) -> NotFound:
    detail = f"{radius:.1f} px, expected are {expected.radius_px:.1f} +- {limits.radius_px:.1f}"
    return NotFound("hole radius", detail)
