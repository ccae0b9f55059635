"""Straight edges: caught by calipers near their rough places, measured by blocks of 16 columns or rows. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cellctl.vision.features import Edge, Floats, Limits, NotFound, Pixels, Singles
from cellctl.vision.gates import accept_outline
from cellctl.vision.outline import Measured, Outline
from cellctl.vision.robust import line_consensus, middle, straight, tukey_fit
from cellctl.vision.scan import Line, Scan, edge_covariance
from cellctl.vision.steps import PLATEAU_PX, Steps, respond, true_steps
from cellctl.vision.strip import BLOCK_PX, Lane, line_strip

CALIPER_PX = 32  # to either side of the rough line: beyond, another edge is another peak of the votes
SKIP = 8  # calipers take two columns of each block
FEWEST_BLOCKS = 8
FEWEST_HITS = 6


class Caught(NamedTuple):
    """A line through caliper hits; the score grows with the number of hits and, less, with their contrast."""

    line: Line
    width_px: float  # of the blur, roughly
    score: float
    rival: float  # share of its calipers that see another such step at one distance beside it


class _Hits(NamedTuple):
    """What the calipers of one lane see of its line."""

    t: Floats  # of all calipers, along, from the line's reference
    line: Line
    place: Floats  # of the line in the profiles of all calipers
    used: Steps  # those that make the line: none when they do not agree
    inliers: int


def catch_lines(pixels: Pixels, lanes: Sequence[Lane], min_contrast: float) -> list[Caught | None]:
    """For each lane, the line that most of its calipers agree on; None when they do not agree."""
    strip = line_strip(pixels, lanes, CALIPER_PX + PLATEAU_PX, SKIP)
    seen = respond(np.ascontiguousarray(strip.levels.T))
    steps = true_steps(seen)
    hits = [
        _hits(lane, strip.distance[0, part.where], steps.only(part.where), 0.5 * min_contrast)
        for lane, part in zip(lanes, strip.parts, strict=True)
    ]
    other = true_steps(seen.without(np.concatenate([hit.place for hit in hits])))
    return [
        _caught(lane, hit, other.only(part.where)) for lane, hit, part in zip(lanes, hits, strip.parts, strict=True)
    ]


def _hits(lane: Lane, begin: Singles, steps: Steps, least: float) -> _Hits:
    """The line through the steps of a lane; `begin` is the distance of each profile's first row."""
    near, rising = lane.line, lane.scan.rising
    t, offset = lane.middles(SKIP) - near.at, begin / near.cosine + steps.place
    (strong,) = (steps.height > least).nonzero()
    together = line_consensus(t[strong], offset[strong])
    if together is None or np.count_nonzero(together) < FEWEST_HITS:
        return _Hits(t, near, steps.place, steps.only(slice(0)), 0)
    design, hits = straight(t), strong[together]
    fit = tukey_fit(design[hits], offset[hits], np.ones(hits.size), 2)
    height, slope = (rising * float(p) for p in fit.parameters)
    line = Line(near.at, near.height + height, near.slope + slope)
    place = steps.place - offset + design @ fit.parameters
    return _Hits(t, line, place, steps.only(hits), int(np.count_nonzero(fit.weights)))


def _caught(lane: Lane, hit: _Hits, other: Steps) -> Caught | None:
    """The line, and how many calipers see a second step of at least half its height at one distance beside it."""
    count = hit.used.place.size
    if count == 0:
        return None
    height = middle(hit.used.height)
    (strong,) = (other.height > 0.5 * height).nonzero()
    together = line_consensus(hit.t[strong], (other.place - hit.place)[strong])
    beside = 0 if together is None else int(np.count_nonzero(together))
    return Caught(hit.line, hit.used.width(), hit.inliers / lane.blocks * math.sqrt(height), beside / count)


class Stretch(NamedTuple):
    """The stretch of an edge that is to be measured."""

    name: str
    scan: Scan
    near: Caught
    first: int
    last: int


def lane_of(stretch: Stretch, limits: Limits) -> Lane:
    """Its blocks. Raises NotFound when they are too few, or when another edge could be meant."""
    name, scan, near, first, last = stretch
    blocks = (last - first) // BLOCK_PX
    if blocks < FEWEST_BLOCKS:
        raise NotFound(name, f"only {max(0, last - first)} px of it are in the picture")
    if near.rival > limits.max_rival:
        detail = f"{near.rival:.0%} of it has another edge at its side, allowed are {limits.max_rival:.0%}"
        raise NotFound(f"{name} rival", detail)
    return Lane(scan, near.line.moved(first + (blocks * BLOCK_PX - 1) / 2.0), first, blocks)


def line_outline(stretch: Stretch, lane: Lane) -> Outline:
    """What moves the blocks: height and slope of the line in the scan's coordinates."""
    line = lane.line
    design = (lane.scan.rising * line.cosine) * straight(lane.middles() - line.at)
    return Outline(stretch.name, design, np.array([line.height, line.slope]), stretch.near.width_px, FEWEST_BLOCKS)


def edge_of(stretch: Stretch, lane: Lane, seen: Measured, limits: Limits) -> tuple[Line, Edge]:
    """The measured edge. Raises NotFound when a limit is not kept."""
    height, slope = (float(p) for p in seen.parameters)
    line = Line(lane.line.at, height, slope)
    edge = _edge(lane, line, seen)
    accept_outline(edge.appearance, edge.inliers, edge.residual_px, limits, stretch.name)
    if edge.angle_sd_deg > limits.max_angle_sd_deg:
        detail = f"its angle is only known to {edge.angle_sd_deg * 1e3:.1f} mdeg"
        raise NotFound(f"{stretch.name} angle", f"{detail}, allowed are {limits.max_angle_sd_deg * 1e3:.1f}")
    return line, edge


def _edge(lane: Lane, line: Line, seen: Measured) -> Edge:
    scan, used = lane.scan, lane.middles()[seen.used]
    ends = [float(used[i]) for i in ((0, -1) if scan.forward else (-1, 0))]
    start, end = (scan.point(along, line.moved(along).height) for along in ends)
    return Edge(
        start=start,
        end=end,
        covariance=edge_covariance(scan, line, start, end, seen.spread),
        appearance=seen.appearance,
        inliers=seen.inliers,
        residual_px=seen.residual_px,
    )
