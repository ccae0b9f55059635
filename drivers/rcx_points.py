"""Points of the controller's table as text and as values. Pure."""

import re
from collections.abc import Iterable
from typing import NamedTuple

from drivers.rcx import DECIMAL, INTEGER
from drivers.rcx_dialect import Dialect

LINE = re.compile(r"P\s*(\d{1,5})\s*=\s*(.*)", re.ASCII)
NUMBERS = 6
HANDS = (0, 1, 2)


class StoredPoint(NamedTuple):
    """Six numbers, in pulses or in mm and degrees; the elbow's side (0: not said) and turns of the two arms."""

    values: tuple[float, float, float, float, float, float]
    in_pulses: bool
    hand: int = 0
    turns: tuple[int, int] = (0, 0)


def parse_point(text: str) -> StoredPoint | None:
    """`x y z r a b [hand [turn turn]]`: pulses when no number has a decimal point; None when it is anything else."""
    fields = text.split()
    if len(fields) not in (6, 7, 9) or not all(DECIMAL.fullmatch(field) for field in fields[:NUMBERS]):
        return None
    extra = fields[NUMBERS:]
    if not all(INTEGER.fullmatch(field) for field in extra) or (extra and int(extra[0]) not in HANDS):
        return None
    a, b, c, d, e, f = map(float, fields[:NUMBERS])
    hand, *turns = [*map(int, extra), 0, 0, 0][:3]
    return StoredPoint(
        (a, b, c, d, e, f), not any("." in field for field in fields[:NUMBERS]), hand, (turns[0], turns[1])
    )


def parse_points(lines: Iterable[str]) -> dict[int, StoredPoint]:
    """`Pn=...` lines by number; raises ValueError that names the line that is none."""
    points: dict[int, StoredPoint] = {}
    for line in lines:
        found = LINE.fullmatch(line.strip())
        point = parse_point(found[2]) if found else None
        if found is None or point is None:
            raise ValueError(f"{line!r} is no point: P1= and six numbers")
        points[int(found[1])] = point
    return points


def point_line(point_number: int, point: StoredPoint, dialect: Dialect) -> str:
    """`Pn=...` as the controller takes it; raises ValueError for a number that it does not have."""
    if not 0 <= point_number <= dialect.highest_point:
        raise ValueError(f"P{point_number} is outside P0 .. P{dialect.highest_point}")
    numbers = " ".join(str(round(value)) if point.in_pulses else dialect.number(value) for value in point.values)
    hand = (
        f" {point.hand} {point.turns[0]} {point.turns[1]}" if any(point.turns) else f" {point.hand}" * bool(point.hand)
    )
    return f"P{point_number}={numbers}{hand}"
