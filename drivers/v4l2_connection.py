"""One connection to a V4L2 camera, from opening to letting go: its thread, its stream, its pictures.

Pictures are fetched on the event loop, which the system calls for that do not hold up. Whatever may wait (opening,
controls, starting and stopping) and the copy of a picture are made in a thread.
"""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress

from drivers.camera import Counters, Frame, Trigger
from drivers.errors import DeviceError, LinkLost, Refused
from drivers.v4l2_capture import BUFFERS, Capture, Wanted
from drivers.v4l2_inbox import Inbox, Picture, Shot
from drivers.worker import Worker

EXPOSED_MARGIN_S = 0.002  # a camera begins to expose within this time of its trigger
LATE_PICTURES = 2  # a new exposure time takes so many pictures of free run to come into force


class Connection:
    """A camera from open() to close(). Used on the event loop; methods with `_now` run in its thread."""

    def __init__(self, wanted: Wanted, on_lost: Callable[[str], None]) -> None:
        self.lost = ""  # why it is of no use any more
        self.inbox: Inbox | None = None
        self.newest_ns = 0  # host time when the newest whole picture came
        self._wanted, self._on_lost = wanted, on_lost
        self._loop = asyncio.get_running_loop()
        self._worker = Worker(wanted.name, self._loop)
        self._capture: Capture | None = None
        self._counters = Counters()
        self._watching = False
        self._ready_s = 0.0  # loop time from which on no picture of an abandoned trigger can come

    @property
    def counters(self) -> Counters:
        """Of this connection so far."""
        return self._counters + self.inbox.counters if self.inbox else self._counters

    @property
    def _device(self) -> Capture:
        if self._capture is None:
            raise LinkLost(self._wanted.name, "not open")
        return self._capture

    # Open and close

    async def open(self) -> None:
        """Connect, check, set; raises DeviceError, OSError."""
        await self._worker.call(self._open_now)

    def _open_now(self) -> None:
        self._capture = Capture(self._wanted)

    def close(self) -> "asyncio.Future[None]":
        """Let the camera go, in the background; the future tells when that is done."""
        self.lose("was closed")
        done = self._worker.call(self._close_now)
        self._worker.finish()
        return done

    def _close_now(self) -> None:
        capture, self._capture = self._capture, None
        if capture is not None:
            with suppress(OSError):
                capture.stop()
            with suppress(OSError):
                capture.close()

    def lose(self, why: str) -> None:
        """From now on this connection is of no use."""
        if self.lost:
            return
        self.lost = why
        self._stop_watching()
        self._end_inbox(f"{self._wanted.path} {why}")
        self._on_lost(why)

    async def answers(self) -> None:
        """Return when the device answers; raises OSError, DeviceError."""
        device = self._device
        await self._worker.call(device.check)

    # Setting

    async def configure(self, exposure_us: float, gain_db: float) -> tuple[float, float]:
        """Set exposure and gain; returns what the camera says that it has."""
        device = self._device
        before = device.exposure
        got = await self._worker.call(lambda: device.set_exposure((exposure_us, gain_db)))
        if self.inbox is not None and got != before and not self._by_trigger:
            self.inbox.floor_ns = time.monotonic_ns() + round(LATE_PICTURES * device.interval_s * 1e9)
        return got

    async def arm(self, trigger: Trigger) -> None:
        """Take pictures by this trigger from now on."""
        device = self._device
        await self.disarm()
        await self._worker.call(lambda: device.start(trigger))
        self.inbox = Inbox(self._wanted.name, trigger, self._give_back)
        self._loop.add_reader(device.node.fileno(), self._on_readable)
        self._watching = True

    async def disarm(self) -> None:
        """Take no more pictures."""
        device = self._device
        self._stop_watching()
        self._end_inbox(f"{self._wanted.path} was disarmed")
        await self._worker.call(device.stop)

    def _stop_watching(self) -> None:
        if self._watching:
            self._watching = False
            self._loop.remove_reader(self._device.node.fileno())

    def _end_inbox(self, why: str) -> None:
        inbox, self.inbox = self.inbox, None
        if inbox is not None:
            inbox.end(LinkLost(self._wanted.name, why))
            self._counters += inbox.counters

    # Pictures

    @property
    def _by_trigger(self) -> bool:
        """Does a software trigger exist, or is the next picture of free run the answer?"""
        return self._device.controls.has_software_trigger

    def _on_readable(self) -> None:
        """Fetch what has come, but let others have their turn, too."""
        try:
            for _ in range(BUFFERS):
                filled = self._device.fetch()
                if filled is None or self.inbox is None:
                    return
                self.inbox.take(filled, self._device.earliest_start_ns(filled), self._device.flaw(filled))
        except OSError as error:
            self.lose(f"does not answer any more ({error.strerror})")
        except DeviceError as error:
            self.lose(f"sent nonsense: {error.detail}")

    def _give_back(self, buffer: int) -> None:
        """A buffer that is not needed any more; nothing when its stream is over."""
        if self._watching:
            try:
                self._device.give_back(buffer)
            except OSError as error:
                self.lose(f"does not answer any more ({error.strerror})")

    async def grab(self, exposed: asyncio.Event | None) -> Frame:
        """A picture whose exposure begins from now on; tells when it is over."""
        inbox = self._armed_for(Trigger.SOFTWARE)
        await asyncio.sleep(max(0.0, self._ready_s - self._loop.time()))
        shot = inbox.shot = Shot(self._loop.create_future(), self._by_trigger)
        timer = None
        try:
            if shot.by_trigger:
                await self._worker.call(lambda: self._press_now(shot))
                timer = self._exposed_later(exposed)
            else:
                shot.floor_ns = time.monotonic_ns()
            picture = await shot.picture
            if exposed is not None:
                exposed.set()
            return await self._frame(picture)
        finally:
            if timer is not None:
                timer.cancel()
            self._leave(shot)

    def _press_now(self, shot: Shot) -> None:
        if shot.picture.done():  # given up before its turn came
            return
        shot.floor_ns = time.monotonic_ns()
        self._device.controls.press()

    def _exposed_later(self, exposed: asyncio.Event | None) -> asyncio.TimerHandle | None:
        if exposed is None:
            return None
        return self._loop.call_later(self._device.exposure[0] / 1e6 + EXPOSED_MARGIN_S, exposed.set)

    def _leave(self, shot: Shot) -> None:
        """Its picture goes back; one that may still come is waited for before the next trigger."""
        if shot.taken is not None:
            self._give_back(shot.taken.filled.buffer)
        elif shot.by_trigger and not shot.picture.done() and not self.lost:
            self._ready_s = self._loop.time() + self._device.exposure[0] * 1e-6 + self._device.interval_s
        shot.picture.cancel()

    async def next_frame(self) -> Frame:
        """The next picture by the line, or the newest in free run."""
        inbox = self._armed_for(Trigger.LINE, Trigger.FREE)
        picture = await inbox.next()
        try:
            frame = await self._frame(picture)
        finally:
            if self.inbox is inbox:
                self._give_back(picture.filled.buffer)
        if self.inbox is not inbox:  # its buffer may have been filled anew meanwhile
            raise LinkLost(self._wanted.name, f"{self._wanted.path} was armed anew")
        return frame

    def _armed_for(self, *triggers: Trigger) -> Inbox:
        if self.inbox is None or self.inbox.trigger not in triggers:
            armed = self.inbox.trigger if self.inbox else "nothing"
            wanted = " or ".join(triggers)
            raise Refused(self._wanted.name, "not armed", f"armed for {armed}, and pictures by {wanted} are asked for")
        return self.inbox

    async def _frame(self, picture: Picture) -> Frame:
        """Copied out of its buffer. The buffer still belongs to us."""
        device, setup, filled = self._device, self._wanted.setup, picture.filled
        exposure_us, gain_db = device.exposure
        pixels, payload = await self._worker.call(lambda: device.copy(filled))
        self._counters += Counters(delivered=1)
        self.newest_ns = picture.received_ns
        return Frame(
            pixels=pixels,
            frame_id=filled.sequence,
            gap=picture.gap,
            exposure_start_ns=picture.start_ns,
            received_ns=picture.received_ns,
            device_ns=filled.stamp_ns,
            exposure_us=exposure_us,
            gain_db=gain_db,
            camera_id=setup.serial,
            region=setup.region,
            pixel_format=setup.pixel_format,
            payload=payload,
        )
