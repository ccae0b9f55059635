"""What commands share: their options, the cell's settings, asking the daemon, and the exit code.

Modules of this folder import nothing but click and the standard library at the top, so that `--help` costs no time.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from cellctl.config import CellConfig

DEFAULT_CONFIG = "/etc/cellctl/cell.toml"
FILE = click.Path(path_type=Path)
F = TypeVar("F", bound=Callable[..., Any])
option = click.option


def with_config(command: F) -> F:
    """The option that every command has which needs the cell's configuration."""
    text = "The cell's configuration."
    return option("--config", type=FILE, envvar="CELLCTL_CONFIG", default=DEFAULT_CONFIG, show_default=True, help=text)(
        command
    )


def with_json(command: F) -> F:
    """The option for programs that read our output."""
    return option("--json", "as_json", is_flag=True, help="JSON for programs instead of text for people.")(command)


def settings(config: Path) -> "CellConfig":
    """The cell's configuration. Raises SettingsError."""
    from cellctl.config import load_config

    return load_config(config)


def end(ok: bool | int) -> None:
    """End with exit code 0 or 1, or with the code that is given."""
    raise SystemExit(int(not ok) if isinstance(ok, bool) else ok)


def ask(config: Path, request: dict[str, object], *, as_json: bool) -> None:
    """Ask the daemon one thing and print its reply."""
    import asyncio

    from cellctl.client import call, print_reply

    print_reply(asyncio.run(call(settings(config).paths.control_socket, request)), as_json=as_json)


def job(config: Path, request: dict[str, object], *, as_json: bool) -> None:
    """Start a job in the daemon, show its progress, end with its result."""
    import asyncio

    from cellctl.client import event_printer, wait_for_job

    path = settings(config).paths.control_socket
    end(asyncio.run(wait_for_job(path, request, event_printer(as_json))))
