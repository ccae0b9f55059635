"""One connection to a GigE Vision camera, from opening to letting go: its threads, its buffers, its pictures."""

import asyncio
import queue
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from drivers.aravis import ACCESS_DENIED, MONO8, AravisError, Arrived, Device, Memory, Stream
from drivers.camera import Frame
from drivers.errors import FrameLost, LinkLost, Mismatch

POLL_S = 0.05
CONTROL_RETRY_S = 0.1
HEARTBEAT_MARGIN_S = 0.5
LENT_BUFFERS = 4
EXPOSED_MARGIN_S = 0.002  # a camera begins to expose within this time of acknowledging a trigger
SETTLE_S = 0.01  # from the end of an exposure until the camera takes the next trigger

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Wanted:
    """Which camera, and how it is to be."""

    name: str
    address: str
    serial: str
    width: int
    height: int
    socket_buffer_bytes: int | None = None
    exposure: tuple[float, float] | None = None  # us and dB; None: as the camera has it


@dataclass(frozen=True, slots=True)
class Counters:
    """Pictures and packets of one connection or more."""

    delivered: int = 0
    stale: int = 0  # of earlier triggers, or doubled: dropped
    incomplete: int = 0
    packets_resent: int = 0
    packets_missing: int = 0

    def __add__(self, other: "Counters") -> "Counters":
        mine, theirs = self.tuple(), other.tuple()
        return Counters(*(a + b for a, b in zip(mine, theirs, strict=True)))

    def tuple(self) -> tuple[int, ...]:
        """In the order of the fields."""
        return self.delivered, self.stale, self.incomplete, self.packets_resent, self.packets_missing


@dataclass(slots=True)
class _Shot:
    """One trigger, and the picture that is awaited."""

    picture: "asyncio.Future[Frame]"
    floor_ns: int | None = None  # camera clock before the trigger
    floor_host_ns: int = 0  # host clock at that reading
    sent_ns: int = 0
    acknowledged: bool = False


