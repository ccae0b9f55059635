"""Second looks in the whole cell over the real protocols: taught, taken when they are needed, recorded."""

from pathlib import Path
from typing import Any

import pytest

from cellctl.assembly.budget import Budget, Needs
from tests.whole_cell import ROOT, whole_cell

BOTH = ["camera-1", "camera-1-again", "camera-2", "camera-2-again"]


def recipes(folder: Path, **changes: str) -> Path:
    """A folder with X85, some values changed."""
    folder.mkdir()
    text = (ROOT / "recipes" / "x85.toml").read_text(encoding="utf-8")
    for key, value in changes.items():
        (line,) = (line for line in text.splitlines() if line.startswith(f"{key} = "))
        text = text.replace(line, f"{key} = {value}")
    (folder / "x85.toml").write_text(text, encoding="utf-8")
    return folder


def looks(record: dict[str, Any]) -> list[str]:
    """Which pictures a record names."""
    return [name.removeprefix(f"{record['unit']}-").removesuffix(".jpg") for name in record["pictures"]]


async def test_batteries_of_any_allowed_size_are_placed_in_the_middle_by_both_corners(
    learnt: Path, tmp_path: Path
) -> None:
    folder = recipes(tmp_path / "recipes", second_look='"always"', battery_size_sd_mm="0.046")
    async with whole_cell(tmp_path, learnt=learnt, recipes=folder) as bench:
        bench.world.scatter.size_uniform = True
        records = await bench.produce(5)
        assert [record["verdict"] for record in records] == ["placed"] * 5
        fits = [verdict.fit for verdict in bench.world.verdicts]
        assert all(fit is not None and fit.good and fit.worst_mm < 0.030 for fit in fits)
        for record in records:
            assert sorted(looks(record)) == BOTH
            assert set(record["data"]["looked_again_ms"]) == {"camera-1", "camera-2"}
            assert record["predicted_mm"] < 0.030
            assert record["data"]["prediction"]["shares"]["part size"] < 0.01


async def test_the_sentence_and_all_shares_are_in_the_record_and_the_plan_is_in_the_log(
    learnt: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        (record,) = await bench.produce(1)
        prediction = record["data"]["prediction"]
        assert prediction["sentence"].startswith("expected ")
        assert "um of 40 um, largest share: " in prediction["sentence"]
        assert sum(prediction["shares"].values()) == pytest.approx(1.0, abs=0.001)
        assert prediction["p99_mm"] == pytest.approx(record["predicted_mm"], abs=1e-6)
        assert "planned: expected" in capsys.readouterr().out


async def test_an_unexpectedly_uncertain_battery_is_looked_at_again_before_it_is_placed(
    learnt: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sizes spread too far for one look, but the plan did not know: the arm goes back over camera 2."""
    folder = recipes(tmp_path / "recipes", battery_size_sd_mm="0.046")
    monkeypatch.setattr(Budget, "needs", Needs(False, False))
    async with whole_cell(tmp_path, learnt=learnt, recipes=folder) as bench:
        records = await bench.produce(2)
        for record in records:
            assert record["verdict"] == "placed"
            assert looks(record) == ["camera-1", "camera-2", "camera-2-again"]
        assert all(verdict.fit is not None and verdict.fit.worst_mm < 0.030 for verdict in bench.world.verdicts)


async def test_without_a_second_look_a_battery_that_is_too_uncertain_is_rejected(learnt: Path, tmp_path: Path) -> None:
    folder = recipes(tmp_path / "recipes", second_look='"never"', battery_size_sd_mm="0.046")
    async with whole_cell(tmp_path, learnt=learnt, recipes=folder) as bench:
        (record,) = await bench.produce(1)
        assert (record["verdict"], record["fault"]) == ("rejected", "V4")
        assert "of 40 um, largest share: part size" in record["sentence"]
