"""The paper's own measurement: binarise, region of interest, Canny, Hough lines; centroid and circle voting.

Its Hough range is corrected to signed rho, without which most lines do not exist. Resolutions are not in the paper;
0.1 deg and 1 px are taken.
"""

import math

import cv2
import numpy as np

from tests.benchmarks.vision.regions import CircleRegion, LineRegion, Straight

RHO_PX, THETA_DEG = 1.0, 0.1
THETA_REACH_DEG = 5.0
CANNY = (50, 150)
WINDOW = 20  # px to either side of the centroid in which centres are voted for


def edge_points(pixels: np.ndarray) -> np.ndarray:
    """(n, 2): u, v of Canny's pixels of the binarised region."""
    _, binary = cv2.threshold(pixels, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    v, u = np.nonzero(cv2.Canny(cv2.GaussianBlur(binary, (5, 5), 0), *CANNY))
    return np.stack([u, v], axis=1).astype(float)


def line(region: LineRegion) -> Straight | None:
    """The most voted line of the Hough accumulator, rho = u cos(theta) + v sin(theta), rho of either sign."""
    points = edge_points(region.pixels)
    if len(points) < 50:
        return None
    normal = math.atan2(region.way[1], region.way[0]) + math.pi / 2
    first = math.ceil((math.degrees(normal) - THETA_REACH_DEG) / THETA_DEG)  # the accumulator's angles are whole steps
    best = (0, 0.0, 0.0)
    for theta in np.radians(THETA_DEG * (first + np.arange(2.0 * THETA_REACH_DEG / THETA_DEG))):
        place = np.rint((points[:, 0] * math.cos(theta) + points[:, 1] * math.sin(theta)) / RHO_PX).astype(int)
        least = int(place.min())
        count = np.bincount(place - least)
        most = int(count.argmax())
        best = max(best, (int(count[most]), float(theta), (most + least) * RHO_PX))
    _, theta, rho = best
    return Straight((rho * math.cos(theta), rho * math.sin(theta)), (-math.sin(theta), math.cos(theta)))


def circle(region: CircleRegion) -> tuple[float, float] | None:
    """The centroid of the hole's edge points, then votes of circles of the known radius in a window about it."""
    _, binary = cv2.threshold(region.pixels, 0, 255, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU)
    count, labels, sizes, _ = cv2.connectedComponentsWithStats(binary)
    if count < 2:
        return None
    area = math.pi * region.radius_px**2
    blob = 1 + int(np.argmin(np.abs(sizes[1:, cv2.CC_STAT_AREA] - area)))
    v, u = np.nonzero(cv2.Canny((labels == blob).astype(np.uint8) * 255, *CANNY))
    if len(u) < 50:
        return None
    centre = np.rint([u.mean(), v.mean()])
    k = np.arange(-WINDOW, WINDOW + 1)
    votes = np.zeros((len(k), len(k)), int)
    for row, dv in enumerate(k):
        away = np.hypot(u[:, None] - (centre[0] + k), (v - (centre[1] + dv))[:, None]) - region.radius_px
        votes[row] = np.count_nonzero(np.abs(away) < 0.5, axis=0)
    row, column = np.unravel_index(votes.argmax(), votes.shape)
    return float(centre[0] + k[column]), float(centre[1] + k[row])
