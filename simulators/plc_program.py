"""The program in the simulated PLC: the delivered cell.st, executed scan by scan between wires and registers.

Process timers run in world seconds; what watches the client (heartbeat, session) runs in wall seconds, because the
client is not accelerated.
"""

from collections.abc import Callable, MutableMapping
from pathlib import Path
from typing import Protocol

from simulators.plc_wiring import OUTPUTS, Actuators, PlcWorld, inputs
from simulators.st.errors import StError
from simulators.st.library import NOWHERE, TimeBase
from simulators.st.machine import Machine

DELIVERED = Path(__file__).parent.parent / "deploy" / "plc" / "cell.st"
ON_WALL_TIME = ("client", "startUp", "sinceScan")  # function blocks of the program
ORDERS, PICTURE = range(0, 16), range(100, 132)  # registers written by the client, written by the PLC
US_PER_S = 1_000_000


class Program(Protocol):
    """What a PLC executes; another program for the same register map may take its place."""

    def scan(self, now_world_s: float, now_wall_s: float) -> None:
        """One PLC cycle."""

    def halt(self) -> None:
        """The PLC goes to STOP: every output drops."""

    def restart(self) -> None:
        """Power came back: variables are fresh but those that are RETAIN."""


class PlcProgram:
    """A Structured Text program on the wires of the world and the registers of the Modbus server.

    `memory` are the holding registers. Raises StError when the program is not in the subset that is executed, or lacks
    a terminal or a function block that the cell needs; OSError when it cannot be read.
    """

    def __init__(
        self,
        world: PlcWorld,
        memory: MutableMapping[int, int],
        *,
        photo_switch: Callable[[], bool],
        button: Callable[[str], bool],
        source: Path = DELIVERED,
    ) -> None:
        self._world_time, self._wall_time = TimeBase(), TimeBase()
        time_of = dict.fromkeys(ON_WALL_TIME, self._wall_time)
        self.machine = Machine(_text(source), name=str(source), time=self._world_time, time_of=time_of)
        self._registers = memory
        self._actuators = Actuators(world)
        terminals = inputs(world, photo_switch, button)
        places, self._outputs = self.machine.located("%I"), self.machine.located("%Q")
        registers = self.machine.located("%M")
        strange = registers.keys() - {f"%MW{register}" for register in (*ORDERS, *PICTURE)}
        if odd := (places.keys() ^ terminals.keys()) | (self._outputs.keys() ^ OUTPUTS) | strange:
            raise _refused(source, f"addresses that are not wired, or lack: {', '.join(sorted(odd))}")
        self._inputs = [(places[address], read) for address, read in terminals.items()]
        words = {int(address.removeprefix("%MW")): at for address, at in registers.items()}
        self._orders = [(at, register) for register, at in words.items() if register in ORDERS]
        self._picture = [(at, register) for register, at in words.items() if register in PICTURE]

    def scan(self, now_world_s: float, now_wall_s: float) -> None:
        """One PLC cycle: read, execute, drive, publish. Raises StFault when the program fails."""
        self._world_time.now_us = round(now_world_s * US_PER_S)
        self._wall_time.now_us = round(now_wall_s * US_PER_S)
        memory, registers = self.machine.memory, self._registers
        for at, read in self._inputs:
            memory[at] = read()
        for at, register in self._orders:
            memory[at] = registers[register]
        self.machine.scan()
        self._actuators.drive({address: memory[at] for address, at in self._outputs.items()})
        for at, register in self._picture:
            registers[register] = memory[at] & 0xFFFF

    def halt(self) -> None:
        """The PLC goes to STOP: every output drops; valves with two coils stay where they are."""
        self._actuators.drive(dict.fromkeys(self._outputs, False))

    def restart(self) -> None:
        """Power came back: variables are fresh but those that are RETAIN."""
        self.machine.power_cycle()


def _text(source: Path) -> str:
    try:
        return source.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise _refused(source, f"this is no text in UTF-8 (byte {error.start})") from None


def _refused(source: Path, message: str) -> StError:
    error = StError(NOWHERE, message)
    error.source = str(source)
    return error
