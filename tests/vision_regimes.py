"""Pictures as a shop floor makes them: clean, with nuisances, and with strong ones; the truth is known.

ideal     blur, noise and contrast vary, nothing else
nuisance  and texture, scratches, dust, uneven light, glare, parts of the outline hidden now and then
strong    faint, noisy and unsharp, twice the nuisances, parts of the outline always hidden
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from simulators.parts import BACKGROUND, BODY, FOIL, HOLE
from simulators.render import Disks, Light, Polygon, Shape, Stroke
from tests.vision_scenes import EDGE_MM, HOLE_MM, PLAIN, Camera, View, base_view, battery_view, some_place

Span = tuple[float, float]
Kind = Literal["base", "battery"]
Segment = tuple[np.ndarray, np.ndarray]  # start and end of a straight outline, mm in the part's frame
CEILING = 40.0


@dataclass(frozen=True)
class Regime:
    """What varies from picture to picture; `amount` scales the nuisances."""

    name: str
    blur_px: Span
    noise: tuple[float, ...]  # a few values: the renderer keeps a bank of noise for each
    exposure: Span
    texture: float
    amount: int


IDEAL = Regime("ideal", (0.8, 1.5), (2.0, 3.0, 4.0, 5.0), (0.7, 1.2), 0.0, 0)
NUISANCE = Regime("nuisance", (0.8, 1.5), (2.0, 3.0, 4.0, 5.0), (0.7, 1.2), 1.5, 1)
STRONG = Regime("strong", (0.8, 2.0), (4.0, 5.0, 6.5, 8.0), (0.42, 0.75), 2.5, 2)
REGIMES = (IDEAL, NUISANCE, STRONG)


class Case(NamedTuple):
    """A picture and the information in one px of an edge of contrast 1: 1 / (variance of its offset)."""

    view: View
    exposure: float
    information: float


def base_case(rng: np.random.Generator, regime: Regime) -> Case:
    """A base within +-1 mm and +-1.5 deg of its place."""
    camera, exposure = some_camera_of(rng, regime), float(rng.uniform(*regime.exposure))
    edge = np.array([-7.0, EDGE_MM]), np.array([7.0, EDGE_MM])
    over = [*_hidden(rng, regime, edge), *_hidden_arc(rng, regime), *_dirt(rng, regime, [edge], HOLE_MM)]
    view = base_view(rng, replace(camera, exposure=exposure), some_place(rng), over=over, texture=regime.texture)
    return _finished(rng, regime, view, exposure)


def battery_case(rng: np.random.Generator, regime: Regime) -> Case:
    """A battery's corner within +-1 mm and +-1.5 deg of its place."""
    camera, exposure = some_camera_of(rng, regime), float(rng.uniform(*regime.exposure))
    corner = (int(rng.choice([-1, 1])), int(rng.choice([-1, 1])))
    mark = np.array([corner[0] * 26.5, corner[1] * 42.5])
    edges = [
        (mark - (corner[0] * 2.0, 0.0), mark - (corner[0] * 11.0, 0.0)),
        (mark - (0.0, corner[1] * 2.0), mark - (0.0, corner[1] * 7.5)),
    ]
    over = [*_hidden(rng, regime, edges[0]), *_hidden(rng, regime, edges[1]), *_dirt(rng, regime, edges, 0.0)]
    view = battery_view(
        rng, replace(camera, exposure=exposure), some_place(rng), corner, over=over, texture=regime.texture
    )
    return _finished(rng, regime, view, exposure)


def some_camera_of(rng: np.random.Generator, regime: Regime) -> Camera:
    """Mounted nearly straight, looking up or down; its light is uneven when there are nuisances."""
    light = PLAIN
    if regime.amount:
        light = Light(*(float(x) for x in rng.uniform(-0.12, 0.12, 2)), float(rng.uniform(0.0, 0.12)))
    return Camera(
        turn_deg=float(rng.uniform(-3.0, 3.0)),
        looks="down" if rng.random() < 0.5 else "up",
        noise=float(rng.choice(regime.noise)),
        blur_px=float(rng.uniform(*regime.blur_px)),
        light=light,
    )


def contrast(feature: Literal["hole", "edge", "battery"]) -> float:
    """Grey levels across an outline in full light."""
    return {"hole": BODY - HOLE, "edge": BODY - BACKGROUND, "battery": FOIL - CEILING}[feature]


def _finished(rng: np.random.Generator, regime: Regime, view: View, exposure: float) -> Case:
    glared = view._replace(pixels=_glare(rng, regime, view))
    blur = math.hypot(view.optics.blur_px, math.sqrt(1.0 / 12.0))
    noise2 = view.optics.noise**2 + 1.0 / 12.0
    return Case(glared, exposure, exposure**2 / (2.0 * math.sqrt(math.pi) * blur * noise2))


def _hidden(rng: np.random.Generator, regime: Regime, edge: Segment) -> list[Shape]:
    """Something lies over 5 to 25 % of an edge (in half of the pictures), or over up to 40 % of it (always)."""
    if regime.amount == 0 or (regime.amount == 1 and rng.random() < 0.5):
        return []
    share = float(rng.uniform(0.05, 0.25 if regime.amount == 1 else 0.40))
    start, end = edge
    along, across = _ways(edge)
    middle = start + (end - start) * rng.uniform(share / 2, 1.0 - share / 2)
    half = along * (share / 2) * float(np.linalg.norm(end - start))
    near, far = across * rng.uniform(0.1, 0.6), across * rng.uniform(0.1, 0.6)
    outline = np.array([middle - half - near, middle + half - near, middle + half + far, middle - half + far])
    return [Polygon(outline, float(rng.uniform(20.0, 200.0)))]


