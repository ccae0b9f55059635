"""The whole cell over the real protocols, judged by the world."""

import asyncio
import json
import math
import sys
from pathlib import Path

import pytest

from cellctl.desk.demo import TABLE_2
from simulators.supply import Delivery, Displacement, Sizes
from tests.whole_cell import ROOT, whole_cell


async def test_the_papers_ten_rows_are_found_and_placed(learnt: Path, tmp_path: Path) -> None:
    """Found to 0.005 mm and 0.01 deg of what was set up (robot that repeats exactly), placed to 0.025 mm."""
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        bench.world.arm.repeatability_mm = bench.world.arm.repeatability_deg = 0.0
        rows = [Delivery(Displacement(*base), Displacement(*battery), Sizes()) for battery, base in TABLE_2]
        bench.world.queue_deliveries(rows)
        records = await bench.produce(len(rows))
        for (battery, base), record, verdict in zip(TABLE_2, records, bench.world.verdicts, strict=True):
            found_battery = [record[f"battery_{key}"] for key in ("dx_mm", "dy_mm", "dt_deg")]
            found_base = [record[f"base_{key}"] for key in ("dx_mm", "dy_mm", "dt_deg")]
            for set_up, found in ((battery, found_battery), (base, found_base)):
                assert math.dist(set_up[:2], found[:2]) <= 0.005 * math.sqrt(2)
                assert found == pytest.approx(set_up, abs=0.01)
            assert verdict.fit is not None
            assert verdict.fit.worst_mm <= 0.025


async def test_both_cameras_place_every_battery_of_a_scattering_line(learnt: Path, tmp_path: Path) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        records = await bench.produce(10)
        assert [record["verdict"] for record in records] == ["placed"] * 10
        assert [verdict.fit is not None and verdict.fit.good for verdict in bench.world.verdicts] == [True] * 10
        assert max(verdict.fit.worst_mm for verdict in bench.world.verdicts if verdict.fit) < 0.040


async def test_with_camera_2_only_most_batteries_do_not_fit(learnt: Path, tmp_path: Path) -> None:
    """The paper's comparison: a recipe switch that takes the base as taught, and nothing else (13 of 100 there)."""
    recipes = tmp_path / "recipes"
    recipes.mkdir()
    text = (ROOT / "recipes" / "x85.toml").read_text(encoding="utf-8")
    for name, cameras in (("x85", "both"), ("single", "camera_2_only")):
        (recipes / f"{name}.toml").write_text(text.replace('"both"', f'"{cameras}"'), encoding="utf-8")
    async with whole_cell(tmp_path, learnt=learnt, recipes=recipes) as bench:
        await bench.produce(15, "single")
        good = [verdict.fit is not None and verdict.fit.good for verdict in bench.world.verdicts]
        assert sum(good) <= 7  # 13 %: more than 7 of 15 happens once in 3,000 runs


async def test_a_users_own_recipe_with_other_sizes_and_features_runs(tmp_path: Path) -> None:
    """Copied from x85; another battery, another corner, another hole, another seat. From nothing to good units."""
    changes = {
        'model = "X85"': 'model = "mine"',
        "width_mm = 53.0": "width_mm = 48.0",
        "height_mm = 85.0": "height_mm = 72.0",
        'corner = "lower_left"': 'corner = "upper_right"',
        "hole_radius_mm = 3.0": "hole_radius_mm = 2.2",
        "edge_distance_mm = 6.0": "edge_distance_mm = 4.5",
        "seat_y_mm = -62.0": "seat_y_mm = -56.0",
    }
    text = (ROOT / "recipes" / "x85.toml").read_text(encoding="utf-8")
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new, 1)
    recipes = tmp_path / "recipes"
    recipes.mkdir()
    (recipes / "mine.toml").write_text(text, encoding="utf-8")
    async with whole_cell(tmp_path, product="mine", recipes=recipes, seed=5) as bench:
        await bench.commission(4, "mine")
        await bench.produce(3, "mine")
        fits = [verdict.fit for verdict in bench.world.verdicts]
        assert len(fits) == 3
        assert all(fit is not None and fit.good and fit.worst_mm < 0.040 for fit in fits)


async def test_the_demonstration_leaves_its_figures_records_and_pictures(tmp_path: Path) -> None:
    """Two real processes over real ports, as `make demo` runs them; short."""
    out = tmp_path / "demo"
    options = ("--speed", "100", "--units", "2", "--repeats", "2", "--out", str(out))
    demo = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "cellctl", "demo", *options), stdout=asyncio.subprocess.PIPE
    )
    printed, _ = await asyncio.wait_for(demo.communicate(), 100)
    assert demo.returncode == 0, printed.decode()
    figures = json.loads((tmp_path / "demo.json").read_text(encoding="utf-8"))
    assert figures["both_cameras"]["units"] == figures["both_cameras"]["good"] == 2
    assert figures["camera_2_only"]["units"] == 2
    assert len(figures["table_2"]) == len(TABLE_2)
    assert max(row["placement_error_mm"] for row in figures["table_2"]) < 0.040
    assert "Table 1" in printed.decode()
    assert len(list((out / "state" / "pictures").glob("2*-camera-1.jpg"))) >= 20
