"""Our Modbus server against clients that others wrote.

pymodbus (Python), libmodbus and mbpoll (C, from Debian), modbus-serial (node; only where it is installed).
"""

import asyncio
import json
import shutil
from collections.abc import Callable
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTcpClient

from simulators.modbus import ModbusServer
from simulators.modbus_bank import Bank, Table
from tests.modbus_wire import bank, serving
from tests.peers import libmodbus
from tests.peers.programs import NODE_FILES, NODE_MODULES, missing, node, said

COILS = [1, 0, 1, 1, 0, 0, 1, 1, 1, 0]
INPUTS = [1, 0, 0, 1, 0, 0, 0, 0, 0, 1]


def known_bank() -> Bank:
    """Inputs that clients can recognise."""
    registers = bank()
    registers.tables[Table.DISCRETES].update(dict(enumerate(INPUTS)))
    registers.tables[Table.INPUTS].update({0: 0xCAFE, 1: 0x0001, 2: 0x86A0})
    registers.tables[Table.HOLDING].update({100 + n: 1000 + n for n in range(32)})
    return registers


async def test_pymodbus_reads_and_writes_everything() -> None:
    async with serving(known_bank()) as server:
        client = AsyncModbusTcpClient("127.0.0.1", port=server.port, retries=0, reconnect_delay=0, timeout=1)
        await client.connect()
        try:
            await client.write_coils(19, [bool(bit) for bit in COILS])
            await client.write_coil(50, True)
            await client.write_registers(0, [1, 2, 3])
            await client.write_register(3, 4)
            await client.mask_write_register(address=3, and_mask=0xFFF0, or_mask=0x000A)
            both = await client.readwrite_registers(read_address=0, read_count=5, write_address=4, values=[5])
            coils = await client.read_coils(19, count=10)
            inputs = await client.read_discrete_inputs(0, count=10)
            words = await client.read_input_registers(0, count=1)
            about = await client.read_device_information()
            refused = await client.read_holding_registers(16, count=1)
            unknown = await client.report_device_id()
        finally:
            client.close()

    assert both.registers == [1, 2, 3, 0xA, 5]
    assert coils.bits[:10] == [bool(bit) for bit in COILS]
    assert inputs.bits[:10] == [bool(bit) for bit in INPUTS]
    assert words.registers == [0xCAFE]
    assert about.information == {0: b"cellctl", 1: b"simulated server", 2: b"1.0"}
    assert (refused.exception_code, unknown.exception_code) == (2, 1)


def everything(port: int) -> dict[str, Any]:
    """What libmodbus gets of our server."""

    def refusal(ask: Callable[[], Any]) -> int:
        try:
            ask()
        except libmodbus.Refused as refused:
            return refused.code
        return 0

    client = libmodbus.Client(port)
    try:
        client.write_bits(19, COILS)
        client.write_bit(50, 1)
        client.write_words(0, [1, 2, 3])
        client.write_word(3, 4)
        client.mask(3, 0xFFF0, 0x000A)
        return {
            "both": client.write_and_read(4, [5], 0, 5),
            "coils": client.read_bits("bits", 19, 10),
            "inputs": client.read_bits("input_bits", 0, 10),
            "input words": client.read_words("input_registers", 0, 3),
            "many": client.read_words("registers", 100, 32),
            "no address": refusal(lambda: client.read_words("registers", 16, 1)),
            "read only": refusal(lambda: client.write_words(100, [1])),
            "no function": refusal(client.report_slave_id),
        }
    finally:
        client.close()


async def test_libmodbus_reads_and_writes_everything() -> None:
    if libmodbus.library() is None:
        missing("libmodbus", "libmodbus5")
    async with serving(known_bank()) as server:
        got = await asyncio.to_thread(everything, server.port)

    assert got == {
        "both": [1, 2, 3, 0xA, 5],
        "coils": COILS,
        "inputs": INPUTS,
        "input words": [0xCAFE, 1, 0x86A0],
        "many": list(range(1000, 1032)),
        "no address": 2,
        "read only": 2,
        "no function": 1,
    }
    assert server.functions == dict.fromkeys((1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23), 1) | {3: 2, 16: 2}


MBPOLL = [
    (("-t", "0", "-r", "19", "-c", "3"), ["[19]: \t0", "[20]: \t1", "[21]: \t0"]),
    (("-t", "1", "-r", "0", "-c", "4"), ["[0]: \t1", "[1]: \t0", "[3]: \t1"]),
    (("-t", "3:hex", "-r", "0", "-c", "1"), ["[0]: \t0xCAFE"]),
    (("-t", "3:int", "-B", "-r", "1", "-c", "1"), ["[1]: \t100000"]),
    (("-t", "4", "-r", "100", "-c", "32"), ["[100]: \t1000", "[131]: \t1031"]),
]


@pytest.mark.parametrize(("asked", "shown"), MBPOLL)
async def test_mbpoll_shows_what_is_there(asked: tuple[str, ...], shown: list[str]) -> None:
    async with serving(known_bank()) as server:
        server.bank.tables[Table.COILS][20] = 1
        code, output = await mbpoll(server, *asked)

    assert code == 0, output
    assert all(line in output for line in shown), output


async def test_mbpoll_writes_and_is_refused() -> None:
    async with serving(known_bank()) as server:
        wrote = [
            await mbpoll(server, "-t", "4", "-r", "3", values=("7", "8")),
            await mbpoll(server, "-t", "0", "-r", "5", values=("1", "1", "1")),
        ]
        refused = await mbpoll(server, "-t", "4", "-r", "16", "-c", "1")

    assert [code for code, _ in wrote] == [0, 0], wrote
    assert [server.bank.tables[Table.HOLDING][at] for at in (3, 4)] == [7, 8]
    assert [server.bank.tables[Table.COILS][at] for at in range(4, 9)] == [0, 1, 1, 1, 0]
    assert refused[0] != 0
    assert "Illegal data address" in refused[1]


async def mbpoll(server: ModbusServer, *options: str, values: tuple[str, ...] = ()) -> tuple[int | None, str]:
    """One poll, with addresses as on the wire."""
    found = shutil.which("mbpoll")
    if found is None:
        missing("mbpoll", "mbpoll")
    return await said(found, "-0", "-1", "-p", str(server.port), *options, "127.0.0.1", *values)


async def test_node_modbus_serial_reads_and_writes_everything_and_much_at_once() -> None:
    runtime = node()
    async with serving(known_bank()) as server:
        code, output = await said(runtime, str(NODE_FILES / "client.js"), str(server.port), NODE_PATH=str(NODE_MODULES))

    assert code == 0, output
    assert json.loads(output) == {
        "coils": [bool(bit) for bit in COILS],
        "inputs": [bool(bit) for bit in INPUTS],
        "holding": [1, 2, 3, 0xA],
        "input_words": [0xCAFE],
        "vendor": "cellctl",
        "no_address": 2,
        "no_function": 1,
        "at_once": list(range(1000, 1032)),
    }