def _hidden_arc(rng: np.random.Generator, regime: Regime) -> list[Shape]:
    """Something lies over part of the hole's rim: in 40 % of the pictures, or always."""
    if regime.amount == 0 or (regime.amount == 1 and rng.random() > 0.4):
        return []
    half = float(rng.uniform(0.05, 0.25 if regime.amount == 1 else 0.40)) * math.pi
    phi = float(rng.uniform(-math.pi, math.pi)) + np.linspace(-half, half, 16)
    rim = np.stack([np.cos(phi), np.sin(phi)], axis=1)
    inner, outer = HOLE_MM - rng.uniform(0.1, 0.5), HOLE_MM + rng.uniform(0.05, 0.3)
    return [Polygon(np.concatenate([inner * rim, outer * rim[::-1]]), float(rng.uniform(20.0, 200.0)))]


def _dirt(rng: np.random.Generator, regime: Regime, edges: Sequence[Segment], hole_mm: float) -> list[Shape]:
    """Scratches, a quarter of them nearly along an edge, and dust, some of it on the outlines."""
    shapes: list[Shape] = []
    for _ in range(regime.amount * int(rng.integers(8, 21))):
        edge = edges[int(rng.integers(len(edges)))]
        along, across = _ways(edge)
        beside = rng.random() < 0.25
        turn = rng.normal(0.0, 0.05) if beside else rng.uniform(-math.pi, math.pi)
        middle = _some_point(rng, edge) + across * rng.normal(0.0, 1.5 if beside else 4.0)
        way = (along * math.cos(turn) + across * math.sin(turn)) * rng.uniform(0.3, 2.0)
        line = np.array([middle - way, middle + way])
        shapes.append(Stroke(line, float(rng.uniform(0.008, 0.05)), float(rng.uniform(20.0, 200.0))))
    count = regime.amount * int(rng.integers(30, 81))
    if count:
        spots, radii = _apart([_speck(rng, edges, hole_mm) for _ in range(count)], rng.uniform(0.025, 0.08, count))
        dark = rng.random(len(spots)) < 0.7
        shapes += [Disks(spots[m], radii[m], level) for m, level in ((dark, 30.0), (~dark, 190.0)) if m.any()]
    return shapes


def _apart(spots: list[np.ndarray], radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Those that touch none of the others before them: the renderer paints the disks of one colour at once."""
    kept: list[int] = []
    for i, spot in enumerate(spots):
        if all(math.dist(spot, spots[j]) > radii[i] + radii[j] + 0.03 for j in kept):
            kept.append(i)
    return np.array(spots)[kept], radii[kept]


def _speck(rng: np.random.Generator, edges: Sequence[Segment], hole_mm: float) -> np.ndarray:
    """A grain lies on an outline (every fifth), or anywhere near."""
    edge = edges[int(rng.integers(len(edges)))]
    on_it = rng.random() < 0.2
    if on_it and hole_mm and rng.random() < 0.5:
        phi, r = rng.uniform(-math.pi, math.pi), hole_mm + rng.normal(0.0, 0.05)
        return np.array([r * math.cos(phi), r * math.sin(phi)])
    return _some_point(rng, edge) + _ways(edge)[1] * rng.normal(0.0, 0.05 if on_it else 4.0)


def _some_point(rng: np.random.Generator, edge: Segment) -> np.ndarray:
    return edge[0] + (edge[1] - edge[0]) * rng.uniform(0.0, 1.0)


def _ways(edge: Segment) -> tuple[np.ndarray, np.ndarray]:
    along = (edge[1] - edge[0]) / np.linalg.norm(edge[1] - edge[0])
    return along, np.array([-along[1], along[0]])


def _glare(rng: np.random.Generator, regime: Regime, view: View) -> np.ndarray:
    """Up to two (strong: three) soft bright spots; half of them lie on a feature."""
    count = int(rng.integers(1, 4)) if regime.amount == 2 else int(rng.integers(0, 3)) * regime.amount
    pixels = view.pixels
    height, width = pixels.shape
    for _ in range(count):
        at = rng.uniform((0.0, 0.0), (width, height))
        if rng.random() < 0.5:
            one, two = view.truth[0], view.truth[1 + int(rng.integers(2))]
            start = view.truth[1] if len(view.features[0]) == 3 and hasattr(view.features[0], "radius_px") else one
            at = np.array(start) + (np.array(two if two != start else view.truth[2]) - np.array(start)) * rng.uniform(
                0.0, 1.0
            )
        pixels = lit(pixels, at, float(rng.uniform(20.0, 70.0)), float(rng.uniform(60.0, 200.0)))
    return pixels


def lit(pixels: np.ndarray, at: np.ndarray, size_px: float, level: float) -> np.ndarray:
    """The picture with a Gaussian spot of light."""
    height, width = pixels.shape
    reach = 4.0 * size_px
    u0, u1 = int(np.clip(at[0] - reach, 0, width)), int(np.clip(at[0] + reach, 0, width))
    v0, v1 = int(np.clip(at[1] - reach, 0, height)), int(np.clip(at[1] + reach, 0, height))
    u, v = np.arange(u0, u1), np.arange(v0, v1)[:, None]
    light = level * np.exp(-0.5 * ((u - at[0]) / size_px) ** 2) * np.exp(-0.5 * ((v - at[1]) / size_px) ** 2)
    lit = pixels.copy()
    lit[v0:v1, u0:u1] = np.clip(np.rint(pixels[v0:v1, u0:u1] + light), 0.0, 255.0)
    return lit
