"""Freely licensed ways to measure the same features, each with one reasonable set of parameters."""

import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np

from tests.benchmarks.vision import paper
from tests.benchmarks.vision.regions import CircleRegion, LineRegion, Straight

TURN_DEG = 5.0  # lines further off the expected direction are not meant
CircleMethod = Callable[[CircleRegion], tuple[float, float] | None]
LineMethod = Callable[[LineRegion], Straight | None]


def _canny(pixels: np.ndarray) -> np.ndarray:
    return cv2.Canny(cv2.GaussianBlur(pixels, (5, 5), 0), 40, 80)


def _radius_is_right(radius: float, region: CircleRegion) -> bool:
    return abs(radius - region.radius_px) < 12.0


# -- circles ----------------------------------------------------------------------------------------------


def _hough_circles(region: CircleRegion, method: int, strict: float) -> tuple[float, float] | None:
    r = region.radius_px
    found = cv2.HoughCircles(
        cv2.GaussianBlur(region.pixels, (5, 5), 0),
        method,
        1.5,
        r,
        param1=80 if method == cv2.HOUGH_GRADIENT else 300,
        param2=strict,
        minRadius=int(r - 8),
        maxRadius=int(r + 9),
    )
    return None if found is None else (float(found[0, 0, 0]), float(found[0, 0, 1]))


def hough_gradient(region: CircleRegion) -> tuple[float, float] | None:
    return _hough_circles(region, cv2.HOUGH_GRADIENT, 60)


def hough_alt(region: CircleRegion) -> tuple[float, float] | None:
    return _hough_circles(region, cv2.HOUGH_GRADIENT_ALT, 0.6)


def contour_ellipse(region: CircleRegion) -> tuple[float, float] | None:
    _, binary = cv2.threshold(
        cv2.GaussianBlur(region.pixels, (5, 5), 0), 0, 255, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU
    )
    contours, _ = cv2.findContours(binary, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    area = math.pi * region.radius_px**2
    best = min(contours, key=lambda c: abs(cv2.contourArea(c) - area), default=None)
    if best is None or len(best) < 50:
        return None
    (u, v), _, _ = cv2.fitEllipse(best)
    return u, v


def ransac_circle(region: CircleRegion) -> tuple[float, float] | None:
    from skimage.measure import CircleModel

    model = _ransac(region.pixels, CircleModel, 3, lambda m: _radius_is_right(m.radius, region))
    return None if model is None else (float(model.center[0]), float(model.center[1]))


def _ransac(pixels: np.ndarray, kind: type, fewest: int, is_valid: Callable[[Any], bool]) -> Any:
    """Canny's points and scikit-image's RANSAC; None when it finds nothing."""
    from skimage.measure import ransac

    v, u = np.nonzero(_canny(pixels))
    if len(u) < 50:
        return None
    points = np.stack([u, v], axis=1).astype(float)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return ransac(points, kind, fewest, 1.5, max_trials=1500, rng=1, is_model_valid=lambda m, *_: is_valid(m))[0]


def edge_drawing_circle(region: CircleRegion) -> tuple[float, float] | None:
    drawing = _edge_drawing(region.pixels)
    found = drawing.detectEllipses()
    if found is None:
        return None
    near = [e for e in found[:, 0] if _radius_is_right(e[2] if e[2] > 0 else (e[3] + e[4]) / 2, region)]
    return (float(near[0][0]), float(near[0][1])) if near else None


def _edge_drawing(pixels: np.ndarray) -> "cv2.ximgproc.EdgeDrawing":
    drawing = cv2.ximgproc.createEdgeDrawing()
    parameters = cv2.ximgproc.EdgeDrawing.Params()
    parameters.EdgeDetectionOperator, parameters.GradientThresholdValue = cv2.ximgproc.EdgeDrawing_SOBEL, 36
    drawing.setParams(parameters)
    drawing.detectEdges(pixels)
    return drawing


# -- lines ------------------------------------------------------------------------------------------------


def _longest(segments: np.ndarray | None, region: LineRegion) -> Straight | None:
    """The longest of the segments (n, 4) in the expected direction."""
    best, most = None, 0.0
    for u0, v0, u1, v1 in [] if segments is None else np.asarray(segments, float).reshape(-1, 4):
        length = math.hypot(u1 - u0, v1 - v0)
        if length > most and _is_along((u1 - u0, v1 - v0), region):
            best, most = Straight(((u0 + u1) / 2, (v0 + v1) / 2), (u1 - u0, v1 - v0)), length
    return best


def _is_along(way: Sequence[float], region: LineRegion) -> bool:
    turn = abs(way[0] * region.way[1] - way[1] * region.way[0])
    return turn < math.sin(math.radians(TURN_DEG)) * math.hypot(*way)


def hough_lines(region: LineRegion) -> Straight | None:
    found = cv2.HoughLines(_canny(region.pixels), 1, math.radians(0.1), 150)
    for rho, theta in [] if found is None else found[:, 0]:
        line = Straight((rho * math.cos(theta), rho * math.sin(theta)), (-math.sin(theta), math.cos(theta)))
        if _is_along(line.way, region):
            return line
    return None


def hough_lines_p(region: LineRegion) -> Straight | None:
    found = cv2.HoughLinesP(_canny(region.pixels), 1, math.radians(0.1), 100, minLineLength=150, maxLineGap=40)
    return _longest(found, region)


def lsd(region: LineRegion) -> Straight | None:
    return _longest(cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(region.pixels)[0], region)


def contour_line(region: LineRegion) -> Straight | None:
    """Huber's fit to the longest contour of the binarised region, away from the region's border."""
    _, binary = cv2.threshold(cv2.GaussianBlur(region.pixels, (5, 5), 0), 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(binary, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    best = max(contours, key=len, default=None)
    if best is None:
        return None
    points, (height, width) = best[:, 0].astype(np.float32), region.pixels.shape
    inner = (points > 3).all(axis=1) & (points[:, 0] < width - 4) & (points[:, 1] < height - 4)
    if np.count_nonzero(inner) < 50:
        return None
    du, dv, u, v = cv2.fitLine(points[inner], cv2.DIST_HUBER, 0, 0.01, 0.01).ravel().tolist()
    return Straight((u, v), (du, dv))


def ransac_line(region: LineRegion) -> Straight | None:
    from skimage.measure import LineModelND

    model = _ransac(region.pixels, LineModelND, 2, lambda m: _is_along(m.direction, region))
    return None if model is None else Straight(tuple(model.origin), tuple(model.direction))


def edge_drawing_line(region: LineRegion) -> Straight | None:
    return _longest(_edge_drawing(region.pixels).detectLines(), region)


CIRCLES: dict[str, CircleMethod] = {
    "paper: centroid, circle votes": paper.circle,
    "cv2.HoughCircles GRADIENT": hough_gradient,
    "cv2.HoughCircles ALT": hough_alt,
    "cv2 contour, fitEllipse": contour_ellipse,
    "scikit-image RANSAC": ransac_circle,
    "EdgeDrawing": edge_drawing_circle,
}
LINES: dict[str, LineMethod] = {
    "paper: Hough accumulator": paper.line,
    "cv2.HoughLines": hough_lines,
    "cv2.HoughLinesP": hough_lines_p,
    "cv2 LSD": lsd,
    "cv2 contour, fitLine": contour_line,
    "scikit-image RANSAC": ransac_line,
    "EdgeDrawing": edge_drawing_line,
}
