"""The things that are moved about in the cell, and where each of them is."""

from dataclasses import dataclass

from simulators.parts import BaseDrawing, BatteryDrawing, PlateDrawing
from simulators.place import Place
from simulators.supply import Delivery, Displacement
from simulators.verdict import Rectangle

PLATE = PlateDrawing()
PLATE_MIDDLE = Place((PLATE.columns - 1) * PLATE.pitch_mm / 2, (PLATE.rows - 1) * PLATE.pitch_mm / 2)


@dataclass
class Base:
    """The base on the carrier at the station."""

    place: Place  # base frame in robot coordinates
    delivery: Delivery
    carrier_id: int
    seat: Rectangle
    drawing: BaseDrawing  # with the sizes that this one came out with


@dataclass
class Battery:
    """A battery, somewhere. `place` is seen from `where`: table and floor from the room, tool, seat from the base."""

    size: Rectangle
    drawing: BatteryDrawing
    where: str
    place: Place
    displacement: Displacement


@dataclass
class Plate:
    """The dot plate for camera 2, in its nest or on the cup. `place` is its large dot's, seen from `where`."""

    where: str
    place: Place
