"""How sure a pose is: the covariances of single features carried to corners and poses. Pure."""

from __future__ import annotations

import math

import numpy as np

from cellctl.geometry import Px
from cellctl.vision.features import BaseMeasurement, BatteryMeasurement, Edge, Floats, Matrix
from cellctl.vision.plane import direction


def base_covariance(seen: BaseMeasurement) -> Floats:
    """Covariance (3, 3) of a base's pose in the picture: hole u px, v px, angle of the edge deg (from u to v).

    Hole and edge are measured from different pixels, so they err independently.
    """
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = seen.circle.covariance_px2
    covariance[2, 2] = seen.edge.covariance[1][1]
    return covariance


def battery_covariance(seen: BatteryMeasurement, edge: Edge) -> Floats:
    """Covariance (3, 3) of a battery's pose in the picture: corner u px, v px, angle of one of its edges deg.

    Raises ValueError when the edge is none of the measurement's.
    """
    if edge not in (seen.edge_1, seen.edge_2):
        raise ValueError("the direction of a battery must come from one of its two measured edges")
    used = [0, 1, 2 if edge == seen.edge_1 else 3]
    return np.array(seen.covariance)[np.ix_(used, used)]


def corner_covariance(corner: Px, one: Edge, two: Edge) -> Matrix:
    """Covariance (4, 4) of a corner: u px, v px, and the angles of the edges whose lines meet there, deg.

    With normal n, offset o, turn a and lever L from the middle of each edge to the corner c: n c = o + L a.
    """
    normals, joint = [], np.zeros((4, 4))
    for i, edge in enumerate((one, two)):
        way, middle = direction(edge.start, edge.end), edge.middle
        normals.append((-way.v, way.u))
        lever = math.radians((corner.u - middle.u) * way.u + (corner.v - middle.v) * way.v)
        (offset, both), (_, turn) = edge.covariance
        joint[i, i] = offset + 2.0 * lever * both + lever * lever * turn
        joint[i, i + 2] = joint[i + 2, i] = both + lever * turn
        joint[i + 2, i + 2] = turn
    to_corner = np.identity(4)
    to_corner[:2, :2] = np.linalg.inv(normals)
    return as_matrix(to_corner @ joint @ to_corner.T)


def as_matrix(covariance: Floats) -> Matrix:
    """The same as plain numbers, exactly symmetric."""
    return tuple(tuple(row) for row in ((covariance + covariance.T) / 2.0).tolist())
