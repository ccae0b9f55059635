"""Commands that need no daemon, and how a coroutine is run from the command line."""

import json
from collections.abc import Coroutine, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click

T = TypeVar("T")

OK = 0
WRONG_SETTINGS = 78


def run_loop(job: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine on a loop whose timers are exact: epoll rounds them up to a millisecond."""
    import asyncio
    import selectors

    with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())) as runner:
        return runner.run(job)


def check_recipes(files: Sequence[Path], *, as_json: bool) -> int:
    """Print what is wrong with each recipe file, or that nothing is; the exit code."""
    from cellctl.recipe import load_recipe
    from cellctl.strict_toml import SettingsError

    findings: dict[str, list[str]] = {}
    for file in files:
        try:
            load_recipe(file.parent, file.name.removesuffix(".toml"))
            findings[str(file)] = []
        except SettingsError as error:
            findings[str(file)] = list(error.lines)
    for name, lines in findings.items():
        if not as_json:
            click.echo("\n".join(lines) or f"{name}: ok")
    if as_json:
        click.echo(json.dumps(findings))
    return WRONG_SETTINGS if any(findings.values()) else OK


def list_folder(folder: Path, *, as_json: bool) -> None:
    """Print the recipes of a folder."""
    from cellctl.recipe import list_recipes

    names = list_recipes(folder)
    click.echo(json.dumps(names) if as_json else "\n".join(names) or f"no recipes in {folder}")


def print_faults(*, as_json: bool) -> None:
    """Print the table of faults."""
    from cellctl.faults import FAULTS, UNKNOWN

    for fault in sorted([*FAULTS.values(), UNKNOWN], key=lambda row: row.code):
        click.echo(
            json.dumps(fault._asdict()) if as_json else f"{fault.code}  {fault.reaction.value:<8} {fault.remedy}"
        )
