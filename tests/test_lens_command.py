"""`cellctl calibrate lens` over folders as people have them."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

from cellctl.__main__ import cli
from cellctl.calibration.errors import LensRefused
from cellctl.calibration.lens.boards import Chessboard
from cellctl.calibration.lens.sightings import find_board, views_of
from cellctl.calibration.lens.solve import LensResult, calibrate_lens
from cellctl.config import load_config
from cellctl.desk.lens_file import LensFile
from cellctl.faults import NotCalibrated
from cellctl.geometry import Pose
from cellctl.strict_toml import SettingsError
from simulators.optics import Optics
from simulators.parts import dot_plate, scene
from simulators.place import Place
from simulators.render import render
from tests.real_pictures import chessboards

BOARD = "chessboard:9x6:25mm"


@pytest.fixture(scope="module")
def real(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the real pictures alone."""
    folder = tmp_path_factory.mktemp("real") / "pictures"
    folder.mkdir()
    for path in chessboards():
        shutil.copy(path, folder)
    return folder


@pytest.fixture(scope="module")
def result(real: Path) -> LensResult:
    """What comes of them."""
    board = Chessboard(9, 6, 25.0)
    sightings = [find_board(cv2.imread(str(path), 0), board) for path in sorted(real.iterdir())]
    return calibrate_lens("pinhole", views_of(sightings, board, (640, 480)), [p.name for p in sorted(real.iterdir())])


def some(real: Path, folder: Path, count: int) -> Path:
    """A folder of the first so many of them."""
    folder.mkdir()
    for path in sorted(real.iterdir())[:count]:
        shutil.copy(path, folder)
    return folder


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, ["calibrate", "lens", *map(str, arguments)])


# -- the real pictures -------------------------------------------------------------------------------------------------


def test_real_pictures_are_calibrated_better_than_opencv_does(result):
    """OpenCV's best on these pictures: 0.183 px, fx 533.0 px (cornerSubPix with a half-window of 7 px)."""
    assert len(result.names) == 13
    assert not result.out
    assert result.fit.rms_px < 0.165
    assert result.hold_out_px < 0.17
    assert result.fit.shared[0] == pytest.approx(533.0, abs=1.5)


def test_on_the_same_corners_the_result_is_opencvs(result):
    fit = result.fit
    board = np.column_stack([fit.adjustment.views.board_mm, np.zeros(54)]).astype(np.float32)
    corners = [points.astype(np.float32) for points in fit.adjustment.views.points_px]
    assert fit.used.all()
    rms, matrix, lens, _, _, sd, _, _ = cv2.calibrateCameraExtended([board] * 13, corners, (640, 480), None, None)
    k1, k2, p1, p2, k3 = lens.ravel().tolist()
    theirs = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], k1, k2, k3, p1, p2])
    assert fit.rms_px == pytest.approx(rms, rel=1e-4)
    assert np.abs((fit.shared - theirs) / result.sd).max() < 0.05
    assert result.sd == pytest.approx(sd.ravel()[[0, 1, 2, 3, 4, 5, 8, 6, 7]], rel=0.02)


def test_the_command_reports_and_writes_what_it_found(real, tmp_path):
    out, real = tmp_path / "lens", some(real, tmp_path / "six", 6)
    done = run(real, "--board", BOARD, "--out", out)
    assert done.exit_code == 0, done.output
    for word in ("6 used, 0 left out", "fx_px", "hold-out", "left06.jpg", "lens.json"):
        assert word in done.output
    drawn = cv2.imread(str(out / "report.png"))
    assert drawn.shape[:2] == (1140, 1440)
    file = LensFile.read(out / "lens.json", "")
    assert file.rms_px < 0.165
    assert len(file.pictures) == 6
    assert np.array(file.covariance).shape == (9, 9)
    again = run(real, "--board", BOARD, "--out", out, "--json")
    assert json.loads(again.stdout)["result"]["values"] == list(file.values)
    kept = [path.name for path in out.iterdir() if path.name.startswith("lens-")]
    assert kept == [f"lens-{file.made_at:%Y%m%d-%H%M%S}.json"]
    text = (out / "lens.json").read_text()
    (out / "lens.json").write_text(text.replace('"fx_px"', '"fy_px"', 1))
    with pytest.raises(NotCalibrated, match="damaged or edited"):
        LensFile.read(out / "lens.json", "")


def test_a_mixed_folder_names_what_it_leaves_out(real, tmp_path):
    folder = some(real, tmp_path / "mixed", 5)
    (folder / "empty.png").write_bytes(b"")
    (folder / "cut.jpg").write_bytes((folder / "left01.jpg").read_bytes()[:9000])
    (folder / "notes.txt").write_text("not a picture")
    (folder / "text.tiff").write_text("not a picture either")
    large = cv2.resize(cv2.imread(str(folder / "left02.jpg")), (800, 600))
    cv2.imwrite(str(folder / "large.bmp"), large)
    cv2.imwrite(str(folder / "nothing.tif"), np.full((480, 640), 90, np.uint8))
    shutil.copy(folder / "left03.jpg", folder / "left03 again.jpg")
    done = run(folder, "--board", BOARD, "--out", tmp_path / "out", "--json")
    assert done.exit_code == 0, done.output
    out = {one["name"]: one["reason"] for one in json.loads(done.stdout)["result"]["left_out"]}
    said = {
        "empty.png": "it is empty",
        "cut.jpg": "cut off",
        "text.tiff": "no PNG, TIFF, BMP or JPEG",
        "large.bmp": "is 800 x 600 px, the others are 640 x 480",
        "nothing.tif": "no chessboard of 9 x 6",
        "left03.jpg": "shows exactly what",
    }
    assert {name.replace(" again", "") for name in out} == set(said)
    for name, reason in out.items():
        assert said[name.replace(" again", "")] in reason


