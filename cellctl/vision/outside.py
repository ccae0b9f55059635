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
from cellctl.vision.features import Edge, NotFound, Pixels, Singles
from cellctl.vision.plane import cross, direction
from cellctl.vision.robust import line_consensus, middle
from cellctl.vision.steps import HAAR_PX

STATIONS = 16  # along the edge
FEWEST = 10  # of them: what covers up to half of an edge has an outer border too, and the edge is the true one
BEGIN_PX = 4.0  # so far from the edge its own blur is over
LIKE_IT = 0.45  # of the edge's contrast: of a stripe of two pixels, no more is left
FALLING = np.repeat(np.array([[1.0, -1.0]], np.float32), HAAR_PX, axis=1)


class Border(NamedTuple):
    """The measured edge of a part, and any point on that side of it where the part is."""

    name: str
    edge: Edge
    bright_left: bool
    inside: Px


def check_outside(pixels: Pixels, border: Border, reach_px: float) -> None:
    """Raises NotFound when most of the edge has a step like its own at one distance within `reach_px` outside it."""
    steps = _steps_outside(pixels, border, reach_px)
    place = steps.argmax(axis=1).astype(np.float64)
    (strong,) = (steps.max(axis=1) > LIKE_IT * HAAR_PX * border.edge.contrast).nonzero()
    together = line_consensus(strong.astype(np.float64), place[strong]) if strong.size >= FEWEST else None
    if together is not None and np.count_nonzero(together) >= FEWEST:
        apart, share = BEGIN_PX + HAAR_PX + middle(place[strong[together]]), np.count_nonzero(together) / STATIONS
        raise NotFound(f"{border.name} rival", f"{share:.0%} of it has another such edge {apart:.0f} px outside it")


def _steps_outside(pixels: Pixels, border: Border, reach_px: float) -> Singles:
    """How large a step of the edge's polarity is (stations, px), in sums of so many pixels, from near it outwards."""
    start, end = border.edge.start, border.edge.end
    way = direction(start, end)
    inside_left = cross(way, Px(border.inside.u - start.u, border.inside.v - start.v)) < 0.0
    out = Px(-way.v, way.u) if inside_left else Px(way.v, -way.u)
    gap = math.dist(start, end) / (STATIONS - 1)
    walk = np.array([(out[i], gap * way[i], start[i] + BEGIN_PX * out[i]) for i in (0, 1)])
    nearest = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    size = round(reach_px) + 2 * HAAR_PX, STATIONS
    grey = cv2.warpAffine(pixels, walk, size, flags=nearest, borderMode=cv2.BORDER_REPLICATE)
    like_it = FALLING if inside_left == border.bright_left else -FALLING
    return np.asarray(cv2.filter2D(grey, cv2.CV_32F, like_it)[:, HAAR_PX : 1 - HAAR_PX], np.float32)
