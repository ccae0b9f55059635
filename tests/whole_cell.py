"""A whole cell for tests: one world behind its protocol servers, and the daemon's own objects, in one process.

`commissioned` calibrates and teaches once per test session; every test then gets a fresh world of the same seed (the
same bolts in the same places) and a copy of what was learnt. Tests judge by `bench.world`.
"""

import asyncio
import contextlib
import itertools
import json
import os
import shutil
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from cellctl.assembly.hand import Devices
from cellctl.cell import Cell
from cellctl.config import CellConfig, load_config
from cellctl.config_camera import CameraConfig
from cellctl.control.buttons import watch_buttons
from cellctl.control.events import Event
from cellctl.control.requests import parse_request
from cellctl.control.session import Session
from cellctl.daemon import build_devices, with_state
from cellctl.desk.demo import hurried
from cellctl.desk.records import units
from cellctl.journal import Journal
from cellctl.journal_file import FILE_NAME
from cellctl.machine import State
from cellctl.pictures.writer import Pictures
from drivers.camera import Setup
from drivers.v4l2 import V4l2Camera
from simulators.cell import Addresses, SimulatedCell
from simulators.layout import Carrier
from simulators.product import load_product
from simulators.robot.log import Log
from simulators.v4l2 import V4l2CameraServer
from simulators.world import World

ROOT = Path(__file__).resolve().parent.parent
SEED = 11
SPEED = 50.0
WITHIN_S = 30.0
ON_THE_SECOND_ARM = (
    ('mount = "tool"', 'mount = "arm_2"'),
    ("x_mm = 55, y_mm = 0, t_deg = 0 }", "x_mm = 55, y_mm = 0, t_deg = -70 }"),  # mount_from_camera_1
    ("x_mm = 340, y_mm = -20, t_deg = 0 }", "x_mm = 340, y_mm = -20, t_deg = -24 }"),  # board
)
STUCK = {State.ABORTED, State.HELD, State.SUSPENDED}  # nothing goes on by itself from here
_next = itertools.count(1)


def loopback() -> str:
    """The first three bytes of loopback addresses that no other test has."""
    return f"127.{20 + os.getpid() % 200}.{next(_next) % 250}"


class Bench:
    """One running cell."""

    def __init__(self, world: World, config: CellConfig, devices: Devices) -> None:
        self.world = world
        self.config = config
        self.devices = devices
        self.events: list[Event] = []
        self.cell: Cell
        self.press: Callable[[str], None]  # a button at the line
        self.robot_log: Log
        self.session: Session
        self.journal: Journal

    async def ask(self, verb: str, **what: object) -> dict[str, Any]:
        """What a client of the control socket would ask."""
        request = parse_request(json.dumps({"version": 1, "verb": verb, **what}).encode())
        return dict(await self.session.handle(request))  # type: ignore[arg-type]

    async def command(self, name: str, *until: State) -> None:
        """A command, and wait for the state that it leads to."""
        await self.ask("command", name=name)
        await self.until(*until)

    async def until(self, *states: State) -> None:
        """Wait for one of these states."""
        async with asyncio.timeout(WITHIN_S):
            while self.cell.state not in states:
                assert self.cell.state not in STUCK, self.cell.message
                await asyncio.sleep(0.005)

    async def when(self, holds: Callable[[], bool]) -> None:
        """Wait for something to be so."""
        async with asyncio.timeout(WITHIN_S):
            while not holds():
                await asyncio.sleep(0.001)

    async def ready(self, recipe: str = "x85") -> None:
        """To Idle with a recipe."""
        if self.cell.state is State.ABORTED:
            await self.command("clear", State.STOPPED)
        await self.ask("recipe_use", name=recipe)
        await self.command("reset", State.IDLE)

    async def at_rest(self) -> None:
        """From Held, where a person has read why."""
        if self.cell.state is State.HELD:
            await self.command("stop", State.STOPPED)

    async def start(self, count: int) -> None:
        """Begin a production run."""
        await self.ask("units_left", count=count)
        await self.ask("command", name="start")

    async def produce(self, count: int, recipe: str = "x85") -> list[dict[str, Any]]:
        """A production run to its end; the records of its units, oldest first."""
        await self.ready(recipe)
        await self.start(count)
        await self.until(State.COMPLETE)
        await self.when(lambda: self.world.base is None)
        return self.records(count)

    def records(self, count: int) -> list[dict[str, Any]]:
        """The last unit records, oldest first."""
        return units(self.config.paths.state / FILE_NAME, last=count)

    def said(self, kind: str) -> list[Event]:
        """Events of one kind."""
        return [event for event in self.events if event["event"] == kind]

    async def commission(self, repeats: int, recipe: str = "x85") -> None:
        """Calibrate and teach."""
        for what in ("camera-1", "camera-2"):
            await self.job("calibrate", recipe, what=what)
        await self.job("teach", recipe, repeats=repeats, pairs=1)

    async def job(self, verb: str, recipe: str = "x85", **what: object) -> Event:
        """A job to its end, a person helping; how it ended. One that does not go well leaves the cell Held."""
        await self.at_rest()
        await self.ready(recipe)
        ended = len(self.said("job"))
        await self.ask(verb, **what)
        while len(self.said("job")) == ended:
            assert self.cell.state not in STUCK, self.cell.message
            await self.help()
            await asyncio.sleep(0.005)
        await self.when(lambda: self.cell.state in STUCK | {State.COMPLETE})
        return self.said("job")[-1]

    async def help(self) -> None:
        """Do what a person is asked for."""
        if self.session.status()["asks"]:
            what = self.said("progress")[-1]["asks"]
            getattr(self.world, str(what).replace("-", "_"))()
            await self.ask("proceed")


