"""Parts set up around their golden places, and how far what was found of them is from the world's truth."""

from typing import Any

import numpy as np

from cellctl.assembly.views import corner_mm
from cellctl.geometry import Mm, Offset, turned_about
from cellctl.learnt.taught import Taught
from cellctl.recipe import load_recipe
from simulators.supply import Delivery, Displacement, Sizes
from tests.whole_cell import Bench

WITHIN = (0.98, 0.98, 1.48)  # mm, mm, deg; the recipe accepts bases up to 1 mm and 1.5 deg


def taught_in(bench: Bench) -> Taught:
    """The golden assembly in use."""
    recipe = load_recipe(bench.config.paths.recipes, "x85")
    return Taught.read(Taught.path(bench.config.paths.state, recipe), "")


def deliveries(rng: np.random.Generator, count: int) -> list[Delivery]:
    """Bases and batteries anywhere within +-1 mm and +-1.5 deg of where they should lie, sizes to the drawing."""
    drawn = rng.uniform(-1.0, 1.0, (count, 2, 3)) * WITHIN
    return [Delivery(Displacement(*base), Displacement(*battery), Sizes()) for base, battery in drawn.tolist()]


def marks_of(bench: Bench) -> dict[str, tuple[Mm, Mm]]:
    """The rotation centre of each part's offsets, and the mark that is measured, both in the robot frame."""
    recipe, layout = load_recipe(bench.config.paths.recipes, "x85"), bench.world.layout
    seat = layout.station.point(recipe.base.seat_x_mm, recipe.base.seat_y_mm)
    corner = layout.table.point(*corner_mm(recipe.battery))
    return {
        "base": (Mm(*seat), Mm(*layout.station[:2])),
        "battery": (Mm(*layout.table[:2]), Mm(*corner)),
    }


def mark_errors_um(found: list[dict[str, Any]], true: list[Delivery], part: str, centre: Mm, mark: Mm) -> np.ndarray:
    """Where the part's mark was found to have moved, minus where it has, (n, 2)."""
    errors = []
    for record, delivery in zip(found, true, strict=True):
        offset = Offset(*(record[f"{part}_{key}"] for key in ("dx_mm", "dy_mm", "dt_deg")))
        moved = turned_about(centre, offset).point(*mark)
        truly = turned_about(centre, Offset(*vars(getattr(delivery, part)).values())).point(*mark)
        errors.append([(moved.x_mm - truly.x_mm) * 1000, (moved.y_mm - truly.y_mm) * 1000])
    return np.array(errors)
