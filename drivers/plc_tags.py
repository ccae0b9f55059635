"""The register map as a table for people and programs: address, name, unit, and the value in words. Pure.

`plc_registers` decodes what the driver works with; this table also names what cellctl writes, and shows every value.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from drivers.modbus_frames import HEADER_SIZE, said
from drivers.plc_ages import Ages
from drivers.plc_registers import FAULT_NAMES, READ_ADDRESS, RESULT_NAMES, WRITE_ADDRESS, Command, PlcState

Shown = int | float | str | dict[str, bool]
OUTPUT_BITS = ("vacuum", "blow-off", "light camera 1", "light camera 2", "red", "amber", "green", "buzzer")
SAFETY_BITS = ("emergency stop circuit healthy", "guard closed", "air pressure", "robot enable")
INPUT_BITS = (
    "photo switch",
    "vacuum reached",
    "carrier clamped",
    "battery on table",
    "conveyor moving",
    "start button",
    "stop button",
    "reset button",
)


def _number(words: Sequence[int]) -> Shown:
    return words[0]


def _hexadecimal(words: Sequence[int]) -> Shown:
    return f"{words[0]:#06x}"


def _long(words: Sequence[int]) -> Shown:
    return words[0] << 16 | words[1]


def _tenths(words: Sequence[int]) -> Shown:
    return words[0] / 10


def _signed_tenths(words: Sequence[int]) -> Shown:
    return (words[0] - ((words[0] & 0x8000) << 1)) / 10


def _low_byte(words: Sequence[int]) -> Shown:
    return words[0] & 0xFF


def _high_byte(words: Sequence[int]) -> Shown:
    return words[0] >> 8


def _bits(*names: str) -> Callable[[Sequence[int]], Shown]:
    return lambda words: {name: bool(words[0] >> at & 1) for at, name in enumerate(names)}


def _choice(names: Mapping[int, str]) -> Callable[[Sequence[int]], Shown]:
    return lambda words: f"{words[0]} {names.get(words[0], 'unknown')}"


class Tag(NamedTuple):
    """One value of the map: address of its first register, and how the words from there on are shown."""

    address: int
    name: str
    show: Callable[[Sequence[int]], Shown] = _number
    unit: str = ""


CELL_TAGS = (
    Tag(0, "cellctl heartbeat"),
    Tag(1, "session", _hexadecimal),
    Tag(2, "machine state (PackML)"),
    Tag(3, "command sequence"),
    Tag(4, "command", _choice({code.value: code.words for code in Command})),
    Tag(5, "command argument"),
    Tag(6, "outputs", _bits(*OUTPUT_BITS)),
    Tag(7, "arrival acknowledged"),
    Tag(8, "good units"),
    Tag(9, "rejected units"),
)
PLC_TAGS = (
    Tag(100, "PLC heartbeat"),
    Tag(101, "map version", _hexadecimal),
    Tag(102, "session served", _hexadecimal),
    Tag(103, "PLC state", _choice({state.value: state.words for state in PlcState})),
    Tag(104, "safety", _bits(*SAFETY_BITS)),
    Tag(105, "inputs", _bits(*INPUT_BITS)),
    Tag(106, "safety lost, latched", _bits(*SAFETY_BITS)),
    Tag(107, "command accepted"),
    Tag(108, "command finished"),
    Tag(109, "result", _choice(RESULT_NAMES)),
    Tag(110, "arrival sequence"),
    Tag(111, "time since that arrival", _long, "ms"),
    Tag(113, "carrier id"),
    Tag(114, "fault number", _choice(FAULT_NAMES)),
    Tag(115, "vacuum", _signed_tenths, "kPa"),
    Tag(116, "PLC cycle time", _tenths, "ms"),
    Tag(117, "boot counter"),
    Tag(118, "start button presses", _low_byte),
    Tag(118, "stop button presses", _high_byte),
    Tag(119, "reset button presses", _low_byte),
)


class Packet(NamedTuple):
    """One packet on the wire: when, which way, what."""

    at_s: float
    sent: bool
    data: bytes

    def __str__(self) -> str:
        """Direction, bytes, and what is asked in words."""
        asked = f"   {said(self.data[HEADER_SIZE:])}" if self.sent else ""
        return f"{'>' if self.sent else '<'} {self.data.hex(' ')}{asked}"


class Seen(NamedTuple):
    """Both blocks as they went over the wire last, the newest packets, and what is wrong with the link ("" = nothing).

    All times are those of one monotonic clock, `now_s` among them.
    """

    now_s: float
    cell: Ages
    plc: Ages
    packets: tuple[Packet, ...]
    trouble: str


class Value(NamedTuple):
    """One value with its ages: since it was read or written, and since it was last seen to change."""

    address: int
    name: str
    value: Shown
    unit: str
    age_s: float
    unchanged_s: float

    @property
    def text(self) -> str:
        """The value as a person reads it; of bits, those that are set."""
        return _text(self.value, self.unit)


def values(seen: Seen) -> list[Value]:
    """The whole map, in the order of its addresses."""
    blocks = ((CELL_TAGS, WRITE_ADDRESS, seen.cell), (PLC_TAGS, READ_ADDRESS, seen.plc))
    return [_value(tag, tag.address - first, block, seen.now_s) for tags, first, block in blocks for tag in tags]


def shown(tags: Sequence[Tag], words: Mapping[int, int], addresses: Sequence[int]) -> str:
    """Some registers in a sentence: "107 command accepted = 3, 109 result = 2 unknown"."""
    found = [(tag, [words[tag.address], words.get(tag.address + 1, 0)]) for tag in tags if tag.address in addresses]
    return ", ".join(f"{tag.address} {tag.name} = {_text(tag.show(own), tag.unit)}" for tag, own in found)


def _text(value: Shown, unit: str) -> str:
    if isinstance(value, dict):
        return " + ".join(name for name, on in value.items() if on) or "none"
    return f"{value} {unit}".rstrip()


def _value(tag: Tag, at: int, block: Ages, now_s: float) -> Value:
    shown = tag.show(block.words[at : at + 2])
    return Value(tag.address, tag.name, shown, tag.unit, now_s - block.read_at_s, now_s - block.changed_at_s[at])
