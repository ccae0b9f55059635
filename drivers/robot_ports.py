"""Inputs and outputs of the controller: eight bits a port, written and read back."""

from typing import Literal

from drivers.controller import Controller
from drivers.errors import NoAnswer
from drivers.rcx import parse_byte, parse_flag_alone

Inputs = Literal["DI", "SI"]
Outputs = Literal["DO", "MO", "SO"]
FIRST_OWN, HIGHEST = 2, 27  # ports 0 and 1 tell the controller's own state


class Ports:
    """Ports by kind and number; `DI`, 2, 3 is what a pendant shows as DI23. All raise Refused, NoAnswer, LinkLost."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller

    async def read(self, kind: Inputs | Outputs, port: int) -> int:
        """The eight bits of a port, bit 0 lowest."""
        return await self._controller.value(f"{kind}{_checked(port, 0, HIGHEST)}()", parse_byte)

    async def bit(self, kind: Inputs | Outputs, port: int, bit: int) -> bool:
        """One bit of a port."""
        name = f"{kind}{_checked(port, 0, HIGHEST)}({_checked(bit, 0, 7)})"
        return await self._controller.value(name, parse_flag_alone)

    async def write(self, kind: Outputs, port: int, byte: int) -> None:
        """Set all eight bits; raises NoAnswer when they read back otherwise."""
        name = f"{kind}{_checked(port, FIRST_OWN, HIGHEST)}()"
        await self._controller.set(f"{name}={_checked(byte, 0, 255)}")
        if (now := await self._controller.value(name, parse_byte)) != byte:
            raise NoAnswer(self._controller.device, f"{name} was set to {byte} and is {now}")

    async def switch(self, kind: Outputs, port: int, bit: int, on: bool) -> None:
        """Set one bit; raises NoAnswer when it reads back otherwise."""
        name = f"{kind}{_checked(port, FIRST_OWN, HIGHEST)}({_checked(bit, 0, 7)})"
        await self._controller.set(f"{name}={int(on)}")
        if await self._controller.value(name, parse_flag_alone) is not on:
            raise NoAnswer(self._controller.device, f"{name} was set to {int(on)} and is {int(not on)}")


def _checked(number: int, low: int, high: int) -> int:
    if not low <= number <= high:
        raise ValueError(f"{number} is outside {low} .. {high}")
    return number


class Valve:
    """A valve on one of the controller's outputs, by its number on the pendant: 20 is DO20, port 2 bit 0."""

    def __init__(self, ports: Ports, output: int) -> None:
        self._ports = ports
        self._port, self._bit = divmod(output, 10)

    async def switch(self, on: bool) -> None:
        """Open or close it; raises as `Ports.switch`."""
        await self._ports.switch("DO", self._port, self._bit, on)
