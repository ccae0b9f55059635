"""Modbus requests by the book: every function, limit and exception, and who the server is."""

import random
import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulators.modbus_bank import DEVICE_FAILURE, Bank, ModbusError, Table
from simulators.modbus_identity import ANONYMOUS, Identity
from simulators.modbus_requests import respond
from tests.benchmarks.fuzz_modbus import plausible
from tests.modbus_wire import bank


def ask(pdu_hex: str, of: Bank | None = None) -> str:
    return respond(of or bank(), ANONYMOUS, bytes.fromhex(pdu_hex)).hex(" ")


# -- requests by the book (examples of the specification where it has one) -----------------------------------------


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("03 0064 0002", "03 04 00 00 00 00"),
        ("04 0000 0001", "04 02 00 00"),
        ("06 0001 0003", "06 00 01 00 03"),
        ("10 0001 0002 04 000a 0102", "10 00 01 00 02"),
        ("05 0010 ff00", "05 00 10 ff 00"),
        ("0f 0013 000a 02 cd01", "0f 00 13 00 0a"),
        ("16 0004 00f2 0025", "16 00 04 00 f2 00 25"),
        ("17 0003 0001 0003 0001 02 00ff", "17 02 00 ff"),
        ("2b 0e 01 00", "2b 0e 01 83 00 00 03 00 07 63 65 6c 6c 63 74 6c 01 10 73 69 6d 75 6c 61 74 65 64 20 73 65 "
         "72 76 65 72 02 03 31 2e 30"),
        ("2b 0e 04 02", "2b 0e 04 83 00 00 01 02 03 31 2e 30"),
        ("2b 0e 01 77", "2b 0e 01 83 00 00 03 00 07 63 65 6c 6c 63 74 6c 01 10 73 69 6d 75 6c 61 74 65 64 20 73 65 "
         "72 76 65 72 02 03 31 2e 30"),
    ],
)  # fmt: skip
def test_a_right_request_gets_the_answer_of_the_book(request_hex: str, answer_hex: str) -> None:
    assert ask(request_hex) == bytes.fromhex(answer_hex).hex(" ")


@pytest.mark.parametrize(
    ("request_hex", "answer_hex"),
    [
        ("07", "87 01"),  # no such function here
        ("2b 0d 01 00", "ab 01"),  # no such MEI type
        ("2b", "ab 01"),
        ("2b 0e 05 00", "ab 03"),
        ("2b 0e 04 55", "ab 02"),
        ("03 0000 0000", "83 03"),
        ("03 0000 007e", "83 03"),
        ("03 0000 0001 00", "83 03"),  # a byte too many
        ("03 0000", "83 03"),
        ("03 000f 0002", "83 02"),  # 16 does not exist
        ("03 ffff 0001", "83 02"),
        ("03 ffff 0000", "83 03"),  # quantity is checked before the address
        ("01 0000 07d1", "81 03"),
        ("02 0032 0001", "82 02"),
        ("05 0000 0001", "85 03"),
        ("05 0064 ff00", "85 02"),
        ("06 0064 0001", "86 02"),  # read only
        ("0f 0000 000a 01 ff", "8f 03"),  # wrong byte count
        ("10 0000 0002 04 0001", "90 03"),  # too short
        ("10 0000 007c f8" + "00" * 248, "90 03"),
        ("16 0000 ffff", "96 03"),
        ("17 0064 0001 0064 0001 02 0000", "97 02"),  # writes what is read only
        ("17 0064 007e 0000 0001 02 0000", "97 03"),
        ("17 0064 0001 0000 0001 03 000000", "97 03"),
    ],
)
def test_a_wrong_request_gets_the_exception_of_the_book(request_hex: str, answer_hex: str) -> None:
    assert ask(request_hex) == answer_hex


def test_mask_write_follows_the_formula_of_the_specification() -> None:
    registers = bank()
    registers.write(Table.HOLDING, 4, [0x12])

    ask("16 0004 00f2 0025", registers)

    assert registers.tables[Table.HOLDING][4] == 0x17


