"""The things that are moved about in the cell, and where each of them is."""

from dataclasses import dataclass, replace

from simulators.parts import BaseDrawing, BatteryDrawing, PlateDrawing
from simulators.place import Place, turned_about
from simulators.product import Product
from simulators.supply import Delivery, Displacement, Sizes
from simulators.verdict import Rectangle

PLATE = PlateDrawing()
PLATE_MIDDLE = Place((PLATE.columns - 1) * PLATE.pitch_mm / 2, (PLATE.rows - 1) * PLATE.pitch_mm / 2)
PERFECT = Delivery(Displacement(), Displacement(), Sizes())  # parts to the drawing, exactly where they should lie


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


def made_base(product: Product, station: Place, delivery: Delivery, carrier_id: int) -> Base:
    """A base as delivered: moved about its seat's middle, with the seat that came out."""
    centre = station.point(product.base.seat_x_mm, product.base.seat_y_mm)
    moved = turned_about(centre, delivery.base.dx_mm, delivery.base.dy_mm, delivery.base.dt_deg)
    seat = Rectangle(
        product.base.seat_width_mm + delivery.sizes.seat_width_mm,
        product.base.seat_height_mm + delivery.sizes.seat_height_mm,
    )
    made = replace(
        product.base,
        seat_width_mm=seat.width_mm,
        seat_height_mm=seat.height_mm,
        form_sd_mm=delivery.form.base_mm,
        form_seed=2 * delivery.form.seed,
    )
    return Base(moved @ station, delivery, carrier_id, seat, made)


def made_battery(product: Product, table: Place, delivery: Delivery) -> Battery:
    """A battery as delivered: moved about its middle, with the size that came out."""
    moved = turned_about(
        (table.x_mm, table.y_mm), delivery.battery.dx_mm, delivery.battery.dy_mm, delivery.battery.dt_deg
    )
    size = Rectangle(
        product.outline.width_mm + delivery.sizes.battery_width_mm,
        product.outline.height_mm + delivery.sizes.battery_height_mm,
    )
    made = replace(
        product.battery,
        width_mm=size.width_mm,
        height_mm=size.height_mm,
        form_sd_mm=delivery.form.battery_mm,
        form_seed=2 * delivery.form.seed + 1,
    )
    return Battery(size, made, "table", moved @ table, delivery.battery)
