"""An operation under way: what RUN began and END ends, and what can end it before its time."""

import asyncio
from collections.abc import Awaitable, Callable

from simulators.clock import Clock
from simulators.robot.line import Session

DEAD_MAN_S = 0.2


async def wait_until(clock: Clock, world_s: float, interruption: asyncio.Future[str] | None = None) -> None:
    """Wait for a world time, or until interrupted."""
    if interruption is None or clock.now() >= world_s:
        await clock.sleep_until(world_s)
        return
    sleeper = asyncio.ensure_future(clock.sleep_until(world_s))
    try:
        await asyncio.wait((interruption, sleeper), return_when=asyncio.FIRST_COMPLETED)
    finally:
        sleeper.cancel()


class Operation:
    """One operation of one session. `stopped_by_client` is how it ends after ^C; None = ^C does nothing to it."""

    def __init__(self, clock: Clock, session: Session, stopped_by_client: str | None) -> None:
        self.session: Session | None = session
        self.stopped_by_client = stopped_by_client
        self._clock = clock
        self._interruption: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._held_s = clock.now()

    @property
    def is_motion(self) -> bool:
        """Whether the arm moves for it."""
        return self.stopped_by_client is not None

    def interrupt(self, ending: str) -> None:
        """End it before its time; the first reason stands."""
        if not self._interruption.done():
            self._interruption.set_result(ending)

    def hold(self) -> None:
        """The client holds the jog key."""
        self._held_s = self._clock.now()

    async def until(self, world_s: float, *, dead_man: bool = False) -> str | None:
        """Wait for a world time; returns how the operation ends when it is interrupted before, else None."""
        while not self._interruption.done():
            due_s = min(world_s, self._held_s + DEAD_MAN_S) if dead_man else world_s
            if self._clock.now() >= due_s:
                return None if due_s == world_s else "END"
            await wait_until(self._clock, due_s, self._interruption)
        return self._interruption.result()


Work = Callable[[Operation], Awaitable[str]]
