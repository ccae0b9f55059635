"""What the line assembles: drawings of base and battery, read from the recipe file of the phone model as plain data.

The recipe's dimensions are the drawing that the parts are made to. Only these numbers are read; what the controller
makes of the rest of the file is not the world's business.
"""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simulators.parts import BaseDrawing, BatteryDrawing
from simulators.place import Place
from simulators.verdict import Rectangle

GRIP_MARGIN_MM = 8.0  # the cup needs so much battery around its centre


@dataclass(frozen=True)
class Product:
    """One phone model as drawn."""

    base: BaseDrawing
    battery: BatteryDrawing

    @property
    def seat(self) -> Place:
        """Seat frame (its middle) in the base frame."""
        return Place(self.base.seat_x_mm, self.base.seat_y_mm, self.base.seat_t_deg)

    @property
    def outline(self) -> Rectangle:
        """The battery as drawn."""
        return Rectangle(self.battery.width_mm, self.battery.height_mm)

    @property
    def grip_mm(self) -> float:
        """How far from the battery's middle the cup still seals."""
        return min(self.battery.width_mm, self.battery.height_mm) / 2 - GRIP_MARGIN_MM


def load_product(path: Path) -> Product:
    """Read the drawing from a recipe file. Raises SystemExit with one sentence when it cannot."""
    try:
        recipe = tomllib.loads(path.read_text(encoding="utf-8"))
        return _product(recipe)
    except (OSError, ValueError) as error:
        raise SystemExit(f"{path}: cannot read the product's drawing: {error}") from None
    except KeyError as error:
        raise SystemExit(f"{path}: the drawing needs the key {error}") from None


def _product(recipe: dict[str, Any]) -> Product:
    base, battery, gap_mm = recipe["base"], recipe["battery"], float(recipe["limits"]["gap_mm"])
    return Product(
        base=BaseDrawing(
            hole_radius_mm=float(base["hole_radius_mm"]),
            edge_distance_mm=float(base["edge_distance_mm"]),
            seat_x_mm=float(base["seat_x_mm"]),
            seat_y_mm=float(base["seat_y_mm"]),
            seat_t_deg=float(base["seat_t_deg"]),
            seat_width_mm=float(battery["width_mm"]) + 2 * gap_mm,
            seat_height_mm=float(battery["height_mm"]) + 2 * gap_mm,
            edge_reach_mm=(float(base.get("second_edge_from_mm", 0.0)), float(base.get("second_edge_to_mm", 0.0))),
        ),
        battery=BatteryDrawing(width_mm=float(battery["width_mm"]), height_mm=float(battery["height_mm"])),
    )
