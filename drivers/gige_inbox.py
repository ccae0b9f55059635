"""Which of the pictures that come are wanted: those of the right moment, each once. On the event loop.

Before each trigger the camera's clock is latched and read. A picture whose exposure began before that reading belongs
to an earlier trigger, whatever its number says; it is counted and dropped. By the line and in free run the reading
that counts is that of arming.

A camera without a clock is armed anew, with a new stream, after every trigger whose picture did not come and after
every change, so nothing of before can come. Its pictures' numbers must go up, and what it dates is not looked at.
"""

import asyncio
import time
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from drivers.camera import Counters, Frame, Setup, Trigger
from drivers.errors import DeviceError, FrameLost
from drivers.gige_receiver import Received

MOST_WAITING = {Trigger.SOFTWARE: 1, Trigger.LINE: 4, Trigger.FREE: 1}
FRESH_NS = 500_000_000  # a picture of free run that waited longer is none of now
BLOCKS = 0xFFFF  # picture numbers go from 1 to this and begin anew
AHEAD_NS = 1_000_000_000  # no picture is exposed so long after it came
NEAR_THE_END = BLOCKS - 1000
GIGABIT_BPS = 1e9


class Reading(NamedTuple):
    """Both clocks at one moment, ns."""

    host_ns: int
    device_ns: int

    def host_of(self, device_ns: int) -> int:
        """The host's time of a moment that the camera's clock tells."""
        return self.host_ns + device_ns - self.device_ns


@dataclass(slots=True)
class Shot:
    """One software trigger, and the picture that is awaited."""

    picture: "asyncio.Future[Frame]"
    clock: Reading | None = None  # just before the trigger
    sent_ns: int = 0
    acknowledged: bool = False

    @property
    def has_picture(self) -> bool:
        """Did it come?"""
        return self.picture.done() and not self.picture.cancelled() and self.picture.exception() is None


