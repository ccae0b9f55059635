"""What goes wrong ends in the right state, with one clear sentence and the unit recorded; judged by the world."""

import asyncio
import shutil
import signal
import sys
from pathlib import Path

import pytest

from cellctl.control.errors import Declined
from cellctl.desk.client import call
from cellctl.desk.records import units
from cellctl.journal import Journal, Record
from cellctl.journal_file import FILE_NAME
from cellctl.machine import NotAllowed, State
from tests.whole_cell import ROOT, STUCK, Bench, running, simulated, whole_cell


def carrying(bench: Bench) -> bool:
    """A battery hangs on the cup and has left the table."""
    now_s = bench.world.clock.now()
    return bench.world.held is not None and bench.world.arm.tool_at(now_s).z_mm < 61.0


async def moved_since(bench: Bench, for_s: float = 0.05) -> bool:
    """Whether the arm's true place changes within this wall time."""
    before = bench.world.tool()
    await asyncio.sleep(for_s)
    return bench.world.tool() != before


async def test_a_carrier_without_a_base_is_rejected_and_the_next_unit_is_made(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        bench.world.inject("supply", "no_base")
        first, second = await bench.produce(2)
        assert (first["verdict"], first["fault"]) == ("rejected", "V1")
        assert "camera 1" in first["sentence"]
        assert second["verdict"] == "placed"
        empty, whole = bench.world.verdicts
        assert not empty.released_good
        assert whole.fit is not None
        assert whole.fit.good
        pictures = list((bench.config.paths.state / "pictures").glob(f"{first['unit']}-camera-1.*"))
        assert len(pictures) == 1


async def test_a_dark_camera_2_rejects_the_unit_and_the_battery_goes_to_the_tray(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        bench.world.inject("camera_2", "dark")
        (record,) = await bench.produce(1)
        assert (record["verdict"], record["fault"]) == ("rejected", "V2")
        assert len(bench.world.rejected) == 1
        assert bench.world.held is None
        assert not bench.world.verdicts[0].released_good


async def test_a_battery_lost_on_the_way_holds_the_cell_and_a_person_lets_it_go_on(
    learnt: Path, tmp_path: Path
) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ready()
        await bench.start(2)
        await bench.when(lambda: carrying(bench))
        bench.world.inject("vacuum", "lost")
        await bench.until(State.HELD)
        (record,) = bench.records(1)
        assert (record["verdict"], record["fault"]) == ("lost", "P3")
        assert "vacuum check" in bench.cell.message
        assert not await moved_since(bench)
        await bench.command("unhold", State.COMPLETE)
        assert [record["verdict"] for record in bench.records(2)] == ["placed", "placed"]


async def test_a_cup_that_does_not_seal_holds_the_cell(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        bench.world.inject("vacuum", "no_seal")
        await bench.ready()
        await bench.start(1)
        await bench.until(State.HELD)
        assert bench.cell.message.startswith("[P2] no vacuum at the cup within")
        assert bench.records(1)[0]["fault"] == "P2"


async def test_no_base_suspends_and_the_cell_goes_on_when_parts_come(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        bench.world.inject("conveyor", "stuck")
        await bench.ready()
        await bench.start(1)
        await bench.until(State.SUSPENDED)
        assert bench.cell.message.startswith("[P1] no base arrived")
        bench.world.inject("conveyor", "stuck", on=False)
        await bench.command("unsuspend", State.COMPLETE)
        assert bench.records(1)[0]["verdict"] == "placed"


@pytest.mark.parametrize("fault", ["estop", "guard"])
async def test_safety_lost_in_motion_stops_the_arm_until_a_person_clears_and_resets(
    fault: str, learnt: Path, tmp_path: Path
) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ready()
        await bench.start(1)
        await bench.when(lambda: bench.world.held is not None and bench.world.arm.moving_at(bench.world.clock.now()))
        bench.world.inject("safety", fault)
        await bench.until(State.ABORTED)
        assert not await moved_since(bench)
        assert bench.world.held is not None  # vacuum is kept: what hangs on the cup must not fall
        assert bench.records(1)[0]["verdict"] == "lost"
        with pytest.raises(NotAllowed):
            await bench.ask("command", name="start")
        await bench.ask("command", name="clear")
        await bench.until(State.ABORTED)  # the cause is still there
        bench.world.inject("safety", fault, on=False)
        (record,) = await bench.produce(1)
        assert record["verdict"] == "placed"
        assert len(bench.world.rejected) == 1  # the battery of the aborted unit went to the tray first


async def test_a_belt_that_begins_to_creep_keeps_the_battery_out_of_the_seat(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ready()
        await bench.start(1)
        await bench.when(lambda: bench.world.held is not None and bench.world.arm.moving_at(bench.world.clock.now()))
        bench.world.inject("conveyor", "creeps")
        await bench.when(lambda: bench.cell.state in STUCK)
        assert bench.cell.message.startswith(("[P6]", "[S1] PLC is in fault 4"))  # whoever sees it first
        assert bench.world.held is not None
        assert bench.world.seated is None


async def test_abort_by_command_stops_at_once_and_is_recorded(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ready()
        await bench.start(0)
        await bench.when(lambda: bench.world.held is not None and bench.world.arm.moving_at(bench.world.clock.now()))
        await bench.command("abort", State.ABORTED)
        assert not await moved_since(bench)
        assert bench.records(1)[0]["verdict"] == "lost"
        said = await bench.ask("status")
        assert all("is to be verified: aborted in motion: " in str(said[camera]) for camera in ("camera-1", "camera-2"))
        assert (await bench.produce(1))[0]["verdict"] == "placed"  # said, and not insisted on


async def test_an_abort_while_the_record_is_being_written_leaves_one_record(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        finish, writing = bench.journal.finish_unit, asyncio.Event()

        async def on_a_slow_disk(unit: str, record: Record) -> None:
            writing.set()
            await asyncio.sleep(0.1)
            await finish(unit, record)

        bench.journal.finish_unit = on_a_slow_disk  # type: ignore[method-assign]
        await bench.ready()
        await bench.start(1)
        await asyncio.wait_for(writing.wait(), 20)
        await bench.command("abort", State.ABORTED)
        assert [record["verdict"] for record in bench.records(5)] == ["placed"]
        assert "R1" not in bench.cell.message


async def test_stop_ends_the_unit_in_progress_first(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ready()
        await bench.start(0)
        await bench.when(lambda: bench.world.held is not None)
        await bench.command("stop", State.STOPPED)
        assert bench.records(1)[0]["verdict"] == "placed"
        assert bench.world.held is None
        assert not await moved_since(bench)
        assert "verified" not in str((await bench.ask("status"))["camera-1"])


async def test_a_command_given_in_the_very_turn_of_a_state_change_is_acted_on(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ready()
        await bench.ask("command", name="stop")
        while bench.cell.state is not State.STOPPED:
            await asyncio.sleep(0)
        await bench.command("reset", State.IDLE)


async def test_hold_ends_the_unit_and_unhold_goes_on(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ready()
        await bench.start(2)
        await bench.when(lambda: bench.world.held is not None)
        await bench.command("hold", State.HELD)
        assert bench.records(5)[-1]["verdict"] == "placed"
        assert not await moved_since(bench)
        await bench.command("unhold", State.COMPLETE)


async def test_a_robot_that_hangs_up_in_motion_aborts_and_clear_reconnects(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ready()
        await bench.start(1)
        await bench.when(lambda: bench.world.arm.moving_at(bench.world.clock.now()))
        bench.world.inject("robot", "link_drop", for_s=1.0)
        await bench.until(State.ABORTED)
        assert bench.cell.message.startswith("[D1] robot:")
        assert not await moved_since(bench)
        assert (await bench.produce(1))[0]["verdict"] == "placed"


async def test_a_camera_with_its_cable_out_aborts_with_its_name(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ready()
        bench.world.inject("camera_1", "mute")
        await bench.start(1)
        await bench.until(State.ABORTED)
        assert "camera 1" in bench.cell.message
        assert bench.cell.message.startswith("[D")


async def test_a_plc_with_another_register_map_is_refused_at_start(learnt: Path, tmp_path: Path) -> None:
    def other_map(bench: Bench) -> None:
        bench.world.inject("plc", "map_version")

    async with whole_cell(tmp_path, learnt=learnt, before_start=other_map) as bench:
        assert bench.cell.state is State.ABORTED
        assert bench.cell.message.startswith("[D5] plc:")
        assert "0x0100" in bench.cell.message


async def test_a_cell_without_its_devices_starts_in_aborted_and_says_which_is_missing(tmp_path: Path) -> None:
    async with simulated(tmp_path) as bench:
        pass  # and now nobody listens any more
    async with running(bench):
        assert bench.cell.state is State.ABORTED
        assert bench.cell.message.startswith("[D1] plc:")
        assert "5020" in bench.cell.message


@pytest.mark.parametrize("device", ["robot", "camera_2"])
async def test_a_missing_robot_or_camera_is_named_at_start(device: str, learnt: Path, tmp_path: Path) -> None:
    def take_away(bench: Bench) -> None:
        if device == "robot":
            bench.world.inject("robot", "link_drop", for_s=1000.0)
        else:
            bench.world.inject("camera_2", "mute")

    async with whole_cell(tmp_path, learnt=learnt, before_start=take_away) as bench:
        assert bench.cell.state is State.ABORTED
        assert bench.cell.message.startswith("[D")
        assert device.replace("_", " ") in bench.cell.message


async def test_a_cell_that_was_never_calibrated_holds_with_what_to_do(tmp_path: Path) -> None:
    async with whole_cell(tmp_path) as bench:
        await bench.ready()
        await bench.start(1)
        await bench.until(State.HELD)
        assert "cellctl calibrate camera-1" in bench.cell.message


async def test_a_recipe_with_a_mistake_is_refused_with_its_place(learnt: Path, tmp_path: Path) -> None:
    recipes = tmp_path / "recipes"
    recipes.mkdir()
    text = (ROOT / "recipes" / "x85.toml").read_text(encoding="utf-8")
    (recipes / "x85.toml").write_text(text, encoding="utf-8")
    wrong = {"typo": ("settle_s =", "settle_z ="), "nan": ("width_mm = 53.0", "width_mm = nan")}
    for name, (old, new) in wrong.items():
        assert old in text
        (recipes / f"{name}.toml").write_text(text.replace(old, new, 1), encoding="utf-8")
    async with whole_cell(tmp_path, learnt=learnt, recipes=recipes) as bench:
        for name in wrong:
            with pytest.raises(Declined, match=rf"{name}\.toml:\d+:\d+: "):
                await bench.ask("recipe_use", name=name)


async def test_sigterm_ends_the_unit_cleanly_and_leaves_the_arm_standing(learnt: Path, tmp_path: Path) -> None:
    """The daemon as a process of its own, as systemd runs it."""
    async with simulated(tmp_path, learnt=learnt) as bench:
        state = bench.config.paths.state
        arguments = ("-m", "cellctl", "run", "--config", str(tmp_path / "cell.toml"), "--state", str(state))
        daemon = await asyncio.create_subprocess_exec(sys.executable, *arguments, stdout=asyncio.subprocess.DEVNULL)
        socket = state / "control.sock"
        await bench.when(socket.exists)
        await call(socket, {"verb": "recipe_use", "name": "x85"})
        await call(socket, {"verb": "command", "name": "reset"})
        async with asyncio.timeout(20):
            while (await call(socket, {"verb": "status"}))["state"] != "Idle":
                await asyncio.sleep(0.02)
        await call(socket, {"verb": "command", "name": "start"})
        await bench.when(lambda: bench.world.held is not None)
        daemon.send_signal(signal.SIGTERM)
        assert await asyncio.wait_for(daemon.wait(), 30) == 0
        assert not await moved_since(bench)
        assert bench.world.held is None
        assert units(state / FILE_NAME, last=1)[0]["verdict"] == "placed"


async def test_a_killed_daemon_leaves_its_unit_recorded_and_starts_in_aborted(learnt: Path, tmp_path: Path) -> None:
    async with simulated(tmp_path, learnt=learnt) as bench:
        state = bench.config.paths.state
        async with running(bench):
            await bench.ready()
            await bench.start(0)
            await bench.when(lambda: bench.world.held is not None)
            began = units(state / FILE_NAME, last=1)[0]["unit"]
            copy = tmp_path / "as-after-a-power-cut"
            shutil.copytree(state, copy)
        journal = await Journal.open(copy / FILE_NAME)
        try:
            assert not journal.clean
            (lost,) = await journal.close_interrupted("the last run was interrupted")
            assert lost.unit == began
        finally:
            await journal.close()
