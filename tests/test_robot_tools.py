"""`cellctl robot`: what a controller tells, keeps and gets back, and how long its arm takes."""

import asyncio
import io
import json
import os
import re
import socket
from contextlib import contextmanager
from pathlib import Path
from queue import Queue
from threading import Event, Thread

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import drivers.conversation
from cellctl.config import load_config
from cellctl.desk.robot_backup import KINDS, Backup, text_of
from cellctl.desk.robot_restore import differences
from cellctl.recipe import load_recipe
from cellctl.strict_toml import load
from tests.arm_times import moved, predicted, ways_of
from tests.command_line import run
from tests.robot_bench import controller_on

ROOT = Path(__file__).parents[1]
POINTS = ("P1=250.000 50.000 10.000 0.000 0.000 0.000 1 0 0", "P20=1 2 3 4 0 0")
PROGRAM = ("NAME=PICK", "MOVE P,P1", "HALT")


@pytest.fixture(autouse=True)
def short_silences(monkeypatch):
    """A file has ended after its END and a silence; on loopback a short one will do."""
    monkeypatch.setattr(drivers.conversation, "SILENCE_S", 0.03)


@contextmanager
def controller(**settings):
    """A controller on a loop of its own, beside the commands that are tested; its address."""
    serving, done = Queue(), Event()

    async def serve():
        async with controller_on(speed=20, **settings) as (_, served):
            serving.put(served.port)
            await asyncio.to_thread(done.wait)

    thread = Thread(target=asyncio.run, args=(serve(),))
    thread.start()
    try:
        yield f"tcp://127.0.0.1:{serving.get(timeout=5)}"
    finally:
        done.set()
        thread.join()


def say(address, *lines):
    """Lines to a controller as any client sends them, each answered."""
    host, port = address.removeprefix("tcp://").split(":")
    with socket.create_connection((host, int(port)), timeout=5) as connection, connection.makefile("rw") as wire:
        for line in lines:
            wire.write(f"{line}\r\n")
            wire.flush()
            while line and line[0] == "@" and wire.readline().strip() not in ("OK", "READY"):
                pass
        if not lines[-1]:
            assert wire.readline().strip() == "OK"


def filled(address):
    say(address, *(f"@{point}" for point in POINTS), "@S1=1.0 2.0 3.0 4.0", "@H1=0.0 50.0 10.0 R", "@SGI1=5")
    say(address, "@WRITE <PICK>", *PROGRAM, "")


@contextmanager
def cell_at(folder, address):
    """A cell.toml for a robot at an address."""
    text = (ROOT / "deploy/simulated-cell.toml").read_text()
    text = re.sub(r'(\[robot\].*?\naddress = )"[^"]*"', rf'\1"{address}"', text, count=1, flags=re.DOTALL)
    path = folder / "cell.toml"
    path.write_text(text.replace("../recipes", str(ROOT / "recipes")).replace("../build", str(folder)))
    yield path


# -- what it tells and keeps ---------------------------------------------------------------------------------


@pytest.mark.parametrize(("dialect", "version"), [("rcx3", "RCX340 V1.20,R0000"), ("rcx2", "V8.02")])
def test_a_controller_tells_who_and_how_it_is(dialect, version):
    with controller(dialect=dialect) as address:
        told = run("robot", "info", "--address", address, "--dialect", dialect, "--json")
        shown = run("robot", "info", "--address", address, "--dialect", dialect)
    facts = json.loads(told.out)
    assert facts["controller"]["version"].startswith(version)
    assert facts["state"]["mode"] == "automatic"
    assert facts["position"]["x_mm"] == 250
    assert facts["settings"]["ACCEL"] == "100 100 100 100"
    assert re.search(r"^  z_mm            0\.000$", shown.out, re.MULTILINE)
    assert "control power switched on" in shown.out or dialect == "rcx2"
    assert told.code == shown.code == 0


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
def test_what_a_controller_keeps_comes_back_into_an_empty_one(tmp_path, dialect):
    file, which = tmp_path / "robot.toml", ("--dialect", dialect)
    with controller(dialect=dialect) as address:
        filled(address) if dialect == "rcx3" else say_old(address)
        kept = run("robot", "backup", file, "--address", address, *which)
    counts = "2 points, 1 hands, 1 shifts, 0 pallets, 1 variables, 45 parameters, 1 programs"
    assert kept == (0, f"{file}: {counts}\n", "")
    with controller(dialect=dialect) as address:
        put = json.loads(run("robot", "restore", file, "--address", address, *which, "--yes", "--json").out)
    names = [(entry["kind"], entry["name"]) for entry in put["written"]]
    points, frames = [("points", "P1"), ("points", "P20")], [("hands", "H1"), ("shifts", "S1")]
    assert names == [*points, *frames, ("variables", "SGI1"), ("programs", "PICK")]
    assert put["failed"] == put["left"] == []


