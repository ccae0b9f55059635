"""How exact, how honest, how careful and how fast vision is: `make bench-vision`.

Parts: `contest` ours beside the paper's method and free peers on the same pictures; `time` of our finders and of the
renderer; `calibrated` whether errors are as large as a measurement says; `hostile` whether wrong pictures are refused.
Prints tables, writes build/bench-vision.json. Progress is on stderr.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import cv2

from tests.benchmarks.vision import peers
from tests.benchmarks.vision.contest import Contest
from tests.benchmarks.vision.speed import times
from tests.benchmarks.vision.table import contest_table, print_calibrated, print_contest, print_hostile, print_times
from tests.benchmarks.vision.trials import calibrated, refusals
from tests.vision_regimes import REGIMES

OUT = Path("build/bench-vision.json")
PARTS = ("contest", "time", "calibrated", "hostile")


def main() -> None:
    asked = _asked()
    cv2.setNumThreads(1)
    result: dict[str, Any] = {"opencv": cv2.__version__}
    if "time" in asked.part:
        result["time"] = times()
        print_times(result["time"])
    if "contest" in asked.part:
        result["contest"] = {}
        for seed, regime in enumerate(REGIMES):
            contest = Contest(peers.CIRCLES, peers.LINES)
            contest.run(regime, asked.pictures, seed)
            result["contest"][regime.name] = contest_table(contest)
            print_contest(regime.name, asked.pictures, result["contest"][regime.name])
    if "calibrated" in asked.part:
        result["calibrated"] = calibrated(asked.calibrated)
        print_calibrated(result["calibrated"])
    if "hostile" in asked.part:
        result["hostile"] = refusals(asked.hostile)
        print_hostile(result["hostile"])
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


def _asked() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench-vision", description=__doc__)
    parser.add_argument("--part", nargs="+", choices=PARTS, default=PARTS, help="only these parts")
    parser.add_argument("--pictures", type=int, default=200, help="of each part and regime, shown to all methods")
    parser.add_argument("--calibrated", type=int, default=10_000, help="pictures for the calibration of the errors")
    parser.add_argument("--hostile", type=int, default=10_000, help="hostile pictures")
    return parser.parse_args()


if __name__ == "__main__":
    main()
