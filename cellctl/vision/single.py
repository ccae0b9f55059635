"""Find one feature: a hole (or pin) of known radius, or a straight edge. Pure."""

from __future__ import annotations

from cellctl.vision.circle import RoughCircle, catch_circle, check_rough, circle_of, circle_strip
from cellctl.vision.coarse import line_votes, rough_circle, rough_lines
from cellctl.vision.features import Circle, Edge, ExpectedCircle, ExpectedEdge, Limits, NotFound, Pixels, Search
from cellctl.vision.gates import check_in_view
from cellctl.vision.line import FEWEST_BLOCKS, Stretch, catch_lines, edge_of, lane_of, line_outline
from cellctl.vision.outline import measure
from cellctl.vision.picture import checked, checked_search
from cellctl.vision.scan import Line, Scan, stretch
from cellctl.vision.strip import BAND_PX, BLOCK_PX, Lane, line_strip

RADII_PX = (40.0, 4000.0)
ROWS = 19  # of the hole's profiles: as many as most edges have


def find_circle(pixels: Pixels, circle: ExpectedCircle, search: Search, limits: Limits) -> Circle:
    """Measure a circle within `search.position_px` of its expected place.

    Raises NotFound with the check that failed, ValueError when the picture or the expectation is none.
    """
    pixels = checked(pixels)
    rough = roughly_circle(pixels, circle, search, limits)
    strip, outline = circle_strip(pixels, rough, circle, ROWS)
    return circle_of(measure(strip, [outline], limits)[0], circle, limits)


def find_edge(pixels: Pixels, edge: ExpectedEdge, search: Search, limits: Limits) -> Edge:
    """Measure a straight edge whose middle lies within `search.position_px` across of its expected place.

    Raises NotFound with the check that failed, ValueError when the picture or the expectation is none.
    """
    pixels = checked(pixels)
    found = roughly_edge(pixels, edge, search, limits)
    lane = lane_of(found, limits)
    seen = measure(line_strip(pixels, [lane], BAND_PX), [line_outline(found, lane)], limits)[0]
    return edge_of(found, lane, seen, limits)[1]


def roughly_circle(pixels: Pixels, circle: ExpectedCircle, search: Search, limits: Limits) -> RoughCircle:
    """The circle to about a pixel. Raises NotFound, or ValueError for an expectation that is none."""
    checked_search(search, circle.centre)
    if not RADII_PX[0] <= circle.radius_px <= RADII_PX[1]:
        raise ValueError(f"expected a hole of {RADII_PX[0]:.0f} to {RADII_PX[1]:.0f} px radius, got {circle.radius_px}")
    centre = rough_circle(pixels, circle, search.position_px, limits)
    rough = catch_circle(pixels, centre, circle, limits.min_contrast)
    check_rough(rough, circle, limits)
    return rough


def roughly_edge(pixels: Pixels, edge: ExpectedEdge, search: Search, limits: Limits) -> Stretch:
    """The edge to about a pixel. Raises NotFound, or ValueError for an expectation that is none."""
    checked_search(search, edge.start, edge.end)
    votes = line_votes(pixels, edge, search.position_px, search.angle_deg, limits.min_contrast, "edge")
    scan = Scan.of(edge)
    first, last = stretch(scan, pixels, edge.start, edge.end)
    check_in_view(first, last, scan.along(edge.end) - scan.along(edge.start), limits, "edge")
    blocks = (last - first) // BLOCK_PX
    lanes = [Lane(scan, Line.through(scan, rough), first, blocks) for rough in rough_lines(votes, 1)]
    for caught in catch_lines(pixels, lanes, limits.min_contrast) if lanes and blocks >= FEWEST_BLOCKS else ():
        if caught is not None:
            return Stretch("edge", scan, caught, first, last)
    raise NotFound("edge", f"no straight edge within {search.position_px:.0f} px of its place")
