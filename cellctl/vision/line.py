"""One straight edge: caught by calipers near its rough place, measured by blocks of 16 columns or rows. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cellctl.vision.features import Edge, Floats, Limits, NotFound, Pixels
from cellctl.vision.gates import accept_outline, check_seen
from cellctl.vision.profile import Blocks, appearance, beliefs, better_width, block_offsets
from cellctl.vision.robust import Fit, covariance, line_consensus, middle, tukey_fit
from cellctl.vision.scan import Line, Scan, edge_covariance
from cellctl.vision.steps import PLATEAU_PX, Response, Steps, respond, true_steps
from cellctl.vision.strip import BAND_PX, BLOCK_PX, Strip, line_strip

CALIPER_PX = 28  # to either side of the rough line: beyond, another edge is another peak of the votes
SKIP = 4  # calipers take every fourth column
FEWEST_BLOCKS = 8
FEWEST_HITS = 6
ROUNDS = (2, 5)  # of the robust fit in the first and in the last pass


class Caught(NamedTuple):
    """A line through caliper hits; the score grows with the number of hits and, less, with their contrast."""

    line: Line
    width_px: float  # of the blur, roughly
    score: float
    rival: float  # share of its calipers that see another such step at one distance beside it


def catch_line(pixels: Pixels, scan: Scan, near: Line, first: int, last: int, min_contrast: float) -> Caught | None:
    """The line that most calipers near a rough line agree on; None when they do not agree."""
    blocks = (last - first) // BLOCK_PX
    if blocks < FEWEST_BLOCKS:
        return None
    strip = line_strip(pixels, scan, near, first, blocks, CALIPER_PX + PLATEAU_PX, SKIP)
    seen = respond(strip.levels)
    steps = true_steps(seen)
    t = _middles(first, blocks, SKIP) - near.at
    offset = strip.distance[:, 0] / near.cosine + steps.place
    n = near.slope * t + scan.rising * offset
    strong = steps.height > 0.5 * min_contrast
    together = line_consensus(t[strong], n[strong])
    if together is None or np.count_nonzero(together) < FEWEST_HITS:
        return None
    fit = tukey_fit(_straight(t[strong]), n[strong], together.astype(np.float64), 2)
    used = steps.only(strong).only(together)
    line = Line(near.at, near.height + float(fit.parameters[0]), float(fit.parameters[1]))
    beside = _beside(seen, steps.place + (_straight(t) @ fit.parameters - n) * scan.rising, t, used)
    score = np.count_nonzero(fit.weights) / blocks * math.sqrt(middle(used.height))
    return Caught(line, used.width(), score, beside / used.place.size)


def _straight(t: Floats) -> Floats:
    return np.stack([np.ones_like(t), t], axis=1)


def _beside(seen: Response, place: Floats, t: Floats, used: Steps) -> int:
    """How many calipers see a second step of at least half the height that follows the line at some distance."""
    other = true_steps(seen.without(place))
    strong = other.height > 0.5 * middle(used.height)
    together = line_consensus(t[strong], (other.place - place)[strong])
    return 0 if together is None else int(np.count_nonzero(together))


def _middles(first: int, blocks: int, every: int) -> Floats:
    """Along, of the columns (or rows) that each block takes."""
    return np.asarray(np.arange(blocks) * float(BLOCK_PX) + (first + (BLOCK_PX - every) / 2.0), np.float64)


class _Measured(NamedTuple):
    """The last pass over an edge."""

    line: Line
    t: Floats  # middles of the blocks along
    strip: Strip
    blocks: Blocks
    weights: Floats  # before the fit
    fit: Fit
    width_px: float


def measure_line(
    pixels: Pixels, scan: Scan, near: Caught, first: int, last: int, limits: Limits, name: str
) -> tuple[Line, Edge]:
    """Measure an edge within the scanned range, starting from a line good to a pixel or two; it runs as expected.

    Raises NotFound with `name` when too few blocks see an edge, or when a limit is not kept.
    """
    blocks = (last - first) // BLOCK_PX
    if blocks < FEWEST_BLOCKS:
        raise NotFound(name, f"only {max(0, last - first)} px of it are in the picture")
    if near.rival > limits.max_rival:
        detail = f"{near.rival:.0%} of it has another edge at its side, allowed are {limits.max_rival:.0%}"
        raise NotFound(f"{name} rival", detail)
    seen = _measured(pixels, scan, near, first, blocks, limits, name)
    edge = _edge(scan, seen, limits)
    accept_outline(edge.appearance, edge.inliers, edge.residual_px, limits, name)
    if edge.angle_sd_deg > limits.max_angle_sd_deg:
        detail = f"its angle is only known to {edge.angle_sd_deg * 1e3:.1f} mdeg"
        raise NotFound(f"{name} angle", f"{detail}, allowed are {limits.max_angle_sd_deg * 1e3:.1f}")
    return seen.line, edge


def _measured(
    pixels: Pixels, scan: Scan, near: Caught, first: int, blocks: int, limits: Limits, name: str
) -> _Measured:
    t = _middles(first, blocks, 1)
    line, width = near.line.moved(float(t[0] + t[-1]) / 2.0), near.width_px
    design = _straight(t - line.at)
    strip = line_strip(pixels, scan, line, first, blocks, BAND_PX)
    towards_bright = scan.rising * line.cosine
    for rounds in ROUNDS:
        seen = block_offsets(strip, width)
        weights = beliefs(strip, seen, 0.5 * limits.min_contrast)
        check_seen(strip, weights, FEWEST_BLOCKS, limits, name)
        fit = tukey_fit(design, -seen.shift / towards_bright, weights, rounds)
        line = Line(line.at, line.height + float(fit.parameters[0]), line.slope + float(fit.parameters[1]))
        width = better_width(seen, fit.weights, width)
        strip = strip.moved(towards_bright * (design @ fit.parameters))
    return _Measured(line, t, strip, seen, weights, fit, width)


def _edge(scan: Scan, seen: _Measured, limits: Limits) -> Edge:
    line, fit = seen.line, seen.fit
    used = seen.t[fit.weights > 0.0] if fit.weights.any() else seen.t
    ends = [float(used[i]) for i in ((0, -1) if scan.forward else (-1, 0))]
    start, end = (scan.point(along, line.moved(along).height) for along in ends)
    inliers = float(np.mean(fit.weights > 0.0))
    spread = covariance(_straight(seen.t - line.at), fit, seen.weights)
    return Edge(
        start=start,
        end=end,
        covariance=edge_covariance(scan, line, start, end, spread),
        appearance=appearance(seen.strip, seen.blocks, fit.weights, seen.width_px, 0.5 * limits.min_contrast),
        inliers=inliers,
        residual_px=fit.spread * line.cosine,
    )
