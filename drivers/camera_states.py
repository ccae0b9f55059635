"""The states of a camera as a stream that any number of readers follow."""

import asyncio
import time
from collections import deque
from collections.abc import AsyncGenerator

from drivers.camera import State, StateChange

KEPT = 32  # changes that wait for a slow reader


class States:
    """The present state and who follows it. For one event loop."""

    def __init__(self) -> None:
        self.now = StateChange(State.OFFLINE, "not opened yet", time.monotonic_ns())
        self._readers: list[tuple[deque[StateChange], asyncio.Event]] = []

    def to(self, state: State, why: str = "") -> None:
        """Go to this state; nothing when it is so already, for the same reason."""
        if (self.now.state, self.now.why) == (state, why):
            return
        self.now = StateChange(state, why, time.monotonic_ns())
        for waiting, changed in self._readers:
            waiting.append(self.now)
            changed.set()

    async def follow(self) -> AsyncGenerator[StateChange, None]:
        """The present state, then every change."""
        reader = deque([self.now], maxlen=KEPT), asyncio.Event()
        self._readers.append(reader)
        waiting, changed = reader
        try:
            while True:
                while waiting:
                    yield waiting.popleft()
                changed.clear()
                await changed.wait()
        finally:
            self._readers = [other for other in self._readers if other is not reader]
