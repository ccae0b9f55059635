"""What a telecentric camera sees of a plane: edges true to a few thousandths of a pixel, 5 MP in some 10 ms. Pure.

A shape is filled coarsely; only the pixels in a narrow band along its outline are computed. There a pixel's value is
the closed form of a step blurred by the lens (Gaussian) and integrated over the square pixel, at its distance from
the outline as the true optics map it, so tilt, mirror and distortion are exact. Levels are kept in 1/128 grey level.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators.optics import PX_PER_MM, Light, Optics, Points
from simulators.shapes import Contour, Disks, Floats, Polygon, Ring, Shape, Stroke, disk, placed

__all__ = [
    "PX_PER_MM",
    "Disks",
    "Light",
    "Optics",
    "Polygon",
    "Ring",
    "Scene",
    "Shape",
    "Stroke",
    "disk",
    "placed",
    "render",
]

Singles: TypeAlias = NDArray[np.float32]
Pixels: TypeAlias = NDArray[np.uint8]
Canvas: TypeAlias = NDArray[np.uint16]

FINE = 128  # steps per grey level while painting
MARGIN_PX = 48  # painted around the picture, so that bands need no clipping
WIDEST_PX = MARGIN_PX // 2  # from an outline to the border of its band
SMOOTH_DEG = 8.0  # a vertex that turns less than this is no corner
STRIP_ROWS = 54  # rows that are exposed at a time: they stay in the cache
REACH_SIGMA = 3.7  # a step is over at this many sigmas
STEEPEST = math.tan(math.radians(55.0))  # columns scan outlines up to here, rows the others: both around 45 degrees
NOISE_OFFSET = 32  # grey levels; banks are stored positive
BANK_SPARE = 1 << 20  # pixels a bank is longer than a picture


@dataclass(frozen=True, eq=False)
class Scene:
    """What lies in the object plane: shapes are painted in order, on a plain background (grey levels of full light)."""

    background: float
    shapes: Sequence[Shape]


def render(scene: Scene, optics: Optics, rng: np.random.Generator, *, exposure: float = 1.0) -> Pixels:
    """Take a picture (height, width) of the scene; `exposure` 0 is light off, 1 gives the levels of the scene."""
    canvas = np.full((optics.height + 2 * MARGIN_PX, optics.width + 2 * MARGIN_PX), 0, np.uint16)
    if exposure > 0.0:
        canvas.fill(_fine(scene.background * exposure))
        brush = _Brush(canvas, optics, rng, exposure)
        for shape in scene.shapes:
            brush.paint(shape)
    return _exposed(canvas[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX], optics, rng)


def _exposed(light: Canvas, optics: Optics, rng: np.random.Generator) -> Pixels:
    """What the sensor makes of the light on it: uneven illumination, noise, black level, 8 bits."""
    gain = _gain(optics.width, optics.height, optics.light)
    noise = _cut(_noise_bank(round(optics.noise, 2), light.size + BANK_SPARE), light.shape, rng)
    pixels = np.empty(light.shape, np.uint8)
    strip = np.empty((STRIP_ROWS, optics.width), np.uint16)
    for row in range(0, optics.height, STRIP_ROWS):
        rows = slice(row, min(row + STRIP_ROWS, optics.height))
        part = strip[: rows.stop - row]
        cv2.multiply(light[rows], gain[rows], dst=part, scale=1.0 / 32768.0)
        cv2.add(part, noise[rows], dst=part)
        cv2.convertScaleAbs(part, dst=pixels[rows], alpha=1.0 / FINE, beta=optics.black - NOISE_OFFSET)
    return pixels


def _fine(level: float) -> int:
    """A grey level in fine steps; what is far over-exposed stays representable."""
    return round(min(max(level, 0.0), 400.0) * FINE)


@lru_cache(maxsize=4)
def _gain(width: int, height: int, light: Light) -> Canvas:
    """The illumination over the picture, 32768 = full."""
    u, v = np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height)[:, None]
    gain = 1.0 + light.slope_u * u + light.slope_v * v - light.bowl * (u * u + v * v) / 2.0
    return np.asarray(gain * 32768.0, np.uint16)


@lru_cache(maxsize=6)
def _noise_bank(sd: float, length: int) -> Canvas:
    """White noise, made once: pictures take a cut from a random place of it."""
    noise = np.random.default_rng(20191).standard_normal(length, dtype=np.float32)
    np.clip(noise * (sd * FINE) + NOISE_OFFSET * FINE, 0, 2 * NOISE_OFFSET * FINE, out=noise)
    return np.rint(noise).astype(np.uint16)


@lru_cache(maxsize=6)
def _texture_bank(sd: float, rows: int, columns: int) -> Canvas:
    """Surface texture of some pixels' grain, made once, with an offset like the noise."""
    grain = np.random.default_rng(20192).standard_normal((rows, columns), dtype=np.float32)
    soft = cv2.GaussianBlur(grain, (0, 0), 2.5)
    np.clip(soft * (sd * FINE / float(soft.std())) + NOISE_OFFSET * FINE, 0, 2 * NOISE_OFFSET * FINE, out=soft)
    return np.rint(soft).astype(np.uint16).reshape(-1)


