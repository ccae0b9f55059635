"""Lens and lamp of the simulated cameras wear as they are told to, at any world time, and the pictures show it."""

import math

import pytest

from simulators.parts import BaseDrawing, BatteryDrawing
from simulators.product import Product
from simulators.wear import LIGHT_OFF, MOST_BLUR_PX, Wear
from simulators.world import World


def test_a_new_camera_is_not_worn() -> None:
    assert Wear().blur_px(1.1, 1e6) == 1.1
    assert Wear().light_at(1e6) == 1.0


def test_defocus_adds_in_squares_and_grows_with_world_time_up_to_what_can_be_drawn() -> None:
    wear = Wear()
    wear.inject("defocus", 10.0, px=0.5, px_per_s=0.1)
    assert wear.blur_px(1.2, 10.0) == pytest.approx(1.3)
    assert wear.blur_px(1.2, 5.0) == pytest.approx(1.3)
    assert wear.blur_px(1.2, 21.0) == pytest.approx(math.hypot(1.2, 1.6))
    assert wear.blur_px(1.2, 1e6) == MOST_BLUR_PX


def test_light_and_focus_wear_by_themselves_and_a_lamp_never_goes_below_darkness() -> None:
    wear = Wear()
    wear.inject("dim", 0.0, light=0.9, lost_per_s=0.01)
    wear.inject("defocus", 50.0, px=1.0)
    assert wear.light_at(20.0) == pytest.approx(0.7)
    assert wear.light_at(1e6) == LIGHT_OFF
    wear.inject("dark", 60.0)
    assert wear.light_at(61.0) == LIGHT_OFF
    wear.inject("dark", 62.0, on=False)
    assert wear.light_at(1e6) == 1.0
    assert wear.blur_px(0.0, 1e6) == 1.0


@pytest.mark.parametrize(
    ("fault", "params"),
    [
        ("defocus", {"px": -1.0}),
        ("defocus", {"px": 9.0}),
        ("defocus", {"mm": 1.0}),
        ("dim", {"light": 9.0}),
        ("dark", {"off": 1}),
    ],
)
def test_what_cannot_be_is_refused(fault: str, params: dict[str, float]) -> None:
    world = World(1, Product(BaseDrawing(), BatteryDrawing()))
    with pytest.raises(ValueError, match=r"camera fault|a defocus is|a lamp gives"):
        world.inject("camera_2", fault, **params)


def test_an_unknown_camera_fault_names_those_that_there_are() -> None:
    world = World(1, Product(BaseDrawing(), BatteryDrawing()))
    with pytest.raises(ValueError, match=r"camera_1 defocus.*camera_2 dim"):
        world.inject("camera_3", "defocus")
