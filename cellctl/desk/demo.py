"""The whole cell on simulators, live: the simulated cell and the daemon as two processes, and this one as the people.

Nothing here is a short cut: the daemon is the one of `cellctl run`, asked over its control socket; the simulated cell
is the one of `cellctl simulate`. What only a person can do (seat a golden battery) and what only a measuring machine
can know (how a battery truly lies) comes over the simulated cell's own socket, which the daemon never sees.
"""

import asyncio
import contextlib
import json
import os
import re
import shutil
import sys
import time
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellctl.desk import client
from cellctl.desk.demo_report import Row, Run, Summary, heading, row_line, summary_text

ROOT = Path(__file__).resolve().parents[2]
START_WITHIN_S = 30.0
STOP_WITHIN_S = 20.0
MOST_STOPS = 3  # a computer that stands still for a quarter of a second aborts the cell; a person lets it go on

TABLE_2 = (  # the paper's ten rows: battery dX mm, dY mm, dT deg; base dX mm, dY mm, dT deg
    ((0.6640, 0.6305, 0.2811), (-0.0031, 0.1146, -0.1337)),
    ((0.4777, 0.2435, 0.8222), (-0.0128, 0.0659, -0.1247)),
    ((0.1268, -0.3113, -0.4751), (0.0145, -0.0205, 0.0765)),
    ((0.5292, 0.2944, 0.8724), (0.0109, 0.0992, 0.4227)),
    ((-0.4013, 0.2631, -0.5642), (0.0321, -0.0895, 0.2015)),
    ((0.5269, 0.2360, 0.6155), (0.0424, 0.1458, 0.5024)),
    ((-0.9187, -0.3446, -0.6576), (0.0212, 0.1007, -0.1615)),
    ((-0.3167, 0.1582, 0.3849), (0.0446, 0.1132, 0.1495)),
    ((0.4512, 0.3022, 0.2098), (-0.0387, 0.1392, 0.1581)),
    ((-0.2642, 0.8743, 0.9976), (-0.0422, 0.0916, 0.2552)),
)
REPEATABILITY = {"mm": 0.010, "deg": 0.004}  # the paper's robot, 3 sigma


@dataclass(frozen=True)
class Options:
    """What the user asked for."""

    speed: float
    units: int
    seed: int
    repeats: int
    recipe: str
    out: Path


WAITS = re.compile(r"^(settle_s|dwell_s|blow_off_s) = ([0-9.]+)", re.MULTILINE)


def hurried(recipe: str, speed: float) -> str:
    """The text of a recipe whose waits are as long in a fast world as they should be in a real one.

    The controller waits in real seconds; what it waits for happens `speed` times faster.
    """
    return WAITS.sub(lambda wait: f"{wait[1]} = {float(wait[2]) / speed:.6f}", recipe)


class DemoFailed(Exception):
    """The demonstration did not get through; the text says where and what to look at."""


class Aborted(DemoFailed):
    """The cell aborted; what a person would read."""


def main(options: Options) -> int:
    """Run it; returns the exit code."""
    try:
        return asyncio.run(_run(options))
    except (DemoFailed, client.NotReachable, client.RequestFailed) as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1


async def _run(options: Options) -> int:
    began_s = time.monotonic()
    stage = Stage(options)
    async with stage.running():
        await stage.commission()
        table_2 = await stage.table_2()
        both = await stage.production("both cameras", options.recipe, options.units)
        single = await stage.production("camera 2 only", stage.single_recipe, options.units)
    summary = Summary(both, single, table_2, time.monotonic() - began_s, options.speed)
    path = options.out.with_suffix(".json")
    path.write_text(json.dumps(summary.as_dict(), indent=1) + "\n", encoding="utf-8")
    print(summary_text(summary))
    print(f"\nrecords   {stage.state}/journal.db (cellctl units --config {stage.config})")
    print(f"pictures  {stage.state}/pictures")
    print(f"log       {stage.state}/log\nfigures   {path}")
    return 0


