"""The vacuum cup: pressure over time, and when a part is held.

Pressure follows the valve with one time constant; a sealed cup reaches the ejector's full vacuum, an open one only
a little. A part lets go when the pressure has risen above what its weight needs.
"""

import math
from collections.abc import Callable

SEALED_KPA = -72.0
OPEN_KPA = -6.0
HOLDING_KPA = -15.0  # weaker than this and a 60 g battery falls
SUCK_TAU_S = 0.030
VENT_TAU_S = 0.060
BLOW_TAU_S = 0.010


class Suction:
    """Valve, blow-off and pressure at the cup, as functions of world time."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._from_kpa = 0.0
        self._to_kpa = 0.0
        self._tau_s = VENT_TAU_S
        self._since_s = now()
        self.valve = False
        self.blow = False
        self.sealed = False

    def pressure_kpa(self, at_s: float | None = None) -> float:
        """Pressure against the room, negative when sucking."""
        age_s = max((self._now() if at_s is None else at_s) - self._since_s, 0.0)
        return self._to_kpa + (self._from_kpa - self._to_kpa) * math.exp(-age_s / self._tau_s)

    def set(self, *, valve: bool | None = None, blow: bool | None = None, sealed: bool | None = None) -> None:
        """Change something about the cup; the pressure moves on from where it is."""
        wanted = (
            self.valve if valve is None else valve,
            self.blow if blow is None else blow,
            self.sealed if sealed is None else sealed,
        )
        if wanted == (self.valve, self.blow, self.sealed):
            return
        self._from_kpa = self.pressure_kpa()
        self._since_s = self._now()
        self.valve, self.blow, self.sealed = wanted
        if self.valve:
            self._to_kpa, self._tau_s = (SEALED_KPA if self.sealed else OPEN_KPA), SUCK_TAU_S
        else:
            self._to_kpa, self._tau_s = 0.0, (BLOW_TAU_S if self.blow else VENT_TAU_S)

    def lets_go_s(self) -> float | None:
        """World time at which a held part falls off, None while it is held for good."""
        if self._to_kpa <= HOLDING_KPA:
            return None
        if self._from_kpa >= HOLDING_KPA:
            return self._since_s
        return self._since_s + self._tau_s * math.log((self._from_kpa - self._to_kpa) / (HOLDING_KPA - self._to_kpa))
