"""The whole cell over the real protocols, judged by the world."""

import math
from pathlib import Path

import pytest

from cellctl.demo import TABLE_2
from simulators.supply import Delivery, Displacement, Sizes
from tests.whole_cell import whole_cell


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