class Worker:
    """A thread for blocking calls in turn. Daemonic: a call that is stuck must not keep the process from ending."""

    def __init__(self, name: str, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._jobs: queue.SimpleQueue[tuple[asyncio.Future[Any], Callable[[], Any]] | None] = queue.SimpleQueue()
        threading.Thread(target=self._work, name=name, daemon=True).start()

    def call(self, function: Callable[[], T]) -> "asyncio.Future[T]":
        """Have it called in turn. Cancelling the future does not stop the call."""
        answer: asyncio.Future[T] = self._loop.create_future()
        self._jobs.put((answer, function))
        return answer

    def finish(self) -> None:
        """End the thread after the calls already asked for."""
        self._jobs.put(None)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            answer, function = job
            try:
                result = function()
            except Exception as error:  # not handled here: it is raised where the answer is awaited
                post(self._loop, _fail, answer, error)
            else:
                post(self._loop, _give, answer, result)


def post(loop: asyncio.AbstractEventLoop, function: Callable[..., None], *arguments: object) -> None:
    """Have the loop call it; nothing when the loop is closed, for then nobody waits."""
    with suppress(RuntimeError):
        loop.call_soon_threadsafe(function, *arguments)


def _give(answer: "asyncio.Future[Any]", result: object) -> None:
    if not answer.done():
        answer.set_result(result)


def _fail(answer: "asyncio.Future[Any]", error: Exception) -> None:
    if not answer.done():
        answer.set_exception(error)


class Connection:
    """A camera from open() to close(). Used on the event loop; methods with `_now` run in its worker thread."""

    def __init__(self, wanted: Wanted) -> None:
        self.lost = ""  # why it is of no use any more
        self.is_open = False
        self.packet_size = 0
        self._wanted = wanted
        self._loop = asyncio.get_running_loop()
        self._worker = Worker(f"{wanted.name} control", self._loop)
        self._stop = threading.Event()
        self._receiver: threading.Thread | None = None
        self._device: Device | None = None
        self._stream: Stream | None = None
        self._tick_rate = 0
        self._exposure = (0.0, 0.0)
        self._shot: _Shot | None = None
        self._ready_s = 0.0  # loop time from which on a trigger is sure to be taken
        self._last_frame = -1
        self._delivered = self._stale = self._incomplete = 0

    @property
    def counters(self) -> Counters:
        """Of this connection so far."""
        stream = self._stream
        resent, missing = (stream.count("n_resent_packets"), stream.count("n_missing_packets")) if stream else (0, 0)
        return Counters(self._delivered, self._stale, self._incomplete, resent, missing)

    # Open and close

    async def open(self) -> None:
        """Connect, check, arm; raises DeviceError, AravisError, LibraryMissing."""
        await self._worker.call(self._open_now)
        self.is_open = True

    def _open_now(self) -> None:
        wanted = self._wanted
        self._device = device = Device(wanted.address)
        serial = device.serial()
        if serial != wanted.serial:
            detail = f"the camera at {wanted.address} has serial number {serial!r}, not {wanted.serial!r}"
            raise Mismatch(wanted.name, detail)
        self._take_control_now(device)
        payload = device.set_format(wanted.width, wanted.height)
        if payload != wanted.width * wanted.height:
            detail = f"a picture has {payload} bytes, not {wanted.width} x {wanted.height}"
            raise Mismatch(wanted.name, detail)
        self._tick_rate = device.tick_rate()
        if not self._tick_rate:
            raise Mismatch(wanted.name, "the camera has no clock that can be read, so stale pictures would pass")
        self._exposure = device.set_exposure(*wanted.exposure) if wanted.exposure else device.exposure()
        self._stream = device.stream(wanted.socket_buffer_bytes)
        self.packet_size = device.packet_size()
        for _ in range(LENT_BUFFERS):
            self._stream.push(self._memory())
        device.start()
        self._receiver = threading.Thread(target=self._receive, name=f"{wanted.name} receive", daemon=True)
        self._receiver.start()

    def _take_control_now(self, device: Device) -> None:
        """Get control. A program that died keeps it until the camera's heartbeat time is over: wait that long."""
        if device.is_controller:
            return
        until = time.monotonic() + device.number("GevHeartbeatTimeout") / 1e3 + HEARTBEAT_MARGIN_S
        while not self._stop.is_set():
            try:
                return device.take_control()
            except AravisError as error:
                if error.code != ACCESS_DENIED or time.monotonic() > until:
                    raise
            self._stop.wait(CONTROL_RETRY_S)

    def close(self) -> "asyncio.Future[None]":
        """Let the camera go, in the background; the future tells when that is done."""
        answers = self.is_open and not self.lost
        self.lose("was closed")
        self._stop.set()
        done = self._worker.call(lambda: self._close_now(answers))
        self._worker.finish()
        return done

    def _close_now(self, answers: bool) -> None:
        if self._receiver is not None:
            self._receiver.join()
        if self._device is not None and answers:
            with suppress(AravisError):
                self._device.stop()
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()
        if self._device is not None:
            self._device.close()

    def lose(self, why: str) -> None:
        """From now on this connection is of no use."""
        self.lost = self.lost or why
        if self._shot is not None and not self._shot.picture.done():
            where = f"camera {self._wanted.serial} at {self._wanted.address}"
            self._shot.picture.set_exception(LinkLost(self._wanted.name, f"{where} {why}"))

    # Pictures

    async def configure(self, exposure_us: float, gain_db: float) -> tuple[float, float]:
        """Set exposure and gain; returns what the camera says that it has."""
        device = self._opened()
        self._exposure = await self._worker.call(lambda: device.set_exposure(exposure_us, gain_db))
        return self._exposure

    @property
    def triggered(self) -> bool:
        """Did the camera acknowledge the newest trigger?"""
        return self._shot is not None and self._shot.acknowledged

    async def grab(self, exposed: asyncio.Event | None) -> Frame:
        """Trigger, tell when the exposure is over, and wait for that trigger's picture."""
        await asyncio.sleep(max(0.0, self._ready_s - self._loop.time()))
        self._shot = shot = _Shot(self._loop.create_future())
        try:
            await self._worker.call(lambda: self._trigger_now(shot))
            if exposed is not None:
                self._loop.call_later(self._exposure[0] / 1e6 + EXPOSED_MARGIN_S, exposed.set)
            return await shot.picture
        finally:
            exposing_s = 0.0 if _has_picture(shot) else self._exposure[0] / 1e6 + SETTLE_S
            self._ready_s = self._loop.time() + exposing_s
            shot.picture.cancel()

    def _trigger_now(self, shot: _Shot) -> None:
        if shot.picture.done():  # given up before its turn came
            return
        device = self._opened()
        asked_ns = time.monotonic_ns()
        ticks = device.ticks()
        shot.floor_host_ns = (asked_ns + time.monotonic_ns()) // 2
        shot.floor_ns = ticks * 1_000_000_000 // self._tick_rate
        shot.sent_ns = time.monotonic_ns()
        device.trigger()
        shot.acknowledged = True

    def _opened(self) -> Device:
        if self._device is None:
            raise LinkLost(self._wanted.name, "not open")
        return self._device

    def _memory(self) -> Memory:
        """Room for one picture, with its pages mapped, so that receiving is not held up by that."""
        memory = np.empty(self._wanted.width * self._wanted.height, np.uint8)
        memory.fill(0)
        return memory

    def _receive(self) -> None:
        """In the receive thread: hand over what comes, lend new memory, look after the control."""
        stream, device = self._stream, self._device
        while stream is not None and device is not None and not self._stop.is_set():
            arrived = stream.pop(POLL_S)
            if arrived is not None:
                post(self._loop, self._on_arrival, arrived, time.monotonic_ns())
                stream.push(self._memory())
            elif not device.is_controller:
                post(self._loop, self.lose, "lost control, or it is gone")
                return

    def _on_arrival(self, arrived: Arrived, received_ns: int) -> None:
        shot = self._shot
        if shot is None or shot.picture.done() or self._is_stale(arrived, shot):
            self._stale += 1
            return
        self._last_frame = arrived.frame_id
        flaw = self._flaw(arrived)
        if flaw:
            self._incomplete += 1
            shot.picture.set_exception(FrameLost(self._wanted.name, flaw))
            return
        self._delivered += 1
        shot.picture.set_result(self._frame(arrived, shot, received_ns))

    def _is_stale(self, arrived: Arrived, shot: _Shot) -> bool:
        """Taken before this trigger, or the same once more. The time of an incomplete one may be missing (0)."""
        early = shot.floor_ns is None or arrived.device_ns < shot.floor_ns
        if arrived.status != "success":
            return early and arrived.device_ns > 0
        return early or arrived.frame_id == self._last_frame

    def _flaw(self, arrived: Arrived) -> str:
        """Why a picture cannot be used, or nothing. Nobody may look at pixels before this."""
        wanted = self._wanted
        if arrived.status != "success":
            stream = self._stream
            missing, asked = (
                (stream.count("n_missing_packets"), stream.count("n_resend_requests")) if stream else (0, 0)
            )
            return (
                f"picture {arrived.frame_id} came incomplete: {arrived.status}, {arrived.received_bytes} of "
                f"{arrived.memory.nbytes} bytes (since open: {missing} packets missing, {asked} asked for again)"
            )
        size = (arrived.width, arrived.height, arrived.pixel_format, arrived.received_bytes)
        if size != (wanted.width, wanted.height, MONO8, arrived.memory.nbytes):
            return (
                f"picture {arrived.frame_id} is {size[0]} x {size[1]} px, format {size[2]:#x}, {size[3]} bytes, "
                f"not {wanted.width} x {wanted.height} Mono8"
            )
        return ""

    def _frame(self, arrived: Arrived, shot: _Shot, received_ns: int) -> Frame:
        pixels = arrived.memory.reshape(self._wanted.height, self._wanted.width)
        pixels.flags.writeable = False
        began_ns = shot.floor_host_ns + arrived.device_ns - (shot.floor_ns or 0)
        return Frame(
            pixels=pixels,
            frame_id=arrived.frame_id,
            exposure_start_ns=min(max(began_ns, shot.sent_ns), received_ns),
            received_ns=received_ns,
            device_ns=arrived.device_ns,
            exposure_us=self._exposure[0],
            gain_db=self._exposure[1],
            camera_id=self._wanted.serial,
        )


def _has_picture(shot: _Shot) -> bool:
    return shot.picture.done() and not shot.picture.cancelled() and shot.picture.exception() is None
