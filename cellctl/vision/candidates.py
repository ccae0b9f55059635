"""A picture with numbered candidates, for a person to choose from. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.vision.annotate import MARK, annotate
from cellctl.vision.features import ExpectedCircle, ExpectedEdge, Pixels
from cellctl.vision.plane import middle

NUMBER_SCALE = 1.1


def draw_candidates(
    pixels: Pixels, candidates: Sequence[ExpectedCircle | ExpectedEdge], caption: str
) -> NDArray[np.uint8]:
    """A half-size BGR copy of the picture with every candidate outlined and numbered from 1."""
    drawn = annotate(pixels, None, tuple(candidates), caption)
    for number, feature in enumerate(candidates, 1):
        u, v = _label(feature, number)
        at = round(u / 2.0), round(v / 2.0)
        cv2.putText(drawn, str(number), at, cv2.FONT_HERSHEY_SIMPLEX, NUMBER_SCALE, MARK, 2, cv2.LINE_AA)
    return drawn


def _label(feature: ExpectedCircle | ExpectedEdge, number: int) -> tuple[float, float]:
    """Where a candidate's number stands, px: concentric circles get theirs in different directions."""
    if isinstance(feature, ExpectedEdge):
        return middle(feature.start, feature.end)
    angle = math.radians(40.0 * number)
    reach = feature.radius_px
    return feature.centre.u + reach * math.cos(angle), feature.centre.v - reach * math.sin(angle)
