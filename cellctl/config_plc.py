"""The section [plc] of cell.toml: where the PLC is, and how its brand offers the registers of the contract."""

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from cellctl.config_values import Ipv4
from cellctl.strict_toml import Contradiction, Settings
from drivers.plc_layout import Exchange, Layout, PlcAddress
from drivers.plc_registers import READ_ADDRESS, WRITE_ADDRESS


class PlcConfig(Settings):
    """The PLC, a Modbus TCP server."""

    host: Ipv4 = Field(description="IPv4 address of the PLC")
    port: int = Field(ge=1, le=65535, description="TCP port of the PLC, usually 502")
    unit_id: int = Field(ge=0, le=255, description="Modbus unit number")
    scan_period_ms: float = Field(ge=1, le=100, description="One exchange per so many milliseconds, 10 to 20 on a line")
    stale_after_ms: float = Field(ge=50, le=2000, description="An older picture of the PLC's inputs aborts the cell")
    exchange: Exchange = Field(
        description="fc3+fc16 for a PLC that lacks function code 23, fc4+fc16 when its words are input registers"
    )
    cell_registers_at: int = Field(
        default=WRITE_ADDRESS, ge=0, le=65535, description="Address on the wire of the contract's register 0"
    )
    plc_registers_at: int = Field(
        default=READ_ADDRESS, ge=0, le=65535, description="Address on the wire of the contract's register 100"
    )
    byte_order: Literal["high_first", "low_first"] = Field(
        default="high_first", description="Bytes in a register; Modbus says high_first"
    )
    word_order: Literal["high_first", "low_first"] = Field(
        default="high_first", description="Registers of a 32 bit value; the contract says high_first"
    )

    def contradictions(self) -> Iterator[Contradiction]:
        """Both blocks of registers lie apart and end inside the address space."""
        try:
            _ = self.address
        except ValueError as error:
            yield "plc_registers_at", str(error)

    @property
    def address(self) -> PlcAddress:
        """Where the PLC is and how it is asked."""
        layout = Layout(
            cell_at=self.cell_registers_at,
            plc_at=self.plc_registers_at,
            low_byte_first=self.byte_order == "low_first",
            low_word_first=self.word_order == "low_first",
        )
        return PlcAddress(self.host, self.port, self.unit_id, self.exchange, layout)
