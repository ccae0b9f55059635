"""The PLC's register map: words on the wire <-> names. Pure.

Holding registers, addresses as on the wire (0-based), 32-bit values high word first.
cellctl writes 0..15, the PLC writes 100..131; the map has a version word.
"""

from collections.abc import Callable, Sequence
from enum import IntEnum, IntFlag
from typing import Generic, NamedTuple, TypeVar

WRITE_ADDRESS, WRITE_COUNT = 0, 16
READ_ADDRESS, READ_COUNT = 100, 32
LONG_VALUES = (11,)  # places among the PLC's words where 32 bits begin
MAP_VERSION = 0x0100
T = TypeVar("T")


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


LAST_STATE = max(PlcState)


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


FAULT_NAMES = {
    0: "none",
    1: "the carrier did not leave the light beam",
    2: "the carrier was not clamped on a standing belt",
    3: "the motor is on and the belt does not turn",
    4: "the motor is off and the belt turns",
}
RESULT_NAMES = {0: "ok", 1: "wrong state", 2: "unknown", 3: "timed out", 4: "fault", 5: "not your session"}


class Safety(IntFlag):
    """Bits of registers 104 (now) and 106 (lost, latched)."""

    ESTOP_HEALTHY = 1
    GUARD_CLOSED = 2
    AIR_OK = 4
    ROBOT_ENABLE = 8


ALL_SAFE = int(Safety.ESTOP_HEALTHY | Safety.GUARD_CLOSED | Safety.AIR_OK | Safety.ROBOT_ENABLE)
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


class Fact(Generic[T]):
    """One fact of a picture, decoded when somebody asks: of most pictures few are asked for."""

    def __init__(self, read: Callable[[Sequence[int]], T]) -> None:
        self._read = read

    def __get__(self, image: "PlcImage", owner: type["PlcImage"]) -> T:
        return self._read(image.words)


def _word(at: int) -> Fact[int]:
    return Fact(lambda words: words[at])


def _bit(at: int, bit: int) -> Fact[bool]:
    return Fact(lambda words: bool(words[at] >> bit & 1))


class PlcImage:
    """Registers 100..131 as the PLC wrote them."""

    __slots__ = ("words",)

    def __init__(self, words: Sequence[int]) -> None:
        self.words = words

    heartbeat = _word(0)
    map_version = _word(1)
    session = _word(2)  # that the PLC serves; 0 = none
    state = Fact(lambda words: PlcState(words[3]))
    estop_healthy = _bit(4, 0)
    guard_closed = _bit(4, 1)
    air_ok = _bit(4, 2)
    robot_enable = _bit(4, 3)
    photo_switch = _bit(5, 0)
    vacuum_reached = _bit(5, 1)
    carrier_clamped = _bit(5, 2)
    battery_on_table = _bit(5, 3)
    conveyor_moving = _bit(5, 4)
    start_button = _bit(5, 5)
    stop_button = _bit(5, 6)
    reset_button = _bit(5, 7)
    lost = Fact(lambda words: Safety(words[6] & 0xF))  # what fell since the latches were reset, also for a moment
    accepted = _word(7)  # command sequence numbers
    finished = _word(8)
    result = _word(9)
    arrival_seq = _word(10)
    arrival_age_s = Fact(lambda words: ((words[11] << 16) | words[12]) / 1000)
    carrier_id = _word(13)
    fault = _word(14)
    vacuum_kpa = Fact(lambda words: (words[15] - ((words[15] & 0x8000) << 1)) / 10)  # negative when sucking
    cycle_ms = Fact(lambda words: words[16] / 10)
    boot = _word(17)
    start_presses = Fact(lambda words: words[18] & 0xFF)
    stop_presses = Fact(lambda words: words[18] >> 8)
    reset_presses = Fact(lambda words: words[19] & 0xFF)


def decode(words: Sequence[int]) -> PlcImage:
    """The picture in registers 100..131; raises ValueError naming the register when a value has no meaning."""
    if len(words) != READ_COUNT:
        raise ValueError(f"registers 100..131 are {READ_COUNT} words (got {len(words)})")
    if words[3] > LAST_STATE:
        raise ValueError(f"register 103 (PLC state) is {words[3]}, known are 0..{LAST_STATE}")
    return PlcImage(words)


RESERVED = [0] * 6  # registers 10..15


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
        return [value & 0xFFFF for value in self] + RESERVED


def why_unsafe(image: PlcImage) -> str:
    """A sentence with registers and values when safety is lost or was; empty when all is well."""
    words = image.words
    if words[4] & 0xF == ALL_SAFE and not words[6] & 0xF and words[3] < PlcState.FAULT:
        return ""  # nearly always, and asked for after every exchange
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
    if image.state is PlcState.FAULT:
        return f"PLC is in fault {image.fault}: {FAULT_NAMES.get(image.fault, 'see the PLC program')} (register 114)"
    if image.state is PlcState.EMERGENCY_STOP:
        return f"PLC is in {image.state.words} (register 103)"
    return ""
