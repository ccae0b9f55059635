"""What the controller needs of the world."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from simulators.arm import Arm
from simulators.clock import Clock


class World(Protocol):
    """Clock, arm, safety inputs, random numbers, faults."""

    @property
    def clock(self) -> Clock:
        """World time."""

    @property
    def arm(self) -> Arm:
        """The arm that the controller drives."""

    @property
    def estop_pressed(self) -> bool:
        """The emergency stop circuit is open."""

    @property
    def guard_open(self) -> bool:
        """The guard door is open."""

    @property
    def robot_enable(self) -> bool:
        """The PLC allows motion."""

    def stream(self, name: str) -> np.random.Generator:
        """Random numbers that depend on the world's seed and the name."""

    def subscribe(self, callback: Callable[[], None]) -> None:
        """Call back on the loop when a safety fact changes."""

    def register(self, component: str, handler: Callable[..., None]) -> None:
        """Take the faults of a component."""
