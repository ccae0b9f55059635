"""How a motion goes in time: from 0 to 1 with S-shaped ramps, in closed form. Pure.

A ramp builds its acceleration up over a quarter of its time, holds it for a half and takes it away over a quarter, so
that the mean acceleration is three quarters of the peak. Everything is in fractions of a way, per second.
"""

import bisect
import math
from dataclasses import dataclass
from typing import NamedTuple

RISE = 0.25  # of a ramp's time: its acceleration builds up, and as long it goes away again
STOP_RISE_S = 0.01  # for a stop on the way to build up its deceleration


class Phase(NamedTuple):
    """From `at_s` on: the fraction of the way done, its rate, the rate's rate, and that one's rate."""

    at_s: float
    done: float
    speed: float
    accel: float
    jerk: float

    def state_at(self, world_s: float) -> tuple[float, float, float]:
        """Fraction done, its rate, and the rate's rate."""
        t = max(world_s - self.at_s, 0.0)
        done = self.done + t * (self.speed + t * (self.accel / 2 + t * self.jerk / 6))
        return done, self.speed + t * (self.accel + t * self.jerk / 2), self.accel + t * self.jerk


@dataclass(frozen=True, slots=True)
class Profile:
    """How far along its way a motion is, piecewise of constant jerk, until it rests at `final`."""

    phases: tuple[Phase, ...]
    end_s: float
    final: float = 1.0

    @property
    def begin_s(self) -> float:
        """World time of the start."""
        return self.phases[0].at_s

    def done_at(self, world_s: float) -> float:
        """Fraction done, from 0 before the start to `final`."""
        if world_s >= self.end_s:
            return self.final
        return min(max(self._phase(world_s).state_at(world_s)[0], 0.0), self.final)

    def state_at(self, world_s: float) -> tuple[float, float, float]:
        """Fraction done, its rate, and the rate's rate."""
        if world_s >= self.end_s or world_s < self.begin_s:
            return self.done_at(world_s), 0.0, 0.0
        return self._phase(world_s).state_at(world_s)

    def reaches_s(self, done: float) -> float:
        """World time at which this fraction is passed; the end when it never is."""
        early_s, late_s = self.begin_s, self.end_s
        if done >= self.final:
            return late_s
        while late_s - early_s > 1e-7:
            middle_s = (early_s + late_s) / 2
            early_s, late_s = (middle_s, late_s) if self.done_at(middle_s) < done else (early_s, middle_s)
        return late_s

    def braked(self, world_s: float, decel: float) -> "Profile":
        """The same until now, then a stop; the same altogether when it ends no later than the stop would."""
        if not self.begin_s <= world_s < self.end_s:
            return self
        stop = _stop(world_s, self._phase(world_s).state_at(world_s), decel)
        if stop.end_s >= self.end_s or stop.final > self.final:
            return self
        return Profile((*self._until(world_s), *stop.phases), stop.end_s, stop.final)

    def cut(self, world_s: float) -> "Profile":
        """The same until now, then rest at once: something hard was in the way."""
        if not self.begin_s <= world_s < self.end_s:
            return self
        done = self.done_at(world_s)
        return Profile((*self._until(world_s), Phase(world_s, done, 0.0, 0.0, 0.0)), world_s, done)

    def _phase(self, world_s: float) -> Phase:
        return self.phases[max(bisect.bisect_right(self.phases, world_s, key=lambda phase: phase.at_s) - 1, 0)]

    def _until(self, world_s: float) -> tuple[Phase, ...]:
        return tuple(phase for phase in self.phases if phase.at_s < world_s)


def at_rest(done: float = 1.0, since_s: float = -math.inf) -> Profile:
    """No motion at all."""
    return Profile((Phase(since_s, done, 0.0, 0.0, 0.0),), since_s, done)


def s_curve(start_s: float, speed: float, accel: float, decel: float) -> Profile:
    """The quickest way from 0 to 1 within these peak rates per second (infinite rates: at once)."""
    if math.isinf(speed) or math.isinf(accel):
        return Profile((Phase(start_s, 1.0, 0.0, 0.0, 0.0),), start_s)
    mean_accel, mean_decel = accel * (1 - RISE), decel * (1 - RISE)
    top = min(speed, math.sqrt(2 * mean_accel * mean_decel / (mean_accel + mean_decel)))
    up_s, down_s = top / mean_accel, top / mean_decel
    cruise_s = max(1 - top * (up_s + down_s) / 2, 0.0) / top
    pieces = [*_ramp(up_s, accel), (cruise_s, 0.0, 0.0), *_ramp(down_s, -decel)]
    return _joined(start_s, (0.0, 0.0), pieces, final=1.0)


def _ramp(ramp_s: float, peak: float) -> list[tuple[float, float, float]]:
    """Duration, first acceleration and jerk of each piece."""
    rise_s = ramp_s * RISE
    jerk = peak / rise_s
    return [(rise_s, 0.0, jerk), (ramp_s - 2 * rise_s, peak, 0.0), (rise_s, peak, -jerk)]


def _stop(start_s: float, state: tuple[float, float, float], decel: float) -> Profile:
    """From this state to rest: build up a deceleration, hold it, take it away."""
    done, speed, accel = state
    jerk = decel / STOP_RISE_S
    if speed <= 0 and accel <= 0:
        return _joined(start_s, (done, 0.0), [(0.0, 0.0, 0.0)])
    if accel < 0 and speed <= accel * accel / (2 * jerk):  # the motion ends by itself as quickly as it can be ended
        return _joined(start_s, (done, speed), [(2 * speed / -accel, accel, accel * accel / (2 * speed))])
    peak = min(decel, math.sqrt(jerk * speed + accel * accel / 2))
    hold_s = max((speed + (accel * accel / 2 - peak * peak) / jerk) / peak, 0.0)
    pieces = [(max(accel + peak, 0.0) / jerk, accel, -jerk), (hold_s, -peak, 0.0), (peak / jerk, -peak, jerk)]
    return _joined(start_s, (done, speed), pieces)


def _joined(
    start_s: float, begun: tuple[float, float], pieces: list[tuple[float, float, float]], final: float | None = None
) -> Profile:
    """Pieces of constant jerk one after the other; it rests where they end unless `final` says so exactly."""
    at_s, (done, speed) = start_s, begun
    phases = []
    for duration_s, accel, jerk in pieces:
        phase = Phase(at_s, done, speed, accel, jerk)
        phases.append(phase)
        at_s += duration_s
        done, speed, _ = phase.state_at(at_s)
    return Profile(tuple(phases), at_s, done if final is None else final)
