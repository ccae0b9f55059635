"""One side of a seated battery: the dark slit between the seat's edge and the battery's, caught and measured. Pure.

Distances across count from the seat towards the battery. The seat's direction is known well before, from the base;
so the slit is caught in the mean profiles of groups of blocks, and only then measured block by block.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cellctl.vision.covariance import as_matrix
from cellctl.vision.features import Appearance, Edge, ExpectedEdge, Floats, Limits, Matrix, NotFound, Pixels, Singles
from cellctl.vision.gates import accept_outline
from cellctl.vision.line import FEWEST_BLOCKS
from cellctl.vision.offsets import Offsets, block_weights, typical_height
from cellctl.vision.robust import Bools, Fit, influences, line_consensus, middle, tukey_fit, widening
from cellctl.vision.scan import Line, Places, Scan, edge_covariance
from cellctl.vision.steps import HAAR_PX
from cellctl.vision.strip import BLOCK_PX
from cellctl.vision.two_steps import Profiles, TwoSteps, fit_two_steps, misfit_px

BAND_PX = 7.0  # beyond either edge
GROUP_BLOCKS = 5  # neighbouring blocks whose mean profile is searched
NARROWEST_PX = 2.0  # width and depth of a slit below that cannot be told apart
WIDE_PX = 6.0  # from here on a slit shows its own blur; below that, blur and width look alike
PASSES = ((3, 2), (3, 3), (1, 5))  # every third block with two rounds of the robust fit, then all
ROUGHER = 2.0  # rims and walls scatter more than an outer edge: allowed against the limits of those
MOST_SD_PX = 1.2  # of the width
BLURS_PX = (0.6, 3.0)
BLUR_SD_PX = 0.05  # how well the blur is known


class Reach(NamedTuple):
    """How far off a seat's edge may be, how wide a slit is searched for, and the blur that the camera has shown."""

    search_px: float
    widest_px: float
    blur_px: float


@dataclass(frozen=True)
class Slit:
    """The gap along one side of a corner. Both edges run the way the expected edge does."""

    seat: Edge
    battery: Edge
    width_px: float  # between the edges, at the middle of the measured stretch
    covariance: Matrix  # (2, 2): width px, angle deg of the battery's edge against the seat's (from u to v)


class Course(NamedTuple):
    """Where a slit is looked for: its scan, a line near the seat's edge, and the columns or rows (blocks, pixels)."""

    scan: Scan
    line: Line
    along: Places

    @property
    def towards(self) -> float:
        """+1 when the battery lies at larger `across`: away from the bright base."""
        return -self.scan.rising

    def apart_px(self, seat: Line, battery: Line) -> float:
        """How far behind one line the other lies, across it, at the middle."""
        return self.towards * seat.cosine * (battery.height - seat.height)

    @property
    def middles(self) -> Floats:
        """Of the blocks, along."""
        return np.asarray(self.along.mean(axis=1), np.float64)


class _Pair(NamedTuple):
    """Lines of the seat's and the battery's edge."""

    seat: Line
    battery: Line


class _EdgeFit(NamedTuple):
    """One edge in a pass: what the blocks said of it, how far they were believed, and the robust straight fit."""

    offsets: Offsets
    weights: Floats
    fit: Fit


class _Fits(NamedTuple):
    """Both edges in a pass."""

    seat: _EdgeFit
    battery: _EdgeFit
    steps: TwoSteps

    @property
    def good(self) -> Bools:
        """Blocks that both fits use."""
        return (self.seat.fit.weights > 0.0) & (self.battery.fit.weights > 0.0)

    @property
    def blur_change_px(self) -> float:
        """How much blurrier than assumed the good blocks are."""
        asked, clear = self.steps.blur_asked[:, self.good].sum(axis=1)
        return float(asked / clear) if clear > 0.0 else 0.0


