"""One straight edge: caught by calipers near its rough place, measured by blocks of 16 columns or rows. Pure.

An edge that runs nearer to the picture's rows is scanned by columns, the others by rows. "Along" is the scanned
coordinate, "across" the one that is measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Px
from cellctl.vision.coarse import RoughLine
from cellctl.vision.features import Edge, ExpectedEdge, Floats, Limits, NotFound, Pixels, Singles
from cellctl.vision.gates import accept_outline
from cellctl.vision.profile import (
    START_BLUR_PX,
    Offsets,
    block_offsets,
    block_weights,
    estimate_blur,
    typical_height,
)
from cellctl.vision.robust import Fit, covariance, line_consensus, middle, tukey_fit

Places: TypeAlias = NDArray[np.int64]

BLOCK_PX = 16
BAND_PX = 7.0  # to either side of the edge, measured across it
CALIPERS = 64
CALIPER_PX = 20  # to either side of the rough line
HAAR_PX = 4  # half width of the step detector
FEWEST_BLOCKS = 8
PASSES = ((3, 2), (1, 5))  # every third block with two rounds of the robust fit, then all with five


@dataclass(frozen=True)
class Scan:
    """How an edge is scanned: along columns (axis 0) or rows (axis 1)."""

    axis: int
    rising: float  # +1: brighter for larger `across`
    forward: bool  # the expected edge runs towards larger `along`

    @classmethod
    def of(cls, edge: ExpectedEdge) -> Scan:
        """The scan that suits an edge of any direction."""
        du, dv = edge.end.u - edge.start.u, edge.end.v - edge.start.v
        axis = 0 if abs(du) >= abs(dv) else 1
        left_is_greater = du < 0.0 if axis == 0 else dv > 0.0  # across grows to the left hand
        return cls(axis, 1.0 if left_is_greater == edge.bright_left else -1.0, (dv if axis else du) > 0.0)

    def along(self, p: Px) -> float:
        """The scanned coordinate of a point."""
        return p[self.axis]

    def across(self, p: Px) -> float:
        """The measured coordinate of a point."""
        return p[1 - self.axis]

    def point(self, along: float, across: float) -> Px:
        """The point with these coordinates."""
        return Px(along, across) if self.axis == 0 else Px(across, along)

    def limits(self, pixels: Pixels) -> tuple[int, int]:
        """Number of pixels along and across."""
        height, width = pixels.shape
        return (width, height) if self.axis == 0 else (height, width)

    def strides(self, pixels: Pixels) -> tuple[int, int]:
        """Steps in the flat picture along and across."""
        width = pixels.shape[1]
        return (1, width) if self.axis == 0 else (width, 1)


class Line(NamedTuple):
    """across = height + slope * (along - at)."""

    at: float
    height: float
    slope: float

    def across(self, along: Floats | Places) -> Floats:
        """Where the line is."""
        return np.asarray(self.height + self.slope * (along - self.at), np.float64)

    def moved(self, at: float) -> Line:
        """The same line, referred to another place along."""
        return Line(at, self.height + self.slope * (at - self.at), self.slope)

    @property
    def cosine(self) -> float:
        """Of the angle between the line and the scan direction."""
        return 1.0 / math.hypot(1.0, self.slope)


class Caught(NamedTuple):
    """A line through caliper hits; the score grows with the number of hits and, less, with their contrast."""

    line: Line
    score: float


def line_through(scan: Scan, rough: RoughLine) -> Line:
    """A rough line in the scan's coordinates."""
    slope = rough.way[1 - scan.axis] / rough.way[scan.axis]
    return Line(scan.along(rough.point), scan.across(rough.point), slope)


def stretch(scan: Scan, pixels: Pixels, one: Px, two: Px) -> tuple[int, int]:
    """The scanned range from one point to another, as far as it is in the picture."""
    ends = sorted((scan.along(one), scan.along(two)))
    return max(2, math.ceil(ends[0])), min(scan.limits(pixels)[0] - 3, math.floor(ends[1]))


def catch_line(pixels: Pixels, scan: Scan, near: Line, first: int, last: int, min_contrast: float) -> Caught | None:
    """The line that most calipers near a rough line agree on; None when they do not agree."""
    if last - first < FEWEST_BLOCKS * BLOCK_PX:
        return None
    along = np.linspace(first, last, CALIPERS).astype(np.int64)
    reach = math.ceil(CALIPER_PX / near.cosine)
    across = np.rint(near.across(along)).clip(reach, scan.limits(pixels)[1] - reach - 1).astype(np.int64)
    step, side = scan.strides(pixels)
    places = (along * step + across * side)[:, None] + np.arange(-reach, reach + 1) * side
    flat = pixels.reshape(-1)
    profile = flat.take(places).astype(np.float32)
    profile += flat.take(places - step)
    profile += flat.take(places + step)
    hit, height = step_response(profile / np.float32(3.0), scan.rising)
    strong = height > 0.5 * min_contrast
    t, n = (along[strong] - near.at).astype(np.float64), (across + hit - reach)[strong]
    together = line_consensus(t, n)
    if together is None or np.count_nonzero(together) < 3:
        return None
    fit = tukey_fit(np.stack([np.ones_like(t), t], axis=1), n, together.astype(np.float64), 2)
    score = np.count_nonzero(fit.weights) / CALIPERS * math.sqrt(middle(height[strong][together]))
    return Caught(Line(near.at, float(fit.parameters[0]), float(fit.parameters[1])), score)