def say_old(address):
    """The same into a controller of the older generation, which answers everything by one OK."""
    points = ("@P1=250.00 50.00 10.00 0.00 0.00 0.00", "@P20=1 2 3 4 0 0")
    say(address, *points, "@S1=1.0 2.0 3.0 4.0", "@H1=0.0 50.0 10.0 R", "@SGI1=5")
    say(address, "@WRITE PGM", *PROGRAM, "")


def test_a_restore_asks_first_keeps_what_only_the_controller_has_and_sets_no_parameter(tmp_path, monkeypatch):
    file = tmp_path / "robot.toml"
    with controller() as address:
        filled(address)
        assert run("robot", "backup", file, "--address", address).code == 0
        say(address, "@P1=251.0 50.0 10.0 0.0 0.0 0.0", "@P5=1 2 3 4 0 0", "@ASPEED 50")
        monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
        asked = run("robot", "restore", file, "--address", address)
        assert re.search(r"^points  P1 +250\.000 50\.000.* +251\.000 50\.000", asked.out, re.MULTILINE)
        assert asked.code != 0
        put = json.loads(run("robot", "restore", file, "--address", address, "--yes", "--json").out)
        assert [entry["name"] for entry in put["written"]] == ["P1"]
        assert [(entry["kind"], entry["name"]) for entry in put["left"]] == [("points", "P5")]
        assert put["failed"] == []
        shown = run("robot", "diff", file, "--address", address)
        assert re.search(r"^points  P5 +- +1 2 3 4", shown.out, re.MULTILINE)


def test_a_file_of_another_controller_is_refused_unless_that_is_meant(tmp_path):
    file = tmp_path / "robot.toml"
    with controller() as address:
        filled(address)
        run("robot", "backup", file, "--address", address)
    with controller(config="YK500XG") as address:
        refused = run("robot", "restore", file, "--address", address, "--yes")
        assert "is of another controller (configuration 'YK400XG' against 'YK500XG'): say --other" in refused.err
        assert refused.code == 1
        assert run("robot", "diff", file, "--address", address).code == 1
        assert run("robot", "restore", file, "--address", address, "--yes", "--other").code == 0
    with controller(dialect="rcx2") as address:
        refused = run("robot", "restore", file, "--address", address, "--dialect", "rcx2", "--yes", "--other")
        assert "is of an rcx3 controller, this is an rcx2: not restored" in refused.err


def test_a_program_that_no_line_can_carry_is_told_and_the_rest_is_written(tmp_path):
    file, programs = tmp_path / "robot.toml", {"A": ["NAME=A", "HALT"], "B": ["NAME=B", "", "HALT"]}
    identity = {"dialect": "rcx3", "version": "", "configuration": "YK400XG", "serial": ""}
    file.write_text(
        text_of(a_backup(points=["P01 = 250.0 50 10 0 0 0", POINTS[1]], programs=programs, controller=identity))
    )
    with controller() as address:
        put = run("robot", "restore", file, "--address", address, "--yes")
        assert "Error: line 2, '', is no line of a file" in put.err
        assert "see `cellctl robot diff`" in put.err
        assert put.code == 1
        left = json.loads(run("robot", "diff", file, "--address", address, "--json").out)["differences"]
        assert [entry["name"] for entry in left if entry["kind"] in ("points", "programs")] == ["B"]


def test_a_backup_replaces_no_file_unasked_and_leaves_none_half_written(tmp_path):
    file = tmp_path / "robot.toml"
    file.write_text("mine")
    refused = run("robot", "backup", file, "--address", "tcp://127.0.0.1:1")
    assert refused == (1, "", f"Error: {file} exists: choose another name, or --force to replace it\n")
    lost = run("robot", "backup", file, "--force", "--address", "tcp://127.0.0.1:1")
    assert "no connection to tcp://127.0.0.1:1" in lost.err
    assert lost.code == 1
    assert file.read_text() == "mine"
    assert os.listdir(tmp_path) == ["robot.toml"]


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (('"P1=250', '"Q1=250'), r":4:10: points: 'Q1=250.* is no point"),
        (('"P20=1 2', '"P1=1 2'), r": points: says P1 twice"),
        (("schema_version = 1", "schema_version = 2"), r":1:18: schema_version: "),
        (('dialect = "rcx3"', 'dialect = "rcx9"'), r"controller\.dialect"),
        (('made_at = "', 'made_at = "yesterday '), r"made_at: must be a date and time"),
    ],
)
def test_a_mistake_in_a_backup_is_named_with_its_place(tmp_path, change, complaint):
    file = tmp_path / "robot.toml"
    file.write_text(text_of(a_backup(points=list(POINTS))).replace(*change))
    refused = run("robot", "diff", file, "--address", "tcp://127.0.0.1:1")
    assert re.search(complaint, refused.err)
    assert refused.code == 78


def a_backup(**changed):
    identity = {"dialect": "rcx3", "version": "V1", "configuration": "YK400XG", "serial": ""}
    empty = {kind: [] for kind in KINDS}
    told = {"schema_version": 1, "made_at": "2026-01-02T03:04:05+00:00", "controller": identity, "programs": {}}
    return Backup.model_validate({**told, **empty, **changed})


