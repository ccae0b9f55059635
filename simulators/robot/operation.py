"""An operation under way: what began, how it can be ended before its time, and how it ended."""

import asyncio
from collections.abc import Awaitable, Callable

from simulators.clock import Clock
from simulators.robot.codes import Code
from simulators.robot.session import Session

Ending = Code | None  # None: it did what it should


async def wait_until(clock: Clock, world_s: float, interruption: "asyncio.Future[Ending] | None" = None) -> None:
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
    """One operation, of one client or of a program. `after_stop` is how it ends when ^C has stopped it."""

    def __init__(
        self, clock: Clock, session: Session | None, *, moves: bool, after_stop: Ending = Code.STOPPED
    ) -> None:
        self.session = session
        self.moves = moves
        self.after_stop = after_stop
        self.held_s = clock.now()
        self._clock = clock
        self._interruption: asyncio.Future[Ending] = asyncio.get_running_loop().create_future()

    @property
    def interrupted(self) -> bool:
        """Whether it has been told to end."""
        return self._interruption.done()

    @property
    def ending(self) -> Ending:
        """How it ends: as it was interrupted."""
        return self._interruption.result() if self._interruption.done() else None

    def interrupt(self, ending: Ending) -> None:
        """End it before its time; the first reason stands."""
        if not self._interruption.done():
            self._interruption.set_result(ending)

    def hold(self) -> None:
        """The client holds the jog key."""
        self.held_s = self._clock.now()

    async def until(self, world_s: float) -> bool:
        """Wait for a world time; False when it is interrupted before."""
        if not self._interruption.done():
            await wait_until(self._clock, world_s, self._interruption)
        return not self._interruption.done()


Work = Callable[[Operation], Awaitable[Ending]]
