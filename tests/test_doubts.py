"""Collision, abort in motion, temperature: when a calibration that was good is used no more, and what clears it."""

from datetime import timedelta
from pathlib import Path

import pytest

from cellctl.config import CellConfig, load_config
from cellctl.daemon import with_state
from cellctl.faults import NotCalibrated
from cellctl.learnt.calibrations import CameraCalibration, caution, read_calibration, read_doubtful
from cellctl.learnt.doubts import Doubt, Temperature, raise_doubt, settle_doubt, temperature_now
from cellctl.learnt.references import now
from cellctl.learnt.standing import objections, standing_texts
from tests.learnt_files import calibration
from tests.whole_cell import ROOT


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    return with_state(load_config(ROOT / "deploy" / "simulated-cell.toml"), tmp_path)


def in_use(config: CellConfig, **changed: object) -> CameraCalibration:
    made = calibration(**({"made_at": now() - timedelta(hours=1)} | changed))
    made.save(CameraCalibration.path(config.paths.state, "camera-1"))
    return made


def entered(config: CellConfig, celsius: float, hours_ago: float = 0.0) -> None:
    Temperature(made_at=now() - timedelta(hours=hours_ago), celsius=celsius).save(Temperature.path(config.paths.state))


def test_after_a_collision_nothing_is_used_until_it_is_verified(config: CellConfig):
    made = in_use(config)
    raise_doubt(config.paths.state, "robot: position deviation", grave=True)
    with pytest.raises(NotCalibrated, match="position deviation") as refused:
        read_calibration(config, "camera-1")
    assert "run `cellctl calibrate verify camera-1`" in str(refused.value)
    assert read_doubtful(config, "camera-1") == made
    settle_doubt(config.paths.state, "camera-1", made)
    assert read_calibration(config, "camera-1") == made
    assert caution(config, made) is None


def test_verifying_one_version_says_nothing_about_another(config: CellConfig):
    made = in_use(config)
    raise_doubt(config.paths.state, "hit", grave=True)
    settle_doubt(config.paths.state, "camera-1", made)
    in_use(config, poses=14)
    with pytest.raises(NotCalibrated, match="hit"):
        read_calibration(config, "camera-1")


def test_a_calibration_made_afterwards_is_not_doubted(config: CellConfig):
    raise_doubt(config.paths.state, "hit", grave=True)
    made = in_use(config, made_at=now())
    assert read_calibration(config, "camera-1") == made


def test_after_an_abort_in_motion_it_is_said_or_insisted_on_as_the_cell_is_set(config: CellConfig):
    made = in_use(config)
    raise_doubt(config.paths.state, "aborted in motion", grave=False)
    assert read_calibration(config, "camera-1") == made
    assert "aborted in motion" in (caution(config, made) or "")
    assert any("to be verified: aborted in motion" in line for line in objections(config, None))
    strict = config.model_copy(update={"calibration": config.calibration.model_copy(update={"after_abort": "verify"})})
    with pytest.raises(NotCalibrated, match="aborted in motion"):
        read_calibration(strict, "camera-1")


def test_a_milder_event_does_not_hide_a_collision(config: CellConfig):
    in_use(config)
    raise_doubt(config.paths.state, "position deviation", grave=True)
    raise_doubt(config.paths.state, "aborted in motion", grave=False)
    with pytest.raises(NotCalibrated, match="position deviation"):
        read_calibration(config, "camera-1")


def test_a_damaged_note_of_an_event_counts_as_one(config: CellConfig):
    made = in_use(config)
    Doubt.path(config.paths.state, "camera-1").write_bytes(b"\x00")
    with pytest.raises(NotCalibrated, match="cannot be used"):
        read_calibration(config, "camera-1")
    settle_doubt(config.paths.state, "camera-1", made)
    assert read_calibration(config, "camera-1") == made


@pytest.mark.parametrize(("celsius", "usable"), [(20.1, True), (25.9, True), (26.1, False), (19.9, False)])
def test_at_another_temperature_a_calibration_is_not_used(config: CellConfig, celsius: float, usable: bool):
    made = in_use(config, temperature_c=23.0)
    entered(config, celsius)
    if usable:
        assert read_calibration(config, "camera-1") == made
        return
    with pytest.raises(NotCalibrated, match=f"made at 23 C, it is {celsius:g} C now, 3 K of change are allowed"):
        read_calibration(config, "camera-1")


def test_a_temperature_entered_long_ago_is_not_believed(config: CellConfig):
    in_use(config, temperature_c=23.0)
    entered(config, 40.0, hours_ago=13)
    assert temperature_now(config.paths.state, 12) is None
    assert read_calibration(config, "camera-1")
    entered(config, 40.0, hours_ago=-1)  # the clock was set back
    assert temperature_now(config.paths.state, 12) is None


def test_the_standing_says_what_is_usable_and_what_is_not(config: CellConfig):
    made = in_use(config)
    texts = standing_texts(config, None)
    assert texts["camera-1"].startswith(f"{made.id} of ")
    assert texts["camera-2"].startswith("NOT USABLE: ")
    assert "run `cellctl calibrate camera-2`" in texts["camera-2"]
    assert "golden assembly" not in texts