def step_response(profiles: Singles, rising: float) -> tuple[Floats, Singles]:
    """Place and height of the largest step in each profile (n, m), by the difference of two boxes."""
    total = np.cumsum(profiles, axis=1)
    total = np.concatenate([np.zeros((len(total), 1), total.dtype), total], axis=1)
    centre = total[:, HAAR_PX : total.shape[1] - HAAR_PX]
    response = total[:, 2 * HAAR_PX :] + total[:, : total.shape[1] - 2 * HAAR_PX] - 2.0 * centre
    response *= np.float32(rising / HAAR_PX)
    best = response.argmax(axis=1)
    row = np.arange(len(response))
    inner = best.clip(1, response.shape[1] - 2)
    before, at, after = (response[row, inner + k] for k in (-1, 0, 1))
    bend = before - 2.0 * at + after
    part = 0.5 * (before - after) / np.where(np.abs(bend) > 1e-6, bend, 1.0)
    return best + np.clip(part, -1.0, 1.0) + (HAAR_PX - 0.5), response[row, best]


class _Band(NamedTuple):
    """Pixels about a line in blocks (blocks, pixels): levels and signed distances towards the bright side."""

    levels: Singles
    distance: Singles


def measure_line(
    pixels: Pixels, scan: Scan, line: Line, first: int, last: int, limits: Limits, name: str
) -> tuple[Line, Edge]:
    """Measure an edge within the scanned range, starting from a line good to some pixels; it runs as expected.

    Raises NotFound with `name` when too few blocks see an edge, or when a limit is not kept.
    """
    blocks = (last - first) // BLOCK_PX
    if blocks < FEWEST_BLOCKS:
        raise NotFound(name, f"only {max(0, last - first)} px of it are in the picture")
    along = first + np.arange(blocks * BLOCK_PX).reshape(blocks, BLOCK_PX)
    t = along.mean(axis=1)
    line = line.moved(float(t.mean()))
    design = np.stack([np.ones(blocks), t - line.at], axis=1)
    blur = START_BLUR_PX
    for every, rounds in PASSES:
        band = _band(pixels, scan, line, along[::every].reshape(-1))
        offsets = block_offsets(band.levels, band.distance, blur)
        weights = block_weights(offsets, 0.5 * limits.min_contrast)
        if np.count_nonzero(weights) < FEWEST_BLOCKS // every:
            raise NotFound(name, f"{np.count_nonzero(weights)} of {len(weights)} blocks see an edge")
        shift = -offsets.shift * (scan.rising / line.cosine)
        fit = tukey_fit(design[::every], shift, weights, rounds)
        line = Line(line.at, line.height + float(fit.parameters[0]), line.slope + float(fit.parameters[1]))
        blur = estimate_blur(band.levels, band.distance, offsets, fit.weights) or blur if every > 1 else blur
    edge = _edge(scan, line, t, fit, covariance(design, fit, weights), offsets, blur, limits)
    _accept(edge, band, limits, name)
    return line, edge


def _band(pixels: Pixels, scan: Scan, line: Line, along: Places) -> _Band:
    half = math.ceil(BAND_PX / line.cosine)
    across = line.across(along)
    whole = np.rint(across).clip(half, scan.limits(pixels)[1] - half - 1)
    step, side = scan.strides(pixels)
    offset = np.arange(-half, half + 1)
    places = (along * step + whole.astype(np.int64) * side)[:, None] + offset * side
    distance = offset.astype(np.float32) - (across - whole).astype(np.float32)[:, None]
    distance *= np.float32(scan.rising * line.cosine)
    levels = pixels.reshape(-1).take(places).astype(np.float32)
    return _Band(levels.reshape(-1, BLOCK_PX * offset.size), distance.reshape(-1, BLOCK_PX * offset.size))


def _edge(
    scan: Scan, line: Line, t: Floats, fit: Fit, spread: Floats, offsets: Offsets, blur: float, limits: Limits
) -> Edge:
    used = t[fit.weights > 0.0] if fit.weights.any() else t
    ends = [float(used[i]) for i in ((0, -1) if scan.forward else (-1, 0))]
    start, end = (scan.point(along, line.moved(along).height) for along in ends)
    cosine = line.cosine
    return Edge(
        start=start,
        end=end,
        offset_sd_px=math.sqrt(max(0.0, float(spread[0, 0]))) * cosine,
        angle_sd_deg=math.degrees(math.sqrt(max(0.0, float(spread[1, 1]))) * cosine * cosine),
        blur_px=blur,
        contrast=typical_height(offsets, 0.5 * limits.min_contrast),
        inliers=float(np.mean(fit.weights > 0.0)),
        residual_px=fit.spread * cosine,
    )


def _accept(edge: Edge, band: _Band, limits: Limits, name: str) -> None:
    """Raises NotFound for the first limit that the edge does not keep."""
    accept_outline(edge.contrast, edge.inliers, edge.residual_px, band.levels, limits, name)
    if edge.angle_sd_deg > limits.max_angle_sd_deg:
        detail = f"its angle is only known to {edge.angle_sd_deg * 1e3:.1f} mdeg"
        raise NotFound(f"{name} angle", f"{detail}, allowed are {limits.max_angle_sd_deg * 1e3:.1f}")