TEXT = st.text(st.characters(min_codepoint=1, max_codepoint=255), max_size=40)


@settings(deadline=None, max_examples=50)
@given(st.lists(TEXT), st.dictionaries(st.from_regex(r"[A-Z0-9_]{1,32}", fullmatch=True), st.lists(TEXT)), TEXT)
def test_whatever_a_controller_tells_is_read_back_from_the_file_as_it_was(tmp_path_factory, lines, programs, version):
    identity = {"dialect": "rcx2", "version": version, "configuration": "", "serial": "A-1"}
    backup = a_backup(variables=lines, parameters=lines, programs=programs, controller=identity)
    file = tmp_path_factory.mktemp("backups") / "robot.toml"
    file.write_text(text_of(backup), encoding="utf-8", newline="")
    assert load(file, Backup) == backup
    assert differences(backup, load(file, Backup)) == []


# -- whose robot it is ---------------------------------------------------------------------------------------


def test_a_robot_that_the_daemon_owns_is_left_alone(tmp_path):
    with socket.socket(socket.AF_UNIX) as daemon, cell_at(tmp_path, "tcp://127.0.0.1:1") as cell:
        path = load_config(cell).paths.control_socket
        path.parent.mkdir(parents=True)
        daemon.bind(str(path))
        daemon.listen()
        for command in (["info"], ["backup", tmp_path / "x"], ["time", "x85", "--yes"]):
            refused = run("robot", *command, "--config", cell)
            assert refused.err.startswith("Error: the daemon runs and owns the robot: stop it first")
            assert refused.code == 1


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--address", "somewhere"], "--address: 'somewhere' is no link address"),
        (["--config", "nowhere.toml"], "nowhere.toml"),
        (["--config", ROOT / "deploy/cell.toml", "--dialect", "rcx2"], "--dialect goes with --address"),
    ],
)
def test_a_robot_that_cannot_be_found_is_told(arguments, complaint):
    refused = run("robot", "info", *arguments)
    assert complaint in refused.err
    assert refused.code != 0


# -- how long it takes ---------------------------------------------------------------------------------------


def test_times_are_predicted_without_a_robot(tmp_path):
    with cell_at(tmp_path, "tcp://127.0.0.1:1") as cell:
        shown = run("robot", "time", "x85", "--predict", "--config", cell)
        facts = json.loads(run("robot", "time", "x85", "--predict", "--config", cell, "--json").out)
    assert shown.code == 0
    assert "places as drawn, for it has not been taught" in shown.out
    rows = {row["name"]: row["predicted_s"] for row in facts["stretches"]}
    assert rows["arm in all"] == pytest.approx(sum(rows.values()) / 2)
    assert 0.5 < rows["arm in all"] < 2


def test_the_arm_moves_only_when_a_person_says_so(tmp_path, monkeypatch):
    with controller() as address, cell_at(tmp_path, address) as cell:
        monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
        asked = run("robot", "time", "x85", "--config", cell)
        assert "the way is free? [y/N]" in asked.out
        assert asked.code == 130
        state = json.loads(run("robot", "info", "--config", cell, "--json").out)
        assert (state["position"]["x_mm"], state["state"]["motor power"]) == (250, "off")
        assert state["controller"]["serial"] == "SIM-ROBOT"
        refused = run("robot", "time", "x85", "--config", cell, "--json")
        assert "--json asks nothing, so say --yes as well, or --predict" in refused.err
        timed = json.loads(run("robot", "time", "x85", "--config", cell, "--json", "--yes").out)
    assert timed["exchange_ms"] > 0
    assert all(row["measured_s"] > 0 for row in timed["stretches"])
    assert [row["name"] for row in timed["stretches"]][-1] == "arm in all"


@pytest.mark.parametrize("dialect", ["rcx3", "rcx2"])
async def test_the_arm_takes_as_long_as_predicted_for_every_stretch(tmp_path, dialect):
    async with controller_on(speed=5, dialect=dialect) as (_, controller):
        with cell_at(tmp_path, f"tcp://127.0.0.1:{controller.port}") as cell:
            config = load_config(cell)
        config = config.model_copy(update={"robot": config.robot.model_copy(update={"dialect": dialect})})
        ways = ways_of(config, load_recipe(config.paths.recipes, "x85"))
        times, arm_s = await moved(config, ways, controller.log)
    assert [row.name for row in times.rows] == [way.name for way in ways]
    assert all(row.measured_s > 0 for row in times.rows)
    assert arm_s == pytest.approx(predicted(config, ways), rel=0.05)


def test_the_way_down_is_slow_only_where_it_must_be():
    """What the last stretch saves of the arm's time in a unit."""
    config = load_config(ROOT / "deploy/simulated-cell.toml")
    recipe = load_recipe(config.paths.recipes, "x85")
    slow = recipe.model_copy(update={"motion": recipe.motion.model_copy(update={"touch_mm": None})})
    quick_s, slow_s = (sum(predicted(config, ways_of(config, each))) for each in (recipe, slow))
    assert quick_s / slow_s == pytest.approx(0.83, abs=0.01)
