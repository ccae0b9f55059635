"""What vision is told to look for, what it found, and why it refused. Pixels: centres, u right, v down."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cellctl.geometry import Px

Pixels: TypeAlias = NDArray[np.uint8]
Floats: TypeAlias = NDArray[np.float64]
Singles: TypeAlias = NDArray[np.float32]
Matrix: TypeAlias = tuple[tuple[float, ...], ...]


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
    min_inliers: float = 0.25  # part of an outline that agrees with the fitted shape
    max_residual_px: float = 0.35  # spread of the outline about the fitted shape
    max_angle_sd_deg: float = 0.02  # own prediction of the edge's angle error, 1 sigma
    min_contrast: float = 20.0  # grey levels across an edge
    max_saturated: float = 0.30  # part of an outline that is over-exposed; that part is not measured
    max_rival: float = 0.75  # second best outline against the best one
    max_blur_px: float = 3.0  # sigma of an outline's blur
    min_in_view: float = 0.7  # part of an expected edge that must be in the picture
    max_overrun: float = 0.40  # part of an edge's extension past the corner that still looks like the edge


class Appearance(NamedTuple):
    """How the picture shows an outline: what focus, light and exposure are judged by."""

    blur_px: float  # sigma of the edge's Gaussian blur: drifts when the focus drifts
    contrast: float  # grey levels from the dark to the bright side
    noise: float  # grey levels, one sigma of the pixels about the fitted profile: sensor noise and texture
    dark: float  # grey level beside the outline
    bright: float
    saturated: float  # share of the pixels along the outline that are at 255


@dataclass(frozen=True)
class Circle:
    """A measured circle."""

    centre: Px
    radius_px: float
    covariance_px2: Matrix  # (2, 2) of the centre: u, v
    appearance: Appearance
    inliers: float
    residual_px: float

    @property
    def sd_px(self) -> float:
        """Of the centre, one sigma per axis."""
        return math.sqrt((self.covariance_px2[0][0] + self.covariance_px2[1][1]) / 2.0)

    @property
    def blur_px(self) -> float:
        """Sigma of the edge's blur."""
        return self.appearance.blur_px

    @property
    def contrast(self) -> float:
        """Grey levels across the outline."""
        return self.appearance.contrast


@dataclass(frozen=True)
class Edge:
    """A measured straight edge; start and end lie on the fitted line at the ends of the used stretch.

    It runs the way the expected edge does. Its offset counts towards the right hand of somebody walking from start
    to end on the screen (v runs down), its angle in the sense from u to v.
    """

    start: Px
    end: Px
    covariance: Matrix  # (2, 2): offset px at the middle, angle deg
    appearance: Appearance
    inliers: float
    residual_px: float

    @property
    def middle(self) -> Px:
        """Half way from start to end."""
        return Px((self.start.u + self.end.u) / 2.0, (self.start.v + self.end.v) / 2.0)

    @property
    def offset_sd_px(self) -> float:
        """Across the edge, at its middle, one sigma."""
        return math.sqrt(self.covariance[0][0])

    @property
    def angle_sd_deg(self) -> float:
        """Of its direction, one sigma."""
        return math.sqrt(self.covariance[1][1])

    @property
    def blur_px(self) -> float:
        """Sigma of the edge's blur."""
        return self.appearance.blur_px

    @property
    def contrast(self) -> float:
        """Grey levels across the edge."""
        return self.appearance.contrast


@dataclass(frozen=True)
class BaseMeasurement:
    """A base as camera 1 sees it."""

    circle: Circle
    edge: Edge
    hole_to_edge_px: float

    @property
    def appearances(self) -> dict[str, Appearance]:
        """By feature."""
        return {"hole": self.circle.appearance, "edge": self.edge.appearance}


@dataclass(frozen=True)
class BatteryMeasurement:
    """A battery's corner as camera 2 sees it; the corner is where the edges' straight lines meet."""

    edge_1: Edge
    edge_2: Edge
    corner: Px
    covariance: Matrix  # (4, 4): corner u px, v px, angle of edge 1 deg, of edge 2 deg
    squareness_deg: float  # angle from edge 1 to edge 2 less the expected one

    @property
    def corner_covariance_px2(self) -> Matrix:
        """(2, 2) of the corner: u, v."""
        return tuple(row[:2] for row in self.covariance[:2])

    @property
    def corner_sd_px(self) -> float:
        """Of the corner, one sigma per axis."""
        return math.sqrt((self.covariance[0][0] + self.covariance[1][1]) / 2.0)

    @property
    def appearances(self) -> dict[str, Appearance]:
        """By feature."""
        return {"edge 1": self.edge_1.appearance, "edge 2": self.edge_2.appearance}
