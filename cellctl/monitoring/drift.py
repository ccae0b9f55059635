"""Whether the cell drifts, by how far its batteries lie off in their bases, unit after unit; and why. Pure.

Shift: a CUSUM per axis on dX, dY and dT against the first units after teaching. It is self-starting (Hawkins and
Olwell, 1998): every unit is compared with mean and spread of those before it, so no run is needed to begin with.
Slack and limit are chosen by Brook's and Evans' Markov chain: a shift by 10 um is to be found within 25 units in 19 of
20 cases while the spread is at most 8 um, and a quiet cell is to be blamed less than once in 5,000 units.

Cause: a regression of dX and dY over the last 300 units or so. What is the same for all units comes from the places of
the cameras, the robot or the temperature; what grows with the turn of R, from the tool's rotation centre; what grows
with the battery's offset in the cup, from the scale of camera 2. The scale of camera 1 cannot be learnt like this: the
bases lie within a tenth of a millimetre.

Lengths are in um, angles in mdeg, in the frame of the base; an error is where the battery is less where it should be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

import numpy as np

BASELINE_UNITS = 500  # mean and spread of so many units are the measure of all later ones
FEWEST_UNITS = 12  # before that, nothing is judged
MEMORY_UNITS = 300.0  # of the regression
CLIP = 4.0  # one wild unit counts as so many sigmas
SUSPICIOUS = 0.4  # part of the limit from which on units are no measure of later ones
LEAST_SPREAD = 0.3  # um and mdeg: below that a cell is not believed to repeat
SURE = 4.5  # sigmas of a slope that is reported as a cause
EVERY_UNITS = 10  # slopes are looked at once in so many units: they cannot change faster
LEAST_SPAN = 1e-6  # of the normal matrix' eigenvalues: below that all units were placed alike


class Rule(NamedTuple):
    """Of a CUSUM, in sigmas: what a unit may be off without counting, and the sum that is a signal."""

    slack: float
    limit: float


AXES = ("dX", "dY", "dT")
RULES = (Rule(0.55, 8.5), Rule(0.55, 8.5), Rule(0.8, 7.0))


class Observation(NamedTuple):
    """One unit: how far its battery is off, the turn of R at its seat, and the battery's offset in the cup.

    Turn and offset are differences from the golden assembly; the offset is in the tool's frame.
    """

    dx_um: float
    dy_um: float
    dt_mdeg: float
    turned_deg: float
    offset_x_mm: float
    offset_y_mm: float


class Shift(NamedTuple):
    """Of the battery's measured corner, and of its direction."""

    dx_um: float = 0.0
    dy_um: float = 0.0
    dt_mdeg: float = 0.0

    @property
    def sentence(self) -> str:
        """For people."""
        return f"dX {self.dx_um:+.1f} dY {self.dy_um:+.1f} um dT {self.dt_mdeg:+.1f} mdeg"


class Cause(StrEnum):
    """What makes all batteries lie off."""

    CONSTANT = "constant"
    TOOL_CENTRE = "tool centre"
    CAMERA_2_SCALE = "camera 2 scale"


class Axis(NamedTuple):
    """What is known of one axis: the units of its baseline, and both CUSUMs with how long they have been above 0."""

    units: int = 0
    mean: float = 0.0
    squares: float = 0.0  # sum of squared deviations from the mean
    high: float = 0.0
    low: float = 0.0
    high_units: int = 0
    low_units: int = 0

    @property
    def spread(self) -> float:
        """1 sigma of a unit."""
        return max(math.sqrt(self.squares / max(1, self.units - 1)), LEAST_SPREAD)


class Moments(NamedTuple):
    """Sums over the last units, of 1, the turn t (rad), the offset o (mm), the error e (um) and their products."""

    units: float = 0.0
    t: float = 0.0
    ox: float = 0.0
    oy: float = 0.0
    tt: float = 0.0
    oo: float = 0.0
    t_ox: float = 0.0
    t_oy: float = 0.0
    ex: float = 0.0
    ey: float = 0.0
    t_ex: float = 0.0
    t_ey: float = 0.0
    o_e: float = 0.0
    ee: float = 0.0


