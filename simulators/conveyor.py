"""The conveyor: carriers come with the belt until the stop pin, stand there clamped, and leave when the pin is down."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from simulators.belt import SPEED_MM_S, Belt

APART_MM = 140.0  # from the station to the next carrier when one has left
APART_SCATTER_MM = 10.0  # more or less, evenly
LEAVE_MM = 40.0  # until a released carrier is out of the light beam
CLAMP_S = 0.06  # until the clamp has closed; it opens at once
BOUNCE_S = 0.015  # the photoelectric switch chatters at most so long when a carrier comes or goes
MOST_BOUNCES = 4
CREEP_MM_S = 5.0
Fault = Literal["stuck", "blocked", "creeps"]
FAULTS: tuple[Fault, ...] = ("stuck", "blocked", "creeps")
Event = Literal["arrived", "left"]


class Conveyor:
    """Belt, carriers, clamp and light beam as functions of world time.

    Faults: "stuck" = the belt turns but nothing comes; "blocked" = it does not turn; "creeps" = it does not stop.
    """

    def __init__(self, now: Callable[[], float], rng: np.random.Generator) -> None:
        self._now = now
        self._rng = rng
        self._belt = Belt(now)
        self._driven = False
        self._faults: set[Fault] = set()
        self._mark_mm = 0.0  # where the belt was when the last thing happened
        self._apart_mm = APART_MM
        self._clamp_since_s: float | None = None
        self._beam_changed_s = -BOUNCE_S
        self._bounce_s, self._bounces = BOUNCE_S, MOST_BOUNCES
        self.occupied = False  # a carrier stands at the station
        self.leaving = False

    @property
    def moving(self) -> bool:
        """Whether the belt turns."""
        return self._belt.speed_mm_s() > 0

    @property
    def clamped(self) -> bool:
        """Whether the clamp has closed."""
        return self._clamp_since_s is not None and self._now() - self._clamp_since_s >= CLAMP_S

    def drive(self, on: bool) -> None:
        """Switch the motor."""
        self._driven = on
        self._aim()

    def clamp(self, on: bool) -> None:
        """Move the clamp."""
        if not on:
            self._clamp_since_s = None
        elif self._clamp_since_s is None:
            self._clamp_since_s = self._now()

    def release(self) -> None:
        """Lower the stop pin for the carrier at the station; it leaves as the belt runs."""
        if self.occupied and not self.leaving:
            self.leaving = True
            self._mark_mm = self._belt.ran_mm()

    def put(self) -> None:
        """A person sets a carrier down at the station and clamps it."""
        self.leaving = False
        self._mark_mm = self._belt.ran_mm()
        self._clamp_since_s = self._now() - CLAMP_S
        self._stand(True, self._now())

    def remove(self) -> None:
        """A person takes the carrier away."""
        self.leaving = False
        self._clamp_since_s = None
        self._mark_mm = self._belt.ran_mm()
        self._stand(False, self._now())

    def inject(self, fault: Fault, on: bool = True) -> None:
        """Make something go wrong, or well again."""
        (self._faults.add if on else self._faults.discard)(fault)
        if fault == "stuck":
            self._mark_mm = self._belt.ran_mm()
        self._aim()

    def step(self) -> Event | None:
        """What has happened since the last call, one thing at a time."""
        if self.leaving and self._clamp_since_s is None and self._has_run(LEAVE_MM):
            self.leaving = False
            self._happened(False, LEAVE_MM)
            self._apart_mm = APART_MM + self._rng.uniform(-APART_SCATTER_MM, APART_SCATTER_MM)
            return "left"
        if not self.occupied and "stuck" not in self._faults and self._has_run(self._apart_mm):
            self._happened(True, self._apart_mm)
            return "arrived"
        return None

    def photo_switch(self) -> bool:
        """The light beam at the station, with the chatter of its first milliseconds."""
        age_s = self._now() - self._beam_changed_s
        if age_s >= self._bounce_s:
            return self.occupied
        return self.occupied ^ bool(int(age_s / self._bounce_s * 2 * self._bounces) % 2)

    def _aim(self) -> None:
        driven_mm_s = SPEED_MM_S if self._driven else CREEP_MM_S * ("creeps" in self._faults)
        self._belt.aim(0.0 if "blocked" in self._faults else driven_mm_s)

    def _has_run(self, mm: float) -> bool:
        return self._belt.ran_mm() - self._mark_mm >= mm

    def _happened(self, occupied: bool, after_mm: float) -> None:
        self._mark_mm += after_mm
        self._stand(occupied, self._belt.reaches_s(self._mark_mm))

    def _stand(self, occupied: bool, since_s: float) -> None:
        """A carrier breaks the light beam, or none does any more; the switch chatters."""
        if occupied != self.occupied:
            self.occupied, self._beam_changed_s = occupied, since_s
            self._bounce_s = self._rng.uniform(0.2, 1.0) * BOUNCE_S
            self._bounces = int(self._rng.integers(1, MOST_BOUNCES + 1))
