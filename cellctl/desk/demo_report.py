"""What the demonstration shows: a line per unit, the paper's tables beside ours, and the figures as JSON."""

from __future__ import annotations

import statistics
from dataclasses import dataclass, field
from typing import Any, NamedTuple

PAPER_GOOD = {"both cameras": 100, "camera 2 only": 13}  # of 100, the paper's Table 1


class Row(NamedTuple):
    """One unit: what the daemon found, what the world knows."""

    unit: str
    verdict: str
    found_base: list[float] | None
    found_battery: list[float] | None
    predicted_mm: float | None  # p99
    placement_error_mm: float | None  # of the worst corner, against this very battery in the middle of its seat
    clearance_mm: float | None
    good: bool
    cycle_s: float  # world seconds, carrier to carrier

    @classmethod
    def of(cls, event: dict[str, Any], verdict: dict[str, Any]) -> Row:
        """From the daemon's event and the world's verdict on the same carrier."""
        data = event["data"]
        return cls(
            unit=event["unit"],
            verdict=event["verdict"],
            found_base=data["base"],
            found_battery=data["battery"],
            predicted_mm=data["predicted_mm"],
            placement_error_mm=verdict["placement_error_mm"],
            clearance_mm=verdict["clearance_mm"],
            good=verdict["good"],
            cycle_s=verdict["cycle_s"],
        )


@dataclass
class Run:
    """Units assembled one after the other in the same way."""

    title: str
    units: int
    rows: list[Row] = field(default_factory=list)
    interrupted: int = 0  # how often the cell aborted

    @property
    def good(self) -> int:
        """How many batteries lie in their seats, by the world."""
        return sum(row.good for row in self.rows)

    @property
    def errors_mm(self) -> list[float]:
        """Placement errors: the worst of the four corners of each placed battery."""
        return [row.placement_error_mm for row in self.rows if row.placement_error_mm is not None]

    @property
    def predicted_mm(self) -> list[float]:
        """Predicted p99 of each unit."""
        return [row.predicted_mm for row in self.rows if row.predicted_mm is not None]

    def as_dict(self) -> dict[str, Any]:
        """For the JSON file."""
        return {
            "units": len(self.rows),
            "good": self.good,
            "interrupted": self.interrupted,
            "placement_error_mm": quantiles(self.errors_mm) | {"max": max(self.errors_mm, default=None)},
            "predicted_p99_mm": quantiles(self.predicted_mm)["p50"],
        }


class Summary(NamedTuple):
    """All of it."""

    both: Run
    single: Run
    table_2: list[dict[str, Any]]
    wall_s: float
    speed: float

    def as_dict(self) -> dict[str, Any]:
        """For the JSON file."""
        cycles_s = [row.cycle_s for row in self.both.rows]
        return {
            "both_cameras": self.both.as_dict(),
            "camera_2_only": self.single.as_dict(),
            "table_2": self.table_2,
            "cycle_s": quantiles(cycles_s),
            "world_speed": self.speed,
            "wall_s": round(self.wall_s, 2),
        }


def quantiles(values: list[float]) -> dict[str, float | None]:
    """Median and 99th percentile (the largest value when there are fewer than 100)."""
    if not values:
        return {"p50": None, "p99": None}
    ordered = sorted(values)
    return {
        "p50": round(statistics.median(ordered), 5),
        "p99": round(ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))], 5),
    }


def heading(title: str, units: int) -> str:
    """Before a run. Offsets in mm, mm, deg; predicted p99 of the worst corner and what came true, um; cycle in s."""
    pad = " " * len(_place(0, units, ""))
    return (
        f"\n{title}, {units} units\n{pad}{'battery dX':>10} {'dY':>6} {'dT':>8}   {'base dX':>8} {'dY':>8} {'dT':>8}   "
        f"{'p99':>6}   {'true':>6}   {'cycle':>6}"
    )


def row_line(run: Run, row: Row) -> str:
    """One unit."""
    number = len(run.rows)
    verdict = "good" if row.good else ("does not fit" if row.placement_error_mm is not None else row.verdict)
    return (
        f"{_place(number, run.units, row.unit)}{_offset(row.found_battery)}   {_offset(row.found_base)}   "
        f"{_um(row.predicted_mm)}   {_um(row.placement_error_mm)}   {row.cycle_s:6.2f}  {verdict}"
    )


def summary_text(summary: Summary) -> str:
    """The paper's Table 1 beside ours."""
    lines = [
        "",
        "Table 1: batteries that lie in their seats",
        f"{'':16}{'paper':>12}{'here':>16}{'error um p50/p99/max':>26}{'predicted p99':>16}",
    ]
    for run in (summary.both, summary.single):
        errors = quantiles(run.errors_mm)
        worst, predicted = max(run.errors_mm, default=None), quantiles(run.predicted_mm)["p50"]
        lines.append(
            f"{run.title:<16}{PAPER_GOOD[run.title]:>8} / 100{run.good:>10} / {len(run.rows)}"
            f"{_um(errors['p50']):>12} /{_um(errors['p99'])} /{_um(worst)}{_um(predicted):>13}"
        )
    cycle = quantiles([row.cycle_s for row in summary.both.rows])
    lines.append(
        f"cycle {cycle['p50']} s (median, world time at speed {summary.speed:g}), all in {summary.wall_s:.1f} s"
    )
    return "\n".join(lines)


def _place(number: int, units: int, unit: str) -> str:
    return f"[{number:>4}/{units}] {unit:<16}"


def _offset(offset: list[float] | None) -> str:
    if offset is None:
        return f"{'not measured':>24}"
    return f"{offset[0]:+8.4f} {offset[1]:+8.4f} {offset[2]:+8.4f}"


def _um(value_mm: float | None) -> str:
    return f"{'-':>6}" if value_mm is None else f"{value_mm * 1000:6.1f}"
