"""Pictures that a whole cell has taken, by the commands for picture files; its calibration says the rest."""

import json
from pathlib import Path

import pytest

from cellctl.recipe import Recipe
from cellctl.strict_toml import load
from tests.command_line import run
from tests.whole_cell import ROOT, whole_cell


async def test_pictures_of_production_are_found_again_and_teach_a_recipe_by_the_calibration_alone(
    learnt: Path, tmp_path: Path
) -> None:
    album = tmp_path / "album"
    album.mkdir()
    async with whole_cell(tmp_path, learnt=learnt, album=album) as bench:
        await bench.produce(2)
    _by_state(tmp_path / "cell.toml", bench.config.paths.state)
    cell = ("--config", tmp_path / "cell.toml")
    tried = run("vision", "test", album, "--recipe", ROOT / "recipes" / "x85.toml", *cell, "--json")
    rows = [json.loads(line) for line in tried.out.splitlines()][:-1]
    base, battery = (
        [row["file"] for row in rows if row["found"] and row["camera"] == camera and abs(row["dx_mm"]) < 1.2]
        for camera in (1, 2)
    )
    assert len(base) >= 2, tried.out
    assert len(battery) >= 2, tried.out
    taught = run(
        *("recipe", "teach", "mine", "--base", *base, "--battery", *battery, "--from", ROOT / "recipes" / "x85.toml"),
        *(*cell, "--folder", tmp_path, "--out", tmp_path / "drawn"),
    )
    assert taught.code == 0, taught.err
    recipe = load(tmp_path / "mine.toml", Recipe)
    assert recipe.battery.corner == "lower_left"
    assert "by the calibration of camera-2" in (tmp_path / "mine.toml").read_text(encoding="utf-8")
    assert recipe.base.hole_radius_mm == pytest.approx(3.0, abs=0.003)
    assert recipe.base.edge_distance_mm == pytest.approx(6.0, abs=0.003)
    wrong = run(
        *("recipe", "teach", "other", "--base", *base, "--battery", *battery, "--from", ROOT / "recipes" / "x85.toml"),
        *(*cell, "--folder", tmp_path, "--out", tmp_path / "drawn", "--corner", "upper_left"),
    )
    assert "--corner upper_left: by the calibration of camera-2" in wrong.err


def _by_state(config: Path, state: Path) -> None:
    """Name the state folder of the test in the file that the commands read."""
    lines = config.read_text(encoding="utf-8").splitlines()
    config.write_text("\n".join(f'state = "{state}"' if s.startswith("state =") else s for s in lines), "utf-8")
