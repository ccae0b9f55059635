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
from cellctl.vision.gates import accept_outline
from cellctl.vision.outline import Measured, Outline
from cellctl.vision.robust import Rays, circle_consensus, middle, rays, tukey_fit
from cellctl.vision.steps import PLATEAU_PX, Response, Steps, respond, true_steps
from cellctl.vision.strip import BAND_PX, Strip, check_inside, ring, ring_strip

RAYS = 72
RAY_PX = 30  # to either side of the outline
FEWEST_SECTORS = 12
GROWTH_PX = 24.0  # a circle is caught, and its radius then refused, up to this much beside its radius


class _Calipers(NamedTuple):
    """Radial calipers about a pixel: steps to their pixels in the flat picture (3, rays * px), and the rays."""

    places: NDArray[np.intp]
    rays: Rays


@lru_cache(maxsize=8)
def _calipers(radius: int, width: int) -> _Calipers:
    phi = np.linspace(0.0, 2.0 * math.pi, RAYS, endpoint=False)
    c, s = np.cos(phi)[:, None], np.sin(phi)[:, None]
    reach = RAY_PX + PLATEAU_PX
    r, beside = radius + np.arange(-reach, reach + 1), np.array([-1.5, 0.0, 1.5])[:, None, None]
    du, dv = np.rint(c * r - s * beside), np.rint(s * r + c * beside)
    return _Calipers((dv * width + du).astype(np.intp).reshape(3, -1), rays(phi))


class RoughCircle(NamedTuple):
    """A circle good to about a pixel."""

    centre: Px
    radius_px: float
    width_px: float  # of the blur, roughly
    rival: float  # share of its rays that see another circle's outline near its own


def catch_circle(pixels: Pixels, centre: Px, expected: ExpectedCircle, min_contrast: float) -> RoughCircle:
    """The circle that most radial calipers about a rough centre agree on. Raises NotFound when they do not."""
    radius, outward = round(expected.radius_px), 1 if expected.dark_inside else -1
    calipers = _calipers(radius, pixels.shape[1])
    u, v = round(centre.u), round(centre.v)
    check_inside(pixels, u, v, expected.radius_px + RAY_PX + PLATEAU_PX)
    taken = pixels.reshape(-1).take(calipers.places + (v * pixels.shape[1] + u))
    profiles = np.add.reduce(taken, axis=0, dtype=np.uint16).reshape(RAYS, -1)[:, ::outward].astype(np.float32)
    seen = respond(profiles)
    steps = true_steps(seen)
    strong = steps.height > 1.5 * min_contrast  # of the sum of three
    d = outward * (steps.place - (RAY_PX + PLATEAU_PX))
    together = circle_consensus(calipers.rays, d, strong, GROWTH_PX)
    if together is None or np.count_nonzero(together) < FEWEST_SECTORS:
        raise NotFound("hole", f"no round outline near ({centre.u:.0f}, {centre.v:.0f}) px")
    used = steps.only(together)
    shift = tukey_fit(calipers.rays.design, d, together.astype(np.float64), 2).parameters
    found = outward * (calipers.rays.design @ shift)
    beside = _beside(seen, found + (RAY_PX + PLATEAU_PX), calipers.rays, used)
    du, dv, growth = shift.tolist()
    return RoughCircle(Px(u + du, v + dv), radius + growth, used.width(), beside / used.place.size)


def _beside(seen: Response, place: Floats, about: Rays, used: Steps) -> int:
    """How many rays see a second step of at least half the height that makes another circle."""
    other = true_steps(seen.without(place))
    strong = other.height > 0.5 * middle(used.height)
    together = circle_consensus(about, other.place - (RAY_PX + PLATEAU_PX), strong, RAY_PX)
    return 0 if together is None else int(np.count_nonzero(together))


def check_rough(rough: RoughCircle, expected: ExpectedCircle, limits: Limits) -> None:
    """Raises NotFound when this cannot be the circle, or another one could be."""
    if abs(rough.radius_px - expected.radius_px) > limits.radius_px + 2.0:
        raise _wrong_radius(rough.radius_px, expected, limits)
    if rough.rival > limits.max_rival:
        detail = f"{rough.rival:.0%} of it has another round outline at its side, allowed are {limits.max_rival:.0%}"
        raise NotFound("hole rival", detail)


def circle_strip(pixels: Pixels, rough: RoughCircle, expected: ExpectedCircle, rows: int) -> tuple[Strip, Outline]:
    """The blocks of a caught circle, and what moves them: its centre and its radius. Raises NotFound."""
    (centre, radius, width, _), whole = rough, round(rough.radius_px)
    outward = 1 if expected.dark_inside else -1
    check_inside(pixels, round(centre.u), round(centre.v), whole + BAND_PX)
    about = ring(whole, pixels.shape[1], rows)
    strip = ring_strip(pixels, about, centre, radius - whole, outward)
    begin = np.array([centre.u, centre.v, radius])
    return strip, Outline("hole", outward * about.design, begin, width, FEWEST_SECTORS)


def circle_of(seen: Measured, expected: ExpectedCircle, limits: Limits) -> Circle:
    """The measured circle. Raises NotFound when a limit is not kept."""
    u, v, radius = (float(p) for p in seen.parameters)
    circle = Circle(
        centre=Px(u, v),
        radius_px=radius,
        covariance_px2=as_matrix(seen.spread[:2, :2]),
        appearance=seen.appearance,
        inliers=seen.inliers,
        residual_px=seen.residual_px,
    )
    accept_outline(circle.appearance, circle.inliers, circle.residual_px, limits, "hole")
    if abs(circle.radius_px - expected.radius_px) > limits.radius_px:
        raise _wrong_radius(circle.radius_px, expected, limits)
    return circle


def _wrong_radius(radius: float, expected: ExpectedCircle, limits: Limits) -> NotFound:
    detail = f"{radius:.1f} px, expected are {expected.radius_px:.1f} +- {limits.radius_px:.1f}"
    return NotFound("hole radius", detail)