def _cut(bank: Canvas, shape: tuple[int, ...], rng: np.random.Generator) -> Canvas:
    """A picture's worth of a bank, from a random place, without copying."""
    size = shape[0] * shape[1]
    start = int(rng.integers(0, bank.size - size + 1))
    return bank[start : start + size].reshape(shape)


@lru_cache(maxsize=8)
def _step(sigma: float) -> Singles:
    """The step's rise from -8 to +8 px in 1/1024 px."""
    return np.array(
        [0.5 * (1.0 + math.erf(i / (1024.0 * sigma * math.sqrt(2.0)))) for i in range(-8192, 8193)], np.float32
    )


class _Spans(NamedTuple):
    """Short arcs of outlines in the picture: ends and directions at the ends, (n, 2) px."""

    start: Points
    end: Points
    leave: Points
    arrive: Points


class _Crossings(NamedTuple):
    """Where outlines cross whole columns or rows: all (n,), px."""

    at: Floats  # column or row
    across: Floats  # position across
    slope: Floats
    bend: Floats  # second derivative
    rising: Floats  # +1 where the outline runs towards greater columns or rows


class _Band(NamedTuple):
    """Pixels along an outline: flat places on the canvas and how much of each the shape covers."""

    places: NDArray[np.intp]
    cover: Singles


