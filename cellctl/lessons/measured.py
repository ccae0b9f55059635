"""The values of a recipe that pictures give: medians of figures, and stretches of edges that are clean in most of them.

Rounded to what a person would write: lengths to a micrometre, stretches to 0.1 mm and never longer than they are. Pure.
"""

import math
import statistics
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from cellctl.geometry import Mm, wrap_deg
from cellctl.lessons.lesson import BaseFigures, BatteryFigures, Span
from cellctl.lessons.values import CannotTeach, Value, Values
from cellctl.pictures.scale import Scale
from cellctl.recipe_parts import Margin
from cellctl.vision.features import Appearance
from cellctl.vision.stretches import longest_run

STEP_MM = 0.1
MOST_CLEAN = 2 / 3  # part of the pictures in which a stretch must be clean
SPARE_MM = 0.2  # left out at either end of a clean stretch
SHORTEST_MM = 2.0
CONTRAST_SHARE = 0.5  # of the weakest feature's contrast: pictures with less are refused

KEYS = {
    *(f"base.{key}" for key in ("hole_radius_mm", "hole", "edge_distance_mm", "edge_from_mm", "edge_to_mm")),
    *(f"base.{key}" for key in ("edge_bright_side", "view_x_mm", "view_y_mm")),
    *(f"battery.{key}" for key in ("corner", "edge_skip_mm", "edge_x_mm", "edge_y_mm", "bright")),
    *(f"battery.{key}" for key in ("view_x_mm", "view_y_mm")),
    "limits.min_contrast",
}
"""What a recipe must have and pictures give."""


class Spread(NamedTuple):
    """A figure over all pictures."""

    median: float
    sd: float | None  # None of one picture
    pictures: int

    @classmethod
    def of(cls, values: Sequence[float]) -> "Spread":
        """Of one value per picture."""
        return cls(statistics.median(values), statistics.stdev(values) if len(values) > 1 else None, len(values))

    @property
    def said(self) -> str:
        """Where the value comes from, for the comment."""
        spread = "" if self.sd is None else f", sd {self.sd * 1000:.2f} um"
        return f"measured in {_pictures(self.pictures)}{spread}"


def base_values(figures: Sequence[BaseFigures], search: Margin) -> Values:
    """Of the base. Raises CannotTeach when no long enough stretch of the edge stays in view within the search."""
    radius, distance = Spread.of([f.radius_mm for f in figures]), Spread.of([f.distance_mm for f in figures])
    view = _middle([f.view_mm for f in figures])
    distance_mm = round(distance.median, 3)

    def seen(x_mm: float) -> bool:
        return search.keeps(x_mm - view.x_mm, distance_mm - view.y_mm)

    start_mm, end_mm = _usable([f.clean_mm for f in figures], seen, "base")
    count = f"measured in {_pictures(len(figures))}"
    return {
        "base.hole_radius_mm": Value(round(radius.median, 3), radius.said),
        "base.hole": Value("dark" if figures[0].hole_dark else "bright", count),
        "base.edge_distance_mm": Value(distance_mm, distance.said),
        "base.edge_from_mm": Value(start_mm, f"straight and clean in {_pictures(len(figures))}"),
        "base.edge_to_mm": Value(end_mm, f"straight and clean in {_pictures(len(figures))}"),
        "base.edge_bright_side": Value("base" if figures[0].base_bright else "outside", count),
        "base.view_x_mm": Value(view.x_mm, "as it lay in the pictures"),
        "base.view_y_mm": Value(view.y_mm, "as it lay in the pictures"),
    }


def battery_values(figures: Sequence[BatteryFigures], search: Margin) -> Values:
    """Of the battery's corner. Raises CannotTeach when a clean stretch is too short."""
    view = _middle([f.view_mm for f in figures])
    starts = [start for f in figures for start, _ in (f.clean_x_mm, f.clean_y_mm)]
    skip_mm = _up(sorted(starts)[math.ceil(MOST_CLEAN * len(starts)) - 1] + SPARE_MM)
    end_x_mm = _end([f.clean_x_mm for f in figures], skip_mm, lambda x: search.keeps(x - view.x_mm, -view.y_mm))
    end_y_mm = _end([f.clean_y_mm for f in figures], skip_mm, lambda y: search.keeps(-view.x_mm, y - view.y_mm))
    count, clean = f"measured in {_pictures(len(figures))}", f"straight and clean in {_pictures(len(figures))}"
    return {
        "battery.edge_skip_mm": Value(skip_mm, f"rounded in {_pictures(len(figures))}"),
        "battery.edge_x_mm": Value(round(end_x_mm - skip_mm, 1), clean),
        "battery.edge_y_mm": Value(round(end_y_mm - skip_mm, 1), clean),
        "battery.bright": Value("battery" if figures[0].battery_bright else "background", count),
        "battery.view_x_mm": Value(view.x_mm, "as it lay in the pictures"),
        "battery.view_y_mm": Value(view.y_mm, "as it lay in the pictures"),
    }


