"""A robot alone on its bench: the least world that a controller needs."""

import zlib
from collections.abc import Callable

import numpy as np

from simulators.arm import START, Arm
from simulators.clock import Clock
from simulators.scara import MODELS, ToolPose


class Bench:
    """Clock, arm, and the safety inputs that a person or a test sets."""

    def __init__(self, *, seed: int = 7, speed: float = 1.0, model: str = "yk400xg", start: ToolPose = START) -> None:
        self.seed = seed
        self.clock = Clock(speed)
        self.arm = Arm(self.clock, self.stream("arm"), start=start, scara=MODELS[model])
        self.estop_pressed = self.guard_open = False
        self.robot_enable = self.air_ok = True
        self._subscribers: list[Callable[[], None]] = []
        self._handlers: dict[str, Callable[..., None]] = {}

    def stream(self, name: str) -> np.random.Generator:
        """Random numbers that depend on the seed and the name only."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])

    def subscribe(self, callback: Callable[[], None]) -> None:
        """Call back, on the loop, whenever a safety fact changes."""
        self._subscribers.append(callback)

    def register(self, component: str, handler: Callable[..., None]) -> None:
        """The controller takes the faults of its component."""
        self._handlers[component] = handler

    def inject(self, component: str, fault: str, **params: object) -> None:
        """Make something go wrong; raises ValueError for what cannot be done."""
        if component == "safety":
            self._inject_safety(fault, on=bool(params.get("on", True)))
        elif component in self._handlers:
            self._handlers[component](fault, **params)
        else:
            raise ValueError(f"cannot inject {component} {fault}; there are: safety, {', '.join(self._handlers)}")

    def safety(self, **facts: bool) -> None:
        """Set safety facts: estop_pressed, guard_open, robot_enable, air_ok."""
        for name, value in facts.items():
            setattr(self, name, value)
        for callback in self._subscribers:
            callback()

    def _inject_safety(self, fault: str, *, on: bool) -> None:
        facts = {"estop": {"estop_pressed": on}, "guard": {"guard_open": on}, "enable": {"robot_enable": not on}}
        if fault not in facts:
            raise ValueError(f"cannot inject safety {fault}; there are: {', '.join(facts)}")
        self.safety(**facts[fault])
