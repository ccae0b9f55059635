"""The other side of `bench_reaction`: a PLC and a robot controller in a process of their own, and what truly came.

On order the PLC shows the emergency stop circuit open (register 104 bit 0, latched in 106) while the robot's own
circuit stays closed: the controller must stop the arm because of that bit and of nothing else.
"""

import asyncio
import time
from collections.abc import Iterable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from simulators.plc import PlcServer
from simulators.product import load_product
from simulators.robot import RobotController
from simulators.robot.log import Entry
from simulators.running import exact_loop
from simulators.world import World

PRODUCT = Path(__file__).parents[2] / "recipes" / "x85.toml"
ESTOP = 0b1
QUESTION = "@?"


class Heard(NamedTuple):
    """One line or control character that came at the robot; all processes share this clock, CLOCK_MONOTONIC."""

    at_s: float
    text: str

    @property
    def is_question(self) -> bool:
        """Moves nothing and stops nothing."""
        return self.text.startswith(QUESTION)

    @property
    def is_motion(self) -> bool:
        """Begins a motion."""
        return self.text.startswith(("@MOVE", "@DRIVE", "@PMOVE"))


class Outcome(NamedTuple):
    """When the bit was set, and everything that came at the robot since."""

    bit_at_s: float
    heard: list[Heard]


class Side:
    """Carries out orders that come through a pipe: "open" the circuit, "tell" what came since, "close" it, "end"."""

    def __init__(self, orders: Connection, speed: float) -> None:
        self._orders = orders
        self._world = World(1, load_product(PRODUCT), speed=speed)
        self._plc = PlcServer(self._world)
        self._robot = RobotController(self._world)
        self._robot.log.listener = self._listen
        self._heard: list[Heard] = []
        self._open_at_s: float | None = None
        self._ended = asyncio.Event()
        bank = self._plc.modbus.bank
        scan = bank.before_read

        def show(*block: Any) -> None:
            scan(*block)
            if self._open_at_s is not None:
                self._plc.memory[104] &= ~ESTOP
                self._plc.memory[106] |= ESTOP

        bank.before_read = show

    async def run(self) -> None:
        await self._plc.start()
        await self._robot.start()
        self._orders.send((self._plc.port, self._robot.port))
        loop = asyncio.get_running_loop()
        loop.add_reader(self._orders.fileno(), self._obey)
        await self._ended.wait()
        loop.remove_reader(self._orders.fileno())
        await self._robot.close()
        await self._plc.close()

    def _obey(self) -> None:
        order = self._orders.recv()
        if order == "open":
            self._heard.clear()
            self._open_at_s = time.monotonic()
        elif order == "tell":
            assert self._open_at_s is not None
            self._orders.send(Outcome(self._open_at_s, list(self._heard)))
        elif order == "close":
            self._open_at_s = None
        else:
            self._ended.set()

    def _listen(self, entry: Entry) -> None:
        if entry.kind == "heard":
            self._heard.append(Heard(time.monotonic(), entry.line))
        elif entry.kind == "control":
            self._heard.append(Heard(time.monotonic(), f"{entry.byte!r}"))


def serve(orders: Connection, speed: float) -> None:
    """The whole process."""
    with asyncio.Runner(loop_factory=exact_loop) as runner:
        runner.run(_serve(orders, speed))


async def _serve(orders: Connection, speed: float) -> None:
    await Side(orders, speed).run()


def last_ms(outcome: Outcome, heard: Iterable[Heard]) -> float:
    """From the bit to the last of these; 0 when none came."""
    return max((1e3 * (each.at_s - outcome.bit_at_s) for each in heard), default=0.0)
