"""Find one feature: a hole (or pin) of known radius, or a straight edge. Pure."""

from __future__ import annotations

from cellctl.vision.circle import catch_circle, measure_circle
from cellctl.vision.coarse import line_votes, rough_circle, rough_lines
from cellctl.vision.features import Circle, Edge, ExpectedCircle, ExpectedEdge, Limits, NotFound, Pixels, Search
from cellctl.vision.gates import check_in_view
from cellctl.vision.line import catch_line, measure_line
from cellctl.vision.picture import checked, checked_search
from cellctl.vision.scan import Line, Scan, stretch

RADII_PX = (40.0, 4000.0)


def find_circle(pixels: Pixels, circle: ExpectedCircle, search: Search, limits: Limits) -> Circle:
    """Measure a circle within `search.position_px` of its expected place.

    Raises NotFound with the check that failed, ValueError when the picture or the expectation is none.
    """
    pixels = checked(pixels)
    checked_search(search, circle.centre)
    if not RADII_PX[0] <= circle.radius_px <= RADII_PX[1]:
        raise ValueError(f"expected a hole of {RADII_PX[0]:.0f} to {RADII_PX[1]:.0f} px radius, got {circle.radius_px}")
    centre = rough_circle(pixels, circle, search.position_px, limits)
    return measure_circle(pixels, catch_circle(pixels, centre, circle, limits.min_contrast), circle, limits)


def find_edge(pixels: Pixels, edge: ExpectedEdge, search: Search, limits: Limits) -> Edge:
    """Measure a straight edge whose middle lies within `search.position_px` across of its expected place.

    Raises NotFound with the check that failed, ValueError when the picture or the expectation is none.
    """
    pixels = checked(pixels)
    checked_search(search, edge.start, edge.end)
    votes = line_votes(pixels, edge, search.position_px, search.angle_deg, limits.min_contrast, "edge")
    scan = Scan.of(edge)
    first, last = stretch(scan, pixels, edge.start, edge.end)
    check_in_view(first, last, scan.along(edge.end) - scan.along(edge.start), limits, "edge")
    for rough in rough_lines(votes, 1):
        caught = catch_line(pixels, scan, Line.through(scan, rough), first, last, limits.min_contrast)
        if caught is not None:
            return measure_line(pixels, scan, caught, first, last, limits, "edge")[1]
    raise NotFound("edge", f"no straight edge within {search.position_px:.0f} px of its place")
