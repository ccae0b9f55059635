"""The PLC's registers in the contract's order over one connection, however this PLC offers them."""

from collections.abc import Callable, Sequence

from drivers import modbus_frames as frames
from drivers.modbus import ModbusLink, WireLog
from drivers.plc_layout import PlcAddress
from drivers.plc_registers import READ_COUNT, WRITE_COUNT


class PlcPort:
    """One connection from open to close; after any error it is closed and cannot be used again."""

    def __init__(
        self, device: str, address: PlcAddress, *, within_s: float, transaction: int, wire_log: WireLog | None = None
    ) -> None:
        layout, exchange = address.layout, address.exchange
        self._layout = layout
        self._link = ModbusLink(
            device,
            address.host,
            address.port,
            unit_id=address.unit_id,
            within_s=within_s,
            transaction=transaction,
            wire_log=wire_log,
        )
        self._one_request = exchange == "fc23"
        self._look = frames.read(
            layout.plc_at, READ_COUNT, frames.READ_INPUT if exchange == "fc4+fc16" else frames.READ_HOLDING
        )

    @property
    def transaction(self) -> int:
        """Number of the last question: the next connection goes on from there."""
        return self._link.transaction

    async def open(self) -> None:
        """Connect; raises LinkLost."""
        await self._link.open()

    def close(self) -> None:
        """Let the connection go at once. May be called at any time, also twice."""
        self._link.close()

    async def cell_words(self) -> Sequence[int]:
        """Registers 0..15 as they stand in the PLC. Raises LinkLost, NoAnswer, Garbled, Refused, like all that ask."""
        return self._layout.to_wire(await self._link.read(self._layout.cell_at, WRITE_COUNT))

    async def picture(self) -> Sequence[int]:
        """Registers 100..131; nothing is written."""
        return self._layout.from_wire(await self._link.ask(self._look))

    def begin(self, words: Sequence[int] | None, over: Callable[[], None]) -> None:
        """Write registers 0..15 (None: nothing), then read 100..131; `over` is called at the end, well or not."""
        if words is None:
            self._link.begin(self._look, over)
        elif self._one_request:
            self._link.begin(self._swap(words), over)
        else:
            write = frames.write(self._layout.cell_at, self._layout.to_wire(words))
            self._link.begin(write, lambda: self._written(over))

    def outcome(self) -> Sequence[int]:
        """Registers 100..131 of the exchange that is over; raises what went wrong."""
        return self._layout.from_wire(self._link.outcome())

    def _written(self, over: Callable[[], None]) -> None:
        if self._link.well:
            self._link.begin(self._look, over, goes_on=True)
        else:
            over()

    def _swap(self, words: Sequence[int]) -> frames.Request:
        layout = self._layout
        return frames.read_write(layout.plc_at, READ_COUNT, layout.cell_at, layout.to_wire(words))
