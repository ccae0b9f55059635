"""The command line, judged by what it prints, how it ends, and what it imports for that."""

import asyncio
import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Mapping
from pathlib import Path

import pytest

from cellctl.__main__ import main
from cellctl.control.errors import Declined
from cellctl.control.events import job_event, progress_event, state_event, unit_event
from cellctl.control.requests import CalibrateRequest, CommandRequest, Request, TeachRequest, UnitsLeftRequest
from cellctl.control.server import ControlServer
from cellctl.faults import FAULTS
from cellctl.journal import Journal, Record, Verdict
from cellctl.log import configure
from cellctl.machine import Command

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A cell.toml whose files are in a folder of this test."""
    text = (ROOT / "deploy" / "cell.toml").read_text(encoding="utf-8")
    for key, name in (("recipes", "recipes"), ("state", "state"), ("control_socket", "c.sock"), ("log", "log")):
        lines = [f'{key} = "{tmp_path}/{name}"' if line.startswith(f"{key} =") else line for line in text.splitlines()]
        text = "\n".join(lines) + "\n"
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def cellctl(config: Path, monkeypatch: pytest.MonkeyPatch):
    """Run a command line in this process; returns exit code, standard output, standard error."""
    monkeypatch.setenv("CELLCTL_CONFIG", str(config))

    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["cellctl", *arguments])
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            try:
                main()
            except SystemExit as end:
                return int(end.code or 0), out.getvalue(), err.getvalue()
        return 0, out.getvalue(), err.getvalue()

    return run


class Daemon:
    """Answers at the control socket like a cell would."""

    def __init__(self, path: Path) -> None:
        self.asked: list[Request] = []
        self.server = ControlServer(path, self.answer)

    async def answer(self, request: Request) -> Mapping[str, object]:
        self.asked.append(request)
        publish = self.server.publish
        match request:
            case CommandRequest(name="hold"):
                raise Declined("a person is teaching")
            case CommandRequest(name="start"):
                publish(state_event("Execute", 6, "Production", "start by command"))
                publish(unit_event("20261122-000001", "placed", "placed"))
                done = any(isinstance(asked, UnitsLeftRequest) for asked in self.asked)
                publish(state_event("Complete" if done else "Aborted", 17 if done else 9, "Production"))
            case CalibrateRequest():
                publish(progress_event("calibrate", "put the dot plate into its nest", asks="plate"))
                publish(job_event("calibrate", request.what == "camera-1", "hold-out error 4.1 um"))
            case TeachRequest():
                publish(state_event("Aborted", 9, "Maintenance", "guard open"))
        return {"state": "Idle", "good": 3, "recipe": None, "plc": {"linked": True}, "allowed": ["start", "abort"]}


@pytest.fixture
async def daemon(config: Path) -> AsyncIterator[Daemon]:
    log = configure(None, stream=io.StringIO())
    daemon = Daemon(config.parent / "c.sock")
    daemon.server.open()
    serving = asyncio.create_task(daemon.server.run())
    yield daemon
    serving.cancel()
    await asyncio.wait([serving])
    log.close()


# -- operating ---------------------------------------------------------------------------------------------


async def test_status_is_one_line_per_fact_or_json(cellctl, daemon: Daemon):
    code, out, err = await asyncio.to_thread(cellctl, "status")
    assert (code, err) == (0, "")
    assert out.splitlines()[0].split() == ["state", "Idle"]
    assert "plc linked  yes" in out
    assert "allowed     start, abort" in out

    code, out, err = await asyncio.to_thread(cellctl, "status", "--json")
    assert json.loads(out)["good"] == 3


@pytest.mark.parametrize("command", [command.title for command in Command if command.title != "hold"])
async def test_every_command_of_the_machine_can_be_given(cellctl, daemon: Daemon, command: str):
    code, out, err = await asyncio.to_thread(cellctl, command)
    assert (code, err) == (0, "")
    assert out
    (asked,) = daemon.asked
    assert isinstance(asked, CommandRequest)
    assert asked.name == command


async def test_a_refusal_is_one_sentence_and_exit_code_1(cellctl, daemon: Daemon):
    assert await asyncio.to_thread(cellctl, "hold") == (1, "", "a person is teaching\n")


def test_without_a_daemon_the_exit_code_is_69_and_the_remedy_is_said(cellctl):
    code, out, err = cellctl("status")
    assert (code, out) == (69, "")
    assert err.startswith("the daemon does not run: nobody listens on ")
    assert "systemctl start cellctl" in err
    assert len(err.splitlines()) == 1


async def test_start_tells_the_run_length_first(cellctl, daemon: Daemon):
    code, _, _ = await asyncio.to_thread(cellctl, "start", "--units", "5")
    assert code == 0
    assert [type(asked).__name__ for asked in daemon.asked] == ["UnitsLeftRequest", "CommandRequest"]


async def test_start_and_wait_shows_the_run_and_ends_with_its_result(cellctl, daemon: Daemon):
    code, out, _ = await asyncio.to_thread(cellctl, "start", "--wait")
    assert code == 1  # this run was aborted
    assert out.splitlines() == ["Execute start by command", "20261122-000001 placed placed", "Aborted"]
    code, out, _ = await asyncio.to_thread(cellctl, "start", "--wait", "--units", "1", "--json")
    assert code == 0
    assert [json.loads(line)["event"] for line in out.splitlines()] == ["state", "unit", "state"]


async def test_a_calibration_shows_what_to_do_and_ends_with_its_result(cellctl, daemon: Daemon):
    code, out, err = await asyncio.to_thread(cellctl, "calibrate", "camera-1")
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        "calibrate put the dot plate into its nest",
        "  when it is done: cellctl proceed",
        "calibrate done: hold-out error 4.1 um",
    ]
    code, out, _ = await asyncio.to_thread(cellctl, "calibrate", "camera-2")
    assert code == 1
    assert "calibrate failed:" in out


async def test_other_requests_reach_the_daemon_as_they_were_meant(cellctl, daemon: Daemon):
    assert (await asyncio.to_thread(cellctl, "mode", "maintenance"))[0] == 0
    assert (await asyncio.to_thread(cellctl, "recipe", "use", "x85"))[0] == 0
    assert (await asyncio.to_thread(cellctl, "proceed"))[0] == 0
    assert (await asyncio.to_thread(cellctl, "calibrate", "temperature", "23.5"))[0] == 0
    assert (await asyncio.to_thread(cellctl, "calibrate", "accept", "camera-1"))[0] == 0
    assert (await asyncio.to_thread(cellctl, "calibrate", "accept", "camera-2", "0123456789ab"))[0] == 0
    assert (await asyncio.to_thread(cellctl, "calibrate", "revert", "camera-2"))[0] == 0
    assert (await asyncio.to_thread(cellctl, "teach", "--repeats", "7", "--pairs", "3"))[0] == 1  # aborted: guard open
    assert [asked.model_dump(exclude={"version"}) for asked in daemon.asked if asked.verb != "status"] == [
        {"verb": "mode", "name": "maintenance"},
        {"verb": "recipe_use", "name": "x85"},
        {"verb": "proceed"},
        {"verb": "temperature", "celsius": 23.5},
        {"verb": "calibration_use", "camera": "camera-1", "what": "accept", "calibration": None},
        {"verb": "calibration_use", "camera": "camera-2", "what": "accept", "calibration": "0123456789ab"},
        {"verb": "calibration_use", "camera": "camera-2", "what": "revert", "calibration": None},
        {"verb": "teach", "repeats": 7, "pairs": 3},
    ]


# -- settings ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["status", "run", "units", "log"])
def test_a_wrong_configuration_is_exit_code_78_with_place_and_value(cellctl, config: Path, command: str):
    config.write_text(config.read_text().replace("port = 502", "port = 99999"))
    code, out, err = cellctl(command)
    assert (code, out) == (78, "")
    assert f"{config}:" in err
    assert "99999" in err
    assert "Traceback" not in err


def test_a_missing_configuration_is_named(cellctl):
    code, _, err = cellctl("status", "--config", "/nowhere/cell.toml")
    assert code == 78
    assert "/nowhere/cell.toml" in err


def test_recipes_are_checked_one_by_one(cellctl, tmp_path: Path):
    good = ROOT / "recipes" / "x85.toml"
    bad = tmp_path / "bad.toml"
    bad.write_text(good.read_text().replace("schema_version = 1", "schema_version = 7"))
    code, out, _ = cellctl("recipe", "check", str(good), str(bad))
    assert code == 78
    assert out.splitlines()[0] == f"{good}: ok"
    assert out.splitlines()[1].startswith(f"{bad}:")

    code, out, _ = cellctl("recipe", "check", "--json", str(good))
    assert (code, json.loads(out)) == (0, {str(good): []})


def test_the_recipes_of_the_cell_are_listed(cellctl, config: Path):
    folder = config.parent / "recipes"
    folder.mkdir()
    assert cellctl("recipe", "list")[:2] == (0, f"no recipes in {folder}\n")
    for name in ("b.toml", "a.toml", "notes.txt"):
        (folder / name).touch()
    assert cellctl("recipe", "list")[:2] == (0, "a\nb\n")
    assert cellctl("recipe", "list", "--json")[:2] == (0, '["a", "b"]\n')


# -- looking back ------------------------------------------------------------------------------------------


async def write_units(folder: Path) -> None:
    journal = await Journal.open(folder / "journal.db")
    for fault in (None, "V1"):
        unit = await journal.begin_unit(
            recipe="x85", recipe_hash="f", arrival_sequence=1, carrier_id=2, calibration_ids={}
        )
        verdict = Verdict.REJECTED if fault else Verdict.PLACED
        await journal.finish_unit(unit, Record(verdict=verdict, sentence="s", fault=fault, cycle_s=5.0))
    await journal.close()


def test_units_are_shown_filtered_and_exported(cellctl, config: Path):
    assert cellctl("units")[0] == 1  # no journal yet
    (config.parent / "state").mkdir()
    asyncio.run(write_units(config.parent / "state"))
    code, out, _ = cellctl("units")
    assert code == 0
    assert len(out.splitlines()) == 3
    assert "V1" in cellctl("units", "--verdict", "rejected")[1]
    assert [json.loads(line)["fault"] for line in cellctl("units", "--json", "--last", "1")[1].splitlines()] == ["V1"]
    assert cellctl("units", "--csv", "--fault", "V1")[1].count("rejected") == 1
    assert cellctl("units", "--verdict", "eaten")[0] == 2


def test_the_log_is_shown(cellctl, config: Path):
    code, _, err = cellctl("log")
    assert code == 1
    assert "there is no log file" in err
    folder = config.parent / "log"
    folder.mkdir()
    event = {"time": "2026-11-22T14:03:07.412+00:00", "level": "warning", "event": "battery lost", "remedy": "Look."}
    (folder / "cellctl.jsonl").write_text(json.dumps(event) + "\n")
    assert "WARNING battery lost -> Look." in cellctl("log", "--lines", "5")[1]
    assert json.loads(cellctl("log", "--json")[1]) == event


def test_the_table_of_faults_is_printed(cellctl):
    code, out, _ = cellctl("faults")
    assert code == 0
    for row in FAULTS.values():
        assert f"{row.code}  {row.reaction.value:<8} {row.remedy}" in out
    rows = [json.loads(line) for line in cellctl("faults", "--json")[1].splitlines()]
    assert {row["code"] for row in rows} == {row.code for row in FAULTS.values()} | {"X1"}


# -- the program itself ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [["dance"], ["start", "--units", "-1"], ["recipe", "check"], ["units", "--last", "0"], ["mode", "party"]],
)
def test_wrong_usage_is_exit_code_2(cellctl, arguments: list[str]):
    code, out, err = cellctl(*arguments)
    assert (code, out) == (2, "")
    assert "Usage:" in err


def test_the_help_names_every_command_and_the_exit_codes(cellctl):
    code, out, _ = cellctl("--help")
    assert code == 0
    names = "run status start stop hold unhold suspend unsuspend abort clear reset complete mode log recipe calibrate"
    for name in f"{names} teach units check simulate demo proceed faults".split():
        assert f"\n  {name} " in out
    assert "Exit codes: 0 ok, 1 refused or failed, 2 wrong usage, 69 the daemon is not reachable, 78" in out


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """As for an installed program: compiled files are kept, and no configuration is set."""
    kept = {key: value for key, value in os.environ.items() if key not in ("PYTHONDONTWRITEBYTECODE", "CELLCTL_CONFIG")}
    return kept | {"PYTHONPYCACHEPREFIX": str(tmp_path_factory.mktemp("compiled"))}


def fresh(environment: Mapping[str, str], *arguments: str) -> tuple[str, set[str]]:
    """What a fresh interpreter prints for a command line, and the modules it has imported by then."""
    code = (
        "import sys, atexit, runpy\n"
        "atexit.register(lambda: sys.stderr.write('\\n'.join(sorted(sys.modules))))\n"
        f"sys.argv = {['cellctl', *arguments]!r}\n"
        "runpy.run_module('cellctl', run_name='__main__')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, timeout=30, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout, set(done.stderr.splitlines())


def test_help_imports_only_click_and_the_standard_library(environment):
    out, modules = fresh(environment, "--help")
    assert "Run and operate an assembly cell" in out
    assert modules.isdisjoint({"cv2", "numpy", "scipy", "pydantic", "structlog", "asyncio", "sqlite3", "pymodbus"})
    ours = {name for name in modules if name.startswith(("cellctl.", "drivers", "simulators"))}
    assert {name for name in ours if not name.startswith("cellctl.cli")} <= {"cellctl.__main__"}


def test_checking_a_recipe_imports_no_vision_and_no_devices(environment):
    out, modules = fresh(environment, "recipe", "check", "recipes/x85.toml")
    assert out == "recipes/x85.toml: ok\n"
    assert modules.isdisjoint({"cv2", "scipy", "numpy", "structlog", "asyncio", "pymodbus", "serial"})


def test_the_command_line_never_imports_the_simulators():
    source = "".join(path.read_text() for path in (ROOT / "cellctl").rglob("*.py"))
    assert "import simulators" not in source
    assert "from simulators" not in source


def cpu_ms(environment: Mapping[str, str], *arguments: str) -> float:
    """Processor time of one run of the interpreter."""
    with subprocess.Popen(
        [sys.executable, *arguments], cwd=ROOT, env=environment, stdout=subprocess.DEVNULL
    ) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = status
    assert status == 0
    return (used.ru_utime + used.ru_stime) * 1000


@pytest.mark.parametrize(("arguments", "most"), [(["--help"], 11), (["recipe", "check", "recipes/x85.toml"], 23)])
def test_the_command_line_answers_at_once(environment, arguments: list[str], most: float):
    """In multiples of a bare interpreter beside it (13 ms on a quiet machine: 150 and 300 ms), however busy it is."""
    cpu_ms(environment, "-m", "cellctl", *arguments)  # compiles
    bare_ms, took_ms = [], []
    while not took_ms or (min(took_ms) >= most * min(bare_ms) and len(took_ms) < 12):
        bare_ms.append(cpu_ms(environment, "-c", "pass"))
        took_ms.append(cpu_ms(environment, "-m", "cellctl", *arguments))
    assert min(took_ms) < most * min(bare_ms)


def test_simulate_hands_over_to_the_simulators(environment):
    command = [sys.executable, "-m", "cellctl", "simulate", "--help"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, timeout=30, text=True, check=True)
    assert "--person" in done.stdout


def test_a_reader_that_goes_away_is_no_error_worth_a_traceback(environment):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "cellctl", "faults"]
    with subprocess.Popen(command, cwd=ROOT, env=environment, stdout=write, stderr=subprocess.PIPE) as process:
        os.close(write)
        _, complaint = process.communicate(timeout=30)
    assert (process.returncode, complaint) == (1, b"")
