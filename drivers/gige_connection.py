"""One connection to a GigE Vision camera, from opening to letting go: its threads, its arming, its pictures."""

import asyncio
import threading
import time
from collections.abc import Callable
from contextlib import suppress

from drivers.aravis import Device
from drivers.aravis_library import NO_LINK, AravisError
from drivers.camera import Counters, Frame, Trigger
from drivers.errors import LinkLost, Refused
from drivers.gige_inbox import Inbox, Reading, Shot
from drivers.gige_receiver import Received, Receiver
from drivers.gige_setup import Payload, Wanted, check_serial, set_format, set_packet_delay, set_trigger, take_control
from drivers.worker import Worker, post

EXPOSED_MARGIN_S = 0.002  # a camera begins to expose within this time of acknowledging a trigger
SETTLE_S = 0.01  # from the end of an exposure until the camera takes the next trigger
CLOCK_RUNS_S = 0.005
CLOCK_HOLDS_NS = 1_000_000_000  # two quartz clocks part by some 50 us in this time
TEMPERATURE = "DeviceTemperature"


class Connection:
    """A camera from open() to close(). Used on the event loop; methods with `_now` run in its worker thread."""

    def __init__(self, wanted: Wanted, on_lost: Callable[[str], None]) -> None:
        self.lost = ""  # why it is of no use any more
        self.is_open = False
        self.has_clock = True
        self.packet_size = 0
        self.exposure = (0.0, 0.0)  # us and dB, as read back
        self.inbox: Inbox | None = None  # while armed
        self._wanted = wanted
        self._on_lost = on_lost
        self._loop = asyncio.get_running_loop()
        self._worker = Worker(f"{wanted.name} control", self._loop)
        self._stop = threading.Event()
        self._device: Device | None = None
        self._receiver: Receiver | None = None
        self._tick_rate = 0
        self._payload = Payload(0, False)
        self._ready_s = 0.0  # loop time from which on a trigger is sure to be taken
        self._before = Counters()  # of earlier armings
        self._doubtful = False  # a picture of an earlier trigger may still come, and nothing tells it apart

    @property
    def counters(self) -> Counters:
        """Of this connection so far."""
        return self._before + self._of_this_arming()

    def _of_this_arming(self) -> Counters:
        inbox, receiver = self.inbox, self._receiver
        if inbox is None or receiver is None:
            return Counters()
        return inbox.counters + receiver.packets

    # Open and close

    async def open(self) -> None:
        """Connect, check, set; raises DeviceError, AravisError, LibraryMissing."""
        await self._worker.call(self._open_now)
        self.is_open = True

    def _open_now(self) -> None:
        wanted = self._wanted
        self._device = device = Device(wanted.address)
        check_serial(device, wanted)
        take_control(device, self._stop)
        self._payload = set_format(device, wanted)
        set_packet_delay(device, wanted)
        self._tick_rate = device.tick_rate()
        self.has_clock = self._clock_runs_now(device)
        self.exposure = device.set_exposure(*wanted.exposure) if wanted.exposure else device.exposure()

    def _clock_runs_now(self, device: Device) -> bool:
        """Can it be read, and does it go on?"""
        if not self._tick_rate:
            return False
        try:
            before = device.ticks()
            self._stop.wait(CLOCK_RUNS_S)
            return device.ticks() != before
        except AravisError as error:
            if error.code in NO_LINK:
                raise
            return False

    def close(self) -> "asyncio.Future[None]":
        """Let the camera go, in the background; the future tells when that is done."""
        answers = self.is_open and not self.lost
        self._on_lost = _nobody
        self.lose("was closed")
        self._stop.set()
        self._before, self.inbox = self.counters, None
        done = self._worker.call(lambda: self._close_now(answers))
        self._worker.finish()
        return done

    def _close_now(self, answers: bool) -> None:
        device, receiver = self._device, self._receiver
        if device is not None and receiver is not None and answers:
            with suppress(AravisError):
                device.stop()
        self._end_receiving_now()
        if device is not None:
            device.close()

    def lose(self, why: str) -> None:
        """From now on this connection is of no use."""
        if not self.lost:
            self.lost = why
            self._on_lost(why)
        if self.inbox is not None:
            self.inbox.end(LinkLost(self._wanted.name, f"{self._wanted.where} {self.lost}"))

    # Arming

    async def arm(self, trigger: Trigger) -> None:
        """Take pictures by this trigger."""
        await self.disarm()
        await self._worker.call(lambda: self._arm_now(trigger))
        self._doubtful = False

    async def disarm(self) -> None:
        """Take no more pictures; whoever waits for one is told."""
        if self.inbox is not None:
            self.inbox.end(Refused(self._wanted.name, "not armed", "it was disarmed"))
        self._before, self.inbox = self.counters, None
        await self._worker.call(self._stop_now)

    def _arm_now(self, trigger: Trigger) -> None:
        device = self._opened()
        set_trigger(device, self._wanted, trigger)
        # A new stream each time: the library drops pictures whose numbers begin anew within an old one.
        stream = device.stream(self._wanted.socket_buffer_bytes, with_chunks=self._payload.with_chunks)
        self.packet_size = device.packet_size()
        self._receiver = Receiver(device, self._wanted.setup, self._payload, stream, (self._came, self._went))
        inbox = Inbox(self._wanted.name, self._wanted.setup, trigger, self._read_clock_now(), has_clock=self.has_clock)
        inbox.exposure = self.exposure
        self.inbox = inbox
        device.start()
        self._receiver.start(f"{self._wanted.name} receive")

    def _stop_now(self) -> None:
        if self._receiver is not None:
            self._opened().stop()
        self._end_receiving_now()

    def _end_receiving_now(self) -> None:
        receiver, self._receiver = self._receiver, None
        if receiver is not None:
            receiver.stop()

    def _came(self, received: Received) -> None:
        """In the receive thread."""
        post(self._loop, self._on_arrival, received)

    def _went(self) -> None:
        """In the receive thread."""
        post(self._loop, self.lose, "lost control, or it is gone")

    def _on_arrival(self, received: Received) -> None:
        if self.inbox is not None:
            self.inbox.take(received)

    # Pictures

    async def configure(self, exposure_us: float, gain_db: float) -> tuple[float, float]:
        """Set exposure and gain; returns what the camera says that it has.

        By the line and in free run, pictures exposed before that are not delivered any more.
        """
        clock = await self._worker.call(lambda: self._configure_now(exposure_us, gain_db))
        if self.inbox is not None and not self.has_clock:
            await self.arm(self.inbox.trigger)
        elif self.inbox is not None:
            self.inbox.exposure = self.exposure
            self.inbox.begin_anew(clock)
        return self.exposure

    def _configure_now(self, exposure_us: float, gain_db: float) -> Reading:
        self.exposure = self._opened().set_exposure(exposure_us, gain_db)
        return self._read_clock_now()

    @property
    def triggered(self) -> bool:
        """Did the camera acknowledge the newest trigger?"""
        return self.inbox is not None and self.inbox.shot is not None and self.inbox.shot.acknowledged

    async def grab(self, exposed: asyncio.Event | None) -> Frame:
        """Trigger, tell when the exposure is over, and wait for that trigger's picture."""
        inbox = self._armed_for(Trigger.SOFTWARE)
        if self._doubtful:
            await self.arm(Trigger.SOFTWARE)
            inbox = self._armed_for(Trigger.SOFTWARE)
        await asyncio.sleep(max(0.0, self._ready_s - self._loop.time()))
        inbox.shot = shot = Shot(self._loop.create_future())
        try:
            await self._worker.call(lambda: self._trigger_now(shot))
            if exposed is not None:
                self._loop.call_later(self.exposure[0] / 1e6 + EXPOSED_MARGIN_S, exposed.set)
            return await shot.picture
        finally:
            self._doubtful = not (self.has_clock or shot.has_picture)
            exposing_s = 0.0 if shot.has_picture else self.exposure[0] / 1e6 + SETTLE_S
            self._ready_s = self._loop.time() + exposing_s
            shot.picture.cancel()

    async def running_inbox(self) -> Inbox:
        """Where the pictures of the line or of free run are, with a fresh reading of the clocks."""
        inbox = self._armed_for(Trigger.LINE, Trigger.FREE)
        if time.monotonic_ns() - inbox.clock.host_ns > CLOCK_HOLDS_NS:
            inbox.clock = await self._worker.call(self._read_clock_now)
        return inbox

    async def temperature_c(self) -> float | None:
        """Of the camera, if it has a thermometer; asks the camera in any case. Raises AravisError, LinkLost."""
        device = self._opened()
        await self._worker.call(self._read_clock_now)
        return await self._worker.call(lambda: device.real(TEMPERATURE) if device.has(TEMPERATURE) else None)

    def _armed_for(self, *triggers: Trigger) -> Inbox:
        inbox = self.inbox
        if inbox is None or inbox.trigger not in triggers:
            state = f"armed for {inbox.trigger}" if inbox is not None else "not armed"
            detail = f"it is {state}, this needs {' or '.join(triggers)}"
            raise Refused(self._wanted.name, "not armed", detail)
        return inbox

    def _trigger_now(self, shot: Shot) -> None:
        if shot.picture.done():  # given up before its turn came
            return
        shot.clock = self._read_clock_now()
        shot.sent_ns = time.monotonic_ns()
        self._opened().trigger()
        shot.acknowledged = True

    def _read_clock_now(self) -> Reading:
        """Of a camera without a clock: the host's time twice; it is asked something all the same."""
        device = self._opened()
        if not self.has_clock:
            device.packet_size()
            return Reading(time.monotonic_ns(), time.monotonic_ns())
        asked_ns = time.monotonic_ns()
        ticks = device.ticks()
        return Reading((asked_ns + time.monotonic_ns()) // 2, ticks * 1_000_000_000 // self._tick_rate)

    def _opened(self) -> Device:
        if self._device is None:
            raise LinkLost(self._wanted.name, "not open")
        return self._device


def _nobody(_why: str) -> None:
    """The one who let it go knows."""