def course(pixels: Pixels, edge: ExpectedEdge, first: int, last: int, name: str) -> Course:
    """The blocks of a seat's edge in the scanned range. Raises NotFound when too little of it is in the picture."""
    scan = Scan.of(edge)
    blocks = (last - first) // BLOCK_PX
    if blocks < 3 * FEWEST_BLOCKS:
        raise NotFound(name, f"only {max(0, last - first)} px of it are in the picture")
    along = first + np.arange(blocks * BLOCK_PX).reshape(blocks, BLOCK_PX)
    return Course(scan, line_of(scan, edge).moved(float(along.mean())), along)


def line_of(scan: Scan, edge: Edge | ExpectedEdge) -> Line:
    """The line through both ends of an edge, in the scan's coordinates."""
    slope = (scan.across(edge.end) - scan.across(edge.start)) / (scan.along(edge.end) - scan.along(edge.start))
    return Line(scan.along(edge.start), scan.across(edge.start), slope)


def measure_slit(pixels: Pixels, way: Course, reach: Reach, limits: Limits, name: str) -> Slit:
    """Find and measure the slit along a seat's edge. Raises NotFound with the check that failed."""
    pair = _caught(pixels, way, reach, limits, name)
    blur = reach.blur_px
    for every, rounds in PASSES:
        part = way._replace(along=way.along[::every])
        seen = _profiles(pixels, part, pair, name)
        fits = _fitted(part, pair, fit_two_steps(seen, blur), rounds, limits, name)
        pair = _Pair(_moved(pair.seat, fits.seat.fit), _moved(pair.battery, fits.battery.fit))
        if every > 1 and way.apart_px(*pair) > WIDE_PX:
            blur = min(max(blur + fits.blur_change_px, BLURS_PX[0]), BLURS_PX[1])
    slit = _slit(way, pair, fits, seen, blur)
    _accept(slit, limits, name)
    return slit


# -- catching ----------------------------------------------------------------------------------------------


def _caught(pixels: Pixels, way: Course, reach: Reach, limits: Limits, name: str) -> _Pair:
    """Both edges to about a pixel: a step down and, within the widest slit, a step up, in most groups of blocks."""
    groups = len(way.along) // GROUP_BLOCKS
    along = way.along[: groups * GROUP_BLOCKS]
    first, last = -reach.search_px - 2 * HAAR_PX, reach.search_px + reach.widest_px + 2 * HAAR_PX
    levels, distance = _window(pixels, way._replace(along=along), way.line, (first, last), name)
    profile = levels.reshape(groups, GROUP_BLOCKS * BLOCK_PX, -1).mean(axis=1)
    down, up, depth = _deepest(profile, round(reach.widest_px))
    start = distance.reshape(groups, GROUP_BLOCKS * BLOCK_PX, -1)[:, :, 0].mean(axis=1)
    strong = depth > 0.4 * limits.min_contrast
    t = along.reshape(groups, -1).mean(axis=1) - way.line.at
    seat, battery = (
        _line_through(way, t[strong], (way.towards * (start + place) / way.line.cosine)[strong]) for place in (down, up)
    )
    if seat is None or battery is None:
        raise NotFound(name, f"{np.count_nonzero(strong)} of {groups} stretches show a dark slit, and not on one line")
    return _Pair(seat, battery)


def _deepest(profile: Singles, widest: int) -> tuple[Floats, Floats, Singles]:
    """Places of the best step down and step up behind it in each profile (n, m), px, and the smaller one's height."""
    total = np.concatenate([np.zeros((len(profile), 1), np.float32), np.cumsum(profile, axis=1)], axis=1)
    ahead, centre, behind = total[:, 2 * HAAR_PX :], total[:, HAAR_PX:-HAAR_PX], total[:, : -2 * HAAR_PX]
    rise = (ahead + behind - 2.0 * centre) / HAAR_PX
    behind_it = sliding_window_view(rise[:, 2:], widest - 1, axis=1)
    both = np.minimum(-rise[:, : behind_it.shape[1]], behind_it.max(axis=-1))
    row, down = np.arange(len(both)), both.argmax(axis=1)
    up = down + 2 + behind_it[row, down].argmax(axis=-1)
    return down + HAAR_PX - 0.5, up + HAAR_PX - 0.5, both[row, down]


