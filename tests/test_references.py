"""Calibrations and taught references: durable, strict, and refused when they do not belong here."""

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from cellctl.calibration.plane_map import PlaneMap
from cellctl.config import CellConfig, load_config
from cellctl.daemon import with_state
from cellctl.faults import NotCalibrated
from cellctl.geometry import Pose
from cellctl.recipe import load_recipe
from cellctl.references import CameraCalibration, Taught, geometry_of, now, read_calibration, read_taught
from tests.whole_cell import ROOT

PLANE = PlaneMap(((136.0, 0.0), (0.0, -136.0)), (1300.0, 970.0), 0.0, (1295.5, 971.5))


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    return with_state(load_config(ROOT / "deploy" / "simulated-cell.toml"), tmp_path)


def calibration(**changed: object) -> CameraCalibration:
    values = {
        "made_at": now(),
        "camera": "camera-1",
        "serial": "SIM-CAM-1",
        "plane": PLANE,
        "target": Pose(1, 2, 3),
        "poses": 15,
        "rotation_spread_deg": 58.0,
        "rms_px": 0.005,
        "hold_out_um": 5.0,
        "predicted_sd_um": 3.0,
        "note": "z is not observable",
    }
    return CameraCalibration.model_validate(values | changed)


def test_a_calibration_survives_its_file(config: CellConfig) -> None:
    saved = calibration()
    saved.save(CameraCalibration.path(config.paths.state, "camera-1"))
    read = read_calibration(config, "camera-1")
    assert (read, read.id) == (saved, saved.id)


def test_a_missing_calibration_names_the_command(config: CellConfig) -> None:
    with pytest.raises(NotCalibrated, match="cellctl calibrate camera-1"):
        read_calibration(config, "camera-1")


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"serial": "ANOTHER"}, "ANOTHER"),
        ({"made_at": datetime.now(UTC) - timedelta(days=1000)}, "days old"),
        ({"made_at": datetime.now(UTC) + timedelta(days=2)}, "days old"),
    ],
)
def test_a_calibration_that_does_not_belong_here_is_refused(
    config: CellConfig, changed: dict[str, object], says: str
) -> None:
    calibration(**changed).save(CameraCalibration.path(config.paths.state, "camera-1"))
    with pytest.raises(NotCalibrated, match=says):
        read_calibration(config, "camera-1")


@pytest.mark.parametrize("damage", [b"", b"{", b'{"schema_version": 2}', b"\xff\xfe"])
def test_a_damaged_file_is_refused_with_a_sentence(config: CellConfig, damage: bytes) -> None:
    path = CameraCalibration.path(config.paths.state, "camera-1")
    calibration().save(path)
    path.write_bytes(damage)
    with pytest.raises(NotCalibrated, match="cannot be used"):
        read_calibration(config, "camera-1")


def test_a_changed_digit_changes_the_id() -> None:
    same = now()
    assert calibration(made_at=same).id != calibration(made_at=same, rms_px=0.006).id


def test_a_taught_reference_is_refused_after_a_new_calibration(config: CellConfig) -> None:
    recipe = load_recipe(ROOT / "recipes", "x85")
    here = Pose(0, 0, 0)
    taught = Taught(
        made_at=now(),
        recipe="x85",
        geometry=geometry_of(recipe),
        calibrations=("a", "b"),
        look_1=here,
        look_2=here,
        robot_from_base=here,
        base_from_battery=here,
        tool_from_battery=here,
        table_pick=here,
        robot_from_battery_on_table=here,
        repeats=5,
        spread_mm=0.006,
        spread_deg=0.002,
    )
    taught.save(Taught.path(config.paths.state, recipe))
    assert read_taught(config, recipe, ("a", "b")) == taught
    with pytest.raises(NotCalibrated, match="calibrated anew"):
        read_taught(config, recipe, ("a", "c"))