class Alarm(NamedTuple):
    """What a person was told, and has to do something about."""

    cause: Cause
    sentence: str


AT_FIRST, NO_SUMS, NO_SHIFT = Axis(), Moments(), Shift()


@dataclass(frozen=True)
class Drift:
    """All that is known of a cell's drift since it was taught; the next unit makes the next one."""

    units: int = 0
    axes: tuple[Axis, Axis, Axis] = (AT_FIRST, AT_FIRST, AT_FIRST)
    moments: Moments = NO_SUMS
    correction: Shift = NO_SHIFT  # is added to where batteries are placed
    alarms: tuple[Alarm, ...] = ()  # one per cause


class Estimate(NamedTuple):
    """A quantity and its 1 sigma."""

    value: float
    sd: float

    @property
    def sigmas(self) -> float:
        """How clearly it is not 0."""
        return abs(self.value) / self.sd


class Causes(NamedTuple):
    """What the regression says, were each unit placed without correction."""

    constant_x_um: Estimate
    constant_y_um: Estimate
    centre_x_um: Estimate  # of the tool's rotation centre, in the tool's frame
    centre_y_um: Estimate
    scale_ppm: Estimate  # of camera 2

    @property
    def centre_text(self) -> str:
        """For people."""
        x, y = self.centre_x_um, self.centre_y_um
        return f"({x.value:+.0f}, {y.value:+.0f}) +- {max(x.sd, y.sd):.0f} um"

    @property
    def scale_text(self) -> str:
        """For people."""
        return f"{self.scale_ppm.value:+.0f} +- {self.scale_ppm.sd:.0f} ppm"

    @property
    def clearest_slope(self) -> tuple[Cause, float]:
        """The cause other than a constant, and how many sigmas it is clear."""
        centre = max(self.centre_x_um.sigmas, self.centre_y_um.sigmas)
        scale = self.scale_ppm.sigmas
        return (Cause.TOOL_CENTRE, centre) if centre >= scale else (Cause.CAMERA_2_SCALE, scale)


class Signal(NamedTuple):
    """The cell has drifted: the cause, by how much batteries are off by now, and for how many units."""

    cause: Cause
    shift: Shift
    units: int


def after(drift: Drift, seen: Observation) -> tuple[Drift, Signal | None]:
    """What is known after one more unit, and whether that is a signal."""
    errors = seen[:3]
    axes = tuple(_axis_after(axis, error, rule) for axis, error, rule in zip(drift.axes, errors, RULES, strict=True))
    moments = _moments_after(drift.moments, seen, drift.correction)
    known = replace(drift, units=drift.units + 1, axes=(axes[0], axes[1], axes[2]), moments=moments)
    return known, _signal(known)


def restarted(drift: Drift) -> Drift:
    """The same baseline, both CUSUMs of every axis at 0: after something was done about a signal."""
    quiet = [axis._replace(high=0.0, low=0.0, high_units=0, low_units=0) for axis in drift.axes]
    return replace(drift, axes=(quiet[0], quiet[1], quiet[2]))


def _axis_after(axis: Axis, error: float, rule: Rule) -> Axis:
    sigmas = _normal(axis, error)
    high, low = max(0.0, axis.high + sigmas - rule.slack), max(0.0, axis.low - sigmas - rule.slack)
    suspicious = max(high, low) > SUSPICIOUS * rule.limit
    units, mean, squares = axis[:3] if suspicious else _baseline_after(axis, error)
    return Axis(
        units=units,
        mean=mean,
        squares=squares,
        high=high,
        low=low,
        high_units=axis.high_units + 1 if high > 0.0 else 0,
        low_units=axis.low_units + 1 if low > 0.0 else 0,
    )


def _baseline_after(axis: Axis, error: float) -> tuple[int, float, float]:
    """Number, mean and squared deviations of the baseline's units with one more, unless it is complete."""
    if axis.units >= BASELINE_UNITS:
        return axis.units, axis.mean, axis.squares
    reach = CLIP * axis.spread if axis.units >= FEWEST_UNITS else math.inf
    away = min(max(error - axis.mean, -reach), reach)
    mean = axis.mean + away / (axis.units + 1)
    return axis.units + 1, mean, axis.squares + away * (away + axis.mean - mean)


