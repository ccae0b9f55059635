"""How a brand of PLC offers the registers of the contract: where they begin, in which order of bytes and words. Pure.

Inside cellctl every address and every order is the contract's; what differs is turned round here, at the wire.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

from drivers.plc_registers import LONG_VALUES, READ_ADDRESS, READ_COUNT, WRITE_ADDRESS, WRITE_COUNT

Exchange = Literal["fc23", "fc3+fc16", "fc4+fc16"]
LAST_ADDRESS = 0xFFFF


@dataclass(frozen=True, slots=True)
class Layout:
    """Address on the wire of the contract's register 0 and 100, and what comes first; the defaults are the contract."""

    cell_at: int = WRITE_ADDRESS
    plc_at: int = READ_ADDRESS
    low_byte_first: bool = False
    low_word_first: bool = False

    def from_wire(self, words: Sequence[int]) -> Sequence[int]:
        """The PLC's 32 words in the contract's order."""
        if self.low_byte_first:
            words = swapped(words)
        if self.low_word_first:
            words = list(words)
            for at in LONG_VALUES:
                words[at], words[at + 1] = words[at + 1], words[at]
        return words

    def to_wire(self, words: Sequence[int]) -> Sequence[int]:
        """Words of cellctl, none of which is longer than a register, as this PLC wants them; and back again."""
        return swapped(words) if self.low_byte_first else words


def swapped(words: Sequence[int]) -> list[int]:
    """The same with the two bytes of each word exchanged."""
    return [(word & 0xFF) << 8 | word >> 8 for word in words]


@dataclass(frozen=True, slots=True)
class PlcAddress:
    """Where a PLC is and how it is asked: FC23, or FC16 and FC3, or FC16 and FC4 (its words are input registers).

    Raises ValueError for an exchange that does not exist and for registers that overlap or leave the address space.
    """

    host: str
    port: int
    unit_id: int = 1
    exchange: Exchange = "fc23"
    layout: Layout = field(default_factory=Layout)

    def __post_init__(self) -> None:
        if self.exchange not in get_args(Exchange):
            known = " or ".join(f'"{name}"' for name in get_args(Exchange))
            raise ValueError(f"exchange must be {known} (got {self.exchange!r})")
        cell = range(self.layout.cell_at, self.layout.cell_at + WRITE_COUNT)
        plc = range(self.layout.plc_at, self.layout.plc_at + READ_COUNT)
        for whose, block in (("cellctl's", cell), ("the PLC's", plc)):
            if block.start < 0 or block[-1] > LAST_ADDRESS:
                raise ValueError(f"{whose} registers {block.start}..{block[-1]} are not all in 0..{LAST_ADDRESS}")
        if self.exchange != "fc4+fc16" and cell.start <= plc[-1] and plc.start <= cell[-1]:
            raise ValueError(
                f"cellctl's registers {cell.start}..{cell[-1]} overlap the PLC's {plc.start}..{plc[-1]} on the wire"
            )

    def __str__(self) -> str:
        return f"{self.host}:{self.port}, unit {self.unit_id}"
