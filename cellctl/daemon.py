"""One process: builds the devices, runs the cell, answers on the control socket, and tells systemd how it goes.

Order of a start: settings, journal, devices checked, READY. Order of an end (SIGTERM): the unit in progress is
finished, the arm stands, the journal is closed clean. A critical task that dies ends the process; systemd restarts it.
"""

import asyncio
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import cv2

from cellctl import service
from cellctl.arm import build_robot
from cellctl.assembly.hand import Devices
from cellctl.cameras import build_camera
from cellctl.cell import Cell
from cellctl.config import CellConfig, load_config
from cellctl.control.buttons import watch_buttons
from cellctl.control.server import ControlServer
from cellctl.control.session import Session
from cellctl.journal import Journal
from cellctl.journal_file import FILE_NAME as JOURNAL_NAME
from cellctl.lines import FILE_NAME as LOG_NAME
from cellctl.log import configure, log
from cellctl.pictures.writer import Pictures
from drivers.plc import Plc
from drivers.robot_ports import Valve

SWITCH_S = 0.0005  # a vision thread gives the interpreter back to the loop within this time (Python: 5 ms)


def build_devices(config: CellConfig) -> Devices:
    """The drivers of this cell; nothing is connected yet."""
    plc, robot, valve = config.plc, build_robot(config.robot), config.robot.vacuum_output
    return Devices(
        plc=Plc(
            plc.host,
            plc.port,
            unit_id=plc.unit_id,
            scan_period_s=plc.scan_period_ms / 1000,
            stale_after_s=plc.stale_after_ms / 1000,
            exchange=plc.exchange,
            layout=plc.address.layout,
        ),
        robot=robot,
        camera_1=build_camera("camera 1", config.camera_1),
        camera_2=build_camera("camera 2", config.camera_2),
        valve=None if valve is None else Valve(robot.ports, valve),
    )


async def run(config_path: Path, state: Path | None = None) -> int:
    """Run until SIGTERM or SIGINT; returns the exit code. Raises SettingsError, ControlError, RecordLost."""
    config = load_config(config_path)
    if state is not None:
        config = with_state(config, state)
    wanted = config.log
    records = configure(config.paths.log / LOG_NAME, wanted.level, rotate_mb=wanted.rotate_mb, keep=wanted.keep)
    cv2.setNumThreads(1)  # one picture, one core: least jitter
    sys.setswitchinterval(SWITCH_S)
    try:
        config.paths.state.mkdir(parents=True, exist_ok=True)
        journal = await Journal.open(config.paths.state / JOURNAL_NAME)
        came_to_rest = False
        try:
            await _serve(config, journal)
            came_to_rest = True
        finally:
            await journal.close(clean=came_to_rest)
    finally:
        records.close()
    return 0


def with_state(config: CellConfig, state: Path) -> CellConfig:
    """The same cell, its state, log and socket in another folder."""
    folder = state.resolve()
    paths = config.paths.model_copy(
        update={"state": folder, "log": folder / "log", "control_socket": folder / "control.sock"}
    )
    return config.model_copy(update={"paths": paths})


async def _serve(config: CellConfig, journal: Journal) -> None:
    devices = build_devices(config)
    pictures = Pictures(config.paths.state / "pictures")
    session = Session(config, devices, journal, pictures)
    control = ControlServer(config.paths.control_socket, session.handle)
    cell = Cell(config, devices, control.publish)
    session.attach(cell, control.publish)
    config.paths.control_socket.parent.mkdir(parents=True, exist_ok=True)
    control.open()
    stop = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    progress = service.Progress()
    try:
        async with asyncio.TaskGroup() as group:
            tasks = [group.create_task(devices.plc.run(), name="plc")]
            await _start(cell, session, journal)
            tasks += [
                group.create_task(cell.run(), name="cell"),
                group.create_task(control.run(), name="control"),
                group.create_task(watch_buttons(cell, session.command), name="buttons"),
                group.create_task(_mark(progress, "plc scan", lambda: devices.plc.scans)),
                group.create_task(_mark(progress, "cell", lambda: cell.turns)),
                group.create_task(service.feed_watchdog(progress, config.watchdog.progress_within_s)),
            ]
            service.ready(cell.message)
            log.info("ready", why=cell.message)
            await stop.wait()
            service.stopping("ending the unit in progress")
            await cell.shut_down()
            for task in tasks:
                task.cancel()
    finally:
        control.close()
        pictures.close()
        await _close(devices)
    log.info("stopped; the arm stands")


async def _start(cell: Cell, session: Session, journal: Journal) -> None:
    """Check the devices; units that were interrupted get their record before anything else happens.

    What is stale of calibrations and teaching is said now, not only when somebody starts.
    """
    for unit in await journal.close_interrupted("the last run was interrupted"):
        log.warning(f"unit {unit.unit} was interrupted at {unit.last_words}: look for its parts in the cell")
    await cell.start_up(clean=journal.clean)
    for line in await session.stale():
        log.warning(line)


async def _mark(progress: service.Progress, name: str, count: Callable[[], int]) -> None:
    """A critical task has moved on whenever its count has."""
    progress.register(name)
    last = count()
    while True:
        await asyncio.sleep(0.1)
        if count() != last:
            last = count()
            progress.mark(name)


async def _close(devices: Devices) -> None:
    for device in (devices.camera_1, devices.camera_2, devices.robot):
        await device.close()
