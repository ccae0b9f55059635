"""Round outlines anywhere in a picture, of any size: for teaching, where nothing is known yet. Pure.

Points of outlines vote for centres (a Hough vote finds, it does not measure); each of the best circles is then
followed in the full picture to see how much of it is really there, and how strong it is.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from cellctl.geometry import Px
from cellctl.vision.edgels import (
    GOOD_CONTRAST,
    LEAST_CONTRAST,
    SCALE,
    Edgels,
    blocks_of,
    find_edgels,
    strip_across,
    to_full,
)
from cellctl.vision.features import ExpectedCircle, Pixels
from cellctl.vision.picture import checked
from cellctl.vision.robust import circle_consensus, middle, rays, tukey_fit
from cellctl.vision.steps import step_response

RADII_PX = (36, 860)
BIN = 2  # px of the quarter picture that vote for one centre
CENTRES_PER_RADIUS = 3
LEAST_COVERAGE = 0.45  # part of a circle that must be there
MOST_CIRCLES = 12
RAYS, RAYS_PER_BLOCK, RAY_PX = 512, 4, 24
SAME_PX = 6.0  # circles closer than this are one


class RoundOutline(NamedTuple):
    """A circle that is there: its mean contrast and the part of it that is seen."""

    circle: ExpectedCircle
    contrast: float
    coverage: float

    @property
    def score(self) -> float:
        """By how much of it there is to measure: dirt is small."""
        return self.coverage * self.circle.radius_px * min(self.contrast, GOOD_CONTRAST)


def find_circles(pixels: Pixels) -> list[RoundOutline]:
    """All round outlines, best first. Raises ValueError when the picture is none."""
    pixels = checked(pixels)
    edgels = find_edgels(pixels)
    found: list[RoundOutline] = []
    for guess in _guesses(edgels):
        if any(_same_circle(guess, other.circle, 4.0 * SAME_PX) for other in found):
            continue
        outline = follow_circle(pixels, guess)
        if outline is not None and not any(_same_circle(outline.circle, other.circle, SAME_PX) for other in found):
            found.append(outline)
        if len(found) == MOST_CIRCLES:
            break
    return sorted(found, key=lambda outline: -outline.score)


def _guesses(edgels: Edgels) -> list[ExpectedCircle]:
    """Circles by the part of their outline that votes for them, best first."""
    votes = []
    for radius in range(RADII_PX[0] // SCALE, RADII_PX[1] // SCALE):
        for dark in (True, False):
            for share, u, v in _centres(edgels, radius if dark else -radius):
                votes.append((share, ExpectedCircle(Px(to_full(u), to_full(v)), float(SCALE * radius), dark)))
    return [circle for share, circle in sorted(votes, key=lambda vote: -vote[0]) if share > LEAST_COVERAGE]


def _centres(edgels: Edgels, step: int) -> list[tuple[float, float, float]]:
    """The most voted centres `step` px towards the dark side of the points: share of the outline, u, v."""
    u = ((edgels.u - step * edgels.along_u) / BIN).astype(np.intp)
    v = ((edgels.v - step * edgels.along_v) / BIN).astype(np.intp)
    width, height = edgels.width // BIN + 1, edgels.height // BIN + 1
    inside = (u > 0) & (u < width) & (v > 0) & (v < height)
    count = np.bincount(v[inside] * width + u[inside], minlength=width * height).reshape(height, width)
    wide = max(3, round(0.05 * abs(step) / BIN) // 2 * 2 + 1)
    sums = cv2.boxFilter(count.astype(np.float32), -1, (wide, wide), normalize=False, borderType=cv2.BORDER_CONSTANT)
    best = []
    for _ in range(CENTRES_PER_RADIUS):
        _, most, _, (at_u, at_v) = cv2.minMaxLoc(sums)
        best.append((most / (2.0 * math.pi * abs(step)), BIN * (at_u + 0.5), BIN * (at_v + 0.5)))
        cv2.circle(sums, (at_u, at_v), max(2, abs(step) // (4 * BIN)), 0.0, -1)
    return best


def _same_circle(one: ExpectedCircle, other: ExpectedCircle, within_px: float) -> bool:
    apart = math.dist(one.centre, other.centre) + abs(one.radius_px - other.radius_px)
    return apart < within_px and one.dark_inside == other.dark_inside


def follow_circle(pixels: Pixels, guess: ExpectedCircle) -> RoundOutline | None:
    """A circle that is known to some pixels, by radial lines across its outline; None when too little is there."""
    phi = (np.arange(RAYS) + 0.5) * (2.0 * math.pi / RAYS)
    out = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    strip = strip_across(pixels, np.array(guess.centre) + guess.radius_px * out, out, RAY_PX)
    blocks = blocks_of(strip, RAYS_PER_BLOCK)
    hit, height = step_response(blocks, 1.0 if guess.dark_inside else -1.0)
    at = phi.reshape(-1, RAYS_PER_BLOCK).mean(axis=1)
    about, away = rays(at), hit - RAY_PX
    together = circle_consensus(about, away, height > LEAST_CONTRAST, 0.5 * RAY_PX)
    if together is None:
        return None
    fit = tukey_fit(about.design, away, together.astype(np.float64), 4)
    coverage = np.count_nonzero(fit.weights) / len(blocks)
    if coverage < LEAST_COVERAGE:
        return None
    du, dv, growth = (float(p) for p in fit.parameters)
    circle = ExpectedCircle(Px(guess.centre.u + du, guess.centre.v + dv), guess.radius_px + growth, guess.dark_inside)
    return RoundOutline(circle, middle(height[fit.weights > 0.0]), coverage)
