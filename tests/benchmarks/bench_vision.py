"""How exact, how honest, how careful and how fast vision is: `make bench-vision`.

Parts: `contest` ours beside the paper's method and free peers on the same pictures; `time` of our finders and of the
renderer; `calibrated` whether errors are as large as a measurement says; `hostile` whether wrong pictures are refused.
Prints tables and which limits are met, writes build/bench-vision.json. Parts can be run one by one and are put
together as long as nothing that they measure has changed; a part that was interrupted goes on where it was. Two
processes work at a time (`time`: one). Progress is on stderr.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2

from tests.benchmarks.vision.limits import limits, print_limits
from tests.benchmarks.vision.packs import version
from tests.benchmarks.vision.speed import times
from tests.benchmarks.vision.table import contest_table, print_calibrated, print_contest, print_hostile, print_times
from tests.benchmarks.vision.trials import calibrated, compared, refusals

OUT = Path("build/bench-vision.json")
PARTS = ("time", "contest", "calibrated", "hostile")


def main() -> None:
    asked = _asked()
    cv2.setNumThreads(1)
    result = _before()
    run: dict[str, Callable[[], Any]] = {
        "time": times,
        "contest": lambda: {name: contest_table(each) for name, each in compared(asked.pictures).items()},
        "calibrated": lambda: calibrated(asked.calibrated),
        "hostile": lambda: refusals(asked.hostile),
    }
    for part in asked.part:
        result[part] = run[part]()
        _write(result)
    _print(result)


def _before() -> dict[str, Any]:
    """The parts of earlier runs of the same version."""
    start = {"opencv": cv2.__version__, "version": version()}
    if not OUT.exists():
        return start
    found: dict[str, Any] = json.loads(OUT.read_text("utf-8"))
    return found if found.get("version") == version() else start


def _write(result: dict[str, Any]) -> None:
    result["limits"] = [{**limit._asdict(), "met": limit.met} for limit in limits(result)]
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def _print(result: dict[str, Any]) -> None:
    if "time" in result:
        print_times(result["time"])
    for regime, table in result.get("contest", {}).items():
        print_contest(regime, table)
    if "calibrated" in result:
        print_calibrated(result["calibrated"])
    if "hostile" in result:
        print_hostile(result["hostile"])
    print_limits(limits(result))


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench-vision", description=__doc__)
    parser.add_argument("--part", nargs="+", choices=PARTS, default=PARTS, help="only these parts")
    parser.add_argument("--pictures", type=int, default=200, help="of each part and regime, shown to all methods")
    parser.add_argument("--calibrated", type=int, default=10_000, help="pictures for the calibration of the errors")
    parser.add_argument("--hostile", type=int, default=10_000, help="hostile pictures")
    return parser.parse_args()


if __name__ == "__main__":
    main()
