"""The belt's motion: it speeds up and coasts down at constant rates, worked out from the time since its last order."""

import math
from collections.abc import Callable

SPEED_MM_S = 200.0
SPEED_UP_MM_S2 = 1000.0
COAST_DOWN_MM_S2 = 1500.0


class Belt:
    """How far the belt has run, and how fast it is, as functions of world time. It runs one way only."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._since_s = now()
        self._from_mm = 0.0
        self._from_mm_s = 0.0
        self._to_mm_s = 0.0

    def aim(self, speed_mm_s: float) -> None:
        """From now on move towards this speed."""
        if speed_mm_s != self._to_mm_s:
            self._from_mm, self._from_mm_s = self.ran_mm(), self.speed_mm_s()
            self._since_s, self._to_mm_s = self._now(), speed_mm_s

    def speed_mm_s(self) -> float:
        """Now."""
        age_s = self._now() - self._since_s
        return self._to_mm_s if age_s >= self._ramp_s() else self._from_mm_s + self._rate_mm_s2() * age_s

    def ran_mm(self) -> float:
        """Since it was built."""
        age_s, ramp_s = self._now() - self._since_s, self._ramp_s()
        return self._from_mm + self._in_ramp_mm(min(age_s, ramp_s)) + self._to_mm_s * max(age_s - ramp_s, 0.0)

    def reaches_s(self, mm: float) -> float:
        """World time at which it has run so far, if no other order comes; inf when it stops before."""
        left_mm, ramp_s = mm - self._from_mm, self._ramp_s()
        after_mm = left_mm - self._in_ramp_mm(ramp_s)
        if after_mm > 0:
            return self._since_s + ramp_s + after_mm / self._to_mm_s if self._to_mm_s else math.inf
        root_mm_s = math.sqrt(max(self._from_mm_s**2 + 2 * self._rate_mm_s2() * left_mm, 0.0))
        return self._since_s + (2 * left_mm / (self._from_mm_s + root_mm_s) if left_mm > 0 else 0.0)

    def _rate_mm_s2(self) -> float:
        return SPEED_UP_MM_S2 if self._to_mm_s > self._from_mm_s else -COAST_DOWN_MM_S2

    def _ramp_s(self) -> float:
        return (self._to_mm_s - self._from_mm_s) / self._rate_mm_s2()

    def _in_ramp_mm(self, for_s: float) -> float:
        return (self._from_mm_s + self._rate_mm_s2() * for_s / 2) * for_s
