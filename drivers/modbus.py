"""One Modbus TCP connection whose every failure is a typed error. The one home of pymodbus.

pymodbus (3.16) is made strict here: it skips answers of another unit or transaction, accepts a wrong byte count, lets
a request wait out its time when the connection is already gone, and logs what it should raise. So each answer is looked
at before pymodbus sees it, and a broken connection or a bad answer ends the wait at once.
"""

import asyncio
import logging
import struct
from collections.abc import Awaitable, Callable, Sequence

from pymodbus.client import AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from drivers.errors import DeviceError, Garbled, LinkLost, NoAnswer, Refused

CONNECT_WITHIN_S = 0.5
EXCEPTION_NAMES = {
    1: "illegal function",
    2: "illegal data address",
    3: "illegal data value",
    4: "server device failure",
    5: "acknowledge",
    6: "server device busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway target device failed to respond",
}
REMEDIES = {
    1: 'the PLC lacks this function code; if it is FC23 set exchange = "fc3+fc16"',
    2: "the PLC program does not offer these registers; load the program with the right register map",
    11: "check the configured unit id",
}
# Each fault that pymodbus would log is raised here as an error, so its own lines would only repeat it.
logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


class ModbusLink:
    """One connection from open to close; after any error it is closed and cannot be used again.

    Construct it inside the running loop. `within_s` is the deadline of one request.
    """

    def __init__(self, device: str, host: str, port: int, *, unit_id: int = 1, within_s: float = 0.2) -> None:
        self._device = device
        self._peer = f"{host}:{port}"
        self._unit_id = unit_id
        self._within_s = within_s
        self._error: DeviceError | None = None
        self._scope: asyncio.Timeout | None = None
        self._asked: bytes = b""
        self._answer_length = 0
        self._client = AsyncModbusTcpClient(
            host,
            port=port,
            retries=0,
            reconnect_delay=0,
            timeout=max(CONNECT_WITHIN_S, 2 * within_s),  # our own deadline always comes first
            trace_packet=self._inspect,
            trace_connect=self._connection_changed,
        )

    async def open(self) -> None:
        """Connect; raises LinkLost."""
        cancels = _cancels()
        try:
            async with asyncio.timeout(CONNECT_WITHIN_S):
                connected = await self._client.connect()
        except TimeoutError:
            connected = False
        _heed_cancellation(cancels)
        if not connected:
            self.close()
            raise LinkLost(self._device, f"no connection to {self._peer} (Modbus TCP); check address, cable and power")

    def close(self) -> None:
        """Let the connection go at once. May be called at any time, also twice."""
        if self._client.ctx.transport is not None:
            self._client.ctx.transport.abort()  # type: ignore[attr-defined]  # do not linger on unsent bytes
        self._client.close()

    async def read(self, address: int, count: int) -> list[int]:
        """FC3: `count` holding registers. Raises LinkLost, NoAnswer, Garbled, Refused."""
        self._answer_length = 3 + 2 * count
        answer = await self._ask(
            lambda: self._client.read_holding_registers(address, count=count, device_id=self._unit_id),
            f"FC3 reading {_span(address, count)}",
        )
        return list(answer.registers)

    async def write(self, address: int, values: Sequence[int]) -> None:
        """FC16: write holding registers. Raises LinkLost, NoAnswer, Garbled, Refused."""
        self._answer_length = 6
        await self._ask(
            lambda: self._client.write_registers(address, list(values), device_id=self._unit_id),
            f"FC16 writing {_span(address, len(values))}",
        )

    async def read_write(self, read_address: int, count: int, write_address: int, values: Sequence[int]) -> list[int]:
        """FC23: write, then read, in one exchange. Raises LinkLost, NoAnswer, Garbled, Refused."""
        self._answer_length = 3 + 2 * count
        answer = await self._ask(
            lambda: self._client.readwrite_registers(
                read_address=read_address,
                read_count=count,
                write_address=write_address,
                values=values,
                device_id=self._unit_id,
            ),
            f"FC23 reading {_span(read_address, count)} and writing {_span(write_address, len(values))}",
        )
        return list(answer.registers)

    async def _ask(self, request: Callable[[], Awaitable[ModbusPDU]], what: str) -> ModbusPDU:
        answer: ModbusPDU | None = None
        cancels = _cancels()
        try:
            async with asyncio.timeout(self._within_s) as self._scope:
                answer = await request()
        except TimeoutError:
            raise self._error or self._no_answer(what) from None
        except ModbusException as error:
            raise self._error or LinkLost(self._device, f"{what} at {self._peer}: {error}") from None
        finally:
            self._scope = None
            self._asked = b""
            if answer is None:
                self.close()  # a late answer must never meet a later question
        _heed_cancellation(cancels)
        return self._checked(answer, what)

    def _no_answer(self, what: str) -> NoAnswer:
        return NoAnswer(
            self._device, f"{what} at {self._peer}: no answer within {self._within_s * 1000:.0f} ms; check the network"
        )

    def _checked(self, answer: ModbusPDU, what: str) -> ModbusPDU:
        if not answer.isError():
            return answer
        self.close()
        code = answer.exception_code
        name = EXCEPTION_NAMES.get(code, "unknown exception")
        remedy = REMEDIES.get(code, "look at the PLC's own diagnostics")
        raise Refused(self._device, f"exception {code}", f"{what} at {self._peer}: {name}; {remedy}")

    def _connection_changed(self, connected: bool) -> None:
        if not connected:
            self._fail(LinkLost(self._device, f"connection to {self._peer} was closed by the other side"))

    def _fail(self, error: DeviceError) -> None:
        """Remember the first cause and end the wait for the answer now."""
        self._error = self._error or error
        if self._scope is not None and not self._scope.expired():
            self._scope.reschedule(asyncio.get_running_loop().time())

    def _inspect(self, sending: bool, data: bytes) -> bytes:
        """See every packet before pymodbus does; a bad one is withheld from it."""
        if sending:
            self._asked = data[:8]
            return data
        wrong = self._wrong(data)
        if not wrong:
            return data
        self._fail(
            Garbled(self._device, f"answer from {self._peer} has {wrong}: {data[:16].hex(' ')}; is it a Modbus server?")
        )
        return b""

    def _wrong(self, data: bytes) -> str:
        """What is wrong with the bytes received so far; empty when nothing is, yet."""
        if not self._asked:
            return f"{len(data)} bytes that were not asked for"
        if len(data) < 9:
            return ""
        tid, protocol, length, unit, function = struct.unpack_from(">HHHBB", data)
        asked_tid, asked_unit, asked_function = struct.unpack(">H4xBB", self._asked)
        wanted_length = 3 if function & 0x80 else self._answer_length
        found = (protocol, tid, unit, function & 0x7F, length)
        wanted = (0, asked_tid, asked_unit, asked_function, wanted_length)
        for name, is_value, must_be in zip(
            ("protocol id", "transaction", "unit", "function", "length"), found, wanted, strict=True
        ):
            if is_value != must_be:
                return f"{name} {is_value} instead of {must_be}"
        return self._wrong_body(data, function, length)

    @staticmethod
    def _wrong_body(data: bytes, function: int, length: int) -> str:
        if len(data) > 6 + length:
            return f"{len(data) - 6 - length} bytes too many"
        if function in (3, 23) and data[8] != length - 3:
            return f"byte count {data[8]} instead of {length - 3}"
        return ""


def _cancels() -> int:
    """How often the current task has been cancelled."""
    task = asyncio.current_task()
    return task.cancelling() if task else 0


def _heed_cancellation(cancels_before: int) -> None:
    """Cancel again: wait_for of Python 3.11, inside pymodbus, swallows a cancellation that meets the answer."""
    if _cancels() > cancels_before:
        raise asyncio.CancelledError


def _span(address: int, count: int) -> str:
    return f"registers {address}..{address + count - 1}"
