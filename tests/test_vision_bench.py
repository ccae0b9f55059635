"""What `make bench-vision` says and keeps: limits, parts that go on, contests put together."""

import json
from pathlib import Path

import pytest

from tests.benchmarks.vision import packs
from tests.benchmarks.vision.contest import OURS, Contest
from tests.benchmarks.vision.limits import limits
from tests.benchmarks.vision.table import contest_table
from tests.vision_regimes import IDEAL


def squares(numbers: range) -> list[int]:
    return [number * number for number in numbers]


def never(numbers: range) -> list[int]:
    raise AssertionError(f"{numbers} had been done")


def test_a_part_that_was_interrupted_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packs, "DONE", tmp_path)
    file = tmp_path / f"squares-{packs.version()}.jsonl"
    file.write_text('[0, 20, ["kept"]]\n[20, 40, ["cut o', "utf-8")

    found = list(packs.in_packs(squares, 45, "squares"))
    assert sorted(found, key=str) == sorted([["kept"], squares(range(20, 40)), squares(range(40, 45))], key=str)
    assert list(packs.in_packs(never, 45, "squares")) != []
    assert sorted(json.loads(line)[:2] for line in file.read_text("utf-8").splitlines()) == [
        [0, 20],
        [20, 40],
        [40, 45],
    ]


def test_the_first_pack_that_fails_ends_the_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(packs, "DONE", tmp_path)
    with pytest.raises(AssertionError, match="had been done"):
        list(packs.in_packs(never, 200, "never"))


def test_a_limit_is_met_or_said_not_to_be() -> None:
    timed = {
        "find_base ideal": {"median_ms": 4.0, "p99_ms": 11.0},
        "render a base": {"median_ms": 70.0, "p99_ms": 80.0},
    }
    quantity = {"variance of error over sigma": 1.3, "ratio to the bound": 1.8}
    part = {"by regime": {"nuisance": {"hole um": quantity, "Mahalanobis": {"variance of error over sigma": 1.0}}}}
    found = limits(
        {"time": timed, "calibrated": part | {"good pictures refused": 0.001}, "hostile": {"pictures": 9, "wrong": 1}}
    )

    assert [limit.what for limit in found if not limit.met] == [
        "find_base ideal, p99 ms",
        "nuisance, hole um: variance of error / sigma",
        "wrong poses accepted in 9 hostile pictures",
    ]
    assert sum(limit.met for limit in found) == 4


def test_a_peer_that_often_fails_is_none() -> None:
    rows = {OURS: {"noise": 1.0}, "good": {"noise": 3.0, "failed": 0.0}, "fails": {"noise": 0.1, "failed": 0.2}}
    rows = {name: {"failed": 0.0, "ratio to the bound": 1.0} | row for name, row in rows.items()}
    found = limits({"contest": {"ideal": dict.fromkeys(("hole um", "edge um", "edge mdeg"), rows) | _corner(rows)}})

    assert all(limit.met for limit in found)
    assert any("that of good" in limit.what for limit in found)


def _corner(rows: dict) -> dict:
    return dict.fromkeys(("corner um", "corner's edges mdeg"), rows)


@pytest.mark.usefixtures("one_thread")
def test_two_halves_of_a_contest_make_the_whole() -> None:
    whole, both = Contest({}, {}), Contest({}, {})
    whole.run(IDEAL, range(2), seed=4)
    for number in range(2):
        half = Contest({}, {})
        half.run(IDEAL, [number], seed=4)
        both.add(json.loads(json.dumps(half.plain())))

    for quantity, rows in contest_table(whole).items():
        other = contest_table(both)[quantity][OURS]
        assert {k: v for k, v in rows[OURS].items() if k != "median_ms"} == {
            k: v for k, v in other.items() if k != "median_ms"
        }