@contextlib.asynccontextmanager
async def simulated(
    folder: Path,
    *,
    learnt: Path | None = None,
    product: str = "x85",
    seed: int = SEED,
    speed: float = SPEED,
    recipes: Path | None = None,
    settings: Mapping[str, object] | None = None,
    carrier: Carrier = "tool",
    album: Path | None = None,
    video_2: str | None = None,
    video_triggers: bool = True,
    dialect: Literal["rcx3", "rcx2"] = "rcx3",
    robot: Mapping[str, object] | None = None,
) -> AsyncIterator[Bench]:
    """The simulated cell alone, with the configuration that a daemon needs in `folder / "cell.toml"`.

    `learnt` is the state folder of a commissioned cell of the same seed, `settings` are other [calibration] settings,
    `carrier` is what camera 1 is on, `album` a folder that gets every picture, `dialect` the robot controller's,
    `robot` other [robot] settings, `video_2` the file of camera 2 as a V4L2 camera ("": it is opened in this process,
    without a file).
    """
    copies, net = _hurried(recipes or ROOT / "recipes", folder / "hurried", speed), loopback()
    swaps = (*(ON_THE_SECOND_ARM if carrier == "arm_2" else ()), *_as_v4l2(f"{net}.3", video_2))
    config = _config(folder, net, copies, swaps)
    config = config.model_copy(
        update={
            "calibration": config.calibration.model_copy(update=settings),
            "robot": config.robot.model_copy(update={"dialect": dialect, **(robot or {})}),
        }
    )
    if learnt is not None:
        shutil.copytree(learnt, config.paths.state, ignore=shutil.ignore_patterns("*.db*", "log", "pictures"))
    world = World(seed, load_product(config.paths.recipes / f"{product}.toml"), speed=speed, carrier=carrier)
    cameras = f"{net}.2", f"{net}.3" if video_2 is None else video_2
    ports = f"{net}.1", config.plc.port, f"{net}.1", 10023
    addresses = Addresses(*ports, *cameras, video_triggers=video_triggers, robot_dialect=dialect)
    async with SimulatedCell(world, addresses, album) as cell:
        devices = build_devices(config)
        if video_2 == "":
            devices = replace(devices, camera_2=_opened_here(config.camera_2, cell.cameras[2]))
        bench = Bench(world, config, devices)
        bench.press = cell.plc.press
        bench.robot_log = cell.robot.log
        yield bench


@contextlib.asynccontextmanager
async def whole_cell(
    folder: Path, *, before_start: Callable[[Bench], None] = lambda bench: None, **options: Any
) -> AsyncIterator[Bench]:
    """A running cell; options as of `simulated`."""
    async with simulated(folder, **options) as bench:
        before_start(bench)
        async with running(bench):
            yield bench


def _hurried(recipes: Path, copies: Path, speed: float) -> Path:
    copies.mkdir(parents=True, exist_ok=True)
    for recipe in recipes.glob("*.toml"):
        (copies / recipe.name).write_text(hurried(recipe.read_text(encoding="utf-8"), speed), encoding="utf-8")
    return copies


def _as_v4l2(ip: str, path: str | None) -> tuple[tuple[str, str], ...]:
    """How cell.toml changes when the camera of this address is a V4L2 one."""
    if path is None:
        return ()
    return ((f'driver = "gige"\naddress = "{ip}"', f'driver = "v4l2"\naddress = "{path or "/dev/video0"}"'),)


def _opened_here(camera: CameraConfig, server: object) -> V4l2Camera:
    """A driver that reaches the simulated camera where there is no FUSE."""
    assert isinstance(server, V4l2CameraServer)
    return V4l2Camera("camera 2", camera.address, Setup(camera.serial, camera.region), open_node=server.open_here)


def _config(folder: Path, net: str, recipes: Path, swaps: Iterable[tuple[str, str]]) -> CellConfig:
    text = (ROOT / "deploy" / "simulated-cell.toml").read_text(encoding="utf-8")
    text = text.replace('"127.0.0.', f'"{net}.').replace("tcp://127.0.0.", f"tcp://{net}.")
    text = text.replace('"../recipes"', f'"{recipes}"')
    for old, new in swaps:
        assert old in text
        text = text.replace(old, new)
    path = folder / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return with_state(load_config(path), folder / "state")


@contextlib.asynccontextmanager
async def running(bench: Bench) -> AsyncIterator[None]:
    """The daemon's own objects on this cell."""
    state = bench.config.paths.state
    state.mkdir(parents=True, exist_ok=True)
    bench.journal = await Journal.open(state / FILE_NAME)
    pictures = Pictures(state / "pictures")
    bench.session = Session(bench.config, bench.devices, bench.journal, pictures)
    bench.cell = Cell(bench.config, bench.devices, bench.events.append)
    bench.session.attach(bench.cell, bench.events.append)
    scan = asyncio.create_task(bench.devices.plc.run())
    try:
        await bench.cell.start_up(clean=bench.journal.clean)
        tasks = [
            asyncio.create_task(bench.cell.run()),
            asyncio.create_task(watch_buttons(bench.cell, bench.session.command)),
        ]
        try:
            yield
        finally:
            await bench.cell.shut_down()
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
    finally:
        scan.cancel()
        await asyncio.wait([scan])
        for device in (bench.devices.camera_1, bench.devices.camera_2, bench.devices.robot):
            await device.close()
        pictures.close()
        await bench.journal.close()


def commission(folder: Path, *, product: str = "x85", repeats: int = 8, recipes: Path | None = None) -> Path:
    """Calibrate and teach once; returns the state folder."""

    async def run() -> Path:
        async with whole_cell(folder, product=product, recipes=recipes) as bench:
            await bench.commission(repeats, product)
            return bench.config.paths.state

    return asyncio.run(run())
