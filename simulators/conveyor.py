"""The belt that brings carriers: one arrives at the stop pin after the belt has run long enough."""

from collections.abc import Callable

TRAVEL_S = 0.8  # of belt running until the next carrier stands at the pin
LEAVE_S = 0.3  # of belt running until a released carrier is out of the light beam
BOUNCE_S = 0.012  # the photoelectric switch chatters this long
BOUNCES = 3


class Conveyor:
    """Position of the carriers as a function of how long the belt has run."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._ran_s = 0.0  # belt seconds since the last event below
        self._driven_since_s: float | None = None
        self._arrived_s = 0.0
        self.occupied = False  # a carrier stands at the station
        self.leaving = False
        self.clamped = False
        self.stuck = False  # fault: the belt turns but nothing comes

    @property
    def moving(self) -> bool:
        """Whether the belt is driven."""
        return self._driven_since_s is not None

    def drive(self, on: bool) -> None:
        """Start or stop the belt."""
        if on and self._driven_since_s is None:
            self._driven_since_s = self._now()
        elif not on and self._driven_since_s is not None:
            self._ran_s += self._now() - self._driven_since_s
            self._driven_since_s = None

    def release(self) -> None:
        """Lower the stop pin for the carrier at the station; it leaves as the belt runs."""
        if self.occupied and not self.leaving:
            self.leaving = True
            self._restart()

    def put(self) -> None:
        """A person sets a carrier down at the station."""
        self.occupied, self.leaving = True, False
        self._arrived_s = self._now()
        self._restart()

    def remove(self) -> None:
        """A person takes the carrier away."""
        self.occupied = self.leaving = self.clamped = False
        self._restart()

    def step(self) -> str | None:
        """What has happened since the last call: "arrived", "left" or None."""
        ran_s = self._belt_s()
        if self.leaving and not self.clamped and ran_s >= LEAVE_S:
            self.occupied = self.leaving = False
            self._restart()
            return "left"
        if not self.occupied and not self.stuck and ran_s >= TRAVEL_S:
            self._arrived_s = self._now() - (ran_s - TRAVEL_S)
            self.occupied = True
            self._restart()
            return "arrived"
        return None

    def photo_switch(self) -> bool:
        """The light beam at the station, with the chatter of the first milliseconds."""
        age_s = self._now() - self._arrived_s
        if self.occupied and age_s < BOUNCE_S:
            return int(age_s / BOUNCE_S * 2 * BOUNCES) % 2 == 0
        return self.occupied

    def _belt_s(self) -> float:
        running_s = 0.0 if self._driven_since_s is None else self._now() - self._driven_since_s
        return self._ran_s + running_s

    def _restart(self) -> None:
        self._ran_s = 0.0
        if self._driven_since_s is not None:
            self._driven_since_s = self._now()
