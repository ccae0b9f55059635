"""A robot alone on its bench: the least world that a robot controller needs, and a raw client for its wire."""

import asyncio
import zlib
from contextlib import asynccontextmanager

import numpy as np

from drivers.robot import Limits, Robot
from simulators.arm import Arm
from simulators.clock import Clock
from simulators.robot import RobotController


class Bench:
    """Clock, arm, and safety inputs that a test sets."""

    def __init__(self, speed):
        self.clock = Clock(speed)
        self.arm = Arm(self.clock, self.stream("arm"))
        self.estop_pressed = self.guard_open = False
        self.robot_enable = self.air_ok = True
        self._subscribers = []
        self._handlers = {}

    def stream(self, name):
        return np.random.default_rng([7, zlib.crc32(name.encode())])

    def subscribe(self, callback):
        self._subscribers.append(callback)

    def register(self, component, handler):
        self._handlers[component] = handler

    def inject(self, component, fault, **params):
        self._handlers[component](fault, **params)

    def safety(self, **facts):
        for name, value in facts.items():
            setattr(self, name, value)
        for callback in self._subscribers:
            callback()

    def stands(self):
        return not self.arm.moving_at(self.clock.now())

    def position(self):
        return self.arm.commanded_at(self.clock.now())


@asynccontextmanager
async def controller_on(speed=1.0, **settings):
    """A bench and its controller."""
    bench = Bench(speed)
    controller = RobotController(bench, **settings)
    await controller.start()
    try:
        yield bench, controller
    finally:
        await controller.close()


@asynccontextmanager
async def robot_on(front="tcp", speed=1.0, *, on=True, **settings):
    """A bench and the driver on its controller, with power on."""
    async with controller_on(speed, serial_baud=9600 if front == "serial" else None, **settings) as (bench, controller):
        robot = Robot(address_of(controller, front), limits=Limits())
        await robot.open()
        try:
            if on:
                await robot.power_on()
            yield bench, robot
        finally:
            await robot.close()


def address_of(controller, front="tcp"):
    if front == "serial":
        return f"serial:{controller.tty}?baud=9600&parity=odd&flow=xonxoff"
    return f"tcp://127.0.0.1:{controller.port}"


class Wire:
    """A raw client: what was sent and received, byte for byte."""

    def __init__(self, reader, writer):
        self.reader, self.writer = reader, writer

    @classmethod
    async def to(cls, controller, *, greeting=True):
        wire = cls(*await asyncio.open_connection("127.0.0.1", controller.port))
        if greeting:
            assert await wire.lines(2) == ["Welcome to RCX340", ""]
        return wire

    def send(self, data):
        self.writer.write(data.encode("latin-1") if isinstance(data, str) else data)

    async def lines(self, count, within_s=2.0):
        async with asyncio.timeout(within_s):
            received = [await self.reader.readuntil(b"\r\n") for _ in range(count)]
        return [line[:-2].decode("latin-1") for line in received]

    async def ask(self, command, count=1):
        self.send(f"{command}\r\n")
        return await self.lines(count)

    async def silent(self, for_s=0.03):
        try:
            async with asyncio.timeout(for_s):
                return await self.reader.read(1000) == b"never"
        except TimeoutError:
            return True

    async def power_on(self):
        assert await self.ask("@MOTOR ON", 2) == ["RUN", "END"]

    def close(self):
        self.writer.close()


@asynccontextmanager
async def wire_on(speed=1.0, *, on=True, **settings):
    """A bench and a raw client on its controller, with power on."""
    async with controller_on(speed, **settings) as (bench, controller):
        wire = await Wire.to(controller)
        try:
            if on:
                await wire.power_on()
            yield bench, wire
        finally:
            wire.close()
