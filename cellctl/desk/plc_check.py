"""`cellctl plc check`: does a PLC keep the contract? Point by point, with what was sent and what came."""

import asyncio
import json
from collections import Counter
from collections.abc import Sequence

import click

from cellctl.config import CellConfig
from cellctl.desk.plc_motion_points import MOVING_POINTS
from cellctl.desk.plc_player import Found, Player, Point
from cellctl.desk.plc_points import ARRIVED, OWNING, READING, SERVED
from drivers.errors import DeviceError
from drivers.plc_layout import PlcAddress
from drivers.plc_probe import PlcProbe

PASSED, FAILED, NOT_TRIED = "passed", "FAILED", "not tried"
SOMETHING_FAILED, SOMETHING_NOT_TRIED = 1, 3


def check_plc(config: CellConfig, *, move: bool, as_json: bool) -> int:
    """0 = all passed, 1 = a point failed, 3 = none failed but some could not be tried."""
    return asyncio.run(_check(config.plc.address, move=move, as_json=as_json))


async def _check(address: PlcAddress, *, move: bool, as_json: bool) -> int:
    if not as_json:
        click.echo(f"PLC at {address}, {address.exchange}; seen through pymodbus")
    probe = PlcProbe(address)
    await probe.open()
    player = Player(probe)
    verdicts: Counter[str] = Counter()
    try:
        await _try_all(player, READING if move else (*READING, ARRIVED), verdicts, as_json)
        owned = await _try(player, OWNING, verdicts, as_json)
        if owned:
            await _try_all(player, SERVED + (MOVING_POINTS if move else ()), verdicts, as_json)
    finally:
        probe.close()
    _tell_sum(verdicts, as_json=as_json)
    if verdicts[FAILED]:
        return SOMETHING_FAILED
    return SOMETHING_NOT_TRIED if verdicts[NOT_TRIED] else 0


async def _try_all(player: Player, points: Sequence[Point], verdicts: Counter[str], as_json: bool) -> None:
    for point in points:
        await _try(player, point, verdicts, as_json)


async def _try(player: Player, point: Point, verdicts: Counter[str], as_json: bool) -> bool:
    try:
        found = await point.attempt(player)
    except DeviceError as error:
        found = Found(False, error.detail)
        if not await _connected_again(player):
            raise
    verdict = NOT_TRIED if found.passed is None else PASSED if found.passed else FAILED
    verdicts[verdict] += 1
    _tell(point, verdict, found, as_json=as_json)
    return bool(found.passed)


async def _connected_again(player: Player) -> bool:
    """After an error the next point begins on a new connection."""
    player.probe.close()
    player.probe = player.probe.anew()
    try:
        await player.probe.open()
    except DeviceError:
        return False
    return True


def _tell(point: Point, verdict: str, found: Found, *, as_json: bool) -> None:
    if as_json:
        facts = {"sent": found.sent, "came": found.came, "remedy": "" if found.passed else found.remedy}
        click.echo(json.dumps({"point": point.title, "verdict": verdict.lower(), **facts}))
        return
    click.secho(f"{verdict:<9}  {point.title}", fg={PASSED: "green", FAILED: "red"}.get(verdict, "yellow"))
    lines = [("sent", found.sent), ("came", found.came), ("remedy", "" if found.passed else found.remedy)]
    for name, text in lines:
        if text:
            click.echo(f"{'':<11}{name:<6} {text}")


def _tell_sum(verdicts: Counter[str], *, as_json: bool) -> None:
    if as_json:
        click.echo(json.dumps({word.lower(): verdicts[word] for word in (PASSED, FAILED, NOT_TRIED)}))
    else:
        click.echo(", ".join(f"{verdicts[word]} {word.lower()}" for word in (PASSED, FAILED, NOT_TRIED)))
