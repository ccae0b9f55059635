"""A simulated PLC on a world that is only its wires, and the driver on it."""

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import Any

from drivers.plc import Plc
from simulators.clock import Clock
from simulators.plc import PlcServer

TRAVEL_S, LEAVE_S, BOUNCE_S = 0.8, 0.3, 0.01


class Belt:
    """A world that is only what the PLC is wired to. It keeps a record of what truly happened."""

    def __init__(self, speed: float) -> None:
        self.clock = Clock(speed)
        self.estop_pressed = self.guard_open = False
        self.air_ok = True
        self.robot_enable = False
        self.supply = True
        self.sealed = True
        self.brought = 0
        self.left: list[tuple[int, bool]] = []
        self.belt_starts = 0
        self.valve_changes: list[bool] = []
        self.blowing = False
        self.lights = {1: False, 2: False}
        self.tower = (False, False, False, False)
        self._runs = self._clamped = self._leaving = self._good = False
        self._carrier = 0
        self._ran_s = self._seen_s = self._arrived_s = self._valve_s = 0.0
        self._subscribers: list[Callable[[], None]] = []
        self.inject: Callable[..., None] = lambda fault, **params: None

    def subscribe(self, callback: Callable[[], None]) -> None:
        self._subscribers.append(callback)

    def register(self, component: str, handler: Callable[..., None]) -> None:
        assert component == "plc"
        self.inject = handler

    def safety(self, **facts: bool) -> None:
        for name, value in facts.items():
            setattr(self, name, value)
        for callback in self._subscribers:
            callback()

    def _settle(self) -> None:
        now_s = self.clock.now()
        self._ran_s += (now_s - self._seen_s) * self._runs
        self._seen_s = now_s
        if self._leaving and not self._clamped and self._ran_s >= LEAVE_S:
            self.left.append((self._carrier, self._good))
            self._carrier, self._leaving = 0, False
            self._ran_s -= LEAVE_S
        if not self._carrier and self.supply and self._ran_s >= TRAVEL_S:
            self.brought += 1
            self._carrier, self._ran_s, self._arrived_s = 500 + self.brought, 0.0, now_s

    def photo_switch(self) -> bool:
        self._settle()
        age_s = self.clock.now() - self._arrived_s
        return bool(self._carrier) and (age_s > BOUNCE_S or int(age_s * 1000) % 4 < 2)

    def carrier_clamped(self) -> bool:
        self._settle()
        return self._clamped and bool(self._carrier)

    def battery_on_table(self) -> bool:
        return True

    def conveyor_moving(self) -> bool:
        return self._runs

    def vacuum_kpa(self) -> float:
        on = bool(self.valve_changes) and self.valve_changes[-1]
        fade = math.exp(-(self.clock.now() - self._valve_s) / 0.03)
        best = -70.0 if self.sealed else -6.0
        return best * (1 - fade) if on else best * fade * bool(self.valve_changes)

    def carrier_id(self) -> int:
        self._settle()
        return self._carrier

    def drive_conveyor(self, on: bool) -> None:
        self._settle()
        self.belt_starts += on and not self._runs
        self._runs = on

    def clamp(self, on: bool) -> None:
        self._settle()
        self._clamped = on

    def release_carrier(self, good: bool) -> None:
        self._settle()
        self._leaving, self._good, self._ran_s = True, good, 0.0

    def valve(self, on: bool) -> None:
        if on != (self.valve_changes[-1] if self.valve_changes else False):
            self.valve_changes.append(on)
            self._valve_s = self.clock.now()

    def blow(self, on: bool) -> None:
        self.blowing = on

    def light(self, camera: int, on: bool) -> None:
        self.lights[camera] = on

    def lamps(self, red: bool, amber: bool, green: bool, buzzer: bool) -> None:
        self.tower = (red, amber, green, buzzer)


@asynccontextmanager
async def running(plc: Plc) -> AsyncIterator[Plc]:
    task = asyncio.create_task(plc.run())
    try:
        yield plc
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


@dataclass
class Cell:
    """World, PLC and driver, connected."""

    world: Belt
    server: PlcServer
    plc: Plc

    def register(self, address: int) -> int:
        return self.server.memory[address]


@asynccontextmanager
async def powered(speed: float = 20.0, **options: Any) -> AsyncIterator[tuple[Belt, PlcServer]]:
    world = Belt(speed)
    server = PlcServer(world, **options)
    await server.start()
    try:
        yield world, server
    finally:
        await server.close()


@asynccontextmanager
async def cell(speed: float = 20.0, **options: Any) -> AsyncIterator[Cell]:
    async with powered(speed) as (world, server), running(Plc("127.0.0.1", server.port, **options)) as plc:
        await plc.ready(within_s=2)
        yield Cell(world, server, plc)


async def eventually(holds: Callable[[], bool], within_s: float = 2.0) -> None:
    async with asyncio.timeout(within_s):
        while not holds():
            await asyncio.sleep(0.002)


def write_record(server: PlcServer) -> set[int]:
    """Every session number that is written from now on."""
    sessions: set[int] = set()
    scan = server.modbus.bank.after_write

    def then(*block: Any) -> None:
        sessions.add(server.memory[1])
        scan(*block)

    server.modbus.bank.after_write = then
    return sessions
