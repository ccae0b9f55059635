"""Devices belong to the daemon while it runs: whoever wants one at the desk asks first."""

import asyncio

import click

from cellctl.config import CellConfig


async def nobody_owns(config: CellConfig, device: str) -> None:
    """Raises ClickException when the daemon runs and so owns the device, or when that cannot be told."""
    path = config.paths.control_socket
    try:
        _, writer = await asyncio.open_unix_connection(path)
    except (FileNotFoundError, ConnectionRefusedError):
        return
    except OSError as error:
        raise click.ClickException(f"{path}: {error.strerror}, so nobody knows whether the daemon runs") from error
    writer.close()
    raise click.ClickException(
        f"the daemon runs and owns {device}: stop it first (`systemctl stop cellctl`), "
        "or look at what it knows: `cellctl status`, `cellctl log`"
    )
