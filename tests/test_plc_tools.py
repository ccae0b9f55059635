"""`cellctl plc watch` and `plc check` against the simulated PLC, good ones and bad ones; judged by what truly moved."""

import asyncio
import io
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from cellctl.control.plc_report import report
from cellctl.control.requests import BadRequest, PlcRequest, Request, parse_request
from cellctl.control.server import ControlServer
from cellctl.desk import plc_points as points
from cellctl.desk.plc_player import Player
from cellctl.desk.plc_watch import DirectReader
from cellctl.log import configure
from drivers.errors import DeviceError
from drivers.plc import Plc
from drivers.plc_layout import Layout, PlcAddress
from drivers.plc_probe import PlcProbe
from simulators.plc import PlcServer
from tests.command_line import Ended, run
from tests.plc_belt import powered, running, write_record
from tests.test_plc_wire import brand

CELL = Path(__file__).parent.parent / "deploy" / "cell.toml"
Memory = dict[int, int]


@pytest.fixture
def cellctl(tmp_path: Path) -> Callable[..., Any]:
    """Run `cellctl plc ...` for a PLC at a port of loopback, in a thread of its own."""

    async def command(port: int, *arguments: str) -> Ended:
        text = CELL.read_text(encoding="utf-8")
        replaced = (
            ('host = "192.168.10.10"', 'host = "127.0.0.1"'),
            ("port = 502\n", f"port = {port}\n"),
            ('"/run/cellctl/control.sock"', f'"{tmp_path}/c.sock"'),
        )
        for old, new in replaced:
            assert old in text
            text = text.replace(old, new)
        (tmp_path / "cell.toml").write_text(text, encoding="utf-8")
        return await asyncio.to_thread(run, "plc", *arguments, "--config", tmp_path / "cell.toml")

    return command


# -- check -------------------------------------------------------------------------------------------------------


async def test_a_good_plc_passes_every_point_and_everything_comes_to_rest(cellctl: Callable[..., Any]) -> None:
    async with powered(speed=1.0) as (world, server):
        ended = await cellctl(server.port, "check", "--move", "--yes", "--json")
        *found, total = map(json.loads, ended.out.splitlines())

        assert [point["point"] for point in found if point["verdict"] != "passed"] == []
        assert total == {"passed": 28, "failed": 0, "not tried": 0}
        assert ended.code == 0
        assert world.left == [(501, True)]
        assert world.valve_changes == [True, False]
        await asyncio.sleep(0.6)
        assert not world.conveyor_moving()
        assert not world.robot_enable


async def test_without_move_nothing_moves_and_the_text_says_what_was_sent_and_came(cellctl: Callable[..., Any]) -> None:
    async with powered(speed=1.0) as (world, server):
        ended = await cellctl(server.port, "check")

        assert ended.code == 3
        assert "not tried  the time since an arrival counts milliseconds" in ended.out
        assert "21 passed, 0 failed, 1 not tried" in ended.out
        assert "sent   3 command sequence = 1, 4 command = 99 unknown\n" in ended.out
        assert "came   107 command accepted = 1, 108 command finished = 1, 109 result = 2 unknown\n" in ended.out
        assert (world.belt_starts, world.valve_changes, world.brought) == (0, [], 0)


async def test_a_plc_that_serves_somebody_is_only_read(cellctl: Callable[..., Any]) -> None:
    async with powered() as (_, server), running(Plc("127.0.0.1", server.port)) as plc:
        await plc.ready(within_s=2)
        sessions = write_record(server)
        ended = await cellctl(server.port, "check", "--json")

        *_, last, total = map(json.loads, ended.out.splitlines())
        assert (last["point"], last["verdict"]) == ("no other client is served", "not tried")
        assert "systemctl stop cellctl" in last["remedy"]
        assert (ended.code, total["failed"]) == (3, 0)
        assert sessions == {plc.image.session}


