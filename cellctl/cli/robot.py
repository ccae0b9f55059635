"""`cellctl robot ...`"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from cellctl.cli.options import FILE, F, end, option, with_cell_if_any, with_config, with_json

if TYPE_CHECKING:
    from cellctl.desk.robot_link import Which


@click.group()
def robot() -> None:
    """Look into the robot's controller, keep what it stores, time the arm.

    The daemon must not run. To be sure whose answers it hears, every command first stops what the controller is doing.
    """


def with_controller(command: F) -> F:
    """The options that say which controller is meant."""
    wrapped: Callable[..., Any] = with_cell_if_any(command)
    address = "A controller by its address instead of the cell's: tcp://HOST:PORT or serial:/dev/NAME?baud=9600"
    wrapped = option("--dialect", type=click.Choice(["rcx3", "rcx2"]), help="Generation behind --address.")(wrapped)
    wrapped = option("--address", help=address)(wrapped)
    return wrapped  # type: ignore[return-value]


def which_of(config: Path | None, address: str | None, dialect: Literal["rcx3", "rcx2"] | None) -> "Which":
    """The controller that is meant."""
    from cellctl.desk.robot_link import Which

    return Which(config, address, dialect)


@robot.command()
@with_controller
@with_json
def info(as_json: bool, **which: Any) -> None:
    """Show versions, state, position, limits, settings and the latest alarms."""
    from cellctl.desk.robot_info import info as show

    end(show(which_of(**which), as_json=as_json))


@robot.command()
@click.argument("file", type=FILE)
@option("--force", is_flag=True, help="Replace a file that exists.")
@with_controller
@with_json
def backup(file: Path, force: bool, as_json: bool, **which: Any) -> None:
    """Write what the controller keeps into FILE: points, hands, shifts, pallets, variables, programs, parameters."""
    from cellctl.desk.robot_backup import backup as keep

    end(keep(which_of(**which), file, force=force, as_json=as_json))


@robot.command()
@click.argument("file", type=FILE)
@option("--yes", "sure", is_flag=True, help="Do not ask.")
@option("--other", is_flag=True, help="Also into another controller than the one that the file was read from.")
@with_controller
@with_json
def restore(file: Path, sure: bool, other: bool, as_json: bool, **which: Any) -> None:
    """Put what FILE says back into the controller; shows what differs and asks before. Nothing is deleted."""
    from cellctl.desk.robot_restore import restore as put_back

    end(put_back(which_of(**which), file, sure=sure, other=other, as_json=as_json))


@robot.command()
@click.argument("file", type=FILE)
@with_controller
@with_json
def diff(file: Path, as_json: bool, **which: Any) -> None:
    """Show where the controller differs from FILE; ends with 1 when it does."""
    from cellctl.desk.robot_restore import diff as compare

    end(compare(which_of(**which), file, as_json=as_json))


@robot.command("time")
@click.argument("recipe")
@option("--predict", is_flag=True, help="Only predict; the robot is not even asked.")
@option("--yes", "sure", is_flag=True, help="Do not ask whether the arm may move.")
@with_config
@with_json
def time_(recipe: str, predict: bool, sure: bool, config: Path, as_json: bool) -> None:
    """Move the arm along a unit of RECIPE, without parts, and show each stretch's time against the predicted one."""
    from cellctl.desk.robot_time import show_times

    end(show_times(config, recipe, predict=predict, sure=sure, as_json=as_json))
