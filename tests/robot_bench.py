"""A robot alone on its bench, for both sides of its wire: controllers, drivers on them, and raw clients."""

import asyncio
import contextlib
import os
from contextlib import asynccontextmanager
from dataclasses import fields

from drivers.robot import Limits, Robot
from simulators.arm import START
from simulators.robot import Bench, Options, RobotController
from simulators.robot.serial_line import XOFF, XON

OPTIONS = {field.name for field in fields(Options)}


class WatchedBench(Bench):
    """The bench with what tests ask about its arm."""

    def stands(self):
        return not self.arm.moving_at(self.clock.now())

    def position(self):
        return self.arm.commanded_at(self.clock.now())


@asynccontextmanager
async def controller_on(speed=1.0, *, model="yk400xg", start=START, **settings):
    """A bench and its controller; `settings` are the controller's, or fields of its Options."""
    options = {name: settings.pop(name) for name in OPTIONS & settings.keys()}
    bench = WatchedBench(speed=speed, model=model, start=start)
    controller = RobotController(bench, options=Options(**options), **settings)
    await controller.start()
    try:
        yield bench, controller
    finally:
        await controller.close()


@asynccontextmanager
async def robot_on(front="tcp", speed=1.0, *, on=True, **settings):
    """A bench and the driver on its controller, with power on."""
    async with controller_on(speed, serial_baud=9600 if front == "serial" else None, **settings) as (bench, controller):
        robot = Robot(address_of(controller, front), limits=Limits(), dialect=settings.get("dialect", "rcx3"))
        bench.controller = controller
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
        dialect = controller.machine.dialect
        if greeting and dialect.greeting:
            assert await wire.lines(2) == [dialect.options.greeting or dialect.greeting, ""]
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


class SerialWire:
    """A raw client on a terminal; the same verbs. It obeys XON and XOFF."""

    def __init__(self, path):
        self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._data = b""
        self._unsent = b""
        self.held = False
        self.holds = 0

    def send(self, data):
        self._unsent += data.encode("latin-1") if isinstance(data, str) else data
        self._move()

    async def lines(self, count, within_s=5.0):
        async with asyncio.timeout(within_s):
            while self._data.count(b"\r\n") < count:
                await asyncio.sleep(0.001)
                self._move()
        *lines, self._data = self._data.split(b"\r\n", count)
        return [line.decode("latin-1") for line in lines]

    async def ask(self, command, count=1):
        self.send(f"{command}\r\n")
        return await self.lines(count)

    async def silent(self, for_s=0.05):
        await asyncio.sleep(for_s)
        self._move()
        return not self._data

    def _move(self):
        with contextlib.suppress(BlockingIOError):
            heard = os.read(self._fd, 4096)
            self.holds += heard.count(XOFF)
            for byte in heard:
                self.held = byte == XOFF if byte in (XON, XOFF) else self.held
            self._data += heard.translate(None, bytes((XON, XOFF)))
        while self._unsent and not self.held:
            sent = os.write(self._fd, self._unsent[:64])
            self._unsent = self._unsent[sent:]
            if sent == 64:
                break

    def close(self):
        os.close(self._fd)


@asynccontextmanager
async def wire_on(speed=1.0, *, on=True, **settings):
    """A bench and a raw client on its controller, with power on."""
    async with controller_on(speed, **settings) as (bench, controller):
        wire = await Wire.to(controller)
        bench.controller = controller
        try:
            if on and controller.machine.dialect.name == "rcx3":
                await wire.power_on()
            yield bench, wire
        finally:
            wire.close()


@asynccontextmanager
async def serial_wire_on(speed=1.0, *, baud=9600, **settings):
    """A bench and a raw client on its controller's serial line."""
    async with controller_on(speed, port=None, serial_baud=baud, **settings) as (bench, controller):
        wire = SerialWire(controller.tty)
        bench.controller = controller
        try:
            yield bench, wire
        finally:
            wire.close()