def _line_through(way: Course, t: Floats, across: Floats) -> Line | None:
    """The line that most groups agree on, from their distances to the course's line."""
    together = line_consensus(t, across)
    if together is None or np.count_nonzero(together) < 4:
        return None
    fit = tukey_fit(np.stack([np.ones_like(t), t], axis=1), across, together.astype(np.float64), 2)
    height, slope = (float(p) for p in fit.parameters)
    return Line(way.line.at, way.line.height + height, way.line.slope + slope)


# -- measuring ---------------------------------------------------------------------------------------------


def _profiles(pixels: Pixels, way: Course, pair: _Pair, name: str) -> Profiles:
    """The blocks' pixels from a little before the seat's edge to a little behind the battery's."""
    apart = way.towards * pair.seat.cosine * (pair.battery.across(way.along) - pair.seat.across(way.along))
    levels, past_seat = _window(pixels, way, pair.seat, (-BAND_PX, BAND_PX + max(0.0, float(apart.max()))), name)
    past_battery = past_seat - apart.reshape(-1, 1).astype(np.float32)
    blocks = len(way.along)
    return Profiles(levels.reshape(blocks, -1), past_seat.reshape(blocks, -1), past_battery.reshape(blocks, -1))


def _fitted(way: Course, pair: _Pair, steps: TwoSteps, rounds: int, limits: Limits, name: str) -> _Fits:
    """Robust straight fits to the blocks' shifts. Raises NotFound when too few blocks see both edges."""
    least = 0.5 * limits.min_contrast
    design = np.stack([np.ones(len(way.along)), way.middles - way.line.at], axis=1)
    edges = []
    for offsets, line in ((steps.down, pair.seat), (steps.up, pair.battery)):
        weights = block_weights(offsets, least)
        shift = offsets.shift * (way.towards / line.cosine)
        edges.append(_EdgeFit(offsets, weights, tukey_fit(design, shift, weights, rounds)))
    fits = _Fits(edges[0], edges[1], steps)
    if np.count_nonzero(fits.good) < FEWEST_BLOCKS:
        raise NotFound(name, f"{np.count_nonzero(fits.good)} of {len(fits.good)} blocks see both edges")
    return fits


def _moved(line: Line, fit: Fit) -> Line:
    return Line(line.at, line.height + float(fit.parameters[0]), line.slope + float(fit.parameters[1]))


def _window(
    pixels: Pixels, way: Course, line: Line, span_px: tuple[float, float], name: str
) -> tuple[Singles, Singles]:
    """Levels of the pixels across a line, and their distances past it: (columns, pixels). Raises NotFound."""
    along = way.along.reshape(-1)
    across = line.across(along)
    whole = np.rint(across).astype(np.int64)
    k = np.arange(math.floor(span_px[0] / line.cosine), math.ceil(span_px[1] / line.cosine) + 1)
    furthest = whole[[0, -1]][:, None] + int(way.towards) * k[[0, -1]]
    if furthest.min() < 0 or furthest.max() >= way.scan.limits(pixels)[1]:
        raise NotFound(name, "it lies at the rim of the picture")
    step, side = way.scan.strides(pixels)
    places = (along * step + whole * side)[:, None] + int(way.towards) * side * k
    distance = k.astype(np.float32) - (way.towards * (across - whole)).astype(np.float32)[:, None]
    return pixels.reshape(-1).take(places).astype(np.float32), distance * np.float32(line.cosine)


# -- the result --------------------------------------------------------------------------------------------


