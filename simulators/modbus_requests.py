"""Modbus requests on a bank of data, by the book: bytes in, bytes out. Pure.

Source: MODBUS Application Protocol V1.1b3, section 6. Its state diagrams check function (exception 1), values and
quantities (3), addresses (2), and then execute (4), in this order; a request of a wrong length is a wrong value.
"""

import struct
from collections.abc import Callable

from simulators.modbus_bank import ILLEGAL_FUNCTION, ILLEGAL_VALUE, Bank, ModbusError, Table
from simulators.modbus_identity import ENCAPSULATED, Identity

COIL_VALUES = (0x0000, 0xFF00)
WRITING = frozenset({5, 6, 15, 16, 22, 23})  # functions that change something


def respond(bank: Bank, identity: Identity, pdu: bytes, lacking: frozenset[int] = frozenset()) -> bytes:
    """The answer to one request, by the book; functions in `lacking` are unknown. `pdu` has its function code."""
    function = pdu[0]
    try:
        if function == ENCAPSULATED and function not in lacking:
            return identity.answer(pdu)
        if function not in HANDLERS or function in lacking:
            raise ModbusError(ILLEGAL_FUNCTION)
        return HANDLERS[function](bank, pdu)
    except struct.error:
        return bytes((function | 0x80, ILLEGAL_VALUE))  # too short or too long for its function
    except ModbusError as error:
        return bytes((function | 0x80, error.code))


def _require(true: bool) -> None:
    if not true:
        raise ModbusError(ILLEGAL_VALUE)


def _exactly(layout: str, pdu: bytes) -> tuple[int, ...]:
    """Fields after the function code; struct.error when there are fewer or more bytes."""
    return struct.unpack(layout, pdu[1:])


def _read_bits(bank: Bank, pdu: bytes) -> bytes:
    table = Table.COILS if pdu[0] == 1 else Table.DISCRETES
    address, count = _exactly(">HH", pdu)
    _require(1 <= count <= 2000)
    bank.check(table, address, count)
    number = sum(bool(bit) << at for at, bit in enumerate(bank.read(table, address, count)))
    size = (count + 7) // 8
    return bytes((pdu[0], size)) + number.to_bytes(size, "little")


def _read_registers(bank: Bank, pdu: bytes) -> bytes:
    table = Table.HOLDING if pdu[0] == 3 else Table.INPUTS
    address, count = _exactly(">HH", pdu)
    _require(1 <= count <= 125)
    bank.check(table, address, count)
    return struct.pack(f">BB{count}H", pdu[0], 2 * count, *bank.read(table, address, count))


def _write_coil(bank: Bank, pdu: bytes) -> bytes:
    address, value = _exactly(">HH", pdu)
    _require(value in COIL_VALUES)
    bank.check(Table.COILS, address, 1, writing=True)
    bank.write(Table.COILS, address, [int(value != 0)])
    return pdu


def _write_register(bank: Bank, pdu: bytes) -> bytes:
    address, value = _exactly(">HH", pdu)
    bank.check(Table.HOLDING, address, 1, writing=True)
    bank.write(Table.HOLDING, address, [value])
    return pdu


def _write_coils(bank: Bank, pdu: bytes) -> bytes:
    address, count, size = struct.unpack_from(">HHB", pdu, 1)
    _require(1 <= count <= 1968 and size == (count + 7) // 8 and len(pdu) == 6 + size)
    bank.check(Table.COILS, address, count, writing=True)
    number = int.from_bytes(pdu[6:], "little")
    bank.write(Table.COILS, address, [number >> at & 1 for at in range(count)])
    return pdu[:5]


def _write_registers(bank: Bank, pdu: bytes) -> bytes:
    address, count, size = struct.unpack_from(">HHB", pdu, 1)
    _require(1 <= count <= 123 and size == 2 * count and len(pdu) == 6 + size)
    bank.check(Table.HOLDING, address, count, writing=True)
    bank.write(Table.HOLDING, address, struct.unpack(f">{count}H", pdu[6:]))
    return pdu[:5]


def _mask_register(bank: Bank, pdu: bytes) -> bytes:
    address, and_mask, or_mask = _exactly(">HHH", pdu)
    bank.check(Table.HOLDING, address, 1, writing=True)
    value = bank.tables[Table.HOLDING][address]
    bank.write(Table.HOLDING, address, [(value & and_mask) | (or_mask & ~and_mask & 0xFFFF)])
    return pdu


def _read_write_registers(bank: Bank, pdu: bytes) -> bytes:
    read_at, read_count, write_at, write_count, size = struct.unpack_from(">HHHHB", pdu, 1)
    _require(1 <= read_count <= 125 and 1 <= write_count <= 121)
    _require(size == 2 * write_count and len(pdu) == 10 + size)
    bank.check(Table.HOLDING, read_at, read_count)
    bank.check(Table.HOLDING, write_at, write_count, writing=True)
    bank.write(Table.HOLDING, write_at, struct.unpack(f">{write_count}H", pdu[10:]))
    return struct.pack(f">BB{read_count}H", 23, 2 * read_count, *bank.read(Table.HOLDING, read_at, read_count))


HANDLERS: dict[int, Callable[[Bank, bytes], bytes]] = {
    1: _read_bits,
    2: _read_bits,
    3: _read_registers,
    4: _read_registers,
    5: _write_coil,
    6: _write_register,
    15: _write_coils,
    16: _write_registers,
    22: _mask_register,
    23: _read_write_registers,
}
FUNCTIONS = (*HANDLERS, ENCAPSULATED)