class _Brush:
    """Paints shapes on one canvas."""

    def __init__(self, canvas: Canvas, optics: Optics, rng: np.random.Generator, exposure: float) -> None:
        self._canvas = canvas
        self._optics = optics
        self._rng = rng
        self._exposure = exposure
        self._sigma = math.hypot(optics.blur_px, math.sqrt(1.0 / 12.0))
        self._table = _step(round(self._sigma, 6))
        self._scale = optics.px_per_mm
        self._left = math.copysign(1.0, float(np.linalg.det(optics.matrix)))  # -1: mirrored

    def paint(self, shape: Shape) -> None:
        """Fill the inside, then set the band along the outline; all bands see what was there before."""
        loops = [self._optics.traced(*contour) for contour in shape.contours(self._scale)]
        if not any(self._in_view(points) for points, _ in loops):
            return
        level = shape.level * self._exposure
        if isinstance(shape, Stroke):
            half = 0.5 * shape.width_mm * self._scale
            self._blend([(b, self._before(b)) for b in self._bands(_spans(loops, closed=False), half)], level, None)
            return
        spans = _spans(loops, closed=True)
        bands = [(b, self._before(b)) for b in [*self._bands(spans, None), *self._corners(spans)]]
        self._blend(bands, level, self._fill([p for p, _ in loops], level, shape.texture * self._exposure))

    def _in_view(self, points: Points) -> bool:
        u, v = points[..., 0], points[..., 1]
        seen_u = float(u.max()) > -MARGIN_PX and float(u.min()) < self._optics.width + MARGIN_PX
        return seen_u and float(v.max()) > -MARGIN_PX and float(v.min()) < self._optics.height + MARGIN_PX

    def _fill(self, loops: list[Points], level: float, texture: float) -> Canvas | None:
        """Fill the inside; returns the textured surface (canvas shape) if there is one."""
        whole = [np.rint(p + MARGIN_PX).astype(np.int32).reshape(-1, p.shape[-2], 2) for p in loops]
        outlines = [loop for group in whole for loop in group]
        sd = round(texture * 4.0) / 4.0
        if sd == 0.0:
            cv2.fillPoly(self._canvas, outlines, (_fine(level),))
            return None
        rows, columns = self._canvas.shape
        grain = _cut(_texture_bank(sd, rows + BANK_SPARE // columns, columns), (rows, columns), self._rng)
        surface = grain + np.uint16(max(0, _fine(level) - NOISE_OFFSET * FINE))
        mask = np.zeros(self._canvas.shape, np.uint8)
        cv2.fillPoly(mask, outlines, (255,))
        cv2.copyTo(surface, mask, self._canvas)
        return surface

    def _before(self, band: _Band) -> Singles:
        return self._canvas.reshape(-1).take(band.places, mode="clip").astype(np.float32)

    def _blend(self, bands: list[tuple[_Band, Singles]], level: float, surface: Canvas | None) -> None:
        flat = self._canvas.reshape(-1)
        for band, before in bands:
            new = np.float32(_fine(level)) if surface is None else surface.reshape(-1).take(band.places, mode="clip")
            flat[band.places] = (before + (new - before) * band.cover + np.float32(0.5)).astype(np.uint16)

    def _bands(self, spans: _Spans, half_px: float | None) -> list[_Band]:
        """The bands of the spans, one scanned by columns and one by rows; `half_px` is half a stroke's width."""
        both = (self._band(spans, 0, half_px), self._band(spans, 1, half_px))
        return [band for band in both if band.places.size]

    def _band(self, spans: _Spans, along: int, half_px: float | None) -> _Band:
        """The pixels near all places where the spans cross whole columns (along 0) or rows (along 1)."""
        rows, columns = self._canvas.shape
        size, stride = (columns, rows), (1, columns)
        cross = _crossings(spans, along, size[along] - 2 * MARGIN_PX)
        nearest = np.rint(cross.across)
        seen = (nearest > -WIDEST_PX) & (nearest < size[1 - along] - 2 * MARGIN_PX + WIDEST_PX)
        if not seen.all():
            cross, nearest = _Crossings(*(a[seen] for a in cross)), nearest[seen]
        width = self._width(cross, half_px)
        k = np.arange(-width, width + 1)[:, None]
        offset = k.astype(np.float32) + (nearest - cross.across).astype(np.float32)
        distance = _distance(offset, cross, self._left if along == 0 else -self._left, self._sigma)
        start = (cross.at + MARGIN_PX) * stride[along] + (nearest + MARGIN_PX) * stride[1 - along]
        return _Band(start.astype(np.intp) + k * stride[1 - along], self._covered(distance, half_px))

    def _width(self, cross: _Crossings, half_px: float | None) -> int:
        """How many pixels the band reaches to either side; it is wider along a column where the edge is steep."""
        slope = float(np.abs(cross.slope).max(initial=0.0))
        width = math.ceil((REACH_SIGMA * self._sigma + (half_px or 0.0)) * math.hypot(1.0, slope))
        if width > WIDEST_PX:
            raise ValueError(f"a stroke of {2 * (half_px or 0):.0f} px is too wide: use a polygon")
        return width

    def _covered(self, distance: Singles, half_px: float | None) -> Singles:
        """Coverage of pixels at a signed distance (1/1024 px, inside positive) from an edge or a stroke's middle."""
        if half_px is None:
            distance += np.float32(8192.5)
            return self._table.take(distance.astype(np.int32), mode="clip")
        half = np.float32(half_px * 1024.0 + 8192.5)
        both = self._table.take((half - distance).astype(np.int32), mode="clip")
        return both + self._table.take((half + distance).astype(np.int32), mode="clip") - np.float32(1.0)

    def _corners(self, spans: _Spans) -> list[_Band]:
        """Squares about the sharp vertices: there two edges meet."""
        half = math.ceil(2.0 * REACH_SIGMA * self._sigma)
        limit = np.array([self._optics.width, self._optics.height]) + MARGIN_PX - half - 2
        vertex = np.flatnonzero(np.abs(spans.end - spans.start).max(axis=1) < 1e-6)
        at, come, go = spans.start[vertex], spans.leave[vertex], spans.arrive[vertex]
        turn = np.arctan2(_cross(come, go), np.sum(come * go, axis=1))
        sharp = np.all((at > half + 2 - MARGIN_PX) & (at < limit), axis=1) & (np.abs(turn) > math.radians(SMOOTH_DEG))
        if half > MARGIN_PX - 4 or not sharp.any():
            return []
        return [self._corner_band(at[sharp], come[sharp], go[sharp], turn[sharp], half)]

    def _corner_band(self, at: Points, come: Points, go: Points, turn: Floats, half: int) -> _Band:
        k = np.arange(-half, half + 1)
        pixel = np.rint(at)[:, None, None, :] + np.stack(np.meshgrid(k, k), axis=-1)
        one, two = self._side(pixel, at, come), self._side(pixel, at, go)
        alike = np.clip(np.cos(turn), 0.0, 1.0).astype(np.float32)[:, None, None]
        convex = (turn * self._left > 0.0)[:, None, None]
        cover = np.where(convex, _both(one, two, alike), 1 - _both(1 - one, 1 - two, alike))
        places = (pixel[..., 1] + MARGIN_PX) * self._canvas.shape[1] + pixel[..., 0] + MARGIN_PX
        return _Band(places.astype(np.intp), cover)

    def _side(self, pixel: Points, at: Points, direction: Points) -> Singles:
        """How much of each pixel lies on the left of the straight line through `at`."""
        unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
        away = pixel - at[:, None, None, :]
        distance = 1024.0 * self._left * (unit[:, None, None, 0] * away[..., 1] - unit[:, None, None, 1] * away[..., 0])
        return self._covered(distance.astype(np.float32), None)


def _cross(a: Points, b: Points) -> Floats:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def _both(a: Singles, b: Singles, alike: Singles) -> Singles:
    """Coverage by both of two half planes: the product at a right angle, the smaller one where they are the same."""
    return np.asarray(a * b * (1 - alike) + np.minimum(a, b) * alike, np.float32)


def _spans(loops: list[Contour], *, closed: bool) -> _Spans:
    """All arcs between neighbouring samples of the contours (..., k, 2)."""
    starts, ends, leaves, arrives = [], [], [], []
    for points, directions in loops:
        last = None if closed else -1
        starts.append(points[..., :last, :].reshape(-1, 2))
        leaves.append(directions[..., :last, :].reshape(-1, 2))
        ends.append((np.roll(points, -1, axis=-2) if closed else points[..., 1:, :]).reshape(-1, 2))
        arrives.append((np.roll(directions, -1, axis=-2) if closed else directions[..., 1:, :]).reshape(-1, 2))
    return _Spans(*(np.concatenate(parts) for parts in (starts, ends, leaves, arrives)))


def _crossings(spans: _Spans, along: int, limit: int) -> _Crossings:
    """Where the spans cross whole columns (along 0) or rows (along 1) of the picture, steep spans left out.

    Between its ends a span is a parabola with the slopes of its ends.
    """
    a0, a1 = spans.start[:, along], spans.end[:, along]
    first = np.clip(np.ceil(np.minimum(a0, a1)), 0, limit)
    count = np.clip(np.ceil(np.maximum(a0, a1)), 0, limit) - first
    rise = spans.end[:, 1 - along] - spans.start[:, 1 - along]
    used = np.flatnonzero((count > 0) & (np.abs(rise) <= STEEPEST * np.abs(a1 - a0)))
    number, length = count[used].astype(np.intp), (a1 - a0)[used]
    slopes = [d[used, 1 - along] / d[used, along] for d in (spans.leave, spans.arrive)]
    bend = (slopes[1] - slopes[0]) / length
    slope = rise[used] / length - 0.5 * bend * length
    skipped = first[used] - (np.cumsum(number) - number)
    each = np.repeat(
        np.stack([a0[used], spans.start[used, 1 - along], slope, bend, np.sign(length), skipped]), number, axis=1
    )
    at = np.arange(each.shape[1]) + each[5]
    run = at - each[0]
    return _Crossings(at, each[1] + (each[2] + 0.5 * each[3] * run) * run, each[2] + each[3] * run, each[3], each[4])


def _distance(offset: Singles, cross: _Crossings, left: float, sigma: float) -> Singles:
    """Distance (1/1024 px, inside positive) from a curve of pixels `offset` px away along a column or row.

    Its foot is found to second order. Blur shifts a curved edge to its centre by half its curvature times sigma^2.
    """
    cos = 1.0 / np.sqrt(1.0 + cross.slope**2)
    side = cross.rising * (left * 1024.0)
    hook = 0.5 * cross.bend * cos**3 * side  # half the curvature
    if not np.any(np.abs(hook) > 1e-2):
        return np.asarray(offset * (cos * side).astype(np.float32))
    distance = offset * (hook * (cross.slope * cos) ** 2).astype(np.float32)
    np.subtract((cos * side).astype(np.float32), distance, out=distance)
    distance *= offset
    distance -= (hook * sigma * sigma).astype(np.float32)
    return distance
