"""Our PLC driver against Modbus servers that others wrote, each with the least PLC in its memory.

pymodbus (Python), libmodbus (C, from Debian), modbus-serial (node; only where it is installed).
"""

import asyncio
import contextlib
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, Literal

import pytest
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.errors import LinkLost, NoAnswer, Refused
from drivers.plc import Plc
from tests.peers import least_plc, libmodbus
from tests.peers.programs import NODE_FILES, NODE_MODULES, missing, node, program

Exchange = Literal["fc23", "fc3+fc16"]


@asynccontextmanager
async def pymodbus_server() -> AsyncIterator[int]:
    """The contract in the memory of pymodbus' server."""

    async def plc(function: int, first: int, address: int, count: int, words: list[int], values: Any) -> None:
        if values is None:
            least_plc.scan(words)

    memory = SimData(address=0, count=libmodbus.HELD_WORDS, values=0, datatype=DataType.REGISTERS)
    server = ModbusTcpServer(SimDevice(id=1, simdata=[memory], action=plc), address=("127.0.0.1", 0))
    await server.serve_forever(background=True)
    assert server.transport is not None
    try:
        yield server.transport.sockets[0].getsockname()[1]
    finally:
        await server.shutdown()
        await asyncio.sleep(0.01)


@asynccontextmanager
async def libmodbus_server() -> AsyncIterator[int]:
    """The contract in the memory of libmodbus' server."""
    if libmodbus.library() is None:
        missing("libmodbus", "libmodbus5")
    async with program(sys.executable, "-m", "tests.peers.libmodbus") as process:
        assert process.stdout is not None
        yield int(await process.stdout.readline())


@asynccontextmanager
async def node_server() -> AsyncIterator[int]:
    """The contract in the memory of modbus-serial's server, which knows no function 23."""
    runtime = node()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    async with program(runtime, str(NODE_FILES / "server.js"), str(port), NODE_PATH=str(NODE_MODULES)) as process:
        assert process.stdout is not None
        assert await process.stdout.readline() == b"listening\n"
        yield port


@asynccontextmanager
async def running(plc: Plc) -> AsyncIterator[Plc]:
    task = asyncio.create_task(plc.run())
    try:
        yield plc
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


SERVERS = {"pymodbus": pymodbus_server, "libmodbus": libmodbus_server, "node": node_server}
TALKS: list[tuple[str, Exchange]] = [
    ("pymodbus", "fc23"),
    ("pymodbus", "fc3+fc16"),
    ("libmodbus", "fc23"),
    ("libmodbus", "fc3+fc16"),
    ("node", "fc3+fc16"),
]


@pytest.mark.parametrize(("peer", "exchange"), TALKS)
async def test_our_driver_works_a_plc_on_a_foreign_server(peer: str, exchange: Exchange) -> None:
    async with SERVERS[peer]() as port, running(Plc("127.0.0.1", port, exchange=exchange)) as plc:
        await plc.ready(within_s=3)
        arrivals = []
        for _ in range(3):
            arrivals.append(await plc.bring_base(within_s=2))
            await plc.vacuum(True, within_s=1)
            assert plc.image.vacuum_kpa == -70.0
            await plc.vacuum(False, within_s=1)
            await plc.release(arrivals[-1].carrier_id, good=True, within_s=2)
        await plc.reset_latches(within_s=1)
        await asyncio.sleep(0.3)

        assert [(arrival.sequence, arrival.carrier_id) for arrival in arrivals] == [(1, 501), (2, 502), (3, 503)]
        assert plc.image.boot == 1
        assert not plc.image.carrier_clamped
        assert plc.scans > 20


async def test_a_server_without_function_23_is_refused_with_the_setting_that_helps() -> None:
    async with node_server() as port, running(Plc("127.0.0.1", port)) as plc:
        with pytest.raises(Refused, match=r"exception 1.*|.*fc3\+fc16") as caught:
            await plc.ready(within_s=0.5)

        assert caught.value.code == "exception 1"
        assert 'exchange = "fc3+fc16"' in caught.value.detail


@pytest.mark.parametrize("peer", ["pymodbus", "libmodbus"])
async def test_a_foreign_server_that_goes_away_is_seen_at_once(peer: str) -> None:
    async with contextlib.AsyncExitStack() as stack:
        port = await stack.enter_async_context(SERVERS[peer]())
        plc = await stack.enter_async_context(running(Plc("127.0.0.1", port)))
        await plc.ready(within_s=3)
        unsafe = asyncio.create_task(plc.unsafe())
        await asyncio.sleep(0.05)
        stopping = stack.pop_all()
        began_s = asyncio.get_running_loop().time()
        closing = asyncio.create_task(stopping.aclose())
        async with asyncio.timeout(1):
            await unsafe
        assert asyncio.get_running_loop().time() - began_s < 0.5
        with pytest.raises((LinkLost, NoAnswer)):
            _ = plc.image
        await closing
