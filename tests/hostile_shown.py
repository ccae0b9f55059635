"""A picture that must not be believed, and whether what was made of it is wrong."""

import math
from typing import NamedTuple

import numpy as np

from cellctl.vision import ExpectedCircle
from tests.vision_scenes import Camera, View, line_error

WRONG_UM, WRONG_MDEG = 10.0, 20.0


class Hostile(NamedTuple):
    """A picture, the finder it is shown to, and whether what is looked for is in it at all."""

    name: str
    view: View
    finder: str
    there: bool


def error_of(shown: Hostile) -> tuple[float, float]:
    """How far off an accepted measurement is: um and mdeg, infinite when nothing is there. Raises NotFound."""
    if shown.finder == "base":
        seen = shown.view.base()
        turns, errors_px = (
            [line_error(seen.edge, *shown.view.truth[1:])],
            [math.dist(seen.circle.centre, shown.view.truth[0])],
        )
        errors_px.append(abs(turns[0][0]))
    else:
        held = shown.view.battery()
        corner, end_1, end_2 = shown.view.truth
        turns = [line_error(held.edge_1, corner, end_1), line_error(held.edge_2, corner, end_2)]
        errors_px = [math.dist(held.corner, corner)]
    if not shown.there:
        return math.inf, math.inf
    return 1000.0 / shown.view.optics.px_per_mm * max(errors_px), 1000.0 * max(abs(turn) for _, turn in turns)


def is_wrong(error: tuple[float, float]) -> bool:
    return error[0] > WRONG_UM or error[1] > WRONG_MDEG


def plain_camera(rng: np.random.Generator) -> Camera:
    return Camera(
        turn_deg=float(rng.uniform(-3.0, 3.0)),
        looks="down" if rng.random() < 0.5 else "up",
        blur_px=float(rng.uniform(0.8, 1.5)),
    )


def finder_for(view: View) -> str:
    return "base" if isinstance(view.features[0], ExpectedCircle) else "battery"


def some_corner(rng: np.random.Generator) -> tuple[int, int]:
    return int(rng.choice([-1, 1])), int(rng.choice([-1, 1]))


def either_way(rng: np.random.Generator, least: float, most: float) -> float:
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(least, most))
