"""Hands bytes on at the pace of a serial line, in world time."""

import asyncio
from collections.abc import Callable

from simulators.clock import Clock


class Pacer:
    """One direction of a line. `paused` holds it; `wake` lets it go on."""

    def __init__(self, clock: Clock, byte_s: float, sink: Callable[[bytes], None]) -> None:
        self.waiting = bytearray()
        self.paused = False
        self._clock, self._byte_s, self._sink = clock, byte_s, sink
        self._free_s = 0.0
        self._pump: asyncio.Task[None] | None = None

    def put(self, data: bytes) -> None:
        """Send after what is waiting."""
        self.waiting += data
        self.wake()

    def pause(self, on: bool) -> None:
        """Hold, or go on."""
        self.paused = on
        self.wake()

    def wake(self) -> None:
        """Go on if there is something to do."""
        if (self._pump is None or self._pump.done()) and self.waiting and not self.paused:
            self._free_s = max(self._free_s, self._clock.now())
            self._pump = asyncio.create_task(self._run())

    def clear(self) -> None:
        """Forget what is waiting."""
        self.waiting.clear()

    async def close(self) -> None:
        """Stop."""
        if self._pump is not None:
            self._pump.cancel()
            await asyncio.wait((self._pump,))

    async def _run(self) -> None:
        while self.waiting and not self.paused:
            await self._clock.sleep_until(self._free_s + self._byte_s)
            count = min(int((self._clock.now() - self._free_s) / self._byte_s + 1e-6), len(self.waiting))
            self._free_s += count * self._byte_s
            data = bytes(self.waiting[:count])
            del self.waiting[:count]
            if data:
                self._sink(data)
