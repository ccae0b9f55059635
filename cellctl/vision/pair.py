"""The two edges of a corner, roughly: lines that most calipers see and that stand to each other as expected. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from cellctl.geometry import Px, wrap_deg
from cellctl.vision.coarse import Votes, line_votes, rough_lines, turns_the_same_way
from cellctl.vision.features import ExpectedEdge, Limits, NotFound, Pixels, Search, Singles
from cellctl.vision.line import FEWEST_BLOCKS, Caught, catch_lines
from cellctl.vision.plane import ahead, angle_deg, direction
from cellctl.vision.scan import Line, Scan, stretch
from cellctl.vision.strip import BLOCK_PX, Lane

ROUGH_SQUARE_DEG = 0.8  # rough lines may be so far from the expected angle between them
HYPOTHESES = 4  # lines of a side that are looked at, when so many have nearly as many votes: mostly it is one
DISTINCT_PX = 8.0  # lines closer than this are one
SPARE_PX = 8.0


class Side(NamedTuple):
    """One expected edge of a corner: it starts at the corner."""

    name: str
    edge: ExpectedEdge
    scan: Scan

    @property
    def way(self) -> Px:
        """Unit vector away from the corner."""
        return direction(self.edge.start, self.edge.end)

    @property
    def length_px(self) -> float:
        """From the corner to the end of the used stretch."""
        return math.dist(self.edge.start, self.edge.end)

    def used(self, pixels: Pixels, corner: Px, way: Px, skip_px: float) -> tuple[int, int]:
        """The scanned range of the edge when the corner and the way are these."""
        return stretch(self.scan, pixels, ahead(corner, way, skip_px), ahead(corner, way, self.length_px))


class Near(NamedTuple):
    """A rough line of a side, the way it runs from the corner, and its score."""

    caught: Caught
    way: Px


Sides = tuple[Side, Side]


def square_off_deg(sides: Sides, one: Px, two: Px) -> float:
    """The angle between two ways less the expected one."""
    return wrap_deg(angle_deg(one, two) - angle_deg(sides[0].way, sides[1].way))


def catch_pair(pixels: Pixels, sides: Sides, search: Search, limits: Limits) -> tuple[Near, Near]:
    """The best pair of rough lines. Raises NotFound: no light, no lines, none that fit together, or a rival."""
    votes = _joint_votes(pixels, sides, search, limits)
    found = _catch(pixels, sides, votes, limits)
    for side, lines in zip(sides, found, strict=True):
        if not lines:
            raise NotFound(side.name, f"no straight edge within {search.position_px:.0f} px of its place")
    pairs = [(a, b) for a in found[0] for b in found[1] if abs(square_off_deg(sides, a.way, b.way)) < ROUGH_SQUARE_DEG]
    if not pairs:
        raise NotFound("squareness", f"no two edges within {ROUGH_SQUARE_DEG} deg of the expected angle")
    best = max(pairs, key=lambda pair: pair[0].caught.score + pair[1].caught.score)
    for side, chosen, lines in zip(sides, best, found, strict=True):
        _check_rivals(side, chosen, lines, limits)
    return best


def _joint_votes(pixels: Pixels, sides: Sides, search: Search, limits: Limits) -> tuple[Votes, Votes]:
    """Votes for both sides; each turn is backed by the other side's votes for the same turn of the part."""
    edges = [side.edge._replace(start=ahead(side.edge.start, side.way, limits.corner_skip_px)) for side in sides]
    turned_px = max(side.length_px for side in sides) * math.tan(math.radians(search.angle_deg))
    reach = search.position_px + turned_px + SPARE_PX
    one, two = (
        line_votes(pixels, edge, reach, search.angle_deg, limits.min_contrast, side.name)
        for edge, side in zip(edges, sides, strict=True)
    )
    same = 1 if turns_the_same_way(*edges) else -1
    return _backed(one, two.heights.max(axis=1)[::same]), _backed(two, one.heights.max(axis=1)[::same])


def _backed(votes: Votes, support: Singles) -> Votes:
    """Votes with support per turn (give or take two) added wherever there are votes at all."""
    wide = cv2.dilate(np.ascontiguousarray(support).reshape(-1, 1), np.ones((5, 1), np.uint8))
    return votes._replace(heights=np.where(votes.heights > 0.0, votes.heights + wide, 0.0).astype(np.float32))


def _catch(pixels: Pixels, sides: Sides, votes: tuple[Votes, Votes], limits: Limits) -> tuple[list[Near], list[Near]]:
    """The lines of both sides: all are looked at together."""
    lanes: list[tuple[int, Lane]] = []
    for number, (side, vote) in enumerate(zip(sides, votes, strict=True)):
        first, last = side.used(pixels, side.edge.start, side.way, limits.corner_skip_px)
        blocks = (last - first) // BLOCK_PX
        if blocks >= FEWEST_BLOCKS:
            lanes += [
                (number, Lane(side.scan, Line.through(side.scan, rough), first, blocks))
                for rough in rough_lines(vote, HYPOTHESES)
            ]
    found: tuple[list[Near], list[Near]] = [], []
    if lanes:
        caught = catch_lines(pixels, [lane for _, lane in lanes], limits.min_contrast)
        for (number, _), each in zip(lanes, caught, strict=True):
            if each is not None:
                found[number].append(_near(sides[number], each))
    return found


def _near(side: Side, caught: Caught) -> Near:
    along = math.copysign(caught.line.cosine, side.way[side.scan.axis])
    return Near(caught, side.scan.point(along, along * caught.line.slope))


def _check_rivals(side: Side, chosen: Near, lines: list[Near], limits: Limits) -> None:
    """Raises NotFound when another distinct line is nearly as good."""
    for other in lines:
        line, share = other.caught.line, other.caught.score / chosen.caught.score
        apart = abs(line.height - chosen.caught.line.moved(line.at).height)
        if apart > DISTINCT_PX and share > limits.max_rival:
            detail = f"another line {apart:.0f} px away has {share:.0%} of its score"
            raise NotFound(f"{side.name} rival", f"{detail}, allowed are {limits.max_rival:.0%}")
