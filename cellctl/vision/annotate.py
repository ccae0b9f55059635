"""The picture as a person wants to see it: half size, with what was expected and what was found drawn in. Pure."""

from __future__ import annotations

import math
import textwrap
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Px
from cellctl.vision.features import (
    BaseMeasurement,
    BatteryMeasurement,
    Edge,
    ExpectedCircle,
    ExpectedEdge,
    Pixels,
)
from cellctl.vision.gap import GapMeasurement
from cellctl.vision.picture import checked

Colour: TypeAlias = tuple[int, int, int]  # blue, green, red

EXPECTED: Colour = (200, 170, 60)
FOUND: Colour = (60, 220, 60)
MARK: Colour = (40, 60, 240)
TEXT: Colour = (255, 255, 255)
SHIFT = 4  # drawing in 1/16 px
FARTHEST = 1e5  # drawing stays within what OpenCV's fixed point holds
CROSS_PX = 14.0
LINE_HEIGHT_PX, CHARACTER_PX, TEXT_SCALE = 26, 11.5, 0.62


def annotate(
    pixels: Pixels,
    measurement: BaseMeasurement | BatteryMeasurement | Edge | GapMeasurement | None,
    expected: tuple[ExpectedCircle | ExpectedEdge, ...],
    caption: str,
) -> NDArray[np.uint8]:
    """A half-size BGR copy of the picture (height // 2, width // 2, 3) with features and caption drawn in.

    Raises ValueError when `pixels` is no picture.
    """
    height, width = checked(pixels).shape
    half = cv2.resize(pixels, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    drawn = np.asarray(cv2.cvtColor(half, cv2.COLOR_GRAY2BGR), np.uint8)
    for feature in expected:
        if isinstance(feature, ExpectedCircle):
            _circle(drawn, feature.centre, feature.radius_px, EXPECTED, 1)
        else:
            _line(drawn, feature.start, feature.end, EXPECTED, 1)
    _found(drawn, measurement)
    _caption(drawn, caption)
    return drawn


def _found(
    drawn: NDArray[np.uint8], measurement: BaseMeasurement | BatteryMeasurement | Edge | GapMeasurement | None
) -> None:
    if isinstance(measurement, BaseMeasurement):
        _circle(drawn, measurement.circle.centre, measurement.circle.radius_px, FOUND, 2)
        _line(drawn, measurement.edge.start, measurement.edge.end, FOUND, 2)
        _cross(drawn, measurement.circle.centre)
    elif isinstance(measurement, BatteryMeasurement):
        for edge in (measurement.edge_1, measurement.edge_2):
            _line(drawn, edge.start, edge.end, FOUND, 2)
            _line(drawn, measurement.corner, edge.start, FOUND, 1)
        _cross(drawn, measurement.corner)
    elif isinstance(measurement, GapMeasurement):
        _gap(drawn, measurement)
    elif measurement is not None:
        _line(drawn, measurement.start, measurement.end, FOUND, 2)


def _gap(drawn: NDArray[np.uint8], measurement: GapMeasurement) -> None:
    for slit in (measurement.slit_1, measurement.slit_2):
        for edge, colour in ((slit.seat, EXPECTED), (slit.battery, FOUND)):
            _line(drawn, edge.start, edge.end, colour, 1)
    for corner in (measurement.seat_corner, measurement.battery_corner):
        _cross(drawn, corner)


def _fixed(p: Px) -> tuple[int, int] | None:
    """A point of the picture in the half-size picture, in 1/16 px; None when it is nowhere near."""
    u, v = ((x + 0.5) / 2.0 - 0.5 for x in p)
    if not (abs(u) < FARTHEST and abs(v) < FARTHEST):
        return None
    return round(u * (1 << SHIFT)), round(v * (1 << SHIFT))


def _line(drawn: NDArray[np.uint8], start: Px, end: Px, colour: Colour, thickness: int) -> None:
    a, b = _fixed(start), _fixed(end)
    if a is not None and b is not None:
        cv2.line(drawn, a, b, colour, thickness, cv2.LINE_AA, SHIFT)


def _circle(drawn: NDArray[np.uint8], centre: Px, radius_px: float, colour: Colour, thickness: int) -> None:
    middle = _fixed(centre)
    if middle is not None and math.isfinite(radius_px) and 0.0 <= radius_px < FARTHEST:
        cv2.circle(drawn, middle, round(radius_px / 2.0 * (1 << SHIFT)), colour, thickness, cv2.LINE_AA, SHIFT)


def _cross(drawn: NDArray[np.uint8], at: Px) -> None:
    for du, dv in ((CROSS_PX, 0.0), (0.0, CROSS_PX)):
        _line(drawn, Px(at.u - du, at.v - dv), Px(at.u + du, at.v + dv), MARK, 1)


def _caption(drawn: NDArray[np.uint8], caption: str) -> None:
    """The caption on a dark bar at the bottom, in as many lines as it needs and the picture has."""
    height, width = drawn.shape[:2]
    plain = caption.encode("ascii", "replace").decode()
    lines = textwrap.wrap(plain, max(8, int(width / CHARACTER_PX) - 2))[: max(1, height // (2 * LINE_HEIGHT_PX))]
    top = height - LINE_HEIGHT_PX * len(lines) - 6
    if lines:
        drawn[max(0, top) :] //= 3
    for number, line in enumerate(lines):
        at = (10, top + LINE_HEIGHT_PX * (number + 1) - 4)
        cv2.putText(drawn, line, at, cv2.FONT_HERSHEY_SIMPLEX, TEXT_SCALE, TEXT, 1, cv2.LINE_AA)
