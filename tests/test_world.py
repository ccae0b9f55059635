"""The simulated cell's physics: suction, conveyor, supply, picking and placing, and the judge."""

import asyncio
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.arm import ToolPose
from simulators.clock import Clock
from simulators.conveyor import BOUNCE_S, Conveyor
from simulators.parts import BaseDrawing, BatteryDrawing
from simulators.place import Place, turned_about
from simulators.product import Product
from simulators.suction import HOLDING_KPA, Suction
from simulators.supply import Delivery, Displacement, Scatter, Sizes, Supply
from simulators.verdict import Rectangle, fit
from simulators.world import World

PRODUCT = Product(BaseDrawing(), BatteryDrawing())
SEAT, BATTERY = Rectangle(53.2, 85.2), Rectangle(53.0, 85.0)


class Time:
    """World time that stands still until told otherwise."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


class StillArm:
    """An arm that stands where it is put: the world only asks where the tool truly is."""

    def __init__(self) -> None:
        self.pose = ToolPose(250.0, 0.0, 0.0, 0.0)

    def tool_at(self, _at_s: float) -> ToolPose:
        return self.pose

    def moving_at(self, _at_s: float) -> bool:
        return False


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> World:
    made = World(7, PRODUCT)
    monkeypatch.setattr(made, "arm", StillArm())
    time = Time()
    monkeypatch.setattr(made.clock, "now", time)
    made.conveyor = Conveyor(time, made.stream("conveyor"))
    made.suction = Suction(time)
    made.time = time  # type: ignore[attr-defined]
    return made


def wait(world: World, for_s: float) -> None:
    world.time.now_s += for_s  # type: ignore[attr-defined]
    world.vacuum_kpa()


def put_tool(world: World, place: Place, z_mm: float) -> None:
    world.arm.pose = ToolPose(place.x_mm, place.y_mm, z_mm, place.t_deg)  # type: ignore[attr-defined]


def bring(world: World) -> None:
    world.drive_conveyor(True)
    wait(world, 1.0)
    assert world.photo_switch()
    world.drive_conveyor(False)
    world.clamp(True)


def test_a_carrier_arrives_with_a_base_and_a_battery_comes_with_it(world: World) -> None:
    assert world.carrier_id() == 0
    bring(world)
    assert world.carrier_id() == 1
    assert world.battery_on_table()


def test_the_photo_switch_chatters_when_a_carrier_arrives() -> None:
    time = Time()
    conveyor = Conveyor(time, np.random.default_rng(1))
    conveyor.put()
    seen = []
    for step in range(20):
        time.now_s = BOUNCE_S * step / 10
        seen.append(conveyor.photo_switch())
    assert False in seen
    assert seen[-1]


def test_a_battery_is_picked_carried_and_placed_into_the_seat(world: World) -> None:
    bring(world)
    battery = world.on_table
    assert battery is not None
    put_tool(world, battery.place, world.layout.heights.table_mm)
    world.valve(True)
    wait(world, 0.2)
    assert world.vacuum_kpa() < -60
    assert not world.battery_on_table()
    assert world.base is not None
    put_tool(world, world.base.place @ PRODUCT.seat, world.layout.heights.seat_mm)
    world.valve(False)
    wait(world, 0.5)
    placed = world.fit()
    assert placed is not None
    assert placed.good
    assert placed.worst_mm < 0.2


def test_an_open_cup_reaches_little_vacuum_and_holds_nothing(world: World) -> None:
    world.valve(True)
    wait(world, 1.0)
    assert world.vacuum_kpa() > HOLDING_KPA
    assert world.held is None


def test_a_battery_let_go_in_the_air_is_lost(world: World) -> None:
    bring(world)
    assert world.on_table is not None
    put_tool(world, world.on_table.place, world.layout.heights.table_mm)
    world.valve(True)
    wait(world, 0.2)
    put_tool(world, Place(250.0, 0.0), 20.0)
    world.valve(False)
    wait(world, 0.5)
    assert world.held is None
    assert len(world.lost) == 1


def test_the_verdict_is_given_when_the_carrier_leaves(world: World) -> None:
    bring(world)
    world.release_carrier(True)
    world.clamp(False)
    world.drive_conveyor(True)
    wait(world, 0.4)
    assert world.carrier_id() == 0
    (verdict,) = world.verdicts
    assert verdict.fit is None
    assert verdict.released_good


def test_a_queued_delivery_lies_exactly_as_told(world: World) -> None:
    told = Displacement(0.02, -0.1, 0.4)
    world.queue_deliveries([Delivery(told, Displacement(), Sizes())])
    bring(world)
    assert world.base is not None
    station, seat = world.layout.station, (PRODUCT.base.seat_x_mm, PRODUCT.base.seat_y_mm)
    ideal, real = station.point(*seat), world.base.place.point(*seat)
    assert (real[0] - ideal[0], real[1] - ideal[1]) == pytest.approx((0.02, -0.1))
    assert world.base.place.t_deg - station.t_deg == pytest.approx(0.4)


def test_what_cannot_be_injected_is_refused_with_what_can(world: World) -> None:
    with pytest.raises(ValueError, match="vacuum lost"):
        world.inject("vacuum", "explode")


def test_a_dropped_battery_is_lost(world: World) -> None:
    bring(world)
    assert world.on_table is not None
    put_tool(world, world.on_table.place, world.layout.heights.table_mm)
    world.valve(True)
    wait(world, 0.2)
    world.inject("vacuum", "lost")
    assert world.held is None
    wait(world, 0.5)
    assert world.vacuum_kpa() > -10


def test_the_same_seed_makes_the_same_cell_and_parts() -> None:
    one, two, other = World(3, PRODUCT), World(3, PRODUCT), World(4, PRODUCT)
    assert one.layout.station == two.layout.station
    assert one.supply.next() == two.supply.next()
    assert one.layout.station != other.layout.station


def test_queued_rows_do_not_change_the_random_parts_after_them() -> None:
    one, two = World(3, PRODUCT), World(3, PRODUCT)
    two.queue_deliveries([Delivery(Displacement(), Displacement(), Sizes())])
    assert one.supply.next() != two.supply.next()
    assert one.supply.next() == two.supply.next()


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-1, 1))
def test_a_battery_fits_exactly_when_the_closed_form_says_so(x: float, y: float, t: float) -> None:
    """|dx| + w/2 cos + h/2 sin <= W/2, and the same across (the pocket inequality of a rigid rectangle)."""
    c, s = math.cos(math.radians(t)), abs(math.sin(math.radians(t)))
    across = SEAT.width_mm / 2 - abs(x) - BATTERY.width_mm / 2 * c - BATTERY.height_mm / 2 * s
    along = SEAT.height_mm / 2 - abs(y) - BATTERY.width_mm / 2 * s - BATTERY.height_mm / 2 * c
    judged = fit(SEAT, BATTERY, Place(x, y, t))
    assert judged.clearance_mm == pytest.approx(min(across, along), abs=1e-9)


def test_a_longer_battery_in_the_middle_is_not_misplaced_but_has_less_room() -> None:
    judged = fit(SEAT, Rectangle(53.0, 85.08), Place(0.0, 0.0))
    assert judged.worst_mm == pytest.approx(0.0, abs=1e-9)
    assert judged.clearance_mm == pytest.approx(0.06)


def test_turning_about_a_centre_leaves_the_centre_where_it_is() -> None:
    centre = (100.0, 50.0)
    moved = turned_about(centre, 0.0, 0.0, 30.0).point(*centre)
    assert moved == pytest.approx(centre)


async def test_the_clock_waits_for_what_is_due() -> None:
    clock = Clock(speed=1000.0)
    due_s = clock.now() + 1.0
    with clock.due_by(due_s):
        await asyncio.sleep(0.02)
        assert clock.now() == due_s
    assert clock.now() < due_s + 5.0
    await clock.sleep_until(due_s + 10.0)
    assert clock.now() >= due_s + 10.0


def test_a_battery_that_is_longer_than_drawn_and_placed_by_its_corner_is_off_the_middle() -> None:
    """The corner that camera 2 sees first lies where the drawing has it, so every corner is half the excess off."""
    lies = fit(Rectangle(53.2, 85.2), Rectangle(53.0, 85.06), Place(0.0, 0.03))
    assert lies.worst_mm == pytest.approx(0.03)
    assert lies.clearance_mm == pytest.approx(0.04)


def test_uniform_sizes_fill_the_tolerance_evenly_and_every_pair_has_a_form_of_its_own() -> None:
    supply = Supply(np.random.default_rng(1), Scatter(size_uniform=True, base_form_mm=0.001))
    delivered = [supply.next() for _ in range(400)]
    sizes = np.array([delivery.sizes.battery_height_mm for delivery in delivered])
    assert np.abs(sizes).max() <= 0.08
    assert np.histogram(sizes, bins=4, range=(-0.08, 0.08))[0] == pytest.approx([100] * 4, abs=30)
    assert len({delivery.form.seed for delivery in delivered}) == len(delivered)
