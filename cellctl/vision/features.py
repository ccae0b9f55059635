"""What vision is told to look for, what it found, and why it refused. Pixels: centres, u right, v down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Px

Pixels: TypeAlias = NDArray[np.uint8]
Floats: TypeAlias = NDArray[np.float64]
Singles: TypeAlias = NDArray[np.float32]


class NotFound(Exception):
    """A feature is not there, or not as it must be. `check` names the gate that said no, `detail` has its figures."""

    def __init__(self, check: str, detail: str) -> None:
        super().__init__(f"{check}: {detail}")
        self.check = check
        self.detail = detail


class ExpectedCircle(NamedTuple):
    """A hole (or pin) of known radius."""

    centre: Px
    radius_px: float
    dark_inside: bool


class ExpectedEdge(NamedTuple):
    """A straight edge, of any direction. Walking start -> end on the screen, is the bright side on the left hand?"""

    start: Px
    end: Px
    bright_left: bool


class Search(NamedTuple):
    """How far from the expected place a part may lie."""

    position_px: float
    angle_deg: float


@dataclass(frozen=True)
class Limits:
    """What a measurement must keep to be believed. The defaults suit 136 px/mm; a recipe gives the part's own."""

    radius_px: float = 11.0  # hole radius against the expected one
    hole_to_edge_px: float | None = None  # distance of the hole's centre from the reference edge; None: not checked
    hole_to_edge_tolerance_px: float = 14.0
    squareness_deg: float = 0.3  # angle between the battery's edges against the expected one
    corner_skip_px: float = 270.0  # the rounded corner and what is left out behind it
    min_inliers: float = 0.40  # part of an outline that agrees with the fitted shape
    max_residual_px: float = 0.35  # spread of the outline about the fitted shape
    max_angle_sd_deg: float = 0.02  # own prediction of the edge's angle error, 1 sigma
    min_contrast: float = 20.0  # grey levels across an edge
    max_saturated: float = 0.02  # part of the pixels along an edge that are at 255
    max_rival: float = 0.75  # second best line against the best one
    max_overrun: float = 0.40  # part of an edge's extension past the corner that still looks like the edge


@dataclass(frozen=True)
class Circle:
    """A measured circle."""

    centre: Px
    radius_px: float
    sd_px: float  # of the centre, 1 sigma per axis
    blur_px: float  # sigma of the edge's blur: drifts when the focus drifts
    contrast: float  # grey levels
    inliers: float
    residual_px: float


@dataclass(frozen=True)
class Edge:
    """A measured straight edge; start and end lie on the fitted line at the ends of the used stretch.

    It runs the way the expected edge does.
    """

    start: Px
    end: Px
    offset_sd_px: float  # across, at the middle, 1 sigma
    angle_sd_deg: float
    blur_px: float
    contrast: float
    inliers: float
    residual_px: float


@dataclass(frozen=True)
class BaseMeasurement:
    """A base as camera 1 sees it."""

    circle: Circle
    edge: Edge
    hole_to_edge_px: float


@dataclass(frozen=True)
class BatteryMeasurement:
    """A battery's corner as camera 2 sees it; the corner is where the edges' straight lines meet."""

    edge_1: Edge
    edge_2: Edge
    corner: Px
    corner_sd_px: float  # 1 sigma per axis
    squareness_deg: float  # angle from edge 1 to edge 2 less the expected one
