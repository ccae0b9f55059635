"""Teaching on the whole cell: pairs and repeats, what is refused, one-sided stops, differential accuracy."""

import math
from pathlib import Path

import numpy as np
import pytest

from cellctl.geometry import Mm
from cellctl.machine import State
from tests.golden_scenes import deliveries, mark_errors_um, marks_of, taught_in
from tests.whole_cell import ROOT, Bench, whole_cell


async def test_two_golden_pairs_are_taught_with_their_spreads(learnt: Path, tmp_path: Path) -> None:
    """The second battery is longer than the first by what its corner shows of it, the arm repeats exactly."""
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        world = bench.world
        world.arm.repeatability_mm = world.arm.repeatability_deg = 0.0
        world.scatter.golden_sd_mm = 0.020
        ended = await bench.job("teach", repeats=2, pairs=2)
        assert ended["ok"], ended["text"]
        taught = taught_in(bench)
        assert (taught.pairs, taught.repeats) == (2, 2)
        sizes = world.golden.delivery().sizes
        corner_mm = math.hypot(sizes.battery_width_mm, sizes.battery_height_mm) / 2
        assert taught.between_mm == pytest.approx(corner_mm / 2, abs=0.001)  # sigma per axis of two that far apart
        assert taught.spread_mm < 0.002
        table = [str(event["text"]) for event in bench.said("progress")]
        assert any(row.startswith("between pairs") for row in table)
        assert sum(row.lstrip().startswith(("1  ", "2  ")) for row in table) == 6  # four seatings, two means
        asked = [str(event["asks"]) for event in bench.said("progress") if event["asks"]]
        assert asked.count("put-in-golden-pair") == 1
        assert asked.count("seat-golden-assembly") == 4


@pytest.mark.parametrize(
    ("scatter", "request_", "says"),
    [
        ("golden_seat_mm", {"repeats": 3, "pairs": 1}, "one seating differs from the next by"),
        ("golden_sd_mm", {"repeats": 1, "pairs": 2}, "one golden pair differs from the next by"),
    ],
)
async def test_golden_assemblies_that_differ_too_much_are_refused_with_their_figure(
    scatter: str, request_: dict[str, int], says: str, learnt: Path, tmp_path: Path
) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        before = taught_in(bench)
        setattr(bench.world.scatter, scatter, 0.15)
        ended = await bench.job("teach", **request_)
        assert not ended["ok"]
        assert says in str(ended["text"])
        assert "allowed are 30 um and 30 mdeg: " in str(ended["text"])
        assert taught_in(bench) == before
        assert bench.cell.state is State.HELD
        assert bench.cell.message.startswith("[C2] ")


class Stops:
    """The side from which the arm came to each place where a picture was taken, or something picked or put."""

    def __init__(self, bench: Bench, places: dict[str, Mm]) -> None:
        self._arm, self._tool, self._places = bench.world.arm, bench.world.tool, places
        self.seen: dict[str, set[tuple[float, ...]]] = {name: set() for name in places}
        bench.world.tool = self._asked  # type: ignore[method-assign]

    def _asked(self, at_s: float | None = None):
        tool = self._tool(at_s)
        for name, place in self._places.items():
            if at_s is not None and math.dist(place, tool[:2]) < 2.5:
                miss = self._arm._miss_at(at_s)
                self.seen[name].add((miss.from_x, miss.from_y, miss.from_r))
        return tool


async def test_every_measuring_stop_is_approached_from_the_same_side_in_production_as_in_teaching(
    learnt: Path, tmp_path: Path
) -> None:
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        taught = taught_in(bench)
        seat = taught.robot_from_base @ taught.base_from_battery
        looks = {"look 1": taught.look_1, "look 2": taught.look_2}
        stops = Stops(bench, {**{name: Mm(*pose[:2]) for name, pose in looks.items()}, "seat": Mm(*seat[:2])})
        assert (await bench.job("teach", repeats=1, pairs=1))["ok"]
        taught_sides = dict(stops.seen)
        stops.seen = {name: set() for name in stops.seen}
        await bench.produce(3)
        assert set.union(*stops.seen.values(), *taught_sides.values()) == {(1.0, 1.0, 1.0)}


async def test_lost_motion_of_the_arm_does_not_reach_the_placed_battery(learnt: Path, tmp_path: Path) -> None:
    """0.1 mm and 0.05 deg: from any side that would be three times what is allowed. Without the approach, it is."""
    worst = {}
    for approach in ("mm = 1.0", "mm = 0.0"):
        folder = tmp_path / approach[-3:]
        (folder / "recipes").mkdir(parents=True)
        text = (ROOT / "recipes" / "x85.toml").read_text(encoding="utf-8")
        text = text.replace("approach_mm = 1.0", f"approach_{approach}")
        if approach.endswith("0.0"):
            text = text.replace("approach_deg = 0.5", "approach_deg = 0.0")
        (folder / "recipes" / "x85.toml").write_text(text, encoding="utf-8")
        async with whole_cell(folder, learnt=learnt, recipes=folder / "recipes") as bench:
            bench.world.arm.hysteresis_mm, bench.world.arm.hysteresis_deg = 0.1, 0.05
            bench.world.arm.repeatability_mm = bench.world.arm.repeatability_deg = 0.0
            assert (await bench.job("teach", repeats=1, pairs=1))["ok"]
            bench.world.queue_deliveries(deliveries(np.random.default_rng(3), 4))
            await bench.produce(4)
            worst[approach] = max(verdict.fit.worst_mm for verdict in bench.world.verdicts if verdict.fit)
    assert worst["mm = 1.0"] < 0.010
    assert worst["mm = 0.0"] > 0.030


async def test_differences_from_the_golden_assembly_are_found_to_a_micrometre(learnt: Path, tmp_path: Path) -> None:
    """Within +-1 mm and +-1.5 deg, against the world's truth, with an arm that repeats exactly."""
    async with whole_cell(tmp_path, learnt=learnt) as bench:
        bench.world.arm.repeatability_mm = bench.world.arm.repeatability_deg = 0.0
        assert (await bench.job("teach", repeats=1, pairs=1))["ok"]
        set_up = deliveries(np.random.default_rng(7), 8)
        bench.world.queue_deliveries(set_up)
        records = await bench.produce(len(set_up))
        for part, (centre, mark) in marks_of(bench).items():
            errors_um = mark_errors_um(records, set_up, part, centre, mark)
            assert math.sqrt(float((errors_um**2).mean())) < 1.0  # rms per axis
        assert max(verdict.fit.worst_mm for verdict in bench.world.verdicts if verdict.fit) < 0.008
