"""Other people's GigE Vision programs, and what they need to meet a simulated camera on one machine."""

import asyncio
import os
import shutil
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest

from simulators.gige import GigeCameraServer

HOME = "127.0.0.1"
GVCP_PORT = 3956


class _Ear(asyncio.DatagramProtocol):
    def __init__(self, hear: Callable[[bytes, tuple[str, int]], None]) -> None:
        self.datagram_received = hear  # type: ignore[method-assign]


@asynccontextmanager
async def heard_at_home(server: GigeCameraServer) -> AsyncIterator[None]:
    """A client that asks 127.0.0.1 only, and not everybody, is answered by this camera."""
    ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ear.setblocking(False)
    ear.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    ear.bind((HOME, GVCP_PORT))
    loop = asyncio.get_running_loop()
    transport, _protocol = await loop.create_datagram_endpoint(lambda: _Ear(server._on_broadcast), sock=ear)
    try:
        yield
    finally:
        transport.close()
        await asyncio.sleep(0)


def program(name: str, package: str) -> str:
    """Where a program is. Without it the test is skipped; strict runs must have it."""
    found = shutil.which(name)
    if found is None:
        reason = f"{name} is not installed (Debian package {package})"
        pytest.fail(reason) if os.environ.get("CELLCTL_STRICT") else pytest.skip(reason)
    return str(found)


@asynccontextmanager
async def running(*command: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """A program until the block is left; its output is one pipe."""
    process = await asyncio.create_subprocess_exec(
        *command,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
        env={**os.environ, "LC_ALL": "C"},
    )
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


async def output_of(*command: str, within_s: float = 20.0) -> str:
    """All that a program says until it ends."""
    async with running(*command) as process, asyncio.timeout(within_s):
        said, _ = await process.communicate()
    return said.decode(errors="replace")
