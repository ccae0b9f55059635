"""Calibration, verification and the hysteresis test on the whole cell: what is used, what is not, and why."""

from dataclasses import replace
from pathlib import Path

import pytest

from cellctl.learnt.calibrations import CameraCalibration
from cellctl.learnt.doubts import doubt_about
from cellctl.learnt.versions import shelf
from cellctl.machine import State
from simulators.place import Place
from tests.whole_cell import Bench, whole_cell

QUICK = {"poses": 6, "max_absolute_um": 100.0, "max_differential_um": 10.0, "max_hold_out_um": 100.0}


async def refusal_to_produce(bench: Bench) -> str:
    """Start production, which must not begin, and get back to rest; the sentence that a person reads."""
    before = bench.records(9)
    await bench.at_rest()
    await bench.ready()
    await bench.start(1)
    await bench.until(State.HELD)
    said = bench.cell.message
    await bench.at_rest()
    assert bench.records(9) == before
    return said


async def test_a_new_calibration_waits_until_it_is_accepted_and_then_makes_the_golden_assembly_stale(
    learnt: Path, tmp_path: Path
) -> None:
    async with whole_cell(tmp_path, learnt=learnt, settings=QUICK) as bench:
        state = bench.config.paths.state
        await bench.ask("temperature", celsius=23.5)
        ended = await bench.job("calibrate", what="camera-1")
        assert ended["ok"]
        waits, used = shelf(state, "camera-1").versions
        assert (waits.standing, used.standing) == ("waiting", "in use")
        assert f"waits as {waits.calibration.id}, up to" in str(ended["text"])
        assert waits.calibration.temperature_c == 23.5
        assert waits.calibration.robot_controller == "RCX340 V1.20,R0000, YK400XG"
        assert "golden assembly" in (before := await bench.ask("status"))
        assert not before["golden assembly"].startswith("NOT USABLE")

        reply = await bench.ask("calibration_use", camera="camera-1", what="accept", calibration=None)
        assert reply["in use"] == waits.calibration.id
        assert "stale: it was taught with calibration " + used.calibration.id in str(reply["golden assembly"])
        assert any("is stale: it was taught with calibration" in line for line in await bench.session.stale())
        said = await refusal_to_produce(bench)
        assert said.startswith("[C1] the golden assembly of X85")
        assert f"in use is {waits.calibration.id}" in said

        await bench.ask("calibration_use", camera="camera-1", what="revert", calibration=None)
        (record,) = await bench.produce(1)
        assert record["verdict"] == "placed"


async def test_a_result_beyond_the_gate_is_kept_as_refused_with_its_report_and_never_used(
    learnt: Path, tmp_path: Path
) -> None:
    async with whole_cell(tmp_path, learnt=learnt, settings={**QUICK, "max_hold_out_um": 0.1}) as bench:
        before = shelf(bench.config.paths.state, "camera-1").in_use
        ended = await bench.job("calibrate", what="camera-1")
        assert not ended["ok"]
        assert "the hold-out error is" in str(ended["text"])
        assert "0.1 allowed" in str(ended["text"])
        refused, used = shelf(bench.config.paths.state, "camera-1").versions
        assert (refused.standing, used) == ("refused", before)
        assert "NOT GOOD" in refused.text
        assert refused.path.with_suffix(".png").stat().st_size > 10_000
        assert bench.cell.state is State.HELD
        assert bench.cell.message.startswith("[C2] camera-1: the hold-out error")


async def test_after_a_collision_nothing_is_produced_until_both_cameras_are_verified(
    learnt: Path, tmp_path: Path
) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        await bench.ready()
        await bench.start(1)
        await bench.when(lambda: bench.world.held is not None)
        bench.world.inject("robot", "ng_instead_of_end", code="17.910")
        await bench.until(State.ABORTED)
        assert bench.cell.message.startswith("[D8] robot: ")
        assert "collision" in bench.cell.message
        assert "17.910" in (await bench.ask("status"))["camera-1"]
        said = await refusal_to_produce(bench)
        assert said.startswith("[C1] camera-1 is to be verified: ")
        assert (await bench.job("verify", camera="camera-1"))["ok"]
        assert "camera-2 is to be verified" in await refusal_to_produce(bench)
        ended = await bench.job("verify", camera="camera-2")
        assert str(ended["text"]).endswith("it holds")
        (record,) = await bench.produce(1)
        assert record["verdict"] == "placed"


async def test_a_camera_that_is_not_where_its_calibration_says_does_not_pass_and_is_used_no_more(
    learnt: Path, tmp_path: Path
) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        path = CameraCalibration.path(bench.config.paths.state, "camera-1")
        good = CameraCalibration.read(path, "")
        u, v = good.plane.offset_px
        off = replace(good.plane, offset_px=(u + 0.1 * 136.4, v))
        good.model_copy(update={"plane": off}).save(path)
        ended = await bench.job("verify", camera="camera-1")
        assert not ended["ok"]
        assert "20 um are allowed" in str(ended["text"])
        assert "look for what has come loose" in str(ended["text"])
        assert "camera-1 is to be verified: camera-1 has moved by" in await refusal_to_produce(bench)
        assert doubt_about(bench.config.paths.state, "camera-2") is None


async def test_a_board_that_was_pushed_is_named_instead_of_the_camera(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        pushed = bench.world.layout.board @ Place(0.2, -0.1, 0.1)
        bench.world.layout = replace(bench.world.layout, board=pushed)
        ended = await bench.job("verify", camera="camera-1")
        assert not ended["ok"]
        assert "the dot board rather than the camera has moved" in str(ended["text"])


async def test_the_hysteresis_test_finds_the_lost_motion_of_the_arm(learnt: Path, tmp_path: Path) -> None:
    """The corner of x85's battery is 50.1 mm from the tool's axis."""
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        bench.world.arm.hysteresis_mm, bench.world.arm.hysteresis_deg = 0.040, 0.030
        ended = await bench.job("hysteresis", repeats=2)
        assert ended["ok"]
        worst_um = ended["result"]["worst_um"]  # type: ignore[index]
        assert worst_um == pytest.approx(0.040 * 2**0.5 * 1000 + 0.030 / 57.2958 * 50.1 * 1000, abs=12)
        table = [str(event["text"]) for event in bench.said("progress")[-11:]]
        assert table[0].startswith("approach from")
        assert table[1].split() == ["-x", "-y", "-R", "+0.0", "+0.0", "+0.0", "used"]
        opposite = [float(figure) for figure in table[8].split()[3:6]]
        assert opposite == pytest.approx([40.0, 40.0, 30.0], abs=15)
        assert len(list((bench.config.paths.state / "calibration").glob("hysteresis-*.txt"))) == 1


async def test_the_tool_is_measured_with_its_run_out(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        world = bench.world
        ended = await bench.job("calibrate", what="tool")
        assert ended["ok"], ended["text"]
        said = " ".join(str(event["text"]) for event in bench.said("progress"))
        assert "run-out         held plate's middle" in said
        assert "+-" in said
        assert world.plate.where == "nest"
