"""Which of the pictures that a V4L2 device gives are wanted: those of the right moment, each once. On the event loop.

A picture counts by the earliest moment at which its exposure may have begun. In answer to a trigger that must not be
before the trigger; a device without one runs free, and its first picture that began after the request is the answer.
"""

import asyncio
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from drivers.camera import Counters, Trigger
from drivers.errors import DeviceError, FrameLost
from drivers.v4l2_abi import Filled

MOST_WAITING = {Trigger.SOFTWARE: 0, Trigger.LINE: 4, Trigger.FREE: 1}
FRESH_NS = 500_000_000  # a picture of free run that waited longer is none of now
COUNT = 1 << 32  # picture numbers


class Picture(NamedTuple):
    """A picture in its buffer, not copied yet."""

    filled: Filled
    start_ns: int  # not before this its exposure began
    received_ns: int
    gap: int


@dataclass(slots=True)
class Shot:
    """One request for a picture. Until `floor_ns` is known no picture is the right one."""

    picture: "asyncio.Future[Picture]"
    by_trigger: bool  # the device was told to take it
    floor_ns: int | None = None

    @property
    def taken(self) -> Picture | None:
        """The picture, if it came."""
        came = self.picture.done() and not self.picture.cancelled() and self.picture.exception() is None
        return self.picture.result() if came else None


class Inbox:
    """The pictures of one arming. Those that are not wanted go back through `give_back` at once."""

    def __init__(self, name: str, trigger: Trigger, give_back: Callable[[int], None]) -> None:
        self.trigger = trigger
        self.counters = Counters()
        self.shot: Shot | None = None
        self.floor_ns = time.monotonic_ns()  # older ones are not wanted, whoever asks
        self._name, self._give_back = name, give_back
        self._waiting: deque[Picture | FrameLost] = deque()
        self._changed = asyncio.Event()
        self._ended: DeviceError | None = None
        self._last: int | None = None  # picture's number
        self._newest_ns = 0  # stamp of the latest good picture: an earlier one was seen, or overtaken

    def end(self, error: DeviceError) -> None:
        """No more pictures: whoever waits, or asks from now on, gets this error."""
        self._ended = error
        self._changed.set()
        if self.shot is not None and not self.shot.picture.done():
            self.shot.picture.set_exception(error)

    def take(self, filled: Filled, start_ns: int, flaw: str) -> None:
        """Sort in what came. A damaged picture may have no time stamp (0)."""
        repeated = filled.stamp_ns <= self._newest_ns and not flaw
        if not flaw:
            self._newest_ns = max(self._newest_ns, filled.stamp_ns)
        picture = Picture(filled, start_ns, time.monotonic_ns(), self._count_gap(filled.sequence))
        floor_ns = self._wanted_from()
        early = floor_ns is None or start_ns < floor_ns
        if repeated or (early and not (flaw and filled.stamp_ns <= 0)):
            self._drop(picture, Counters(stale=1))
        elif flaw:
            self._drop(picture, Counters(incomplete=1))
            self._tell_loss(FrameLost(self._name, flaw))
        else:
            self._keep(picture)

    async def next(self) -> Picture:
        """The oldest by the line, the newest in free run. Raises FrameLost, and what ended it."""
        while True:
            while self._waiting:
                first = self._waiting.popleft()
                if isinstance(first, FrameLost):
                    raise first
                if self.trigger is Trigger.LINE or time.monotonic_ns() - first.received_ns < FRESH_NS:
                    return first
                self._drop(first, Counters(overrun=1))
            if self._ended is not None:
                raise self._ended
            self._changed.clear()
            await self._changed.wait()

    def _wanted_from(self) -> int | None:
        """From which moment on pictures are wanted; None when none is."""
        if self.trigger is not Trigger.SOFTWARE:
            return self.floor_ns
        shot = self.shot
        if shot is None or shot.picture.done() or shot.floor_ns is None:
            return None
        return max(shot.floor_ns, self.floor_ns)

    def _drop(self, picture: Picture, why: Counters) -> None:
        self.counters += why
        self._give_back(picture.filled.buffer)

    def _tell_loss(self, lost: FrameLost) -> None:
        """A lost picture that was triggered must be told; in free run the next one will do."""
        if self.trigger is Trigger.LINE:
            self._put(lost)
        elif self.trigger is Trigger.SOFTWARE and self.shot is not None and self.shot.by_trigger:
            self.shot.picture.set_exception(lost)

    def _keep(self, picture: Picture) -> None:
        if self.trigger is Trigger.SOFTWARE:
            assert self.shot is not None
            self.shot.picture.set_result(picture)
        else:
            self._put(picture)

    def _put(self, item: Picture | FrameLost) -> None:
        self._waiting.append(item)
        while len(self._waiting) > MOST_WAITING[self.trigger]:
            oldest = self._waiting.popleft()
            if isinstance(oldest, Picture):
                self._drop(oldest, Counters(overrun=1))
        self._changed.set()

    def _count_gap(self, number: int) -> int:
        """How many numbers are missing before this one. A number that does not go up says nothing."""
        last, self._last = self._last, number
        if last is None:
            return 0
        step = (number - last) % COUNT
        gap = step - 1 if 0 < step < COUNT // 2 else 0
        self.counters += Counters(gaps=gap)
        return gap
