"""The look at the gap and the watch over drift in the whole cell, judged by how the world's batteries truly lie."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cellctl.config import CellConfig
from cellctl.control.errors import Declined
from cellctl.control.events import Event
from cellctl.desk.drift import show
from cellctl.journal_file import FILE_NAME
from cellctl.learnt.calibrations import CameraCalibration, read_calibration
from cellctl.learnt.taught import Taught
from cellctl.monitoring.watch import Kept
from cellctl.recipe import load_recipe
from tests.whole_cell import ROOT, Bench, running, simulated


@pytest.fixture
def recipes(tmp_path: Path) -> Path:
    """X85, every unit looked at."""
    folder = tmp_path / "recipes"
    folder.mkdir()
    text = (ROOT / "recipes" / "x85.toml").read_text(encoding="utf-8")
    assert 'when = "every_nth"' in text
    (folder / "x85.toml").write_text(text.replace('when = "every_nth"', 'when = "every_unit"'), encoding="utf-8")
    return folder


class Witness(list[Event]):
    """Keeps the events, and how each battery lay in its seat when its unit was finished: gap in um, x and y."""

    def __init__(self, bench: Bench) -> None:
        super().__init__()
        self.world = bench.world
        self.gaps_um: list[tuple[float, float]] = []

    def append(self, event: Event) -> None:
        super().append(event)
        base, battery = self.world.base, self.world.seated
        if event["event"] == "unit" and base is not None and battery is not None:
            x, y = battery.place.point(-battery.size.width_mm / 2, -battery.size.height_mm / 2)
            self.gaps_um.append((1000 * (x + base.seat.width_mm / 2), 1000 * (y + base.seat.height_mm / 2)))


def falsify(config: CellConfig, x_mm: float, y_mm: float) -> None:
    """Camera 1's calibration and the golden assembly, as if camera 1 had been calibrated wrongly since."""
    first, second = read_calibration(config, "camera-1"), read_calibration(config, "camera-2")
    offset = np.subtract(first.plane.offset_px, first.plane.matrix @ (x_mm, y_mm)).tolist()
    false = first.model_copy(update={"plane": replace(first.plane, offset_px=(offset[0], offset[1]))})
    false.save(CameraCalibration.path(config.paths.state, "camera-1"))
    recipe = load_recipe(config.paths.recipes, "x85")
    taught = Taught.read(Taught.path(config.paths.state, recipe), "teach")
    taught.model_copy(update={"calibrations": (false.id, second.id)}).keep(config.paths.state, recipe)


async def test_gaps_are_measured_as_they_are_and_drift_is_kept_over_a_restart(
    learnt: Path, recipes: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async with simulated(tmp_path, learnt=learnt, recipes=recipes) as bench:
        bench.events = witness = Witness(bench)
        async with running(bench):
            records = await bench.produce(4)
            found = [(record["data"]["gap"]["x_um"], record["data"]["gap"]["y_um"]) for record in records]
            assert np.abs(np.subtract(found, witness.gaps_um)).max() < 4.0
            assert {record["verdict"] for record in records} == {"placed"}
            assert (await bench.ask("status"))["drift"] == "none found (4 units looked at)"
            assert show(bench.config.paths.state / FILE_NAME, 3, as_json=True) == 0
            shown = json.loads(capsys.readouterr().out.splitlines()[-1])
            assert [unit["unit"] for unit in shown["units"]] == [record["unit"] for record in records[1:]]
        async with running(bench):
            (record,) = await bench.produce(1)
            assert Kept.model_validate_json(json.dumps(record["data"]["drift"])).known.units == 5
            assert show(bench.config.paths.state / FILE_NAME, 5, as_json=False) == 0
            assert "no drift found" in capsys.readouterr().out
            await bench.ask("drift_anew")
            assert (await bench.ask("status"))["drift"] == "none found (0 units looked at)"


async def produced_falsified(
    learnt: Path, recipes: Path, tmp_path: Path, moved_mm: tuple[float, float], count: int
) -> tuple[list[dict[str, object]], Witness]:
    """Units of a cell whose camera 1 is believed to be somewhere else."""
    async with simulated(tmp_path, learnt=learnt, recipes=recipes) as bench:
        falsify(bench.config, *moved_mm)
        bench.events = witness = Witness(bench)
        async with running(bench):
            return await bench.produce(count), witness


async def test_a_hand_eye_falsified_by_a_tenth_of_a_millimetre_is_seen_by_the_gap_and_the_unit_rejected(
    learnt: Path, recipes: Path, tmp_path: Path
) -> None:
    """The battery is placed 0.1 mm off, and the gap says so as exactly as ever."""
    records, witness = await produced_falsified(learnt, recipes, tmp_path, (0.1, 0.0), 2)
    for record, true_um in zip(records, witness.gaps_um, strict=True):
        gap = record["data"]["gap"]
        assert (gap["x_um"], gap["y_um"]) == pytest.approx(true_um, abs=4.0)
        assert gap["dx_um"] == pytest.approx(100.0, abs=60.0)
        assert (record["verdict"], record["fault"]) == ("rejected", "V6")
        assert "allowed are 80 um and 50 mdeg" in str(record["sentence"])


async def test_a_battery_on_the_rim_of_its_seat_is_not_released_as_good(
    learnt: Path, recipes: Path, tmp_path: Path
) -> None:
    records, _ = await produced_falsified(learnt, recipes, tmp_path, (-0.16, 0.0), 1)
    assert (records[0]["verdict"], records[0]["fault"]) == ("rejected", "V5")
    assert records[0]["data"]["gap"] is None


async def test_drift_is_not_forgotten_while_it_is_watched(learnt: Path, recipes: Path, tmp_path: Path) -> None:
    async with simulated(tmp_path, learnt=learnt, recipes=recipes) as bench, running(bench):
        await bench.ready()
        await bench.start(1)
        await bench.when(lambda: bench.cell.state.title == "Execute")
        with pytest.raises(Declined, match="stop the cell first"):
            await bench.ask("drift_anew")
        await bench.when(lambda: bench.cell.state.title == "Complete")
