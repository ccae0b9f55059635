"""Inputs and outputs, eight bits a port. Ports 0 and 1 are the controller's own; what hangs on the others is wired."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from simulators.robot.codes import Code, Refusal
from simulators.robot.language.values import PortRef

INPUTS, OUTPUTS = ("DI", "SI"), ("DO", "MO", "SO", "LO", "TO")
HIGHEST_PORT = {"DI": 27, "DO": 27, "MO": 33, "SI": 27, "SO": 27, "LO": 0, "TO": 0}
FIRST_OWN_PORT = {"DI": 2, "DO": 2, "SI": 2, "SO": 2, "MO": 2, "LO": 0, "TO": 0}
SHOWS_STATE = ("DO", "SO")  # ports 0 and 1 of these
EIGHT = tuple(reversed(range(8)))


@dataclass(frozen=True)
class Wiring:
    """What the world has connected: (port, bit) of DI to a sensor, of DO to an actuator."""

    inputs: Mapping[tuple[int, int], Callable[[], bool]] = field(default_factory=dict)
    outputs: Mapping[tuple[int, int], Callable[[bool], None]] = field(default_factory=dict)


class Ports:
    """`state` gives the bytes of the dedicated output ports 0 and 1."""

    def __init__(
        self, wiring: Wiring, state: Callable[[], tuple[int, int]], changed: Callable[[str, int, int], None]
    ) -> None:
        self._wiring = wiring
        self._state = state
        self._changed = changed
        self._bytes: dict[tuple[str, int], int] = {}

    def clear_outputs(self) -> None:
        """Everything off, as a program reset does."""
        for kind, port in list(self._bytes):
            if kind in OUTPUTS:
                self._set(kind, port, 0)

    def set_input(self, port: int, bit: int, on: bool, kind: str = "DI") -> None:
        """What an unwired input sees from now on."""
        old = self._bytes.get((kind, port), 0)
        self._bytes[kind, port] = old | 1 << bit if on else old & ~(1 << bit)

    def read(self, ref: PortRef) -> int:
        """The value of these bits; raises Refusal IO_PORT."""
        if ref.port > HIGHEST_PORT[ref.kind]:
            raise Refusal(Code.IO_PORT)
        byte = self._byte(ref.kind, ref.port)
        value = 0
        for bit in ref.bits or EIGHT:
            value = value << 1 | byte >> bit & 1
        return value

    def write(self, ref: PortRef, value: int) -> None:
        """Set these bits; raises Refusal IO_PORT, PARAMETER_RANGE."""
        if ref.kind in INPUTS or not FIRST_OWN_PORT[ref.kind] <= ref.port <= HIGHEST_PORT[ref.kind]:
            raise Refusal(Code.IO_PORT)
        bits = ref.bits or EIGHT
        if not 0 <= value < 1 << len(bits):
            raise Refusal(Code.PARAMETER_RANGE)
        byte = self._bytes.get((ref.kind, ref.port), 0)
        for place, bit in enumerate(reversed(bits)):
            byte = byte & ~(1 << bit) | (value >> place & 1) << bit
        self._set(ref.kind, ref.port, byte)

    def _byte(self, kind: str, port: int) -> int:
        if kind in SHOWS_STATE and port < len(self._state()):
            return self._state()[port]
        byte = self._bytes.get((kind, port), 0)
        if kind == "DI":
            for (at, bit), sensor in self._wiring.inputs.items():
                if at == port:
                    byte = byte | 1 << bit if sensor() else byte & ~(1 << bit)
        return byte

    def _set(self, kind: str, port: int, byte: int) -> None:
        changed = self._bytes.get((kind, port), 0) ^ byte
        if not changed:
            return
        self._bytes[kind, port] = byte
        self._changed(kind, port, byte)
        if kind == "DO":
            for (at, bit), actuator in self._wiring.outputs.items():
                if at == port and changed >> bit & 1:
                    actuator(bool(byte >> bit & 1))
