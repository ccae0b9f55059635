"""The data of a Modbus server: coils, discrete inputs, holding and input registers. Pure."""

from collections.abc import Callable, Iterable, Sequence
from enum import Enum

ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE, DEVICE_FAILURE = 1, 2, 3, 4


class Table(Enum):
    """The four tables of the Modbus data model."""

    COILS = "coils"
    DISCRETES = "discrete inputs"
    HOLDING = "holding registers"
    INPUTS = "input registers"


Hook = Callable[[Table, int, int], None]  # table, first address, count


class ModbusError(Exception):
    """The request gets this exception answer. A hook that raises DEVICE_FAILURE says that the device cannot."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


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
        """Raise exception 2 unless the whole block exists and may be written; nothing wraps round after 65535."""
        values = self.tables[table]
        for at in range(address, address + count):
            if at not in values or (writing and table is Table.HOLDING and at in self.read_only):
                raise ModbusError(ILLEGAL_ADDRESS)
