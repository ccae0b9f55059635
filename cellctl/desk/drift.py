"""`cellctl drift`: the drift that the last units have shown, as a table for people or as JSON for programs."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import click
from pydantic import ValidationError

from cellctl.desk.records import units
from cellctl.faults import RecordLost
from cellctl.monitoring.drift import AXES, BASELINE_UNITS, RULES, Drift, Observation, Shift, causes
from cellctl.monitoring.watch import Kept

MOST_ROWS = 5000
BAR = 20


class Looked(NamedTuple):
    """A unit whose gap was measured."""

    unit: str
    seen: Observation


def show(journal: Path, last: int, *, as_json: bool) -> int:
    """Print it; 1 when there are alarms. Raises RecordLost without a journal or when no unit was looked at."""
    newest, looked = _read(journal, last)
    if as_json:
        click.echo(json.dumps(_as_dict(newest, looked)))
    else:
        click.echo("\n".join(_lines(newest, looked)))
    return 1 if newest.known.alarms else 0


def _read(journal: Path, last: int) -> tuple[Kept, list[Looked]]:
    """What the newest unit knew, and the last units of the same golden assembly whose gaps were measured."""
    kept = [(str(row["unit"]), record) for row in units(journal, last=MOST_ROWS) if (record := _kept(row["data"]))]
    if not kept:
        raise RecordLost("no unit has been looked at after placing; see gap.when in the recipe")
    newest = kept[-1][1]
    looked = [Looked(unit, record.seen) for unit, record in kept if record.of == newest.of and record.seen]
    return newest, looked[-last:]


def _kept(data: object) -> Kept | None:
    drift = data.get("drift") if isinstance(data, dict) else None
    try:
        return Kept.model_validate_json(json.dumps(drift)) if drift else None
    except ValidationError:
        return None  # of another release


def _lines(newest: Kept, looked: list[Looked]) -> Iterator[str]:
    known = newest.known
    yield f"{'unit':<16} {'dX um':>8} {'dY um':>8} {'dT mdeg':>8}   {'R deg':>8} {'cup x':>8} {'cup y mm':>8}"
    for unit, seen in looked:
        placed = f"{seen.turned_deg:8.3f} {seen.offset_x_mm:8.3f} {seen.offset_y_mm:8.3f}"
        yield f"{unit:<16} {seen.dx_um:8.1f} {seen.dy_um:8.1f} {seen.dt_mdeg:8.1f}   {placed}"
    yield f"\ngolden assembly {newest.of}, {known.units} units looked at"
    yield from _axis_lines(known, looked)
    yield from _cause_lines(known)
    correction = "none" if known.correction == Shift() else known.correction.sentence
    yield f"correction in force: {correction}"
    yield from (alarm.sentence for alarm in known.alarms)
    if not known.alarms:
        yield "no drift found"


def _axis_lines(known: Drift, looked: list[Looked]) -> Iterator[str]:
    yield f"{'axis':<16} {'first':>8} {'1 sigma':>8} {'of units':>8}   {'now':>8} {'CUSUM':>8} {'limit':>8}"
    for number, (name, axis, rule) in enumerate(zip(AXES, known.axes, RULES, strict=True)):
        now = sum(seen[number] for _, seen in looked) / len(looked) if looked else 0.0
        total = max(axis.high, axis.low)
        bar = "#" * min(BAR, round(BAR * total / rule.limit))
        measure = f"{axis.mean:8.1f} {axis.spread:8.1f} {axis.units:>4}/{BASELINE_UNITS}"
        yield f"{name:<16} {measure}  {now:8.1f} {total:8.1f} {rule.limit:8.1f} |{bar:<{BAR}}|"


def _cause_lines(known: Drift) -> Iterator[str]:
    by = causes(known)
    if by is None:
        yield "causes: too few units, or all were placed alike"
        return
    x, y = by.constant_x_um, by.constant_y_um
    yield f"the same for all units: dX {x.value:+.1f} +- {x.sd:.1f} um, dY {y.value:+.1f} +- {y.sd:.1f} um"
    yield f"with the turn of R, the tool's rotation centre: {by.centre_text}"
    yield f"with the offset in the cup, camera 2's scale: {by.scale_text}"
    yield "camera 1's scale cannot be learnt from production: the bases lie too near to one another"


def _as_dict(newest: Kept, looked: list[Looked]) -> dict[str, object]:
    by = causes(newest.known)
    return {
        "golden_assembly": newest.of,
        "known": newest.model_dump(mode="json")["known"],
        "causes": {name: estimate._asdict() for name, estimate in by._asdict().items()} if by else None,
        "units": [{"unit": unit, **seen._asdict()} for unit, seen in looked],
    }
