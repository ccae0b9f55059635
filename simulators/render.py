"""What a telecentric camera sees of a plane: edges true to a few thousandths of a pixel, 5 MP in some 10 ms. Pure.

A shape is filled coarsely; only the pixels in a narrow band along its outline are computed. There a pixel's value is
the closed form of a step blurred by the lens (Gaussian) and integrated over the square pixel, at its distance from
the outline as the true optics map it, so tilt, mirror and distortion are exact. Levels are kept in 1/128 grey level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from simulators.bands import MARGIN_PX, Band, Singles, Traced, bands, trace
from simulators.optics import PX_PER_MM, Light, Optics
from simulators.shapes import Disks, Placed, Polygon, Ring, Shape, Stroke, disk, placed

__all__ = [
    "PX_PER_MM",
    "Disks",
    "Light",
    "Optics",
    "Placed",
    "Polygon",
    "Ring",
    "Scene",
    "Shape",
    "Stroke",
    "disk",
    "placed",
    "render",
]

Pixels: TypeAlias = NDArray[np.uint8]
Canvas: TypeAlias = NDArray[np.uint16]

FINE = 128  # steps per grey level while painting
BRIGHTEST = 400.0  # what is over-exposed by more is cut off before the noise
STRIP_ROWS = 54  # rows that are worked on at a time: they stay in the cache
NOISE_OFFSET = 32  # grey levels; banks are stored positive
TEXTURE_OFFSET = 8
BANK_SPARE = 1 << 20  # pixels a bank is longer than a picture


@dataclass(frozen=True, eq=False)
class Scene:
    """What lies in the object plane: shapes are painted in order, on a plain background (grey levels of full light)."""

    background: float
    shapes: Sequence[Shape]


def render(scene: Scene, optics: Optics, rng: np.random.Generator, *, exposure: float = 1.0) -> Pixels:
    """Take a picture (height, width) of the scene; `exposure` 0 is light off, 1 gives the levels of the scene."""
    canvas = np.full(
        (optics.height + 2 * MARGIN_PX, optics.width + 2 * MARGIN_PX), _fine(scene.background * exposure), np.uint16
    )
    outlines = trace(scene.shapes, optics) if exposure > 0.0 else []
    edges = bands(outlines, optics)
    for number, outline in enumerate(outlines):
        _paint(canvas, outline, [band.part(number) for band in edges], exposure, rng)
    return _exposed(canvas[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX], optics, rng)


def _fine(level: float) -> int:
    """A grey level in fine steps."""
    return round(min(max(level, 0.0), BRIGHTEST) * FINE)


def _paint(canvas: Canvas, outline: Traced, edges: list[Band], exposure: float, rng: np.random.Generator) -> None:
    """Fill the inside, then set the bands along the outline; all bands see what was there before."""
    flat, level = canvas.reshape(-1), _fine(outline.level * exposure)
    edges = [edge for edge in edges if edge.places.size]
    before = [flat.take(edge.places, mode="clip").astype(np.float32) for edge in edges]
    grain = _grain(canvas.shape, outline.texture, rng)
    surface = None if grain is None else _Surface(grain, exposure, level - TEXTURE_OFFSET * FINE * exposure)
    if outline.half_px is None:
        _fill(canvas, outline, level, surface)
    for edge, old in zip(edges, before, strict=True):
        new = np.float32(level) if surface is None else surface.at(edge.places)
        under = old if outline.over is None else np.float32(_fine(outline.over * exposure))
        flat[edge.places] = _blended(old, np.subtract(new, under), edge.cover)


def _blended(old: Singles, change: Singles, cover: Singles) -> Canvas:
    """`old`, changed as far as it is covered."""
    change *= cover
    change += old
    change += np.float32(0.5)
    return change.astype(np.uint16)


class _Surface(NamedTuple):
    """A surface with texture: grain as under full light, how bright the light is, and what the grain stands on."""

    grain: Canvas
    light: float
    ground: float  # fine steps

    def at(self, places: NDArray[np.intp]) -> Singles:
        """Its levels at flat places of the canvas."""
        return self.grain.reshape(-1).take(places, mode="clip") * np.float32(self.light) + np.float32(self.ground)

    def rows(self, rows: slice) -> Canvas:
        """Its levels in whole rows of the canvas."""
        grain = self.grain[rows]
        return np.asarray(cv2.addWeighted(grain, self.light, grain, 0.0, self.ground), np.uint16)


def _fill(canvas: Canvas, outline: Traced, level: int, surface: _Surface | None) -> None:
    loops = list(np.rint(outline.points + MARGIN_PX).astype(np.int32))
    if surface is None:
        cv2.fillPoly(canvas, loops, (level,))
        return
    mask = np.zeros(canvas.shape, np.uint8)
    cv2.fillPoly(mask, loops, (255,))
    first, last = (int(np.clip(edge(outline.points[..., 1]) + MARGIN_PX, 0, len(canvas))) for edge in (np.min, np.max))
    for row in range(first, min(last + 1, len(canvas)), STRIP_ROWS):
        rows = slice(row, row + STRIP_ROWS)
        cv2.copyTo(surface.rows(rows), mask[rows], canvas[rows])


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


@lru_cache(maxsize=4)
def _gain(width: int, height: int, light: Light) -> Canvas:
    """The illumination over the picture, 32768 = full."""
    u, v = np.linspace(-1.0, 1.0, width), np.linspace(-1.0, 1.0, height)[:, None]
    gain = 1.0 + light.slope_u * u + light.slope_v * v - light.bowl * (u * u + v * v) / 2.0
    return np.asarray(gain * 32768.0, np.uint16)


@lru_cache(maxsize=16)
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
    np.clip(soft * (sd * FINE / float(soft.std())) + TEXTURE_OFFSET * FINE, 0, 2 * TEXTURE_OFFSET * FINE, out=soft)
    return np.rint(soft).astype(np.uint16).reshape(-1)


def _grain(shape: tuple[int, ...], texture: float, rng: np.random.Generator) -> Canvas | None:
    """A random piece of texture of the canvas' shape under full light, in quarters of a grey level's sigma."""
    sd = round(texture * 4.0) / 4.0
    if sd <= 0.0:
        return None
    return _cut(_texture_bank(sd, shape[0] + BANK_SPARE // shape[1], shape[1]), shape, rng)


def _cut(bank: Canvas, shape: tuple[int, ...], rng: np.random.Generator) -> Canvas:
    """A picture's worth of a bank, from a random place, without copying."""
    size = shape[0] * shape[1]
    start = int(rng.integers(0, bank.size - size + 1))
    return bank[start : start + size].reshape(shape)