def test_coils_are_packed_with_the_first_in_the_lowest_bit() -> None:
    coils = bank()

    ask("0f 0013 000a 02 cd01", coils)

    assert ask("01 0013 000a", coils) == "01 02 cd 01"
    assert [coils.tables[Table.COILS][at] for at in range(19, 29)] == [1, 0, 1, 1, 0, 0, 1, 1, 1, 0]


def test_fc23_writes_before_it_reads_and_a_refused_one_writes_nothing() -> None:
    registers = bank()

    assert ask("17 0000 0002 0001 0001 02 beef", registers) == "17 04 00 00 be ef"
    assert ask("17 0010 0001 0001 0001 02 dead", registers) == "97 02"
    assert registers.tables[Table.HOLDING][1] == 0xBEEF


# Function, quantity limit, request with this address and quantity. All addresses exist in these tests.
QUANTITIES = [
    (1, 2000, lambda address, count: struct.pack(">BHH", 1, address, count)),
    (2, 2000, lambda address, count: struct.pack(">BHH", 2, address, count)),
    (3, 125, lambda address, count: struct.pack(">BHH", 3, address, count)),
    (4, 125, lambda address, count: struct.pack(">BHH", 4, address, count)),
    (15, 1968, lambda address, count: struct.pack(">BHHB", 15, address, count, -(-count // 8)) + bytes(-(-count // 8))),
    (16, 123, lambda address, count: struct.pack(">BHHB", 16, address, count, 2 * count & 0xFF) + bytes(2 * count)),
    (23, 125, lambda address, count: struct.pack(">BHHHHB", 23, address, count, 0, 1, 2) + bytes(2)),
    (23, 121, lambda address, count: struct.pack(">BHHHHB", 23, 0, 1, address, count, 2 * count) + bytes(2 * count)),
]  # fmt: skip


@pytest.mark.parametrize(("function", "limit", "request_of"), QUANTITIES)
def test_quantities_reach_to_their_limit_and_addresses_to_65535_without_wrapping(
    function: int, limit: int, request_of: Callable[[int, int], bytes]
) -> None:
    everything = Bank(coils=range(65536), discretes=range(65536), holding=range(65536), inputs=range(65536))

    def exception(address: int, count: int) -> int:
        answer = respond(everything, ANONYMOUS, request_of(address, count))
        assert len(answer) <= 253
        return answer[1] if answer[0] & 0x80 else 0

    assert exception(0, 0) == 3
    assert exception(0, 1) == 0
    assert exception(0, limit) == 0
    assert exception(0, limit + 1) == 3
    assert exception(65535, 1) == 0
    assert exception(65535, 2) == 2
    assert exception(65536 - limit, limit) == 0
    assert exception(65535, limit + 1) == 3  # the quantity is looked at first


@pytest.mark.parametrize(
    "request_hex", ["03 0000 0001", "06 0000 0007", "17 0000 0001 0001 0001 02 0007", "01 0000 0001"]
)
def test_a_device_that_cannot_answers_with_exception_4(request_hex: str) -> None:
    broken = bank()

    def fail(table: Table, address: int, count: int) -> None:
        raise ModbusError(DEVICE_FAILURE)

    broken.before_read = broken.after_write = fail

    assert ask(request_hex, broken) == f"{int(request_hex[:2], 16) | 0x80:02x} 04"


def test_a_server_may_lack_functions_and_says_so_before_it_looks_at_anything_else() -> None:
    for pdu in (bytes.fromhex("17ffff"), bytes.fromhex("2b0e0100")):
        assert respond(bank(), ANONYMOUS, pdu, frozenset({23, 43})) == bytes((pdu[0] | 0x80, 1))


def test_hooks_run_inside_the_request() -> None:
    registers = bank()
    seen: list[tuple[str, Table, int, int]] = []

    def double(table: Table, address: int, count: int) -> None:
        seen.append(("write", table, address, count))
        registers.tables[Table.HOLDING][100] = 2 * registers.tables[Table.HOLDING][0]

    registers.after_write = double
    registers.before_read = lambda table, address, count: seen.append(("read", table, address, count))

    assert ask("17 0064 0001 0000 0001 02 0015", registers) == "17 02 00 2a"
    assert seen == [("write", Table.HOLDING, 0, 1), ("read", Table.HOLDING, 100, 1)]


# -- who the server is ---------------------------------------------------------------------------------------------

LONG = Identity({number: bytes([65 + number % 26]) * 90 for number in (0, 1, 2, 3, 6, 0x80, 0xFE, 0xFF)})


def stream(identity: Identity, code: int) -> dict[int, bytes]:
    """All objects of a category, as a client collects them."""
    found, following, more = dict[int, bytes](), 0, True
    while more:
        answer = respond(bank(), identity, bytes((43, 14, code, following)))
        assert len(answer) <= 253
        assert answer[:4] == bytes((43, 14, code, 0x83))
        more, following, count, at = answer[4] == 0xFF, answer[5], answer[6], 7
        for _ in range(count):
            number, size = answer[at], answer[at + 1]
            found[number] = answer[at + 2 : at + 2 + size]
            at += 2 + size
        assert at == len(answer)
    assert following == 0
    return found


@pytest.mark.parametrize(("code", "last"), [(1, 2), (2, 0x7F), (3, 0xFF)])
def test_a_long_identity_is_handed_out_in_pieces_by_category(code: int, last: int) -> None:
    assert stream(LONG, code) == {number: text for number, text in LONG.objects.items() if number <= last}


def test_one_object_comes_alone_whatever_else_there_is() -> None:
    assert respond(bank(), LONG, bytes((43, 14, 4, 0x80))) == bytes((43, 14, 4, 0x83, 0, 0, 1, 0x80, 90)) + b"Y" * 90


@given(st.dictionaries(st.integers(0, 255), st.binary(max_size=244), max_size=20))
def test_any_identity_that_is_taken_can_be_read_whole(objects: dict[int, bytes]) -> None:
    identity = Identity({0: b"", 1: b"", 2: b""} | objects)

    assert stream(identity, 3) == identity.objects


@pytest.mark.parametrize(
    "objects", [{0: b"a", 1: b"b"}, {0: b"", 1: b"", 2: bytes(245)}, {0: b"", 1: b"", 2: b"", 256: b""}]
)
def test_an_identity_that_cannot_be_read_is_refused(objects: dict[int, bytes]) -> None:
    with pytest.raises(ValueError, match="object"):
        Identity(objects)


# -- fuzz ----------------------------------------------------------------------------------------------------------


def assert_proper(pdu: bytes, answer: bytes) -> None:
    assert 2 <= len(answer) <= 253
    assert answer[0] & 0x7F == pdu[0] & 0x7F
    if answer[0] & 0x80:
        assert len(answer) == 2
        assert answer[1] in (1, 2, 3)


def test_twenty_thousand_random_requests_get_proper_answers() -> None:
    source = random.Random(20261122)
    registers, answered, refused = bank(), 0, 0
    addresses = {table: set(values) for table, values in registers.tables.items()}
    for number in range(20_000):
        pdu = source.randbytes(source.randrange(1, 253)) if number % 4 == 0 else plausible(source)
        if number % 4 == 1:
            at = source.randrange(len(pdu))
            pdu = pdu[:at] + source.randbytes(1) + pdu[at + 1 :]
        answer = respond(registers, ANONYMOUS, pdu)
        assert_proper(pdu, answer)
        answered += answer[0] < 0x80
        refused += answer[0] >= 0x80
    assert answered + refused == 20_000
    assert min(answered, refused) > 4000
    assert {table: set(values) for table, values in registers.tables.items()} == addresses
    assert all(0 <= value <= 0xFFFF for values in registers.tables.values() for value in values.values())