def _normal(axis: Axis, error: float) -> float:
    """How far off a unit is in sigmas, were mean and spread known: Student's t made normal as by Wallace (1959)."""
    if axis.units < FEWEST_UNITS:
        return 0.0
    t = (error - axis.mean) / (axis.spread * math.sqrt(1.0 + 1.0 / axis.units))
    free = axis.units - 1
    z = (8 * free + 1) / (8 * free + 3) * math.sqrt(free * math.log1p(t * t / free))
    return math.copysign(min(z, CLIP), t)


def _moments_after(sums: Moments, seen: Observation, correction: Shift) -> Moments:
    """The sums with one more unit, as it would lie without correction; older units fade."""
    t, ox, oy = math.radians(seen.turned_deg), seen.offset_x_mm, seen.offset_y_mm
    ex, ey = seen.dx_um - correction.dx_um, seen.dy_um - correction.dy_um
    new = Moments(
        *(1.0, t, ox, oy, t * t, ox * ox + oy * oy, t * ox, t * oy),
        *(ex, ey, t * ex, t * ey, ox * ex + oy * ey, ex * ex + ey * ey),
    )
    kept = 1.0 - 1.0 / MEMORY_UNITS
    return Moments(*(kept * old + value for old, value in zip(sums, new, strict=True)))


def causes(drift: Drift) -> Causes | None:
    """The regression; None while there are too few units or they were all placed alike.

    e = constant - t J centre - scale o, with J a quarter turn: where the tool's rotation centre is believed by
    `centre` off, a tool that is turned by t puts the battery off by -t J centre.
    """
    m = drift.moments
    if m.units < FEWEST_UNITS:
        return None
    normal = np.array(
        [
            [m.units, 0.0, 0.0, m.t, -m.ox],
            [0.0, m.units, -m.t, 0.0, -m.oy],
            [0.0, -m.t, m.tt, 0.0, m.t_oy],
            [m.t, 0.0, 0.0, m.tt, -m.t_ox],
            [-m.ox, -m.oy, m.t_oy, -m.t_ox, m.oo],
        ]
    )
    right = np.array([m.ex, m.ey, -m.t_ey, m.t_ex, -m.o_e])
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    even = normal / np.outer(scale, scale)
    if np.linalg.eigvalsh(even)[0] < LEAST_SPAN:
        return None
    inverse = np.linalg.inv(even)
    found = inverse @ (right / scale) / scale
    left = max(m.ee - float(right @ found), 0.0) / max(1.0, 2.0 * m.units - 5.0)
    sd = np.sqrt(np.diag(inverse) * max(left, LEAST_SPREAD**2)) / scale
    of = [Estimate(float(value), float(error)) for value, error in zip(found, sd, strict=True)]
    return Causes(of[0], of[1], of[2], of[3], Estimate(1000.0 * of[4].value, 1000.0 * of[4].sd))


def _signal(drift: Drift) -> Signal | None:
    shift, units = _shift(drift)
    slopes_due = drift.units % EVERY_UNITS == 0 and drift.units >= 4 * FEWEST_UNITS
    if (units or slopes_due) and (by := causes(drift)) is not None:
        slope, sigmas = by.clearest_slope
        if sigmas > SURE:
            return Signal(slope, shift, min(drift.units, round(MEMORY_UNITS)))
    return Signal(Cause.CONSTANT, shift, units) if units else None


def _shift(drift: Drift) -> tuple[Shift, int]:
    """By how much the axes that give a signal have moved, and for how many units; 0 units: none does."""
    moved, since = [], 0
    for axis, rule in zip(drift.axes, RULES, strict=True):
        side, total, units = max((1, axis.high, axis.high_units), (-1, axis.low, axis.low_units), key=lambda s: s[1])
        beyond = total > rule.limit
        moved.append(side * (rule.slack + total / units) * axis.spread if beyond else 0.0)
        since = max(since, units) if beyond else since
    return Shift(*moved), since
