"""The whole cell with camera 1 on the second arm, judged by the world."""

from pathlib import Path

from tests.whole_cell import whole_cell


async def test_with_camera_1_on_the_second_arm_the_cell_calibrates_is_taught_and_assembles(tmp_path: Path) -> None:
    async with whole_cell(tmp_path, carrier="arm_2", seed=12) as bench:
        await bench.commission(4)
        records = await bench.produce(4)
        assert [record["verdict"] for record in records] == ["placed"] * 4
        fits = [verdict.fit for verdict in bench.world.verdicts]
        assert all(fit is not None and fit.good and fit.worst_mm < 0.040 for fit in fits)
