"""Outside a part there is nothing: a second line like its edge, further out, is where the part really ends. Pure.

Something that lies on a part along its edge leaves a narrow stripe of it uncovered. To the calipers, which take thin
lines for scratches, that stripe hides the true edge, and the inner border of what lies there is the better one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from cellctl.geometry import Px
from cellctl.vision.features import Edge, NotFound, Pixels
from cellctl.vision.picture import Shorts
from cellctl.vision.plane import cross, direction
from cellctl.vision.robust import line_consensus, middle, straight, tukey_fit

STATIONS = 16  # along the edge
FEWEST = 12  # of them: scratches are shorter, and what covers half of an edge has an outer border too
BEGIN_PX = 4.0  # so far from the edge its own blur is over
LIKE_IT = 0.35  # of the edge's contrast: the blur leaves no more of a stripe of two pixels
EVERY_PX = 2  # every second pixel outwards is looked at: reading pixels from memory takes longest
BOX = 2  # of them to either side of a step
FALLING = np.repeat(np.array([[1.0, -1.0]], np.float32), BOX, axis=1)


class Border(NamedTuple):
    """The measured edge of a part, and any point on that side of it where the part is."""

    name: str
    edge: Edge
    bright_left: bool
    inside: Px


def check_outside(pixels: Pixels, border: Border, reach_px: float, parallel_deg: float) -> None:
    """Raises NotFound when a line like the edge, as parallel to it as that, is seen within `reach_px` outside it."""
    steps = _steps_outside(pixels, border, reach_px)
    place = BEGIN_PX + EVERY_PX * (steps.argmax(axis=1) + (BOX - 0.5))
    (strong,) = (steps.max(axis=1) > LIKE_IT * BOX * border.edge.contrast).nonzero()
    together = line_consensus(strong.astype(np.float64), place[strong]) if strong.size >= FEWEST else None
    if together is None or np.count_nonzero(together) < FEWEST:
        return
    design = straight(strong[together] * _gap_px(border.edge))
    fit = tukey_fit(design, place[strong[together]], np.ones(len(design)), 2)
    if abs(math.degrees(math.atan(fit.parameters[1]))) < parallel_deg:
        share, apart = len(design) / STATIONS, middle(place[strong[together]])
        raise NotFound(f"{border.name} rival", f"{share:.0%} of it has another such edge {apart:.0f} px outside it")


def _gap_px(edge: Edge) -> float:
    """From station to station."""
    return math.dist(edge.start, edge.end) / (STATIONS - 1)


def _steps_outside(pixels: Pixels, border: Border, reach_px: float) -> Shorts:
    """Steps of the polarity of the edge (stations, places) in grey levels times BOX, from near it outwards."""
    start, end = border.edge.start, border.edge.end
    way = direction(start, end)
    inside_left = cross(way, Px(border.inside.u - start.u, border.inside.v - start.v)) < 0.0
    out = Px(-way.v, way.u) if inside_left else Px(way.v, -way.u)
    gap = _gap_px(border.edge)
    walk = np.array([(EVERY_PX * out[i], gap * way[i], start[i] + BEGIN_PX * out[i]) for i in (0, 1)])
    nearest = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    size = round(reach_px / EVERY_PX) + 2 * BOX, STATIONS
    grey = cv2.warpAffine(pixels, walk, size, flags=nearest, borderMode=cv2.BORDER_REPLICATE)
    like_it = FALLING if inside_left == border.bright_left else -FALLING
    return np.asarray(cv2.filter2D(grey, cv2.CV_16S, like_it)[:, BOX : 1 - BOX], np.int16)
