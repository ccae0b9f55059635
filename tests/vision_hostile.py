"""All kinds of pictures that must not be believed: wrong parts, decoys, bad light."""

from collections.abc import Callable

import numpy as np

from tests import hostile_decoys, hostile_parts, hostile_pictures
from tests.hostile_shown import Hostile

KINDS: tuple[Callable[[np.random.Generator], Hostile], ...] = (
    hostile_parts.wrong_radius,
    hostile_parts.wrong_distance,
    hostile_parts.other_phone,
    hostile_parts.wrong_camera,
    hostile_parts.not_square,
    hostile_parts.too_far,
    hostile_parts.turned,
    hostile_decoys.decoy_circles,
    hostile_decoys.decoy_hole,
    hostile_decoys.glare_ring,
    hostile_decoys.decoy_edges,
    hostile_decoys.decoy_battery_edges,
    hostile_pictures.covered,
    hostile_pictures.cut_off,
    hostile_pictures.badly_lit,
    hostile_pictures.blurred,
    hostile_pictures.shaken,
    hostile_pictures.empty,
    hostile_pictures.texture,
    hostile_pictures.noise,
    hostile_pictures.glared,
)


def hostile(rng: np.random.Generator) -> Hostile:
    """One of all kinds."""
    make = KINDS[int(rng.integers(len(KINDS)))]
    return make(rng)
