"""World time: seconds that run `speed` times faster than the wall, and that wait for the simulator's own work.

A picture takes the simulator tens of milliseconds to compute. Were world time to run on meanwhile, a fast world
would see slow cameras. So whoever works on something that is due at a known world time says so, and the clock
stands at that time until the work is done: `with clock.due_by(t): ...`.
"""

import asyncio
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager


class Clock:
    """The one clock of a simulated cell. `now()` is monotonic and in world seconds."""

    def __init__(self, speed: float = 1.0) -> None:
        if not speed > 0:
            raise ValueError(f"speed must be above 0 (got {speed})")
        self.speed = speed
        self._wall_s = time.monotonic()
        self._world_s = 0.0
        self._dues: dict[object, float] = {}
        self._goes_on = asyncio.Event()  # set, and replaced, whenever somebody's work is done

    def now(self) -> float:
        """World seconds since the start."""
        wall_s = time.monotonic()
        wanted = self._world_s + (wall_s - self._wall_s) * self.speed
        self._wall_s = wall_s
        self._world_s = max(self._world_s, min([wanted, *self._dues.values()]))
        return self._world_s

    @contextmanager
    def due_by(self, at_s: float) -> Iterator[None]:
        """World time does not pass `at_s` until the block is left."""
        key = object()
        self._dues[key] = max(at_s, self.now())
        try:
            yield
        finally:
            self.now()
            del self._dues[key]
            self._goes_on.set()
            self._goes_on = asyncio.Event()

    async def sleep_until(self, at_s: float) -> None:
        """Return at world time `at_s` or at once if that is past. A sleeper costs nothing while time stands."""
        while (left_s := at_s - self.now()) > 0:
            if min(self._dues.values(), default=math.inf) <= self._world_s:
                await self._goes_on.wait()
            else:
                await asyncio.sleep(left_s / self.speed)

    async def sleep(self, for_s: float) -> None:
        """Sleep for so many world seconds."""
        await self.sleep_until(self.now() + for_s)
