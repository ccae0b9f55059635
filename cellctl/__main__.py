"""The command line: a thin table of commands. Each one imports what it needs when it is called.

Nothing but click and the standard library is imported at the top, so that `--help` costs no time.
"""

import os
import sys
from pathlib import Path
from typing import Any

import click

from cellctl.cli.calibrate import calibrate
from cellctl.cli.camera import camera
from cellctl.cli.drift import drift
from cellctl.cli.options import FILE, ask, end, option, settings, with_config, with_json
from cellctl.cli.plc import plc
from cellctl.cli.recipe import recipe
from cellctl.cli.robot import robot
from cellctl.cli.teach import teach
from cellctl.cli.vision import vision


def print_version(context: click.Context, _parameter: click.Parameter, wanted: bool) -> None:
    """Print the version and end."""
    from importlib.metadata import PackageNotFoundError, version

    if not wanted:
        return
    try:
        click.echo(f"cellctl {version('cellctl')}")
    except PackageNotFoundError:
        click.echo("cellctl (from its source tree, not installed)")
    context.exit()


EPILOG = """\b
Exit codes: 0 ok, 1 refused or failed, 2 wrong usage, 69 the daemon is not reachable, 78 a settings file is wrong,
130 interrupted."""


@click.group(epilog=EPILOG, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@option("--version", is_flag=True, expose_value=False, is_eager=True, callback=print_version, help="Show the version.")
def cli() -> None:
    """Run and operate an assembly cell."""


# -- the daemon --------------------------------------------------------------------------------------------


@cli.command()
@with_config
@option("--state", type=FILE, help="Folder of journal and calibration instead of the configured one.")
def run(config: Path, state: Path | None) -> None:
    """Run the cell, until SIGTERM or SIGINT. This is what the service starts."""
    from cellctl.daemon import run as run_daemon
    from cellctl.desk.commands import run_loop

    end(run_loop(run_daemon(config, state)))


@cli.command()
@with_config
@with_json
@option("--offline", is_flag=True, help="Leave the devices alone: settings, folders and calibrations only.")
def check(config: Path, as_json: bool, offline: bool) -> None:
    """Test settings, folders and devices before production; nothing moves."""
    from cellctl.desk.check import check as check_cell
    from cellctl.desk.commands import run_loop

    end(run_loop(check_cell(config, as_json=as_json, offline=offline)))


@cli.command()
@option("--speed", type=click.FloatRange(1, 100), default=100.0, show_default=True, help="1 = real time.")
@option("--units", type=click.IntRange(1), default=100, show_default=True, help="Units of each of the two runs.")
@option("--seed", type=int, default=1, show_default=True, help="Which simulated cell.")
@option("--repeats", type=click.IntRange(1, 100), default=10, show_default=True, help="Golden assemblies.")
@option("--recipe", default="x85", show_default=True, help="Which phone model.")
@option("--out", type=FILE, default=Path("build/demo"), show_default=True, help="Folder to fill; emptied first.")
def demo(**options: Any) -> None:
    """Calibrate, teach and assemble in a simulated cell, live, with the real controller and the real protocols."""
    from cellctl.desk.demo import Options, main

    end(main(Options(**options)))


@cli.command(add_help_option=False, context_settings={"ignore_unknown_options": True})
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def simulate(arguments: tuple[str, ...]) -> None:
    """Run a simulated cell on real ports, for any client (see `cellctl simulate --help`)."""
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", "simulators", *arguments])


# -- operating ---------------------------------------------------------------------------------------------


def machine_command(name: str, text: str) -> None:
    """Add one PackML command to the command line."""

    @cli.command(name, help=text)
    @with_config
    @with_json
    def command(config: Path, as_json: bool) -> None:
        ask(config, {"verb": "command", "name": name}, as_json=as_json)


@cli.command()
@with_config
@with_json
def status(config: Path, as_json: bool) -> None:
    """How is the cell."""
    ask(config, {"verb": "status"}, as_json=as_json)


@cli.command()
@with_config
@with_json
@option("--units", type=click.IntRange(0, 1_000_000), help="Make so many units, then end; 0 = until stopped.")
@option("--wait", is_flag=True, help="Show what happens until the run is over.")
def start(config: Path, as_json: bool, units: int | None, wait: bool) -> None:
    """Start production."""
    import asyncio

    from cellctl.desk.client import event_printer, run_requests, wait_for_run

    requests: list[dict[str, object]] = [{"verb": "units_left", "count": units}] if units is not None else []
    requests.append({"verb": "command", "name": "start"})
    path = settings(config).paths.control_socket
    if wait:
        end(asyncio.run(wait_for_run(path, requests, event_printer(as_json))))
    run_requests(path, requests, as_json=as_json)


machine_command("stop", "End the unit in progress, then stop.")
machine_command("hold", "End the unit in progress, then wait for a person.")
machine_command("unhold", "Go on after a hold.")
machine_command("suspend", "End the unit in progress, then wait for parts.")
machine_command("unsuspend", "Go on after a suspend.")
machine_command("complete", "End the production run after the unit in progress.")
machine_command("abort", "Stop everything at once.")
machine_command("clear", "After an abort: the cell was looked into and is safe.")
machine_command("reset", "After stop, clear or the end of a run: get ready to start.")


@cli.command()
@click.argument("name", type=click.Choice(["production", "maintenance", "manual"]))
@with_config
@with_json
def mode(name: str, config: Path, as_json: bool) -> None:
    """Change what the cell may be used for; only at rest."""
    ask(config, {"verb": "mode", "name": name}, as_json=as_json)


@cli.command()
@with_config
@with_json
def proceed(config: Path, as_json: bool) -> None:
    """Tell the running job that what it asked for is done."""
    ask(config, {"verb": "proceed"}, as_json=as_json)


cli.add_command(recipe)
cli.add_command(calibrate)
cli.add_command(teach)
cli.add_command(drift)
cli.add_command(vision)
cli.add_command(camera)
cli.add_command(robot)
cli.add_command(plc)


# -- looking back ------------------------------------------------------------------------------------------


@cli.command()
@with_config
@option("--file", type=FILE, help="This log file instead of the cell's.")
@option("-f", "--follow", is_flag=True, help="Go on with what comes, until interrupted.")
@option("--lines", type=click.IntRange(0), default=40, show_default=True, help="How many lines to begin with.")
@option("--unit", help="Only this unit.")
@with_json
def log(config: Path, file: Path | None, follow: bool, lines: int, unit: str | None, as_json: bool) -> None:
    """Show the operator's log."""
    from cellctl.desk.tail import Choice, tail
    from cellctl.lines import FILE_NAME

    path = file or settings(config).paths.log / FILE_NAME
    for line in tail(path, Choice(unit=unit, as_json=as_json), lines=lines, follow=follow):
        click.echo(line)


@cli.command()
@with_config
@option("--file", type=FILE, help="This journal instead of the cell's.")
@option("--last", type=click.IntRange(1), default=20, show_default=True, help="How many units.")
@option("--unit", help="Only this unit.")
@option("--verdict", type=click.Choice(["placed", "rejected", "removed", "lost", "open"]), help="Only these.")
@option("--fault", help="Only units with this fault code.")
@option("--csv", "as_csv", is_flag=True, help="CSV with a header.")
@with_json
def units(config: Path, file: Path | None, last: int, as_csv: bool, as_json: bool, **filters: str | None) -> None:
    """Show or export the records of the last units."""
    from cellctl.desk import records
    from cellctl.journal_file import FILE_NAME

    path = file or settings(config).paths.state / FILE_NAME
    rows = records.units(path, last=last, **{key: value for key, value in filters.items() if value is not None})
    write = records.write_csv if as_csv else records.write_json if as_json else records.write_table
    write(rows, sys.stdout)


@cli.command()
@with_json
def faults(as_json: bool) -> None:
    """Print the table of faults: code, what the cell does, what to do."""
    from cellctl.desk.commands import print_faults

    print_faults(as_json=as_json)


def main() -> None:
    """The program `cellctl`. What a person can mend is said in one sentence on standard error."""
    from cellctl.cli.errors import Sentences

    with Sentences():
        cli(standalone_mode=False)


if __name__ == "__main__":
    main()