class Stage:
    """The two processes and the people."""

    def __init__(self, options: Options) -> None:
        self._options = options
        self._person: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
        self._seen = 0  # verdicts
        out = options.out.resolve()
        self.state = out / "state"
        self.config = out / "cell.toml"
        self.single_recipe = f"{options.recipe}-camera-2-only"
        # Every demonstration has its own loopback addresses, so that several can run side by side.
        self._net = f"127.{100 + os.getpid() // 250 % 100}.{1 + os.getpid() % 250}"

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Both processes, from nothing to ready and back to nothing."""
        self._prepare()
        async with self._process("simulated cell", self._person_socket, "simulators", *self._simulator_options()):
            self._person = await asyncio.open_unix_connection(self._person_socket, limit=1 << 24)
            daemon = ("run", "--config", str(self.config), "--state", str(self.state))
            async with self._process("daemon", self._control_socket, "cellctl", *daemon):
                yield
            self._person[1].close()

    # -- what is shown -----------------------------------------------------------------------------------------

    async def commission(self) -> None:
        """Calibrate both cameras and teach the golden assembly, with the daemon's own procedures."""
        print(f"cell      seed {self._options.seed}, world speed {self._options.speed:g}, on {self._net}.x")
        await self._ask({"verb": "recipe_use", "name": self._options.recipe})
        for what in ("camera-1", "camera-2"):
            await self._job({"verb": "calibrate", "what": what})
        await self._job({"verb": "teach", "repeats": self._options.repeats, "pairs": 1})

    async def table_2(self) -> list[dict[str, Any]]:
        """The paper's ten rows: once with a robot that repeats exactly, once with the paper's +-0.01 mm."""
        exact = await self._ten_rows("Table 2, robot that repeats exactly", {"mm": 0.0, "deg": 0.0})
        real = await self._ten_rows("Table 2, robot +-0.01 mm", REPEATABILITY)
        return [
            {
                "set": {"battery": list(battery), "base": list(base)},
                "found": {"battery": one.found_battery, "base": one.found_base},
                "found_with_repeatability": {"battery": two.found_battery, "base": two.found_base},
                "placement_error_mm": two.placement_error_mm,
                "placement_error_exact_robot_mm": one.placement_error_mm,
            }
            for (battery, base), one, two in zip(TABLE_2, exact.rows, real.rows, strict=True)
        ]

    async def _ten_rows(self, title: str, repeatability: dict[str, float]) -> Run:
        await self._do("repeatability", **repeatability)
        deliveries = [{"battery": list(battery), "base": list(base)} for battery, base in TABLE_2]
        for _ in range(MOST_STOPS):
            await self._do("queue", deliveries=deliveries)
            run = await self.production(title, self._options.recipe, len(TABLE_2))
            if not run.interrupted:
                return run
        raise DemoFailed(f"{title}: interrupted {MOST_STOPS} times (log: {self.state}/log)")

    async def production(self, title: str, recipe: str, units: int) -> Run:
        """A run of so many units, one line each. After an abort a person looks, clears and goes on."""
        run = Run(title, units)
        print(heading(title, units))
        await self._command("reset", {"Idle"})
        await self._ask({"verb": "recipe_use", "name": recipe})
        while len(run.rows) < units:
            try:
                await self._run(run)
            except Aborted as error:
                run.interrupted += 1
                print(f"interrupted: {error}", flush=True)
                if run.interrupted > MOST_STOPS:
                    raise
                await self._command("clear", {"Stopped"})
                await self._command("reset", {"Idle"})
        return run

    async def _run(self, run: Run) -> None:
        """One production run to its end."""
        await self._ask({"verb": "units_left", "count": run.units - len(run.rows)})
        async with contextlib.aclosing(client.watch(self._control_socket)) as events:
            await self._ask({"verb": "command", "name": "start"})
            waiting: list[dict[str, Any]] = []
            async for event in events:
                if event["event"] == "unit":
                    waiting.append(event)
                await self._show(run, waiting)
                if self._ended(event):
                    break
        while waiting:
            await self._show(run, waiting)

    async def _show(self, run: Run, waiting: list[dict[str, Any]]) -> None:
        """Print the units whose carriers have left: only then the truth about them is known."""
        verdicts = (await self._do("verdicts", since=self._seen))["verdicts"]
        for verdict in verdicts:
            self._seen += 1
            event = next((e for e in waiting if e["data"]["carrier_id"] == verdict["carrier_id"]), None)
            if event is not None:
                waiting.remove(event)
                row = Row.of(event, verdict)
                run.rows.append(row)
                print(row_line(run, row), flush=True)

    # -- the daemon --------------------------------------------------------------------------------------------

    async def _ask(self, request: dict[str, object]) -> dict[str, Any]:
        return await client.call(self._control_socket, request)

    async def _command(self, name: str, until: set[str]) -> None:
        """A command, and wait until the machine is where it leads."""
        async with contextlib.aclosing(client.watch(self._control_socket)) as events:
            reply = await self._ask({"verb": "command", "name": name})
            if reply["state"] in until:
                return
            async for event in events:
                if event["event"] == "state" and event["state"] in until:
                    return
                self._ended(event)

    async def _job(self, request: dict[str, object]) -> None:
        """Calibration or teaching; the person does what is asked for."""
        await self._command("reset", {"Idle"})
        began_s = time.monotonic()
        async with contextlib.aclosing(client.watch(self._control_socket)) as events:
            await self._ask(request)
            async for event in events:
                if event.get("asks"):
                    await self._do(event["asks"].replace("-", "_"))
                    await self._ask({"verb": "proceed"})
                elif event["event"] == "progress" and sys.stdout.isatty():
                    print(f"\r\033[K{event['job']:<10}{event['text']}", end="", flush=True)
                elif event["event"] == "job":
                    clear = "\r\033[K" if sys.stdout.isatty() else ""
                    print(f"{clear}{event['job']:<10}{event['text']} ({time.monotonic() - began_s:.1f} s)", flush=True)
                if self._ended(event):
                    return

    def _ended(self, event: dict[str, Any]) -> bool:
        """Whether the run is complete. Raises DemoFailed when it stopped for another reason."""
        if event["event"] != "state":
            return False
        if event["state"] == "Aborted":
            raise Aborted(event["text"])
        if event["state"] in {"Held", "Suspended", "Stopped"}:
            raise DemoFailed(f"the cell went to {event['state']}: {event['text']} (log: {self.state}/log)")
        return bool(event["state"] == "Complete")

    # -- the person at the cell --------------------------------------------------------------------------------

    async def _do(self, verb: str, **what: object) -> dict[str, Any]:
        assert self._person is not None
        reader, writer = self._person
        writer.write(json.dumps({"do": verb, **what}).encode() + b"\n")
        answer: dict[str, Any] = json.loads(await asyncio.wait_for(reader.readline(), START_WITHIN_S))
        if "error" in answer:
            raise DemoFailed(f"the simulated cell cannot {verb}: {answer['error']}")
        return answer

    # -- processes ---------------------------------------------------------------------------------------------

    @property
    def _person_socket(self) -> Path:
        return self._options.out.resolve() / "person.sock"

    @property
    def _control_socket(self) -> Path:
        return self.state / "control.sock"

    def _prepare(self) -> None:
        """A fresh folder with the cell's configuration and recipes."""
        out = self.config.parent
        shutil.rmtree(out, ignore_errors=True)
        (out / "recipes").mkdir(parents=True)
        text = (ROOT / "recipes" / f"{self._options.recipe}.toml").read_text(encoding="utf-8")
        text = hurried(text, self._options.speed)
        (out / "recipes" / f"{self._options.recipe}.toml").write_text(text, encoding="utf-8")
        single = text.replace('cameras = "both"', 'cameras = "camera_2_only"')
        (out / "recipes" / f"{self.single_recipe}.toml").write_text(single, encoding="utf-8")
        cell = (ROOT / "deploy" / "simulated-cell.toml").read_text(encoding="utf-8")
        cell = cell.replace('"127.0.0.', f'"{self._net}.').replace("tcp://127.0.0.", f"tcp://{self._net}.")
        self.config.write_text(cell.replace('"../recipes"', '"recipes"'), encoding="utf-8")

    def _simulator_options(self) -> list[str]:
        product = ROOT / "recipes" / f"{self._options.recipe}.toml"
        options = self._options
        return [
            *("--product", str(product), "--seed", str(options.seed), "--speed", str(options.speed)),
            *("--plc", f"{self._net}.1:5020", "--robot", f"{self._net}.1:10023"),
            *("--camera-1", f"{self._net}.2", "--camera-2", f"{self._net}.3"),
            *("--person", str(self._person_socket)),
        ]

    @contextlib.asynccontextmanager
    async def _process(self, name: str, socket: Path, module: str, *arguments: str) -> AsyncIterator[None]:
        """One process that listens, its output in a file; it is ended by SIGTERM and must end well."""
        output = self.config.parent / f"{module}.out"
        with output.open("wb") as file:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", module, *arguments),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=file,
                stderr=asyncio.subprocess.STDOUT,
            )
            try:
                await self._listening(process, name, socket)
                yield
            finally:
                if process.returncode is None:
                    process.terminate()
                code = await asyncio.wait_for(process.wait(), STOP_WITHIN_S)
                if code:
                    raise DemoFailed(f"the {name} ended with {code}: {_last_lines(output)}")

    @staticmethod
    async def _listening(process: asyncio.subprocess.Process, name: str, socket: Path) -> None:
        """Wait until the process listens there."""
        until_s = time.monotonic() + START_WITHIN_S
        while time.monotonic() < until_s and process.returncode is None:
            with contextlib.suppress(OSError):
                _, writer = await asyncio.open_unix_connection(socket)
                writer.close()
                return
            await asyncio.sleep(0.05)
        raise DemoFailed(f"the {name} does not listen on {socket} after {START_WITHIN_S:g} s")


def _last_lines(path: Path, count: int = 3) -> str:
    return " | ".join(path.read_text(encoding="utf-8", errors="replace").splitlines()[-count:]) or "no output"