class Inbox:
    """The pictures of one arming. `clock` maps the camera's time to the host's, and may be read anew.

    Without `has_clock` it is the host's time twice.
    """

    def __init__(self, name: str, setup: Setup, trigger: Trigger, clock: Reading, *, has_clock: bool = True) -> None:
        self.trigger = trigger
        self.counters = Counters()
        self.exposure = (0.0, 0.0)  # us and dB as read back, for pictures that do not bring their own
        self.shot: Shot | None = None
        self.newest_ns = 0  # host time when the newest whole picture came
        self._name, self._setup, self._has_clock = name, setup, has_clock
        self._armed = self.clock = clock
        self._waiting: deque[Frame | FrameLost] = deque()
        self._changed = asyncio.Event()
        self._ended: DeviceError | None = None
        self._last_id: int | None = None

    def begin_anew(self, clock: Reading) -> None:
        """Pictures exposed before now are none of those that are wanted from now on."""
        self._armed = self.clock = clock
        self.counters += Counters(stale=len(self._waiting))
        self._waiting.clear()

    def end(self, error: DeviceError) -> None:
        """No more pictures: whoever waits, or asks from now on, gets this error."""
        self._ended = error
        self._changed.set()
        if self.shot is not None and not self.shot.picture.done():
            self.shot.picture.set_exception(error)

    def take(self, received: Received) -> None:
        """Sort in what came."""
        repeated = received.frame_id == self._last_id
        if not self._has_clock:
            received = received._replace(device_ns=received.received_ns)
            repeated = repeated or self._goes_back(received.frame_id)
        gap = self._count_gap(received.frame_id)
        self._last_id = received.frame_id
        if self.trigger is Trigger.SOFTWARE:
            self._for_shot(received, gap, repeated=repeated)
        elif self._is_early(received, self._armed, repeated=repeated):
            self.counters += Counters(stale=1)
        else:
            self._keep(received, gap)

    async def next_frame(self) -> Frame:
        """The oldest by the line, the newest in free run. Raises FrameLost, and what ended it."""
        while True:
            if self._waiting and not self._is_old(self._waiting[0]):
                return self._given(self._waiting.popleft())
            if self._ended is not None:
                raise self._ended
            self._changed.clear()
            await self._changed.wait()

    def _given(self, waiting: Frame | FrameLost) -> Frame:
        if isinstance(waiting, FrameLost):
            raise waiting
        self.counters += Counters(delivered=1)
        return waiting

    def _is_old(self, first: Frame | FrameLost) -> bool:
        """In free run: of another time than now. It is dropped."""
        if self.trigger is not Trigger.FREE or not isinstance(first, Frame):
            return False
        if time.monotonic_ns() - first.received_ns < FRESH_NS:
            return False
        self._waiting.popleft()
        self.counters += Counters(overrun=1)
        return True

    def _for_shot(self, received: Received, gap: int, *, repeated: bool) -> None:
        shot = self.shot
        if shot is None or shot.picture.done() or self._is_early(received, shot.clock, repeated=repeated):
            self.counters += Counters(stale=1)
            return
        flaw = received.flaw or _misdated(received, shot.clock)
        if flaw or shot.clock is None:  # a whole picture is early without a reading of the clock
            self.counters += Counters(incomplete=1)
            shot.picture.set_exception(FrameLost(self._name, flaw))
            return
        self.counters += Counters(delivered=1)
        shot.picture.set_result(self._frame(received, shot.clock, gap, not_before_ns=shot.sent_ns))

    def _is_early(self, received: Received, clock: Reading | None, *, repeated: bool) -> bool:
        """Taken too soon, or the same once more. The time of an incomplete one may be missing (0)."""
        early = clock is None or received.device_ns < clock.device_ns
        if received.pixels is None:
            return early and received.device_ns > 0
        return early or repeated

    def _keep(self, received: Received, gap: int) -> None:
        """Put it where next_frame() finds it. A lost picture of the line must be told, one of free run need not."""
        flaw = received.flaw or _misdated(received, self.clock)
        if flaw:
            self.counters += Counters(incomplete=1)
            if self.trigger is Trigger.FREE:
                return
            self._waiting.append(FrameLost(self._name, flaw))
        else:
            self._waiting.append(self._frame(received, self.clock, gap, not_before_ns=self._armed.host_ns))
        while len(self._waiting) > MOST_WAITING[self.trigger]:
            self._waiting.popleft()
            self.counters += Counters(overrun=1)
        self._changed.set()

    def _goes_back(self, frame_id: int) -> bool:
        """Its number is lower than the last, and numbers have not begun anew."""
        return self._last_id is not None and frame_id < self._last_id <= NEAR_THE_END

    def _count_gap(self, frame_id: int) -> int:
        """How many numbers are missing before this one. One that does not go up says nothing."""
        if self._last_id is None:
            return 0
        step = frame_id - self._last_id
        if step < 0 and self._last_id > NEAR_THE_END:
            step += BLOCKS
        gap = step - 1 if 0 < step <= BLOCKS else 0
        self.counters += Counters(gaps=gap)
        return gap

    def _frame(self, received: Received, clock: Reading, gap: int, *, not_before_ns: int) -> Frame:
        assert received.pixels is not None
        self.newest_ns = received.received_ns
        exposure_us, gain_db = received.exposure or self.exposure
        began_ns = clock.host_of(received.device_ns)
        if not self._has_clock:  # reckoned back: it was exposed, and came through a gigabit link
            began_ns -= round(exposure_us * 1e3 + received.payload.nbytes * 8e9 / GIGABIT_BPS)
        return Frame(
            pixels=received.pixels,
            frame_id=received.frame_id,
            gap=gap,
            exposure_start_ns=min(max(began_ns, not_before_ns), received.received_ns),
            received_ns=received.received_ns,
            device_ns=received.device_ns if self._has_clock else 0,
            exposure_us=exposure_us,
            gain_db=gain_db,
            camera_id=self._setup.serial,
            region=self._setup.region,
            pixel_format=self._setup.pixel_format,
            payload=received.payload,
        )


def _misdated(received: Received, clock: Reading | None) -> str:
    """Why its time cannot be believed, or nothing. By such a time a stale picture could not be told."""
    if clock is None:
        return ""
    ahead_s = (clock.host_of(received.device_ns) - received.received_ns) / 1e9
    if ahead_s * 1e9 <= AHEAD_NS:
        return ""
    return f"picture {received.frame_id} is dated {ahead_s:.1f} s after it came: the camera dates by another clock"
