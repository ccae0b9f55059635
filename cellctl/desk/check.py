"""Self test: settings, folders, calibrations, golden assemblies and devices, one line each. Nothing moves."""

import asyncio
import contextlib
import json
import os
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import NamedTuple

import click

from cellctl.assembly.hand import Devices
from cellctl.assembly.stops import out_of_reach
from cellctl.config import CellConfig, load_config
from cellctl.daemon import build_devices
from cellctl.faults import CellError, NotCalibrated, NotReady
from cellctl.learnt.calibrations import caution, read_calibration
from cellctl.learnt.doubts import temperature_now
from cellctl.learnt.references import CAMERAS
from cellctl.learnt.taught import taught_in_use
from cellctl.recipe import Recipe, list_recipes, load_recipe
from cellctl.strict_toml import SettingsError
from drivers.camera import Camera
from drivers.errors import DeviceError

READY_WITHIN_S = 3.0


class Finding(NamedTuple):
    """One line of the report. `ok` None = worth knowing, but no reason not to start."""

    what: str
    ok: bool | None
    text: str


async def check(config_path: Path, *, as_json: bool, offline: bool = False) -> int:
    """Print what was found; 0 when the cell may start. Raises SettingsError for a wrong cell.toml."""
    config = load_config(config_path)
    findings = [*_recipes(config), *_folders(config), *_calibrations(config), _temperature(config)]
    if not offline:
        findings += await _devices(config)
    for finding in findings:
        click.echo(json.dumps(finding._asdict()) if as_json else _line(finding))
    return 1 if any(finding.ok is False for finding in findings) else 0


def _line(finding: Finding) -> str:
    mark = {True: "ok     ", False: "FAILED ", None: "note   "}[finding.ok]
    return f"{mark}{finding.what:<12} {finding.text}"


def _recipes(config: CellConfig) -> list[Finding]:
    findings = []
    for name in list_recipes(config.paths.recipes):
        try:
            recipe = load_recipe(config.paths.recipes, name)
            findings += [Finding("recipe", True, f"{name}: {recipe.description}"), _taught(config, name, recipe)]
            findings += [Finding("recipe", False, f"{name}: {text}") for text in out_of_reach(config, recipe)]
        except SettingsError as error:
            findings += [Finding("recipe", False, line) for line in error.lines]
    return findings


def _folders(config: CellConfig) -> list[Finding]:
    findings = []
    for path in (config.paths.state, config.paths.log, config.paths.control_socket.parent):
        nearest = next(folder for folder in (path, *path.parents) if folder.exists())
        usable = nearest.is_dir() and os.access(nearest, os.W_OK | os.X_OK)
        findings.append(Finding("folder", usable, f"{path}{'' if usable else f': {nearest} cannot be written to'}"))
    return findings


def _calibrations(config: CellConfig) -> list[Finding]:
    findings = []
    for camera in CAMERAS:
        try:
            found = read_calibration(config, camera)
            text = f"{camera}: {found.id} of {found.made}, hold-out {found.hold_out_um:.1f} um"
            findings.append(Finding("calibration", True, text))
            if noted := caution(config, found):
                findings.append(Finding("calibration", None, noted))
        except NotCalibrated as error:
            findings.append(Finding("calibration", None, str(error)))
    return findings


def _taught(config: CellConfig, name: str, recipe: Recipe) -> Finding:
    try:
        taught = taught_in_use(config, recipe)
    except NotCalibrated as error:
        return Finding("taught", None, f"{name}: {error}")
    known = f"known to {taught.uncertainty_mm * 1000:.1f} um {taught.uncertainty_deg * 1000:.1f} mdeg"
    return Finding("taught", True, f"{name}: {taught.id} of {taught.made}, {known}")


def _temperature(config: CellConfig) -> Finding:
    valid_h = config.calibration.temperature_valid_h
    try:
        entered_c = temperature_now(config.paths.state, valid_h)
    except NotCalibrated as error:
        return Finding("temperature", None, str(error))
    if entered_c is None:
        unknown = f"none was entered within {valid_h:g} h, so its change since calibrating is not checked"
        return Finding("temperature", None, f"{unknown}: `cellctl calibrate temperature CELSIUS`")
    return Finding("temperature", True, f"{entered_c:g} C")


async def _devices(config: CellConfig) -> list[Finding]:
    """All devices at once, so that one report names all that are missing."""
    devices = build_devices(config)
    async with _scanned(devices):
        asked = [_ask("plc", _plc, devices), _ask("robot", _robot, devices)]
        cameras = [_ask(camera.name, _picture(number), devices) for number, camera in _cameras(devices)]
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(question) for question in (*asked, *cameras)]
        return [task.result() for task in tasks]


@contextlib.asynccontextmanager
async def _scanned(devices: Devices) -> AsyncIterator[None]:
    """The PLC's scan runs beside the questions; everything is let go afterwards."""
    scan = asyncio.create_task(devices.plc.run())
    try:
        yield
    finally:
        scan.cancel()
        await asyncio.wait([scan])
        for device in (devices.robot, devices.camera_1, devices.camera_2):
            await device.close()


async def _ask(what: str, question: Callable[[Devices], Awaitable[str]], devices: Devices) -> Finding:
    try:
        return Finding(what, True, await question(devices))
    except (DeviceError, CellError) as error:
        return Finding(what, False, str(error))


async def _plc(devices: Devices) -> str:
    await devices.plc.ready(within_s=READY_WITHIN_S)
    image = devices.plc.image
    if not (image.estop_healthy and image.guard_closed and image.air_ok):
        raise NotReady("connected, but emergency stop, guard or air is not healthy")
    return f"map version {image.map_version:#06x}, cycle {image.cycle_ms:.1f} ms, safety healthy"


async def _robot(devices: Devices) -> str:
    await devices.robot.open()
    status, here = await devices.robot.status(), await devices.robot.here()
    place = f"at X {here.x_mm:.3f} Y {here.y_mm:.3f} Z {here.z_mm:.3f} mm R {here.r_deg:.3f} deg"
    place += f", controller {await devices.robot.identity()}"
    return place if status.ready else f"{place}; not ready yet: {status.why_not_ready}"


def _cameras(devices: Devices) -> list[tuple[int, Camera]]:
    return [(1, devices.camera_1), (2, devices.camera_2)]


def _picture(number: int) -> Callable[[Devices], Awaitable[str]]:
    async def ask(devices: Devices) -> str:
        camera = dict(_cameras(devices))[number]
        await camera.open()
        frame = await camera.grab()
        height, width = frame.pixels.shape
        return f"{frame.camera_id}, {width} x {height}, mean grey level {frame.pixels.mean():.0f}"

    return ask
