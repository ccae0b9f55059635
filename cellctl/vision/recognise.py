"""Which of all outlines of a picture are the base's hole and edge, or the battery's corner. Pure.

The strongest round outline is the hole, the longest strong edge beside it the reference edge, the strongest two edges
that end at each other at a right angle the corner. A choice that is not clear is not made: `Undecided` has the
candidates, and a person points.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

from cellctl.geometry import Px
from cellctl.vision.blind_circles import RoundOutline, find_circles
from cellctl.vision.blind_lines import find_lines
from cellctl.vision.features import ExpectedCircle, ExpectedEdge, NotFound, Pixels
from cellctl.vision.plane import ahead, cross, direction
from cellctl.vision.stretches import StraightOutline

CLEAR = 0.7  # the second best choice has at most this part of the best one's score
SQUARE_DEG = 3.0
PAST_CORNER_PX = 60.0  # edges end so near the point where their lines meet
MOST_ROUNDING_PX = 1100.0  # radius of the rounded corner: 8 mm at 136 px/mm

Feature = ExpectedCircle | ExpectedEdge
T = TypeVar("T")


class Undecided(NotFound):
    """Several features could be the one that is meant: `candidates`, best first."""

    def __init__(self, what: str, candidates: Sequence[Feature]) -> None:
        super().__init__(what, f"{len(candidates)} features could be it")
        self.candidates = tuple(candidates)


class Corner(NamedTuple):
    """Two edges that run away from the point where their lines meet, `at`; clean are they from start to end."""

    one: StraightOutline
    two: StraightOutline
    at: Px

    @property
    def score(self) -> float:
        """That of the worse edge."""
        return min(self.one.score, self.two.score)

    @property
    def bright_inside(self) -> bool:
        """Whether the part is brighter than what lies around it."""
        inside_left = cross(_way(self.one.edge), _way(self.two.edge)) < 0.0
        return inside_left == self.one.edge.bright_left


def recognise_hole(pixels: Pixels) -> RoundOutline:
    """The hole. Raises NotFound when there is none and Undecided when others are nearly as good."""
    circles = find_circles(pixels)
    if not circles:
        raise NotFound("hole", "there is no round outline in the picture")
    return _clear_best("hole", circles, lambda circle: circle.score, lambda circle: [circle.circle])


def recognise_edge(pixels: Pixels, hole: ExpectedCircle) -> StraightOutline:
    """The reference edge beside the hole, from one end of its clean stretch to the other.

    Raises NotFound when there is none and Undecided when others are nearly as good.
    """
    lines = [line for line in find_lines(pixels) if away_px(line.edge, hole.centre) > hole.radius_px]
    if not lines:
        raise NotFound("edge", "there is no straight edge beside the hole")
    return _clear_best("edge", lines, lambda line: line.score, lambda line: [line.edge])


def recognise_corner(pixels: Pixels) -> Corner:
    """The battery's corner. Raises NotFound when there is none and Undecided when others are nearly as good."""
    pairs = itertools.combinations(find_lines(pixels), 2)
    corners = [corner for pair in pairs if (corner := corner_of(*pair)) is not None]
    if not corners:
        raise NotFound("corner", "no two straight edges end at each other at a right angle")
    return _clear_best("corner", corners, lambda corner: corner.score, lambda c: [c.one.edge, c.two.edge])


def _clear_best(
    what: str, found: Sequence[T], score: Callable[[T], float], shown: Callable[[T], Sequence[Feature]]
) -> T:
    """The best when it is clearly the best; raises Undecided with all that are about as good."""
    ordered = sorted(found, key=score, reverse=True)
    good = [each for each in ordered if score(each) > CLEAR * score(ordered[0])]
    if len(good) > 1:
        raise Undecided(what, list(dict.fromkeys(feature for each in good for feature in shown(each))))
    return ordered[0]


def corner_of(one: StraightOutline, two: StraightOutline) -> Corner | None:
    """The corner of two edges; None when they do not end at each other, or do not enclose a part."""
    square = cross(_way(one.edge), _way(two.edge))
    if abs(square) < math.cos(math.radians(SQUARE_DEG)):
        return None
    between = Px(two.edge.start.u - one.edge.start.u, two.edge.start.v - one.edge.start.v)
    at = ahead(one.edge.start, _way(one.edge), cross(between, _way(two.edge)) / square)
    sides = [_running_away(outline, at) for outline in (one, two)]
    if sides[0] is None or sides[1] is None:
        return None
    corner = Corner(sides[0], sides[1], at)
    return corner if corner.bright_inside == Corner(sides[1], sides[0], at).bright_inside else None


def _running_away(outline: StraightOutline, corner: Px) -> StraightOutline | None:
    """The outline as an edge that begins near the corner; None when it goes past it, or begins far away."""
    edge, way = outline.edge, _way(outline.edge)
    start, end = ((p.u - corner.u) * way.u + (p.v - corner.v) * way.v for p in (edge.start, edge.end))
    if -PAST_CORNER_PX < start < MOST_ROUNDING_PX:
        return outline
    if -MOST_ROUNDING_PX < end < PAST_CORNER_PX:
        return outline._replace(edge=ExpectedEdge(edge.end, edge.start, not edge.bright_left))
    return None


def away_px(edge: ExpectedEdge, point: Px) -> float:
    """Distance of a point from an edge's line."""
    return abs(cross(_way(edge), Px(point.u - edge.start.u, point.v - edge.start.v)))


def _way(edge: ExpectedEdge) -> Px:
    return direction(edge.start, edge.end)
