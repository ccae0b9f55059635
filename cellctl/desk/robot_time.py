"""How long the arm takes for each stretch of a unit: predicted from its speeds, and measured on the robot."""

import json
import statistics
import time
from pathlib import Path
from typing import NamedTuple

import click

from cellctl.arm import HANDS, build_robot, limits_of
from cellctl.assembly.hand import FREEING_SPEED_PCT, lift_free
from cellctl.assembly.stretches import Places, Stretch, drawn_places, predicted_s, stretches, taught_places
from cellctl.config import CellConfig, load_config
from cellctl.desk.commands import run_loop
from cellctl.desk.ownership import nobody_owns
from cellctl.desk.robot_link import ROBOT
from cellctl.faults import NotCalibrated
from cellctl.learnt.taught import taught_in_use
from cellctl.mount import OutOfReach
from cellctl.recipe import Recipe, load_recipe
from drivers.rcx import Position
from drivers.robot import Robot

ROUNDS = 5
EXCHANGES = 20
GOOD_PCT = 5.0
QUESTION = (
    "The arm moves as for {units} units of {recipe}, down to table and seat too. Parts are away and the way is free?"
)


class Time(NamedTuple):
    """One stretch; None where the arm was not moved."""

    name: str
    predicted_s: float
    measured_s: float | None

    @property
    def away_pct(self) -> float | None:
        """By how much the measured time is longer than the predicted one."""
        return None if self.measured_s is None else (self.measured_s / self.predicted_s - 1) * 100


class Times(NamedTuple):
    """All stretches, and how long one exchange with the controller takes."""

    rows: list[Time]
    exchange_s: float

    @property
    def whole(self) -> Time:
        """All stretches together."""
        measured = [row.measured_s for row in self.rows if row.measured_s is not None]
        return Time("arm in all", sum(row.predicted_s for row in self.rows), sum(measured) if measured else None)


def show_times(config_path: Path, name: str, *, predict: bool, sure: bool, as_json: bool) -> int:
    """Print them; 1 when the arm is more than 5 % away from what was predicted.

    Raises SettingsError, ClickException, DeviceError.
    """
    config = load_config(config_path)
    recipe = load_recipe(config.paths.recipes, name)
    ways, where = _ways(config, recipe)
    if as_json and not (sure or predict):
        raise click.ClickException("--json asks nothing, so say --yes as well, or --predict")
    if not predict:
        run_loop(nobody_owns(config, ROBOT))
        if not sure:
            click.confirm(QUESTION.format(units=ROUNDS, recipe=name), abort=True)
    times = Times(_predicted(config, ways, 0.0), 0.0) if predict else run_loop(measured(config, ways))
    click.echo(json.dumps(_facts(times)) if as_json else _text(times, where))
    away_pct = times.whole.away_pct
    return 1 if away_pct is not None and abs(away_pct) > GOOD_PCT else 0


async def measured(config: CellConfig, ways: list[Stretch]) -> Times:
    """Move along all of them some rounds; the median of each. Raises DeviceError."""
    robot = build_robot(config.robot)
    try:
        await robot.open()
        exchange_s = await _exchange_s(robot)
        await robot.power_on()
        await _begin(robot, config, ways[-1])
        rounds = [[await _timed_s(robot, way) for way in ways] for _ in range(ROUNDS)]
    finally:
        await robot.close()
    medians = [statistics.median(each) for each in zip(*rounds, strict=True)]
    rows = _predicted(config, ways, exchange_s)
    return Times([row._replace(measured_s=found) for row, found in zip(rows, medians, strict=True)], exchange_s)


def _ways(config: CellConfig, recipe: Recipe) -> tuple[list[Stretch], str]:
    """The stretches, and which places they are from."""
    try:
        places, where = taught_places(taught_in_use(config, recipe)), "as taught"
    except NotCalibrated:
        places, where = _drawn(config, recipe), "as drawn, for it has not been taught"
    return stretches(places, config, recipe), where


def _drawn(config: CellConfig, recipe: Recipe) -> Places:
    try:
        return drawn_places(config, recipe)
    except OutOfReach as error:
        raise click.ClickException(f"camera 1 cannot look at the base as the cell is drawn: {error}") from error


def _predicted(config: CellConfig, ways: list[Stretch], exchange_s: float) -> list[Time]:
    limits, dynamics, rows = limits_of(config.robot), config.robot.speeds.dynamics, []
    if config.robot.payload_kg is not None:
        dynamics = dynamics.at_payload(config.robot.payload_kg)
    at = Position(ways[-1].legs[-1].to, HANDS[config.robot.hand])
    for way in ways:
        rows.append(Time(way.name, predicted_s(at, way, limits, dynamics, exchange_s=exchange_s), None))
        at = Position(way.legs[-1].to, at.hand)
    return rows


async def _exchange_s(robot: Robot) -> float:
    """How long a question and its answer take."""
    found = []
    for _ in range(EXCHANGES):
        since_s = time.perf_counter()
        await robot.here()
        found.append(time.perf_counter() - since_s)
    return statistics.median(found)


async def _begin(robot: Robot, config: CellConfig, last: Stretch) -> None:
    """Straight up, then to where the first stretch begins."""
    await lift_free(robot, config.positions.safe_z_mm)
    await robot.move(last.legs[-1].to, speed_pct=FREEING_SPEED_PCT)


async def _timed_s(robot: Robot, way: Stretch) -> float:
    since_s = time.perf_counter()
    await robot.move_through(way.legs)
    return time.perf_counter() - since_s


def _facts(times: Times) -> dict[str, object]:
    rows = [{**row._asdict(), "away_pct": row.away_pct} for row in (*times.rows, times.whole)]
    return {"exchange_ms": times.exchange_s * 1000, "stretches": rows}


def _text(times: Times, where: str) -> str:
    head = f"{'stretch':<22}{'predicted s':>12}{'measured s':>12}{'away %':>8}"
    lines = [
        f"{row.name:<22}{row.predicted_s:>12.3f}{_number(row.measured_s, 12, 3)}{_number(row.away_pct, 8, 1)}"
        for row in (*times.rows, times.whole)
    ]
    exchange = f"; one exchange with the controller takes {times.exchange_s * 1000:.1f} ms" if times.exchange_s else ""
    return "\n".join([head, *lines, f"places {where}{exchange}"])


def _number(value: float | None, width: int, decimals: int) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:>{width}.{decimals}f}"
