"""What time does to a camera's lens and lamp: focus that works loose, light that fails. Exact at any world time."""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass

LIGHT_OFF = 0.02  # what the lamps of the hall still give
MOST_BLUR_PX = 3.0  # the renderer's tables end there
FAULTS = ("dark", "dim", "defocus")


@dataclass(frozen=True)
class Drift:
    """A quantity that changes steadily from a moment on."""

    value: float
    per_s: float = 0.0
    since_s: float = 0.0

    def at(self, at_s: float) -> float:
        """Its value at a world time."""
        return self.value + self.per_s * max(0.0, at_s - self.since_s)


@dataclass
class Wear:
    """The state of one camera; as built nothing is worn."""

    defocus_px: Drift = Drift(0.0)  # sigma that the defocus adds, in squares, to the lens' own blur
    light: Drift = Drift(1.0)  # part of the lamp's light that it gives

    def blur_px(self, lens_px: float, at_s: float) -> float:
        """Sigma of the point spread at a world time."""
        return min(math.hypot(lens_px, self.defocus_px.at(at_s)), MOST_BLUR_PX)

    def light_at(self, at_s: float) -> float:
        """Part of the lamp's light at a world time."""
        return max(LIGHT_OFF, self.light.at(at_s))

    def inject(self, fault: str, now_s: float, **params: object) -> None:
        """Put one of FAULTS in force from now on. Raises ValueError for parameters that it does not take."""
        verb: Callable[..., None] = getattr(self, fault)
        try:
            inspect.signature(verb).bind(now_s, **params)
        except TypeError as error:
            raise ValueError(f"camera fault {fault!r}: {error}") from error
        verb(now_s, **params)

    def dark(self, now_s: float, *, on: bool = True) -> None:
        """The lamp is out."""
        self.dim(now_s, light=LIGHT_OFF if on else 1.0)

    def dim(self, now_s: float, *, light: float = 1.0, lost_per_s: float = 0.0) -> None:
        """The lamp gives less (or more) light than when new, and loses more from now on."""
        if not (0.0 <= light <= 4.0 and lost_per_s >= 0.0):
            raise ValueError(f"a lamp gives 0 to 4 times its light and only loses it (got {light}, {lost_per_s})")
        self.light = Drift(light, -lost_per_s, now_s)

    def defocus(self, now_s: float, *, px: float = 0.0, px_per_s: float = 0.0) -> None:
        """The lens is out of focus, and drifts further from now on."""
        if not (0.0 <= px <= MOST_BLUR_PX and px_per_s >= 0.0):
            raise ValueError(f"a defocus is 0 to {MOST_BLUR_PX:g} px and only grows (got {px}, {px_per_s})")
        self.defocus_px = Drift(px, px_per_s, now_s)
