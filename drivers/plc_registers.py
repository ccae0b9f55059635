"""The PLC's register map: words on the wire <-> names. Pure.

Holding registers, addresses as on the wire (0-based), 32-bit values high word first.
cellctl writes 0..15, the PLC writes 100..131; the map has a version word.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple

WRITE_ADDRESS, WRITE_COUNT = 0, 16
READ_ADDRESS, READ_COUNT = 100, 32
MAP_VERSION = 0x0100


class PlcState(IntEnum):
    """Register 103."""

    STARTING = 0
    READY = 1
    RUNNING = 2
    CLIENT_SILENT = 3
    FAULT = 4
    EMERGENCY_STOP = 5

    @property
    def words(self) -> str:
        """As it is called in a sentence."""
        return self.name.lower().replace("_", " ")


class Command(IntEnum):
    """Register 4."""

    NONE = 0
    BRING_BASE = 1
    RELEASE_GOOD = 2
    RELEASE_REJECT = 3
    STOP_CONVEYOR = 4
    RESET_LATCHES = 5

    @property
    def words(self) -> str:
        """As it is called in a sentence."""
        return self.name.lower().replace("_", " ")


RESULT_NAMES = {0: "ok", 1: "wrong state", 2: "unknown", 3: "timed out", 4: "fault", 5: "not your session"}


class Safety(IntFlag):
    """Bits of registers 104 (now) and 106 (lost, latched)."""

    ESTOP_HEALTHY = 1
    GUARD_CLOSED = 2
    AIR_OK = 4
    ROBOT_ENABLE = 8


SAFETY_NAMES = {
    Safety.ESTOP_HEALTHY: "emergency stop circuit",
    Safety.GUARD_CLOSED: "guard",
    Safety.AIR_OK: "air pressure",
    Safety.ROBOT_ENABLE: "robot enable",
}


class Output(IntFlag):
    """Bits of register 6."""

    VACUUM = 1
    BLOW_OFF = 2
    LIGHT_1 = 4
    LIGHT_2 = 8
    RED = 16
    AMBER = 32
    GREEN = 64
    BUZZER = 128


@dataclass(frozen=True, slots=True)
class PlcImage:
    """Registers 100..131 as the PLC wrote them, decoded."""

    heartbeat: int
    map_version: int
    session: int  # that the PLC serves; 0 = none
    state: PlcState
    estop_healthy: bool
    guard_closed: bool
    air_ok: bool
    robot_enable: bool
    photo_switch: bool
    vacuum_reached: bool
    carrier_clamped: bool
    battery_on_table: bool
    conveyor_moving: bool
    start_button: bool
    stop_button: bool
    reset_button: bool
    lost: Safety  # what fell since the latches were reset, also for a moment
    accepted: int  # command sequence numbers
    finished: int
    result: int
    arrival_seq: int
    arrival_age_s: float
    carrier_id: int
    fault: int
    vacuum_kpa: float  # negative when sucking
    cycle_ms: float
    boot: int
    start_presses: int
    stop_presses: int


def decode(words: Sequence[int]) -> PlcImage:
    """The picture in registers 100..131; raises ValueError naming the register when a value has no meaning."""
    if len(words) != READ_COUNT:
        raise ValueError(f"registers 100..131 are {READ_COUNT} words (got {len(words)})")
    if words[3] > max(PlcState):
        raise ValueError(f"register 103 (PLC state) is {words[3]}, known are 0..{max(PlcState)}")
    safety, inputs = words[4], words[5]
    return PlcImage(
        heartbeat=words[0],
        map_version=words[1],
        session=words[2],
        state=PlcState(words[3]),
        estop_healthy=bool(safety & 1),
        guard_closed=bool(safety & 2),
        air_ok=bool(safety & 4),
        robot_enable=bool(safety & 8),
        photo_switch=bool(inputs & 1),
        vacuum_reached=bool(inputs & 2),
        carrier_clamped=bool(inputs & 4),
        battery_on_table=bool(inputs & 8),
        conveyor_moving=bool(inputs & 16),
        start_button=bool(inputs & 32),
        stop_button=bool(inputs & 64),
        reset_button=bool(inputs & 128),
        lost=Safety(words[6] & 0xF),
        accepted=words[7],
        finished=words[8],
        result=words[9],
        arrival_seq=words[10],
        arrival_age_s=((words[11] << 16) | words[12]) / 1000,
        carrier_id=words[13],
        fault=words[14],
        vacuum_kpa=(words[15] - ((words[15] & 0x8000) << 1)) / 10,
        cycle_ms=words[16] / 10,
        boot=words[17],
        start_presses=words[18] & 0xFF,
        stop_presses=words[18] >> 8,
    )


class CellWords(NamedTuple):
    """Registers 0..15 as cellctl writes them; every field is one word."""

    heartbeat: int = 0
    session: int = 0
    machine_state: int = 0
    sequence: int = 0
    command: int = 0
    argument: int = 0
    outputs: int = 0
    arrival_acknowledged: int = 0
    good: int = 0
    rejected: int = 0

    def encode(self) -> list[int]:
        """Sixteen words; counters keep their low word."""
        return [value & 0xFFFF for value in self] + [0] * (WRITE_COUNT - len(self))


def why_unsafe(image: PlcImage) -> str:
    """A sentence with registers and values when safety is lost or was; empty when all is well."""
    down = [
        name
        for name, healthy in (
            ("emergency stop circuit is open", image.estop_healthy),
            ("guard is open", image.guard_closed),
            ("air pressure is missing", image.air_ok),
            ("robot enable is off", image.robot_enable),
        )
        if not healthy
    ]
    if down:
        return f"{', '.join(down)} (register 104); make it safe and reset"
    if image.lost:
        names = ", ".join(name for bit, name in SAFETY_NAMES.items() if bit & image.lost)
        return f"{names} was lost for a moment (register 106 is {int(image.lost):#06x}); find out why and reset"
    if image.state in (PlcState.FAULT, PlcState.EMERGENCY_STOP):
        return (
            f"PLC is in {image.state.words} (register 103 is {int(image.state)}, fault number in 114 is {image.fault})"
        )
    return ""
