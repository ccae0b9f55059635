"""Exchanges with the PLC at a fixed rate, until one fails.

Everything happens in the callbacks of the event loop, in two turns of it per exchange: a task that waited for each
answer would cost half as much again.
"""

import asyncio
import time
from collections.abc import Callable, Sequence

from drivers.plc_port import PlcPort


class PlcCycle:
    """`words` says what to write (None: only look); `seen` gets what was read and when it was asked for."""

    def __init__(
        self,
        port: PlcPort,
        period_s: float,
        words: Callable[[], Sequence[int] | None],
        seen: Callable[[Sequence[int], float], None],
    ) -> None:
        self._port = port
        self._period_s = period_s
        self._words = words
        self._seen = seen
        self._loop = asyncio.get_running_loop()
        self._ended: asyncio.Future[None] = self._loop.create_future()
        self._timer: asyncio.TimerHandle | None = None
        self._kicked = False
        self._begun_at_s = self._due_s = 0.0

    async def run(self) -> None:
        """Go round for ever; raises what ended it."""
        self._due_s = self._loop.time()
        self._begin()
        try:
            await self._ended
        finally:
            self._ended.cancel()
            if self._timer is not None:
                self._timer.cancel()
            self._port.close()

    def kick(self) -> None:
        """Have the next exchange now, or as soon as the one under way is over."""
        self._kicked = True
        if self._timer is not None:
            self._timer.cancel()
            self._timer = self._loop.call_at(self._loop.time(), self._begin)

    def _begin(self) -> None:
        self._timer, self._kicked = None, False
        self._begun_at_s = time.monotonic()
        try:
            self._port.begin(self._words(), self._over)
        except Exception as error:  # nobody else would hear of it: a timer has no caller
            self._end(error)

    def _over(self) -> None:
        if self._ended.done():
            return
        try:
            self._seen(self._port.outcome(), self._begun_at_s)
        except Exception as error:
            self._end(error)
            return
        now_s = self._loop.time()
        if now_s >= self._due_s:
            self._due_s = max(self._due_s + self._period_s, now_s)
        self._timer = self._loop.call_at(now_s if self._kicked else self._due_s, self._begin)

    def _end(self, error: Exception) -> None:
        if not self._ended.done():
            self._ended.set_exception(error)
