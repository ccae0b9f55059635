"""Peers as programs of their own, and what is said where one is not installed."""

import asyncio
import contextlib
import os
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import NoReturn

import pytest

ROOT = Path(__file__).resolve().parents[2]
NODE_FILES = Path(__file__).parent / "node"
NODE_MODULES = ROOT / "build" / "node" / "node_modules"


def missing(peer: str, package: str) -> NoReturn:
    """Skip; in `make test`, where all packages are installed, fail."""
    text = f"{peer} is not installed: apt-get install {package}"
    if os.environ.get("CELLCTL_STRICT"):
        pytest.fail(text)
    pytest.skip(text)


def node() -> str:
    """Where node is; only with its module, which `make node-peer` installs."""
    found = shutil.which("node")
    if found is None or not (NODE_MODULES / "modbus-serial").is_dir():
        pytest.skip("node with modbus-serial is optional: make node-peer")
    return found


@asynccontextmanager
async def program(*arguments: str, **environment: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """A peer, until the end of the block."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        *arguments, stdout=pipe, stderr=asyncio.subprocess.STDOUT, cwd=ROOT, env={**os.environ, **environment}
    )
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            process.kill()
        await process.communicate()


async def said(*arguments: str, **environment: str) -> tuple[int | None, str]:
    """Exit code and output of a peer that ends by itself."""
    async with program(*arguments, **environment) as process, asyncio.timeout(20):
        output, _ = await process.communicate()
        return process.returncode, output.decode()
