"""World time: seconds that run `speed` times faster than the wall, and that wait for the simulator's own work.

A picture takes the simulator tens of milliseconds to compute. Were world time to run on meanwhile, a fast world
would see slow cameras. So whoever works on something that is due at a known world time says so, and the clock
stands at that time until the work is done: `with clock.due_by(t): ...`.
"""

import asyncio
import time
from collections.abc import Iterator
from contextlib import contextmanager

SHORTEST_SLEEP_S = 0.0002


class Clock:
    """The one clock of a simulated cell. `now()` is monotonic and in world seconds."""

    def __init__(self, speed: float = 1.0) -> None:
        if not speed > 0:
            raise ValueError(f"speed must be above 0 (got {speed})")
        self.speed = speed
        self._wall_s = time.monotonic()
        self._world_s = 0.0
        self._dues: dict[object, float] = {}

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

    async def sleep_until(self, at_s: float) -> None:
        """Return at world time `at_s` or at once if that is past."""
        while (left_s := at_s - self.now()) > 0:
            await asyncio.sleep(max(left_s / self.speed, SHORTEST_SLEEP_S))

    async def sleep(self, for_s: float) -> None:
        """Sleep for so many world seconds."""
        await self.sleep_until(self.now() + for_s)
