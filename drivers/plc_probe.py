"""A client for checking a PLC, by pymodbus: an implementation of the wire that shares nothing with the driver's own.

What cellctl normally speaks (`modbus_frames`) would agree with itself about a mistake; this one would not.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Sequence

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from drivers.errors import LinkLost, NoAnswer, Refused
from drivers.modbus import EXCEPTION_NAMES, REMEDIES
from drivers.plc_layout import PlcAddress
from drivers.plc_registers import READ_COUNT, WRITE_COUNT

DEVICE = "plc"
CONNECT_WITHIN_S = 1.0
# Each fault that pymodbus would log is raised here as an error, so its own lines would only repeat it.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


class PlcProbe:
    """One connection. Construct it inside the running loop; every question raises LinkLost, NoAnswer or Refused."""

    def __init__(self, address: PlcAddress, *, within_s: float = 0.5) -> None:
        self._address = address
        self._within_s = within_s
        self._client = AsyncModbusTcpClient(
            address.host, port=address.port, retries=0, reconnect_delay=0, timeout=max(CONNECT_WITHIN_S, 2 * within_s)
        )

    async def open(self) -> None:
        """Connect."""
        try:
            async with asyncio.timeout(CONNECT_WITHIN_S):
                connected = await self._client.connect()
        except TimeoutError:
            connected = False
        if not connected:
            self.close()
            raise LinkLost(DEVICE, f"no connection to {self._address} (Modbus TCP); check address, cable and power")

    def close(self) -> None:
        """Let the connection go; may be called twice."""
        self._client.close()

    def anew(self) -> "PlcProbe":
        """Another one to the same PLC, not open yet."""
        return PlcProbe(self._address, within_s=self._within_s)

    async def cell_words(self) -> Sequence[int]:
        """Registers 0..15 of the contract, by FC3."""
        at, unit = self._address.layout.cell_at, self._address.unit_id
        answer = await self._ask(
            f"FC3 reading {WRITE_COUNT} registers at {at}",
            lambda: self._client.read_holding_registers(at, count=WRITE_COUNT, device_id=unit),
        )
        return self._address.layout.to_wire(answer.registers)

    async def picture(self) -> Sequence[int]:
        """Registers 100..131 of the contract, by FC3 or FC4 as is configured."""
        at, unit = self._address.layout.plc_at, self._address.unit_id
        code, read = 3, self._client.read_holding_registers
        if self._address.exchange == "fc4+fc16":
            code, read = 4, self._client.read_input_registers
        answer = await self._ask(
            f"FC{code} reading {READ_COUNT} registers at {at}", lambda: read(at, count=READ_COUNT, device_id=unit)
        )
        return self._address.layout.from_wire(answer.registers)

    async def exchange(self, words: Sequence[int]) -> Sequence[int]:
        """Write registers 0..15, then read 100..131, as is configured."""
        layout, unit = self._address.layout, self._address.unit_id
        wire = list(layout.to_wire(words))
        if self._address.exchange != "fc23":
            await self._ask(
                f"FC16 writing {WRITE_COUNT} registers at {layout.cell_at}",
                lambda: self._client.write_registers(layout.cell_at, wire, device_id=unit),
            )
            return await self.picture()
        answer = await self._ask(
            f"FC23 reading {READ_COUNT} registers at {layout.plc_at}, writing {WRITE_COUNT} at {layout.cell_at}",
            lambda: self._client.readwrite_registers(
                read_address=layout.plc_at,
                read_count=READ_COUNT,
                write_address=layout.cell_at,
                values=wire,
                device_id=unit,
            ),
        )
        return layout.from_wire(answer.registers)

    async def _ask(self, what: str, request: Callable[[], Awaitable[ModbusPDU]]) -> ModbusPDU:
        try:
            async with asyncio.timeout(self._within_s):
                answer = await request()
        except TimeoutError:
            self.close()
            raise NoAnswer(DEVICE, f"{what}: no answer within {self._within_s * 1000:.0f} ms") from None
        except ModbusException as error:
            self.close()
            raise LinkLost(DEVICE, f"{what}: {error}") from None
        if answer.isError():
            name = EXCEPTION_NAMES.get(answer.exception_code, "unknown exception")
            remedy = REMEDIES.get(answer.exception_code, "look at the PLC's own diagnostics")
            raise Refused(DEVICE, f"exception {answer.exception_code}", f"{what}: {name}; {remedy}")
        return answer
