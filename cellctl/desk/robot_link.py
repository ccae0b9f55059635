"""The robot's controller, talked to from the desk: only while no daemon owns it."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Literal, NamedTuple

import click

from cellctl.arm import build_robot
from cellctl.config import CellConfig, load_config
from cellctl.desk.ownership import nobody_owns
from drivers.link_address import parse_address
from drivers.reach import Limits
from drivers.robot import Robot

ROBOT = "the robot"


class Which(NamedTuple):
    """The controller that is meant: that of the cell, or one by its address."""

    config: Path | None
    address: str | None
    dialect: Literal["rcx3", "rcx2"] | None


class AtDesk(NamedTuple):
    """A controller whose link is open, and what is known of it beforehand. `serial` "": the cell does not name it."""

    robot: Robot
    address: str
    serial: str


@asynccontextmanager
async def at_desk(which: Which) -> AsyncIterator[AtDesk]:
    """The controller, open; it is let go afterwards. Raises ClickException, SettingsError, DeviceError."""
    config = load_config(which.config) if which.config is not None else None
    desk = _of_address(which) if which.address is not None else _of_cell(which, config)
    if config is not None and config.robot.address == desk.address:
        await nobody_owns(config, ROBOT)
    try:
        await desk.robot.open()
        yield desk
    finally:
        await desk.robot.close()


def _of_cell(which: Which, config: CellConfig | None) -> AtDesk:
    if config is None:
        raise click.ClickException("which robot? Name the cell by --config, or a controller by --address")
    if which.dialect is not None:
        raise click.ClickException("--dialect goes with --address; the cell's robot has its own in cell.toml")
    return AtDesk(build_robot(config.robot), config.robot.address, config.robot.serial)


def _of_address(which: Which) -> AtDesk:
    address = which.address or ""
    try:
        parse_address(address)
    except ValueError as error:
        raise click.ClickException(f"--address: {error}") from error
    return AtDesk(Robot(address, limits=Limits(), dialect=which.dialect or "rcx3"), address, "")