def look_values(base: Sequence[BaseFigures], battery: Sequence[BatteryFigures]) -> Values:
    """How the features look, and the least contrast that a picture must have."""
    sought = {
        "base_hole": [f.looks["hole"] for f in base],
        "base_edge": [f.looks["edge"] for f in base],
        "battery_edge_1": [f.looks["edge x"] for f in battery],
        "battery_edge_2": [f.looks["edge y"] for f in battery],
    }
    values = {key: value for name, looks in sought.items() for key, value in _look(name, looks).items()}
    weakest = min(look.contrast for looks in sought.values() for look in looks)
    half = f"half of the weakest contrast, {weakest:.0f}"
    return values | {"limits.min_contrast": Value(float(math.floor(CONTRAST_SHARE * weakest)), half)}


def _look(name: str, looks: Sequence[Appearance]) -> Values:
    medians = {key: round(statistics.median(getattr(look, key) for look in looks), 3) for key in Appearance._fields}
    return {f"light.{name}.{key}": Value(value, "") for key, value in medians.items()}


def picture_values(part: str, scale: Scale, plain_turns_deg: Sequence[float]) -> Values:
    """How the part lies in the pictures; the turns are against the picture's own axes."""
    values: dict[str, str | float] = {
        "mm_per_px": round(scale.plane.mm_per_px, 9),
        "turn_deg": round(middle_turn_deg(plain_turns_deg), 3),
        "seen_from": "above" if scale.seen_from_above else "below",
        "width_px": scale.size[0],
        "height_px": scale.size[1],
    }
    return {f"pictures.{part}.{key}": Value(value, "") for key, value in values.items()}


def middle_turn_deg(turns_deg: Sequence[float]) -> float:
    """The median of directions that lie close together."""
    first = turns_deg[0]
    return wrap_deg(first + statistics.median(wrap_deg(turn - first) for turn in turns_deg))


# -- stretches ---------------------------------------------------------------------------------------------


def _usable(spans: Sequence[Span], seen: Callable[[float], bool], part: str) -> Span:
    """The longest stretch, in steps of 0.1 mm, that is clean in most pictures and stays in view."""
    grid = np.round(np.arange(-20.0, 20.0, STEP_MM), 1)
    clean = sum(((grid >= low + SPARE_MM) & (grid <= high - SPARE_MM)).astype(int) for low, high in spans)
    good = [float(x) for x, count in zip(grid, np.atleast_1d(clean), strict=True) if _most(count, spans) and seen(x)]
    first, last = longest_run(np.array(good), 1.5 * STEP_MM)
    if last - first < SHORTEST_MM:
        raise CannotTeach(
            f"{part}: only {last - first:.1f} mm of an edge are clean and stay in view within the search, needed are "
            f"{SHORTEST_MM:g} mm: put the part nearer to the middle of the picture, or search less "
            f"(--set {part}.search_mm=...)"
        )
    return round(first, 1), round(last, 1)


def _end(spans: Sequence[Span], skip_mm: float, seen: Callable[[float], bool]) -> float:
    return _usable([(skip_mm - SPARE_MM, high) for _, high in spans], seen, "battery")[1]


def _most(count: int, spans: Sequence[Span]) -> bool:
    return count >= math.ceil(MOST_CLEAN * len(spans))


def _middle(views: Sequence[Mm]) -> Mm:
    return Mm(*(round(statistics.median(values), 2) for values in zip(*views, strict=True)))


def _up(x_mm: float) -> float:
    return round(math.ceil(round(x_mm / STEP_MM, 6)) * STEP_MM, 1)


def _pictures(count: int) -> str:
    return f"{count} picture{'s' if count > 1 else ''}"
