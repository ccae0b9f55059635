"""The shelf of calibrations: nothing is overwritten, nothing is used unasked, and a person sees what differs."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cellctl.calibration.difference import differences, worst_um
from cellctl.config import load_config
from cellctl.daemon import with_state
from cellctl.desk.check import check
from cellctl.desk.shelf import list_versions, report, show_version
from cellctl.faults import NotCalibrated
from cellctl.learnt.calibrations import CameraCalibration, read_calibration
from cellctl.learnt.doubts import raise_doubt
from cellctl.learnt.taught import geometry_of
from cellctl.learnt.versions import Report, accept, add_candidate, revert, shelf
from cellctl.recipe import load_recipe
from tests.learnt_files import PLANE, calibration, taught
from tests.whole_cell import ROOT

REPORT = Report("the report\nof a calibration", b"\x89PNG and so on")
TODAY = datetime.now(UTC)


def candidate(state: Path, days_ago: float = 0.0, **changed: object) -> CameraCalibration:
    made = calibration(made_at=TODAY - timedelta(days=days_ago), **changed)
    add_candidate(state, made, REPORT)
    return made


def used(state: Path, days_ago: float, **changed: object) -> CameraCalibration:
    return accept(state, "camera-1", candidate(state, days_ago, **changed).id)


def standings(state: Path) -> dict[str, str]:
    return {version.calibration.id: version.standing for version in shelf(state, "camera-1").versions}


def test_a_candidate_is_not_used_before_it_is_accepted(tmp_path: Path):
    made = candidate(tmp_path)
    assert standings(tmp_path) == {made.id: "waiting"}
    assert not CameraCalibration.path(tmp_path, "camera-1").exists()
    assert accept(tmp_path, "camera-1") == made
    assert standings(tmp_path) == {made.id: "in use"}
    version = shelf(tmp_path, "camera-1").in_use
    assert version is not None
    assert version.text == REPORT.text
    assert version.path.with_suffix(".png").read_bytes() == REPORT.png


def test_accepting_takes_the_newest_that_waits_and_keeps_the_others(tmp_path: Path):
    first = used(tmp_path, 3)
    old, new = candidate(tmp_path, 2, poses=14), candidate(tmp_path, 1, poses=16)
    assert accept(tmp_path, "camera-1") == new
    assert standings(tmp_path) == {first.id: "kept", old.id: "waiting", new.id: "in use"}


def test_a_refused_candidate_is_kept_but_cannot_be_accepted(tmp_path: Path):
    bad = candidate(tmp_path, objections=("the hold-out error is 31 um, 15 allowed",))
    assert standings(tmp_path) == {bad.id: "refused"}
    with pytest.raises(NotCalibrated, match=f"camera-1 has no version {bad.id} that is waiting"):
        accept(tmp_path, "camera-1", bad.id)
    with pytest.raises(NotCalibrated, match="there are: none"):
        accept(tmp_path, "camera-1")


def test_reverting_goes_back_one_by_one_and_forward_by_its_id(tmp_path: Path):
    one, two, three = used(tmp_path, 3), used(tmp_path, 2), used(tmp_path, 1)
    assert revert(tmp_path, "camera-1") == two
    assert revert(tmp_path, "camera-1") == one
    with pytest.raises(NotCalibrated, match=f"no accepted version before {one.id}"):
        revert(tmp_path, "camera-1")
    assert accept(tmp_path, "camera-1", three.id) == three
    assert standings(tmp_path) == {one.id: "kept", two.id: "kept", three.id: "in use"}


def test_reverting_without_a_version_in_use_says_what_to_do(tmp_path: Path):
    with pytest.raises(NotCalibrated, match="cellctl calibrate accept camera-1 ID"):
        revert(tmp_path, "camera-1")


@pytest.mark.parametrize("content", [b"", b'{"schema_version": 1, "camera": "camera-1"}'])
def test_a_file_in_use_that_cannot_be_read_is_put_aside_and_not_lost(tmp_path: Path, content: bytes):
    path = CameraCalibration.path(tmp_path, "camera-1")
    path.parent.mkdir()
    path.write_bytes(content)
    made = candidate(tmp_path)
    assert accept(tmp_path, "camera-1") == made
    found = shelf(tmp_path, "camera-1")
    assert [version.standing for version in found.versions] == ["in use"]
    assert len(found.unreadable) == 1
    assert next(path.parent.glob("camera-1/*unreadable*")).read_bytes() == content


def test_a_file_in_use_that_came_from_elsewhere_is_kept(tmp_path: Path):
    foreign = calibration(made_at=TODAY - timedelta(days=9))
    foreign.save(CameraCalibration.path(tmp_path, "camera-1"))
    made = used(tmp_path, 1)
    assert standings(tmp_path) == {foreign.id: "kept", made.id: "in use"}


@given(data=st.data())
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_whatever_happens_no_calibration_is_ever_lost(data: st.DataObject, tmp_path_factory: pytest.TempPathFactory):
    state, ids = tmp_path_factory.mktemp("state"), set()
    for days_ago in range(9, 0, -1):
        act = data.draw(st.sampled_from(["candidate", "refused", "accept", "revert", "any"]))
        try:
            if act in ("candidate", "refused"):
                objections = ("too bad",) if act == "refused" else ()
                ids.add(candidate(state, days_ago, objections=objections).id)
            elif act == "any":
                accept(state, "camera-1", data.draw(st.sampled_from(sorted(ids) or ["0" * 12])))
            else:
                (accept if act == "accept" else revert)(state, "camera-1")
        except NotCalibrated:
            continue  # nothing to accept, or nothing to go back to
    found = shelf(state, "camera-1")
    assert {version.calibration.id for version in found.versions} == ids
    assert sum(version.standing == "in use" for version in found.versions) <= 1
    assert not found.unreadable
    assert found.in_use is None or not found.in_use.calibration.objections


# -- how far two calibrations lie apart ---------------------------------------------------------------------------


def test_the_difference_at_the_corners_is_that_of_the_maps():
    turned = replace(PLANE, offset_px=(PLANE.offset_px[0] + 136 * 0.010, PLANE.offset_px[1]))
    away = differences(turned, PLANE, (2592, 1944))
    assert [place.place for place in away] == ["middle", "top left", "top right", "bottom left", "bottom right"]
    for place in away:
        assert (place.dx_um, place.dy_um) == (pytest.approx(-10.0), pytest.approx(0.0, abs=1e-6))
    assert worst_um(away) == pytest.approx(10.0)


# -- what the commands print --------------------------------------------------------------------------------------


@pytest.fixture
def config(tmp_path: Path) -> Path:
    text = (ROOT / "deploy" / "simulated-cell.toml").read_text().replace("../build/simulated-cell/state", "state")
    text = text.replace("../recipes", str(ROOT / "recipes"))
    path = tmp_path / "cell.toml"
    path.write_text(text)
    return path


def test_the_list_shows_every_version_with_its_figures(config: Path, capsys: pytest.CaptureFixture[str]):
    state = config.parent / "state"
    one, two = used(state, 2), used(state, 1, hold_out_um=4.0)
    moved = replace(PLANE, offset_px=(PLANE.offset_px[0] + 136 * 0.010, PLANE.offset_px[1]))
    waits = candidate(state, 0.5, plane=moved, temperature_c=23.0)
    bad = candidate(state, 0.1, objections=("the hold-out error is 31 um",))
    assert list_versions(config, as_json=False) == 0
    rows = {line.split()[0]: line.split()[3:] for line in capsys.readouterr().out.splitlines() if line[:3].strip()}
    assert rows[one.id] == ["kept", "5.0", "0.0050", "3.0", "-", "0.0"]
    assert rows[two.id] == ["in", "use", "4.0", "0.0050", "3.0", "-", "-"]
    assert rows[waits.id] == ["waiting", "5.0", "0.0050", "3.0", "23.0", "10.0"]
    assert rows[bad.id][:1] + rows[bad.id][6:] == ["refused", "the", "hold-out", "error", "is", "31", "um"]
    assert list_versions(config, as_json=True) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [row["standing"] for row in listed["versions"]] == ["refused", "waiting", "in use", "kept"]
    assert listed["versions"][1]["worst_away_um"] == pytest.approx(10.0)


def test_showing_a_version_tells_where_it_differs(config: Path, capsys: pytest.CaptureFixture[str]):
    state = config.parent / "state"
    one = used(state, 2)
    two = used(state, 1, plane=replace(PLANE, offset_px=(PLANE.offset_px[0], PLANE.offset_px[1] + 136 * 0.010)))
    assert show_version(config, "camera-1", one.id, as_json=False) == 0
    shown = capsys.readouterr().out
    assert f"camera-1 {one.id}: kept" in shown
    assert "of a calibration" in shown
    assert f"against {two.id} in use" in shown
    assert shown.splitlines()[-1].split()[2:] == ["+0.0", "-10.0", "10.0"]
    assert show_version(config, "camera-1", None, as_json=False) == 0
    assert f"camera-1 {two.id}: in use" in capsys.readouterr().out
    with pytest.raises(NotCalibrated, match="has no version 000000000000"):
        show_version(config, "camera-1", "0" * 12, as_json=False)


def test_the_report_says_whether_both_may_be_used(config: Path, capsys: pytest.CaptureFixture[str]):
    state = config.parent / "state"
    used(state, 1)
    assert report(config, as_json=False) == 1
    printed = capsys.readouterr().out
    assert "camera-1: in use" in printed
    assert "of a calibration" in printed
    assert "camera-2: NOT USABLE:" in printed
    add_candidate(state, second := calibration(camera="camera-2", mount="bench", serial="SIM-CAM-2"), REPORT)
    accept(state, "camera-2", second.id)
    assert report(config, as_json=True) == 0
    assert [json.loads(line)["standing"] for line in capsys.readouterr().out.splitlines()] == ["in use", "in use"]
    assert read_calibration(with_state(load_config(config), state), "camera-2") == second


async def test_the_self_test_says_what_is_stale_or_not_checked(config: Path, capsys: pytest.CaptureFixture[str]):
    state = config.parent / "state"
    used(state, 1)
    add_candidate(state, second := calibration(camera="camera-2", mount="bench", serial="SIM-CAM-2"), REPORT)
    accept(state, "camera-2", second.id)
    raise_doubt(state, "aborted in motion", grave=False)
    recipe = load_recipe(ROOT / "recipes", "x85")
    taught(geometry=geometry_of(recipe), calibrations=("a" * 12, second.id)).keep(state, recipe)
    assert await check(config, as_json=False, offline=True) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("note   calibration  camera-1 is to be verified: aborted in motion") for line in lines)
    assert any(
        "x85: the golden assembly of X85" in line and f"calibration {'a' * 12} of camera-1" in line for line in lines
    )
    assert any("none was entered within 12 h" in line for line in lines)


def test_an_unreadable_version_is_named_and_the_rest_is_shown(config: Path, capsys: pytest.CaptureFixture[str]):
    state = config.parent / "state"
    one = used(state, 1)
    (state / "calibration" / "camera-1" / "20250101-000000-x.json").write_bytes(b"{")
    assert list_versions(config, as_json=False) == 1
    printed = capsys.readouterr().out
    assert one.id in printed
    assert "20250101-000000-x.json cannot be used" in printed
