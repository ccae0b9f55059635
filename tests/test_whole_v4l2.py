"""The whole cell with camera 2 on V4L2, judged by the world."""

from pathlib import Path

import pytest

from cellctl.machine import State
from drivers.v4l2 import V4l2Camera
from tests.v4l2_rig import fuse_is_missing
from tests.whole_cell import whole_cell


def video_2(folder: Path) -> str:
    """Through a file of the kernel where that is possible, else within this process."""
    return "" if fuse_is_missing() else str(folder / "video0")


@pytest.mark.parametrize("triggers", [True, False], ids=["triggered", "free running"])
async def test_a_cell_whose_camera_2_is_a_v4l2_device_assembles(triggers: bool, tmp_path: Path, learnt: Path) -> None:
    video = video_2(tmp_path)
    async with whole_cell(tmp_path, learnt=learnt, video_2=video, video_triggers=triggers) as bench:
        assert isinstance(bench.devices.camera_2, V4l2Camera)
        records = await bench.produce(2)
        assert [record["verdict"] for record in records] == ["placed"] * 2
        fits = [verdict.fit for verdict in bench.world.verdicts]
        assert all(fit is not None and fit.good and fit.worst_mm < 0.040 for fit in fits)
        assert bench.devices.camera_2.counters.delivered >= 2


async def test_an_unplugged_v4l2_camera_aborts_with_its_name_and_the_cell_goes_on_when_it_is_back(
    tmp_path: Path, learnt: Path
) -> None:
    async with whole_cell(tmp_path, learnt=learnt, video_2=video_2(tmp_path)) as bench:
        await bench.ready()
        bench.world.inject("camera_2", "unplug")
        await bench.start(1)
        await bench.until(State.ABORTED)
        assert bench.cell.message.startswith("[D1] camera 2: ")
        bench.world.inject("camera_2", "unplug", on=False)
        bench.world.clear_station()
        records = await bench.produce(1)
        assert records[0]["verdict"] == "placed"
        assert bench.world.verdicts[-1].fit is not None