def test_a_telecentric_camera_is_calibrated_from_four_pictures_of_a_dot_plate(tmp_path):
    folder = tmp_path / "plates"
    folder.mkdir()
    rng = np.random.default_rng(2)
    optics = replace(Optics.aimed((0, 0), looks="down", turn_deg=-2), k1=3e-10, blur_px=1.1, noise=2.5)
    for index, (x_mm, y_mm, turn_deg) in enumerate([(2.5, 1.5, 0), (-2.5, 1.5, 80), (2, -1.5, 170), (-2, -1.5, 265)]):
        middle = Pose(x_mm, y_mm, turn_deg) @ Pose(-4.8, -3.6, 0)
        cv2.imwrite(str(folder / f"{index}.png"), render(scene((dot_plate(), Place(*middle))), optics, rng))
    board = "dots:9x7:1.2mm:0.6mm:0.9mm"
    done = run(folder, "--board", board, "--model", "telecentric", "--json", "--out", tmp_path / "out")
    result = json.loads(done.stdout)["result"]
    found = dict(zip(result["parameters"], result["values"], strict=True))
    sd = dict(zip(result["parameters"], np.sqrt(np.diag(result["covariance"])).tolist(), strict=True))
    scale = float(np.linalg.svd(optics.matrix, compute_uv=False)[0])
    assert found["scale_px_per_mm"] == pytest.approx(scale, abs=4 * sd["scale_px_per_mm"])
    assert found["k1_per_px2"] == pytest.approx(3e-10, abs=4 * sd["k1_per_px2"])
    assert result["rms_px"] < 0.03


@pytest.mark.parametrize(("written", "found"), [('lens = "pinhole"', "pinhole"), ("", "telecentric")])
def test_the_cells_lens_is_the_configured_one_and_telecentric_unless_said(written, found, tmp_path):
    config = load_config(cell_with(written, tmp_path))
    assert (config.camera_1.lens, config.camera_2.lens) == (found, "telecentric")


def test_an_unknown_lens_in_the_configuration_is_refused(tmp_path):
    with pytest.raises(SettingsError, match=r"camera_1\.lens: must be .*telecentric"):
        load_config(cell_with('lens = "fisheye"', tmp_path))


def cell_with(lens: str, folder: Path) -> Path:
    """The simulated cell's configuration with another line about camera 1's lens."""
    text = (Path(__file__).parents[1] / "deploy/simulated-cell.toml").read_text()
    path = folder / "cell.toml"
    path.write_text(re.sub(r"^lens = .*$", lens, text, count=1, flags=re.MULTILINE))
    return path


# -- what is refused ---------------------------------------------------------------------------------------------------


def test_when_no_picture_shows_the_board_it_says_what_it_looked_for_and_what_is_there(real, tmp_path):
    done = run(some(real, tmp_path / "four", 4), "--board", "chessboard:8x5:25mm", "--out", tmp_path / "out")
    assert done.exit_code == 1
    assert "a chessboard of 8 x 5 inner corners is in none of 4 pictures (640 x 480 px)" in done.output
    assert "there is something like a chessboard of 9x6 inner corners" in done.output
    assert not (tmp_path / "out").exists()


def test_too_few_pictures_are_refused_with_the_reasons_as_json(real, tmp_path):
    done = run(some(real, tmp_path / "few", 2), "--board", BOARD, "--json", "--out", tmp_path / "out")
    said = json.loads(done.stdout)
    assert done.exit_code == 1
    assert (said["ok"], said["check"]) == (False, "pictures")
    assert "needs 3 or more" in said["error"]


def test_the_wrong_model_is_refused(result):
    with pytest.raises(LensRefused, match="this lens is pinhole"):
        calibrate_lens("telecentric", result.fit.adjustment.views, list(result.names))


@pytest.mark.parametrize(
    ("arguments", "code", "says"),
    [
        (("{folder}", "--board", "chess:9x6:1"), 2, "write chessboard:9x6:25mm"),
        (("{folder}", "--board", BOARD, "--model", "fisheye"), 2, "'pinhole', 'telecentric'"),
        (("{folder}",), 2, "Missing option '--board'"),
        (("{folder}/nowhere", "--board", BOARD), 1, "no such file or folder"),
        (("{folder}", "--board", BOARD), 1, "there is no picture in it"),
        (("{folder}", "--board", BOARD, "--out", "{folder}"), 1, "must not go among the pictures"),
    ],
)
def test_a_wrong_order_is_refused_with_a_sentence(arguments, code, says, tmp_path):
    import subprocess
    import sys

    done = subprocess.run(
        [sys.executable, "-m", "cellctl", "calibrate", "lens", *(part.format(folder=tmp_path) for part in arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == code
    assert says in done.stderr
    assert "Traceback" not in done.stderr
