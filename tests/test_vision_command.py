"""`cellctl vision test`: what is printed, drawn and returned for pictures that are good, wrong, or none."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from simulators.place import Place
from tests.command_line import run
from tests.picture_album import MM_PER_PX, base_files, battery_files, places, save
from tests.vision_scenes import base_view

RECIPES = Path(__file__).resolve().parent.parent / "recipes"
X85 = ("--recipe", RECIPES / "x85.toml", "--mm-per-px", MM_PER_PX)


@pytest.fixture(scope="module")
def album(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Pictures of both parts in one folder."""
    folder = tmp_path_factory.mktemp("album")
    base_files(folder)
    battery_files(folder)
    return folder


def test_every_picture_of_a_folder_is_found_whichever_part_it_shows(album: Path, tmp_path: Path) -> None:
    ended = run("vision", "test", album, *X85, "--out", tmp_path / "drawn")
    assert ended.code == 0, ended.out
    rows = [line.split() for line in ended.out.splitlines() if ".png" in line or ".tif" in line]
    assert [row[:3] for row in rows] == [
        ["base-0.png", "base", "found"],
        ["base-1.png", "base", "found"],
        ["battery-0.tif", "battery", "found"],
        ["battery-1.tif", "battery", "found"],
    ]
    assert "base: found 2 of 2" in ended.out
    assert "battery: found 2 of 2" in ended.out
    drawn = sorted((tmp_path / "drawn").iterdir())
    assert [path.name for path in drawn] == [
        "001-base-0.jpg",
        "002-base-1.jpg",
        "003-battery-0.jpg",
        "004-battery-1.jpg",
    ]
    assert cv2.imread(str(drawn[0])).shape == (972, 1296, 3)


def test_the_figures_are_those_of_the_scene(album: Path) -> None:
    ended = run("vision", "test", album / "base-0.png", "--camera", "1", *X85, "--json")
    row, last = map(json.loads, ended.out.splitlines())
    place = places(2, 1)[0]
    assert (row["dx_mm"], row["dy_mm"], row["dt_deg"]) == pytest.approx((place.x_mm, place.y_mm, place.t_deg), abs=2e-3)
    assert row["camera"] == 1
    assert row["looks"]["hole"]["blur_px"] == pytest.approx(1.1, abs=0.1)
    assert 0 < row["sd_um"] < 1
    assert last["summary"]["base"]["found"] == 1


def test_a_refusal_names_its_check_and_ends_with_1(album: Path, tmp_path: Path) -> None:
    dark = cv2.imread(str(album / "base-0.png"), cv2.IMREAD_UNCHANGED) // 8
    save(tmp_path / "dark.png", dark)
    ended = run("vision", "test", tmp_path, album / "base-1.png", "--camera", "1", *X85)
    assert ended.code == 1
    assert "dark.png                     base     refused  " in ended.out
    assert "base: found 1 of 2" in ended.out
    ended = run("vision", "test", album / "base-0.png", "--camera", "2", *X85, "--json")
    assert ended.code == 1
    assert json.loads(ended.out.splitlines()[0])["check"]


def test_a_recipe_for_another_part_refuses_with_the_figure(album: Path) -> None:
    x60 = ("--recipe", RECIPES / "x60.toml", "--mm-per-px", MM_PER_PX)
    ended = run("vision", "test", album, *x60, "--json")
    rows = [json.loads(line) for line in ended.out.splitlines()[:-1]]
    assert ended.code == 1
    assert not any(row["found"] for row in rows if row["file"].endswith(".png"))


def test_a_damaged_file_is_one_line_and_the_others_go_on(album: Path, tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes((album / "base-0.png").read_bytes()[:5000])
    ended = run("vision", "test", tmp_path, album / "base-1.png", *X85)
    assert ended.code == 1
    assert "a.png: is cut off" in ended.out
    assert "base: found 1 of 1" in ended.out
    assert "not readable: 1" in ended.out


def test_a_picture_of_another_size_is_refused_by_its_size(album: Path, tmp_path: Path) -> None:
    pixels = cv2.imread(str(album / "base-0.png"), cv2.IMREAD_UNCHANGED)
    save(tmp_path / "small.png", pixels[:1000])
    ended = run("vision", "test", album / "base-1.png", tmp_path / "small.png", *X85)
    assert ended.code == 1
    assert "2592 x 1000 px, expected are 2592 x 1944 px" in ended.out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--recipe", RECIPES / "x85.toml"), "how many mm a pixel shows is not known"),
        (("--recipe", RECIPES / "none.toml", "--mm-per-px", "0.01"), "none.toml: there is no such file"),
        ((*X85, "--config", "nowhere.toml"), ""),
    ],
)
def test_what_is_missing_is_said(
    options: tuple[object, ...], said: str, album: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CELLCTL_CONFIG", raising=False)
    ended = run("vision", "test", album / "base-0.png", *options)
    assert said in ended.err
    assert (ended.code != 0) is bool(said)


def test_drawn_pictures_never_go_among_the_measured_ones(album: Path) -> None:
    ended = run("vision", "test", album, *X85, "--out", album)
    assert ended.code == 1
    assert "--out" in ended.err
    assert len(list(album.iterdir())) == 4


def test_a_wrong_size_of_a_pixel_is_a_sentence(album: Path) -> None:
    ended = run("vision", "test", album / "base-0.png", "--recipe", RECIPES / "x85.toml", "--mm-per-px", "0.2")
    assert ended.code == 1
    assert "is the size of a pixel right" in ended.out


def test_a_search_that_is_too_short_misses_the_part(tmp_path: Path) -> None:
    save(tmp_path / "far.png", base_view(np.random.default_rng(1), place=Place(1.3, 0.0, 0.0)).pixels)
    assert run("vision", "test", tmp_path, "--camera", "1", *X85).code == 0
    assert run("vision", "test", tmp_path, "--camera", "1", *X85, "--search-mm", "0.2").code == 1
