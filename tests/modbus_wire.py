"""A Modbus server with a bank of everything, and raw frames to and from it."""

import asyncio
import struct
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from simulators.modbus import ModbusServer
from simulators.modbus_bank import Bank


def bank() -> Bank:
    return Bank(
        coils=range(0, 100),
        discretes=range(0, 50),
        holding=[*range(0, 16), *range(100, 132)],
        inputs=range(0, 20),
        read_only=range(100, 132),
    )


def frame(transaction: int, pdu: bytes, *, unit: int = 1, protocol: int = 0, length: int | None = None) -> bytes:
    return struct.pack(">HHHB", transaction, protocol, len(pdu) + 1 if length is None else length, unit) + pdu


@asynccontextmanager
async def serving(of: Bank | None = None, **options: Any) -> AsyncIterator[ModbusServer]:
    server = ModbusServer(of or bank(), **options)
    await server.start()
    try:
        yield server
    finally:
        await server.close()


@asynccontextmanager
async def raw(server: ModbusServer) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    try:
        yield reader, writer
    finally:
        writer.close()


async def one_frame(reader: asyncio.StreamReader) -> bytes:
    async with asyncio.timeout(2):
        head = await reader.readexactly(6)
        return head + await reader.readexactly(struct.unpack(">H", head[4:])[0])
