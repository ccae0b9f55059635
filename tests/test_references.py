"""Files of what the cell has learnt: read back exactly as written, or refused with a sentence."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from cellctl.config import CellConfig, load_config
from cellctl.daemon import with_state
from cellctl.faults import NotCalibrated
from cellctl.geometry import Pose
from cellctl.learnt.calibrations import CameraCalibration, read_calibration
from cellctl.learnt.doubts import Doubt, Temperature
from cellctl.learnt.references import Reference, now
from cellctl.learnt.taught import Taught, geometry_of, read_taught
from cellctl.recipe import Placement, load_recipe
from tests.learnt_files import COVARIANCE, PARAMETERS, TOOL, calibration, rows, taught
from tests.whole_cell import ROOT

TIME = datetime(2026, 11, 22, 7, 31, 5, 123456, tzinfo=UTC)
FILES: list[Reference] = [
    calibration(made_at=TIME, camera="camera-2", mount="bench", tool=TOOL, temperature_c=23.5, objections=("too bad",)),
    taught(made_at=TIME),
    Doubt(made_at=TIME, why="the arm hit something", grave=True, verified=("ab", "cd")),
    Temperature(made_at=TIME, celsius=21.5),
]


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    return with_state(load_config(ROOT / "deploy" / "simulated-cell.toml"), tmp_path)


@pytest.fixture(scope="module", params=range(len(FILES)), ids=lambda index: type(FILES[index]).__name__)
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Reference, bytes]:
    path = tmp_path_factory.mktemp("written") / "file.json"
    FILES[request.param].save(path)
    return FILES[request.param], path.read_bytes()


def reread(like: Reference, raw: bytes) -> Reference | None:
    """What a file of these bytes says, None when it is refused."""
    try:
        return type(like).unsealed(raw)
    except ValueError:
        return None


# -- any bytes -------------------------------------------------------------------------------------------------


def test_a_file_says_what_was_written_and_nothing_is_left_over(written: tuple[Reference, bytes], tmp_path: Path):
    file, raw = written
    assert reread(file, raw) == file
    file.save(tmp_path / "deep" / "er" / "file.json")
    assert [path.name for path in (tmp_path / "deep" / "er").iterdir()] == ["file.json"]
    assert len(file.id) == 12
    assert json.loads(raw)["sha256"].startswith(file.id)


@given(bit=st.integers(0, 8 * 20_000))
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_flipped_bit_is_refused_or_changes_nothing(written: tuple[Reference, bytes], bit: int):
    file, raw = written
    bit %= 8 * len(raw)
    damaged = bytearray(raw)
    damaged[bit // 8] ^= 1 << bit % 8
    assert reread(file, bytes(damaged)) in (None, file)


@given(end=st.integers(0, 20_000))
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_truncated_file_is_refused(written: tuple[Reference, bytes], end: int):
    file, raw = written
    end %= len(raw.rstrip())
    assert reread(file, raw[:end]) is None


@given(junk=st.binary(max_size=100) | st.lists(st.none() | st.text(max_size=9)).map(lambda v: json.dumps(v).encode()))
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_other_bytes_are_refused(written: tuple[Reference, bytes], junk: bytes):
    file, _ = written
    assert reread(file, junk) is None


numbers = st.sampled_from(["NaN", "Infinity", "-Infinity", "1e999", '"1.0"', "true", "null", "[]"])


@given(data=st.data(), strange=numbers)
@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_number_that_is_none_is_refused_whatever_the_seal_says(
    written: tuple[Reference, bytes], data: st.DataObject, strange: str
):
    file, _ = written
    names = [name for name, value in file.model_dump(mode="json").items() if isinstance(value, float | list)]
    content = file.model_dump(mode="json")
    spoilt = json.dumps(content | {data.draw(st.sampled_from(names)): "@"}).replace('"@"', strange)
    try:
        found = type(file).model_validate_json(spoilt)
    except ValidationError:
        return
    assert strange in ("null", "[]")  # allowed where nothing may be known
    assert found != file


def test_a_file_of_another_kind_is_refused(written: tuple[Reference, bytes]):
    file, raw = written
    for other in FILES:
        if type(other) is not type(file):
            assert reread(other, raw) is None


@pytest.mark.parametrize(
    ("raw", "says"),
    [
        (b'{"schema_version": 1, "camera": "camera-1"}', "of an earlier release: schema 1, this one reads 3"),
        (b'{"sha256": "", "content": {"schema_version": 9}}', "of a later release: schema 9"),
        (b"[" * 100_000, "recursion"),
        (b" " * 2_000_000, "larger than"),
        (b"", "EOF"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_with_the_remedy(tmp_path: Path, raw: bytes, says: str):
    path = tmp_path / "camera-1.json"
    path.write_bytes(raw)
    with pytest.raises(NotCalibrated, match=says) as refused:
        CameraCalibration.read(path, "run `cellctl calibrate camera-1`")
    assert str(refused.value).startswith(str(path))
    assert str(refused.value).endswith("run `cellctl calibrate camera-1`")
    assert len(str(refused.value).splitlines()) == 1


def test_a_digit_changed_by_hand_is_refused(config: CellConfig):
    path = CameraCalibration.path(config.paths.state, "camera-1")
    calibration().save(path)
    path.write_text(path.read_text().replace('"poses": 15', '"poses": 16'))
    with pytest.raises(NotCalibrated, match="damaged or edited"):
        read_calibration(config, "camera-1")


def test_a_changed_digit_changes_the_id():
    assert calibration(made_at=TIME).id != calibration(made_at=TIME, rms_px=0.006).id


@pytest.mark.parametrize(
    ("covariance", "says"),
    [
        (COVARIANCE[:5], "must be 6 x 6"),
        (COVARIANCE[:, :5], "must be 6 x 6"),
        (COVARIANCE + np.eye(6, k=1), "symmetric"),
        (-COVARIANCE, "not negative"),
        (COVARIANCE * np.nan, "finite"),
    ],
)
def test_a_covariance_that_is_none_is_refused(covariance: np.ndarray, says: str):
    with pytest.raises(ValidationError, match=says):
        calibration(covariance=rows(covariance))
    assert calibration().covariance_array.shape == (len(PARAMETERS),) * 2


# -- does it belong here -----------------------------------------------------------------------------------------


def test_a_missing_calibration_names_the_command(config: CellConfig):
    with pytest.raises(NotCalibrated, match=r"does not exist: run `cellctl calibrate camera-1`"):
        read_calibration(config, "camera-1")


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"serial": "ANOTHER"}, "is of camera ANOTHER, the cell has SIM-CAM-1"),
        ({"view": (8, 0, 2592, 1944)}, "is of picture 2592 x 1944 px at 8, 0, the cell has 2592 x 1944 px at 0, 0"),
        ({"robot_serial": "OLD-ARM"}, "is of robot OLD-ARM, the cell has SIM-ROBOT"),
        ({"mount": "arm_2"}, "is of mount arm_2, the cell has tool"),
        ({"camera": "camera-2", "mount": "bench"}, "is of camera-2"),
        ({"objections": ("the hold-out error is 31 um",)}, "was refused .the hold-out error is 31 um"),
        ({"made_at": now() - timedelta(days=1000)}, "is 1000.0 days old, allowed are 90"),
        ({"made_at": now() + timedelta(days=2)}, "in the future: set the clock right"),
    ],
)
def test_a_calibration_that_does_not_belong_here_and_now_is_refused(
    config: CellConfig, changed: dict[str, object], says: str
):
    calibration(**changed).save(CameraCalibration.path(config.paths.state, "camera-1"))
    with pytest.raises(NotCalibrated, match=says) as refused:
        read_calibration(config, "camera-1")
    assert "run `cellctl calibrate camera-1`" in str(refused.value)


@given(st.datetimes(datetime(1990, 1, 1), datetime(2200, 1, 1)).map(lambda date: date.replace(tzinfo=UTC)))
@settings(max_examples=40, deadline=None)
def test_only_the_dates_of_the_last_90_days_are_believed(tmp_path_factory: pytest.TempPathFactory, made_at: datetime):
    folder = tmp_path_factory.mktemp("state")
    config = with_state(load_config(ROOT / "deploy" / "simulated-cell.toml"), folder)
    calibration(made_at=made_at).save(CameraCalibration.path(folder, "camera-1"))
    age_days = (now() - made_at).total_seconds() / 86400
    try:
        read_calibration(config, "camera-1")
    except NotCalibrated:
        assert not 0.001 < age_days < 89.9
    else:
        assert -0.001 < age_days < 90.1


# -- taught ------------------------------------------------------------------------------------------------------


def test_a_golden_assembly_belongs_to_its_calibrations_and_features(config: CellConfig):
    recipe = load_recipe(ROOT / "recipes", "x60")
    recipe = recipe.model_copy(update={"placement": Placement(second_look="never")})
    first, second = calibration(), calibration(camera="camera-2", mount="bench")
    file = taught(geometry=geometry_of(recipe), calibrations=(first.id, second.id))
    file.keep(config.paths.state, recipe)
    assert read_taught(config, recipe, (first, second)) == file
    renewed = calibration(hold_out_um=4.0)
    with pytest.raises(NotCalibrated) as stale:
        read_taught(config, recipe, (renewed, second))
    assert f"is stale: it was taught with calibration {first.id} of camera-1, in use is {renewed.id}" in str(
        stale.value
    )
    assert "cellctl teach" in str(stale.value)
    taught(geometry="f" * 12).save(Taught.path(config.paths.state, recipe))
    with pytest.raises(NotCalibrated, match="other features"):
        read_taught(config, recipe, (first, second))


def test_every_golden_assembly_stays_in_the_history(config: CellConfig):
    recipe = load_recipe(ROOT / "recipes", "x85")
    for hour in range(3):
        taught(geometry=geometry_of(recipe), made_at=TIME + timedelta(hours=hour)).keep(config.paths.state, recipe)
    kept = sorted((config.paths.state / "taught" / "history").iterdir())
    assert len(kept) == 3
    assert Taught.read(kept[-1], "") == Taught.read(Taught.path(config.paths.state, recipe), "")


def test_more_repeats_and_pairs_make_the_taught_place_surer():
    one = taught(pairs=1, repeats=4, between_mm=None, between_deg=None)
    assert one.uncertainty_mm == pytest.approx(0.003)
    many = taught(pairs=4, repeats=4, spread_mm=0.006, between_mm=0.004)
    assert many.uncertainty_mm == pytest.approx(np.hypot(0.0015, 0.002))


def test_poses_of_a_taught_file_are_read_as_poses(tmp_path: Path):
    taught(look_1=Pose(1.5, -2.5, 170.0)).save(tmp_path / "x.json")
    assert Taught.read(tmp_path / "x.json", "").look_1 == Pose(1.5, -2.5, 170.0)