def _slit(way: Course, pair: _Pair, fits: _Fits, seen: Profiles, blur: float) -> Slit:
    """The measurement; its errors count what else lies beside the edges and how well the blur is known."""
    t, good, cosine = way.middles, fits.good, pair.seat.cosine
    design = np.stack([np.ones(t.size), t - way.line.at], axis=1)
    moved, beside, edges = [], [], []
    sides = ((pair.seat, fits.seat, seen.past_down), (pair.battery, fits.battery, seen.past_up))
    for number, (line, edge, past) in enumerate(sides):
        moved.append(math.sqrt(widening(edge.fit)) * influences(design, edge.fit, edge.weights))
        look = _appearance(fits.steps, edge, number, blur, seen.levels)
        beside.append(misfit_px(fits.steps.rest[good], past[good], look.contrast, blur, round(BAND_PX)))
        spread = moved[-1] @ moved[-1].T + np.diag([(beside[-1] / cosine) ** 2, 0.0])
        edges.append(_edge(way, line, edge.fit, spread, look))
    to_angle = math.degrees(cosine * cosine) * (1.0 if way.scan.axis == 0 else -1.0)
    carried = np.diag([way.towards * cosine, to_angle]) @ (moved[1] - moved[0])
    blurred = BLUR_SD_PX * float(np.median(fits.steps.width_by_blur[good]))
    spread = carried @ carried.T + np.diag([beside[0] ** 2 + beside[1] ** 2 + blurred**2, 0.0])
    return Slit(edges[0], edges[1], way.apart_px(*pair), as_matrix(spread))


def _edge(way: Course, line: Line, fit: Fit, spread: Floats, appearance: Appearance) -> Edge:
    used = way.middles[fit.weights > 0.0]
    ends = [float(used[i]) for i in ((0, -1) if way.scan.forward else (-1, 0))]
    start, end = (way.scan.point(along, line.moved(along).height) for along in ends)
    return Edge(
        start=start,
        end=end,
        covariance=edge_covariance(way.scan, line, start, end, spread),
        appearance=appearance,
        inliers=float(np.mean(fit.weights > 0.0)),
        residual_px=fit.spread * line.cosine,
    )


def _appearance(steps: TwoSteps, edge: _EdgeFit, number: int, blur: float, levels: Singles) -> Appearance:
    """How the picture shows the seat's edge (0) or the battery's (1)."""
    good = edge.fit.weights > 0.0
    before, between, behind = (middle(side[good]) for side in steps.levels.T)
    return Appearance(
        blur_px=blur,
        contrast=typical_height(edge.offsets, 0.0),
        noise=math.sqrt(middle(edge.offsets.variance[good])),
        dark=between,
        bright=(before, behind)[number],
        saturated=float(np.mean(levels >= 254.5)),
    )


def _accept(slit: Slit, limits: Limits, name: str) -> None:
    """Raises NotFound for the first limit that is not kept."""
    rougher = replace(limits, max_residual_px=ROUGHER * limits.max_residual_px)
    for edge, of in ((slit.seat, "seat"), (slit.battery, "battery")):
        accept_outline(edge.appearance, edge.inliers, edge.residual_px, rougher, f"{of}'s edge {name}")
    width_sd_px, angle_sd_deg = (math.sqrt(slit.covariance[i][i]) for i in (0, 1))
    if width_sd_px > MOST_SD_PX or angle_sd_deg > ROUGHER * limits.max_angle_sd_deg:
        detail = f"only known to {width_sd_px:.2f} px and {angle_sd_deg * 1e3:.0f} mdeg"
        raise NotFound(name, f"{detail}, allowed are {MOST_SD_PX} and {ROUGHER * limits.max_angle_sd_deg * 1e3:.0f}")
    if slit.width_px < NARROWEST_PX:
        raise NotFound(name, f"only {slit.width_px:.1f} px wide, from {NARROWEST_PX:g} px on it can be measured")
