"""The PLC's wires: addresses of the program on one side, the world's sensors and actuators on the other."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Protocol

ANALOGUE_FULL_SCALE, FULL_SCALE_KPA = 27648, -100.0  # of the vacuum sensor
ANALOGUE_LIMIT = 32767
OUTPUTS = {*(f"%QX0.{bit}" for bit in range(8)), *(f"%QX1.{bit}" for bit in range(7))}


class PlcWorld(Protocol):
    """What the PLC is wired to."""

    estop_pressed: bool
    guard_open: bool
    air_ok: bool
    robot_enable: bool

    def photo_switch(self) -> bool:
        """A carrier is in the light beam at the station."""

    def carrier_clamped(self) -> bool:
        """The clamp holds a carrier."""

    def battery_on_table(self) -> bool:
        """Presence sensor of the table."""

    def conveyor_moving(self) -> bool:
        """The belt turns."""

    def vacuum_kpa(self) -> float:
        """At the cup, negative when sucking."""

    def carrier_id(self) -> int:
        """Of the carrier at the station, 0 = none."""

    def drive_conveyor(self, on: bool) -> None:
        """Belt motor."""

    def clamp(self, on: bool) -> None:
        """Carrier clamp."""

    def release_carrier(self, good: bool) -> None:
        """Lower the stop pin; the diverter sends the carrier to good or reject."""

    def valve(self, on: bool) -> None:
        """Vacuum valve."""

    def blow(self, on: bool) -> None:
        """Blow-off valve."""

    def light(self, camera: int, on: bool) -> None:
        """Light of camera 1 or 2."""

    def lamps(self, red: bool, amber: bool, green: bool, buzzer: bool) -> None:
        """Signal tower."""


def inputs(
    world: PlcWorld, photo_switch: Callable[[], bool], button: Callable[[str], bool]
) -> dict[str, Callable[[], int | bool]]:
    """What each input terminal shows."""
    return {
        "%IX0.0": photo_switch,
        "%IX0.1": world.carrier_clamped,
        "%IX0.2": world.battery_on_table,
        "%IX0.3": world.conveyor_moving,
        "%IX0.4": lambda: not world.estop_pressed,
        "%IX0.5": lambda: not world.guard_open,
        "%IX0.6": lambda: world.air_ok,
        "%IX1.0": partial(button, "start"),
        "%IX1.1": partial(button, "stop"),
        "%IX1.2": partial(button, "reset"),
        "%IW2": lambda: analogue(world.vacuum_kpa()),
        "%IW4": lambda: world.carrier_id() & 0xFFFF,
    }


def analogue(kpa: float) -> int:
    """The value that the vacuum sensor's input card shows; it ends where the card does."""
    value = round(kpa / FULL_SCALE_KPA * ANALOGUE_FULL_SCALE)
    return max(-ANALOGUE_LIMIT, min(value, ANALOGUE_LIMIT))


class Actuators:
    """Valves, motor, lamps. Valves with two coils stay where they are while neither is on."""

    def __init__(self, world: PlcWorld) -> None:
        self._world = world
        self._terminals: Mapping[str, bool] = {}

    def drive(self, terminals: Mapping[str, bool]) -> None:
        """Give every output terminal its voltage; what has not changed is left alone."""
        before, self._terminals = self._terminals, terminals
        changed = {name for name, on in terminals.items() if on != before.get(name, False)}
        if not changed:
            return
        on, world = terminals, self._world
        world.robot_enable = on["%QX1.6"]
        if changed & {"%QX0.1", "%QX0.2"} and on["%QX0.1"] != on["%QX0.2"]:
            world.clamp(on["%QX0.1"])
        if "%QX0.6" in changed and on["%QX0.6"]:
            world.release_carrier(not on["%QX0.7"])
        if "%QX0.0" in changed:
            world.drive_conveyor(on["%QX0.0"])
        if changed & {"%QX0.3", "%QX0.4"} and on["%QX0.3"] != on["%QX0.4"]:
            world.valve(on["%QX0.3"])
        self._show(on, changed)

    def _show(self, on: Mapping[str, bool], changed: set[str]) -> None:
        world = self._world
        if "%QX0.5" in changed:
            world.blow(on["%QX0.5"])
        for camera, terminal in ((1, "%QX1.0"), (2, "%QX1.1")):
            if terminal in changed:
                world.light(camera, on[terminal])
        if changed & {"%QX1.2", "%QX1.3", "%QX1.4", "%QX1.5"}:
            world.lamps(on["%QX1.2"], on["%QX1.3"], on["%QX1.4"], on["%QX1.5"])