async def test_motion_is_asked_for_and_no_means_no(
    cellctl: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    async with powered() as (world, server):
        monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
        ended = await cellctl(server.port, "check", "--move")

        assert "Is everybody clear of it?" in ended.err
        assert (ended.code, ended.out, server.memory[1], world.belt_starts) == (130, "", 0, 0)


async def test_no_plc_is_a_sentence_and_an_exit_code(cellctl: Callable[..., Any]) -> None:
    async with powered() as (_, server):
        port = server.port
    for arguments in (("check", "--json"), ("watch", "--once")):
        ended = await cellctl(port, *arguments)
        assert (ended.code, ended.out) == (1, "")
        assert f"no connection to 127.0.0.1:{port}" in ended.err


@asynccontextmanager
async def player(server: PlcServer, *, exchange: Any = "fc23", layout: Layout | None = None) -> AsyncIterator[Player]:
    """Somebody who plays cellctl to this PLC."""
    probe = PlcProbe(PlcAddress("127.0.0.1", server.port, 1, exchange, layout or Layout()))
    await probe.open()
    try:
        yield Player(probe)
    finally:
        probe.close()


def lying(server: PlcServer, lie: Callable[[Memory], None]) -> None:
    """From now on the PLC shows something else than its program has found."""
    bank = server.modbus.bank
    scan = bank.before_read

    def show(*block: Any) -> None:
        scan(*block)
        lie(server.memory)

    bank.before_read = show


def words_turned(memory: Memory) -> None:
    memory.update({110: 1, 111: memory[100], 112: 0})  # counts, but in the high word


@pytest.mark.parametrize(
    ("lie", "point", "came", "remedy"),
    [
        (lambda m: m.update({101: 0x0200}), points.map_version, "101 map version = 0x0200", "load the PLC program"),
        (lambda m: m.update({101: 0x0001}), points.map_version, "= 0x0001", "change byte_order"),
        (
            lambda m: m.update({101: 17, 102: 0x0100}),
            points.map_version,
            "0x0011",
            "make plc_registers_at in [plc] one more",
        ),
        (lambda m: m.update({100: 7}), points.heartbeat_runs, "7, then 7", "put the PLC into RUN"),
        (lambda m: m.update({103: 9}), points.state_is_known, "9 unknown", "register 103 may be 0..5"),
        (lambda m: m.update({125: 7}), points.reserved_is_zero, "125 = 0x0007", "write 0"),
        (lambda m: m.update({105: 0x1000}), points.reserved_is_zero, "105 = 0x1000", "shifted"),
        (lambda m: m.update({116: 2000}), points.cycle_is_fast, "200.0 ms", "below 100 ms"),
        (words_turned, points.arrival_age_counts, "more after", "change word_order"),
        (lambda m: m.update({102: 0}), points.session_is_served, "0x0000", "serve the first live session"),
        (lambda m: m.update({103: 3}), points.state_follows_client, "client silent", "show ready"),
        (lambda m: m.update({104: 7}), points.enable_follows_client, "air pressure", "enable the robot"),
        (lambda m: m.update({109: 0}), points.unknown_command_is_refused, "0 ok", "result 2"),
        (lambda m: m.update({109: 2}), points.new_number_is_executed, "2 unknown", "result 0"),
        (lambda m: m.update({107: 1, 108: 1}), points.lower_number_is_new, "= 1", "is a new one"),
        (lambda m: m.update({109: 2}), points.second_client_is_refused, "2 unknown", "serve one session"),
        (lambda m: m.update({104: 15}), points.silence_drops_enable, "robot enable", "drop the enable"),
        (lambda m: m.update({102: 5}), points.silence_frees_session, "0x0005", "show 0 in 102"),
        (lambda m: m.update({106: 8}), points.latches_are_reset, "latched = robot enable", "clear 106"),
    ],
)
async def test_a_plc_that_breaks_the_contract_fails_that_point(
    lie: Callable[[Memory], None], point: Callable[[Player], Any], came: str, remedy: str
) -> None:
    async with powered(speed=1.0) as (_, server), player(server) as client:
        if point not in {each.attempt for each in points.READING}:
            await points.exchange_works(client)
            assert (await points.session_is_served(client)).passed
        lying(server, lie)

        found = await point(client)

        assert found.passed is False
        assert came in found.came
        assert remedy in found.remedy


async def test_a_command_that_is_executed_twice_is_found() -> None:
    async with powered(speed=1.0) as (_, server), player(server) as client:
        await points.exchange_works(client)
        await points.session_is_served(client)
        await points.unknown_command_is_refused(client)
        lying(server, lambda memory: memory.update({109: 0 if memory[4] == 4 else memory[109]}))

        found = await points.same_number_is_not_executed(client)

        assert found.passed is False
        assert "4 command = 4 stop conveyor" in found.sent


async def test_the_probe_speaks_to_every_brand_as_it_is_configured() -> None:
    offered = {"cell_at": 40, "plc_at": 0, "inputs": True, "bytes_turned": True, "long_turned": True}
    layout = Layout(40, 0, low_byte_first=True, low_word_first=True)
    async with brand(**offered) as (_, server), player(server, exchange="fc4+fc16", layout=layout) as client:
        for point in (*points.READING, *points.SERVED[:4]):
            assert (await point.attempt(client)).passed, point.title


# -- watch -------------------------------------------------------------------------------------------------------


async def test_watching_shows_the_map_and_writes_nothing(cellctl: Callable[..., Any]) -> None:
    async with powered() as (_, server), running(Plc("127.0.0.1", server.port)) as plc:
        await plc.vacuum(True, within_s=2)
        sessions = write_record(server)
        ended = await cellctl(server.port, "watch", "--once")

        lines = {line[:4].strip(): line for line in ended.out.splitlines()}
        assert f"PLC at 127.0.0.1:{server.port}, unit 1" in ended.out
        assert f"{plc.image.session:#06x}" in lines["1"]
        assert "vacuum" in lines["6"]
        assert "1 ready" in lines["103"]
        assert "carrier clamped" not in lines["105"]
        assert sessions == {plc.image.session}
        assert plc.image.session == server.memory[102]


async def test_watching_for_programs_gives_values_with_units_and_ages(cellctl: Callable[..., Any]) -> None:
    async with powered() as (_, server):
        ended = await cellctl(server.port, "watch", "--once", "--json")
        shown = json.loads(ended.out)

        vacuum = next(value for value in shown["values"] if value["name"] == "vacuum")
        assert (vacuum["address"], vacuum["value"], vacuum["unit"]) == (115, 0.0, "kPa")
        assert 0 <= vacuum["age_ms"] < 500
        inputs = next(value for value in shown["values"] if value["name"] == "inputs")
        assert inputs["value"]["battery on table"] is True


async def test_the_packets_on_the_wire_are_shown_on_demand(cellctl: Callable[..., Any]) -> None:
    async with powered() as (_, server):
        ended = await cellctl(server.port, "watch", "--once", "--wire")

        asked, answered = ended.out.splitlines()[:2]
        assert asked.endswith("00 00 00 06 01 03 00 00 00 10   FC3 reading registers 0..15")
        assert " < " in answered
        assert len(ended.out.splitlines()) == 4


async def test_the_daemon_is_asked_when_it_runs_and_the_plc_is_left_alone(
    cellctl: Callable[..., Any], tmp_path: Path
) -> None:
    async with powered() as (_, server), running(Plc("127.0.0.1", server.port)) as plc:
        await plc.ready(within_s=2)

        async def answer(request: Request) -> dict[str, object]:
            assert isinstance(request, PlcRequest)
            return report(plc.seen(), request.packets)

        log = configure(None, stream=io.StringIO())
        control = ControlServer(tmp_path / "c.sock", answer)
        control.open()
        serving = asyncio.create_task(control.run())
        try:
            shown = json.loads((await cellctl(server.port, "watch", "--once", "--json")).out)
            wire = (await cellctl(server.port, "watch", "--once", "--wire")).out
            direct = json.loads((await cellctl(server.port, "watch", "--once", "--json", "--direct")).out)
        finally:
            serving.cancel()
            await asyncio.wait([serving])
            control.close()
            log.close()

        assert shown["source"] == "daemon"
        assert direct["source"] == f"PLC at 127.0.0.1:{server.port}, unit 1"
        assert "FC23 reading registers 100..131 and writing registers 0..15" in wire
        assert shown["values"][1]["value"] == direct["values"][1]["value"] == f"{server.memory[1]:#06x}"


@pytest.mark.parametrize("packets", [-1, 401, "all", None])
def test_the_daemon_is_asked_for_a_number_of_packets_that_it_keeps(packets: object) -> None:
    with pytest.raises(BadRequest, match="packets"):
        parse_request(json.dumps({"version": 1, "verb": "plc", "packets": packets}).encode())


async def test_a_reader_comes_back_after_a_broken_connection_and_changes_are_aged() -> None:
    async with powered() as (_, server):
        reader = DirectReader(PlcAddress("127.0.0.1", server.port))
        await reader.look(0)
        server.modbus.break_connections()
        await asyncio.sleep(0.05)
        with pytest.raises(DeviceError):
            await reader.look(0)
        shown = {value["name"]: value for value in (await reader.look(0))["values"]}
        reader.close()

        assert shown["map version"]["unchanged_ms"] >= 50
        assert shown["PLC heartbeat"]["unchanged_ms"] < 50
