"""Modbus requests on a bank of registers, by the book: bytes in, bytes out. Pure.

Sources: MODBUS Application Protocol V1.1b3 (function codes, exception codes and the order in which they are checked)
and MODBUS Messaging on TCP/IP V1.0b (header).
"""

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
HEADER_SIZE = 7
LONGEST_PDU = 253


class Table(Enum):
    """The four tables of the Modbus data model."""

    COILS = "coils"
    DISCRETES = "discrete inputs"
    HOLDING = "holding registers"
    INPUTS = "input registers"


Hook = Callable[[Table, int, int], None]  # table, first address, count


def _ignore(table: Table, address: int, count: int) -> None:
    """Do nothing."""


class Bank:
    """The data of one server. Addresses that are not given do not exist; those in `read_only` refuse writes.

    `before_read` and `after_write` are called inside the request, so a program can work on what was just written and
    the same request reads its result.
    """

    def __init__(
        self,
        *,
        coils: Iterable[int] = (),
        discretes: Iterable[int] = (),
        holding: Iterable[int] = (),
        inputs: Iterable[int] = (),
        read_only: Iterable[int] = (),
    ) -> None:
        addresses = zip(Table, (coils, discretes, holding, inputs), strict=True)
        self.tables: dict[Table, dict[int, int]] = {table: dict.fromkeys(of, 0) for table, of in addresses}
        self.read_only = frozenset(read_only)
        self.before_read: Hook = _ignore
        self.after_write: Hook = _ignore

    def read(self, table: Table, address: int, count: int) -> list[int]:
        """Values of a block that exists."""
        self.before_read(table, address, count)
        values = self.tables[table]
        return [values[at] for at in range(address, address + count)]

    def write(self, table: Table, address: int, values: Sequence[int]) -> None:
        """Set a block that exists."""
        self.tables[table].update(zip(range(address, address + len(values)), values, strict=True))
        self.after_write(table, address, len(values))

    def check(self, table: Table, address: int, count: int, *, writing: bool = False) -> None:
        """Raise exception 2 unless the whole block exists and may be written."""
        values = self.tables[table]
        for at in range(address, address + count):
            if at not in values or (writing and table is Table.HOLDING and at in self.read_only):
                raise ModbusError(ILLEGAL_ADDRESS)


class ModbusError(Exception):
    """The request gets an exception answer."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class BadFrame(Exception):
    """This is not Modbus TCP; the connection must be closed."""


def split_frames(data: bytes) -> tuple[list[tuple[int, int, bytes]], bytes]:
    """The whole frames at the start of `data` as (transaction, unit, pdu), and what is left over.

    Raises BadFrame for a protocol id other than 0 and for a length that no Modbus frame has.
    """
    frames = []
    at = 0
    while len(data) - at >= HEADER_SIZE - 1:
        transaction, protocol, length = struct.unpack_from(">HHH", data, at)
        if protocol != 0:
            raise BadFrame(f"protocol id {protocol}")
        if not 2 <= length <= LONGEST_PDU + 1:
            raise BadFrame(f"length {length}")
        end = at + HEADER_SIZE - 1 + length
        if len(data) < end:
            break
        frames.append((transaction, data[at + 6], data[at + HEADER_SIZE : end]))
        at = end
    return frames, data[at:]


@dataclass
class Identity:
    """Objects of Read Device Identification by id: 0 vendor, 1 product code, 2 revision are mandatory."""

    objects: dict[int, bytes] = field(default_factory=lambda: {0: b"cellctl", 1: b"simulated server", 2: b"1.0"})


def respond(bank: Bank, identity: Identity, pdu: bytes) -> bytes:
    """The answer to one request, by the book. `pdu` has at least its function code."""
    function = pdu[0]
    handler = HANDLERS.get(function)
    try:
        if handler is None:
            raise ModbusError(ILLEGAL_FUNCTION)
        if function == 43:
            return _identify(identity, pdu)
        return handler(bank, pdu)
    except struct.error:
        return bytes((function | 0x80, ILLEGAL_VALUE))  # too short for its function
    except ModbusError as error:
        return bytes((function | 0x80, error.code))


def _require(true: bool, code: int = ILLEGAL_VALUE) -> None:
    if not true:
        raise ModbusError(code)


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
    _require(value in (0x0000, 0xFF00))
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


def _no_mei(bank: Bank, pdu: bytes) -> bytes:
    """Function 43 asks for the identity, not for the bank."""
    raise ModbusError(ILLEGAL_FUNCTION)


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
    43: _no_mei,
}
LAST_OBJECT_OF_CATEGORY = {1: 0x02, 2: 0x7F, 3: 0xFF}
CONFORMITY_LEVEL = 0x83  # extended, stream and individual access


def _identify(identity: Identity, pdu: bytes) -> bytes:
    """Read Device Identification (43 / 14): a stream of objects (codes 1..3) or one (code 4)."""
    _require(len(pdu) > 1 and pdu[1] == 14, ILLEGAL_FUNCTION)
    _mei, code, first = _exactly(">BBB", pdu)
    _require(1 <= code <= 4)
    objects = identity.objects
    if code == 4:
        _require(first in objects, ILLEGAL_ADDRESS)
        chosen = [first]
    else:
        last = LAST_OBJECT_OF_CATEGORY[code]
        start = first if first in objects and first <= last else 0  # an unknown object starts from the beginning
        chosen = [number for number in sorted(objects) if start <= number <= last]
    body, count, following = b"", 0, 0
    for number in chosen:
        if 7 + len(body) + 2 + len(objects[number]) > LONGEST_PDU:
            following = number
            break
        body += bytes((number, len(objects[number]))) + objects[number]
        count += 1
    more = 0xFF if following else 0x00
    return bytes((43, 14, code, CONFORMITY_LEVEL, more, following, count)) + body
