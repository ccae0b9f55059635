"""What commands share: their options, the cell's settings, asking the daemon, and the exit code.

Modules of this folder import nothing but click and the standard library at the top, so that `--help` costs no time.
"""

import math
import re
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


def with_cell_if_any(command: F) -> F:
    """The option of commands that work without a cell, and better with one."""

    def known(_context: click.Context, _option: click.Parameter, given: Path | None) -> Path | None:
        usual = Path(DEFAULT_CONFIG)
        return given or (usual if usual.exists() else None)

    text = f"The cell's configuration, if there is one.  [default: {DEFAULT_CONFIG}, if it is there]"
    return option("--config", type=FILE, envvar="CELLCTL_CONFIG", callback=known, help=text)(command)


def with_json(command: F) -> F:
    """The option for programs that read our output."""
    return option("--json", "as_json", is_flag=True, help="JSON for programs instead of text for people.")(command)


class Numbers(click.ParamType[tuple[float, ...]]):
    """So many numbers with commas between them, or x as in 53x85."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.name = f"{count} numbers"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """The numbers; fails with a sentence."""
        try:
            numbers = tuple(float(part) for part in re.split(r"[,x]", value))
        except ValueError:
            numbers = ()
        if len(numbers) != self.count or not all(map(math.isfinite, numbers)):
            self.fail(f"{value!r} must be {self.count} numbers with commas between them", param, ctx)
        return numbers


class Greedy(click.Command):
    """Options that may be repeated take all words up to the next option, as a shell's `*` gives them."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Repeat the option before every further word."""
        repeated = {name for param in self.params if getattr(param, "multiple", False) for name in param.opts}
        spread: list[str] = []
        current: str | None = None
        for word in args:
            if word.startswith("-"):
                current = word if word in repeated else None
            elif current and spread[-1] != current:
                spread.append(current)
            spread.append(word)
        return super().parse_args(ctx, spread)


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

    from cellctl.desk.client import call, print_reply

    print_reply(asyncio.run(call(settings(config).paths.control_socket, request)), as_json=as_json)


def job(config: Path, request: dict[str, object], *, as_json: bool) -> None:
    """Start a job in the daemon, show its progress, end with its result."""
    import asyncio

    from cellctl.desk.client import event_printer, wait_for_job

    path = settings(config).paths.control_socket
    end(asyncio.run(wait_for_job(path, request, event_printer(as_json))))
