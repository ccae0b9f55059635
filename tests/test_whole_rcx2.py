"""The whole cell with an RCX240 instead of an RCX340, which has the vacuum valve, too: the same work."""

from cellctl.machine import State
from tests.whole_cell import whole_cell


async def test_a_cell_with_an_older_controller_is_calibrated_and_assembles(learnt, tmp_path):
    async with whole_cell(tmp_path, learnt=learnt, dialect="rcx2", robot={"vacuum_output": 20}) as bench:
        await bench.job("calibrate", what="camera-2")
        records = await bench.produce(2)

        assert bench.cell.state is State.COMPLETE
        assert [record["verdict"] for record in records] == ["placed", "placed"]
        heard = {entry.line for entry in bench.robot_log.of("heard")}
        assert {"@?MOD", "@RIGHTY", "@ETHER ECHO 0"} <= heard
        assert not any(line.startswith("@?MODE") for line in heard)
        valve = [entry.byte & 1 for entry in bench.robot_log.of("output") if entry.port == "DO2"]
        assert valve == [1, 0] * (len(valve) // 2)
        assert len(valve) >= 4
        fits = [verdict.fit for verdict in bench.world.verdicts]
        assert len(fits) == 2
        assert all(fit is not None and fit.good and fit.worst_mm < 0.04 for fit in fits)
