"""A V4L2 camera by the kernel's own calls: whole pictures of the right moment, or an error.

Works with any device node that streams through mapped buffers and stamps its pictures by the host's monotonic clock:
USB (UVC), MIPI and PCI cameras. Which picture is the right one: `drivers.v4l2_inbox`.
"""

import asyncio
import time
from collections.abc import AsyncGenerator, Coroutine
from dataclasses import replace
from typing import Any, TypeVar

from drivers.camera import Counters, Frame, Health, Setup, State, StateChange, Trigger
from drivers.camera_states import States
from drivers.errors import DeviceError, LinkLost, NoAnswer, Refused
from drivers.v4l2_capture import Decode, Opener, Wanted
from drivers.v4l2_connection import Connection
from drivers.v4l2_node import KernelNode, meaning

OPEN_WITHIN_S = 5.0  # a USB camera may take a second to start its sensor
CONTROL_WITHIN_S = 2.0
CLOSE_WITHIN_S = 2.0
MOST_PARTING = 4
EXPOSURE_TOLERANCE = 0.005
EXPOSURE_TOLERANCE_US = 1.0
GAIN_TOLERANCE_DB = 0.1
SILENT = "did not answer in time"

T = TypeVar("T")


class V4l2Camera:
    """One camera; see `drivers.camera.Camera` for the contract of its verbs. They take turns.

    `path` is its device node. `decode` turns a JPEG into its (height, width) uint8 luma or raises ValueError; with it
    the camera sends MJPG. `gain_db_per_step` is what its maker says of one step of its gain, which has no unit;
    without it only 0 dB, the lowest gain, can be had. `open_node` opens the node.
    """

    def __init__(
        self,
        name: str,
        path: str,
        setup: Setup,
        *,
        decode: Decode | None = None,
        gain_db_per_step: float | None = None,
        open_node: Opener = KernelNode,
    ) -> None:
        self._wanted = Wanted(name, path, setup, open_node, decode, gain_db_per_step)
        self._connection: Connection | None = None
        self._parting: set[asyncio.Future[None]] = set()  # ends of earlier connections that are under way
        self._turn = asyncio.Lock()
        self._counters = Counters()
        self._states = States()

    @property
    def name(self) -> str:
        """What the operator calls it."""
        return self._wanted.name

    @property
    def counters(self) -> Counters:
        """What happened since this object was made, all connections together."""
        return self._counters + self._connection.counters if self._connection else self._counters

    @property
    def state(self) -> StateChange:
        """How it stands now."""
        return self._states.now

    def states(self) -> AsyncGenerator[StateChange, None]:
        """The present state, then every change."""
        return self._states.follow()

    async def open(self) -> None:
        """Connect anew, check the serial number, set the format, arm; exposure and gain as last configured.

        Raises LinkLost (not there), NoAnswer, Mismatch (another camera, or no camera), Refused (another program has
        it, or it does not take region or format), Garbled.
        """
        async with self._turn:
            self._part()
            if len(self._parting) > MOST_PARTING:
                count = len(self._parting)
                raise LinkLost(self.name, f"{self._wanted.path}: {count} earlier connections have not ended yet")
            self._states.to(State.CONNECTING)
            self._connection = Connection(self._wanted, self._on_lost)
            try:
                await self._opened(self._connection)
            except BaseException as error:
                self._part(error.detail if isinstance(error, DeviceError) else "opening was cancelled")
                raise
            self._states.to(State.ARMED, Trigger.SOFTWARE)

    async def _opened(self, connection: Connection) -> None:
        try:
            async with asyncio.timeout(OPEN_WITHIN_S):
                if self._parting:  # a device that is not free yet would be busy
                    await asyncio.wait(self._parting)
                await connection.open()
                await connection.arm(Trigger.SOFTWARE)
        except TimeoutError:
            raise NoAnswer(self.name, f"{self._wanted.path} could not be opened in {OPEN_WITHIN_S} s") from None
        except OSError as error:
            raise self._meaning(error) from error

    async def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> None:
        """Set exposure and gain, also for later openings; automatic ones are turned off.

        Raises Refused when the camera does not take them or reads back others, NoAnswer, LinkLost.
        """
        async with self._turn:
            connection = self._open_connection()
            got_us, got_db = await self._controlled(
                connection.configure(exposure_us, gain_db), "exposure not confirmed"
            )
        tolerance_us = max(EXPOSURE_TOLERANCE_US, EXPOSURE_TOLERANCE * exposure_us)
        if abs(got_us - exposure_us) > tolerance_us or abs(got_db - gain_db) > GAIN_TOLERANCE_DB:
            detail = f"asked for {exposure_us:g} us and {gain_db:g} dB, it set {got_us:g} us and {got_db:g} dB"
            raise Refused(self.name, "read-back", detail)
        self._wanted = replace(self._wanted, exposure=(exposure_us, gain_db))

    async def arm(self, trigger: Trigger = Trigger.SOFTWARE) -> None:
        """Take pictures by this trigger from now on. SOFTWARE always works: see `drivers.v4l2_inbox`.

        Raises Refused when the camera has no such trigger (it is disarmed then), NoAnswer, LinkLost.
        """
        async with self._turn:
            connection = self._open_connection()
            self._states.to(State.READY)
            await self._controlled(connection.arm(trigger), "not armed")
            self._states.to(State.ARMED, trigger)

    async def disarm(self) -> None:
        """Take no more pictures. Raises NoAnswer, LinkLost."""
        async with self._turn:
            await self._controlled(self._open_connection().disarm(), "not disarmed")
            self._states.to(State.READY)

    async def grab(self, *, within_s: float = 1.0, exposed: asyncio.Event | None = None) -> Frame:
        """The picture whose exposure began after this call: by the camera's trigger, or the next one of free run.

        `exposed` is set when the exposure is over: with a trigger at the exposure time and 2 ms after it, else when
        the picture is there. `exposure_start_ns` is the earliest time at which the exposure may have begun.

        Raises FrameLost (triggered, and damaged), NoAnswer, LinkLost, Refused.
        """
        connection = None
        try:
            async with asyncio.timeout(within_s), self._turn:
                connection = self._open_connection()
                return await connection.grab(exposed)
        except TimeoutError:
            raise self._nothing_came(connection, within_s) from None
        except OSError as error:
            raise self._meaning(error) from error

    async def next_frame(self, *, within_s: float = 1.0) -> Frame:
        """The next picture by the line, or the newest in free run. Others may have their turn while it is awaited.

        Raises FrameLost, NoAnswer, LinkLost, Refused.
        """
        connection = None
        try:
            async with asyncio.timeout(within_s):
                async with self._turn:
                    connection = self._open_connection()
                return await connection.next_frame()
        except TimeoutError:
            raise self._nothing_came(connection, within_s) from None
        except OSError as error:
            raise self._meaning(error) from error

    async def health(self) -> Health:
        """How it is; one that does not answer is an answer too."""
        age_s, answers = None, False
        try:
            async with asyncio.timeout(CONTROL_WITHIN_S), self._turn:
                connection = self._open_connection()
                await connection.answers()
                answers = True
                age_s = (time.monotonic_ns() - connection.newest_ns) / 1e9 if connection.newest_ns else None
        except (TimeoutError, OSError, DeviceError):
            pass  # what is wrong will be said by the verb that needs the camera
        return Health(self.state.state, self.state.why, answers, last_picture_s=age_s)

    async def close(self) -> None:
        """Let the camera go; returns after 2 s at the latest, what is left then ends in the background."""
        async with self._turn:
            self._part("was closed")
            if self._parting:
                await asyncio.wait(self._parting, timeout=CLOSE_WITHIN_S)

    def _on_lost(self, why: str) -> None:
        self._states.to(State.FAULTED, why)

    def _part(self, why: str = "") -> None:
        """Drop the connection; it ends in the background."""
        connection, self._connection = self._connection, None
        if connection is not None:
            parting = connection.close()
            self._counters += connection.counters
            self._parting.add(parting)
            parting.add_done_callback(self._parting.discard)
            self._states.to(State.OFFLINE, why)

    def _open_connection(self) -> Connection:
        if self._connection is None:
            raise LinkLost(self.name, f"{self._wanted.path} is not open")
        if self._connection.lost:
            raise LinkLost(self.name, f"{self._wanted.path} {self._connection.lost}; open it again")
        return self._connection

    async def _controlled(self, work: Coroutine[Any, Any, T], otherwise: str) -> T:
        """Control calls within their deadline. One that is broken off leaves the camera in an unknown state."""
        connection = self._connection
        assert connection is not None
        try:
            async with asyncio.timeout(CONTROL_WITHIN_S):
                return await work
        except TimeoutError:
            connection.lose(SILENT)
            raise NoAnswer(self.name, f"{otherwise} within {CONTROL_WITHIN_S} s") from None
        except asyncio.CancelledError:
            connection.lose("was interrupted while it was being set")
            raise
        except OSError as error:
            raise self._meaning(error) from error

    def _nothing_came(self, connection: Connection | None, within_s: float) -> DeviceError:
        if connection is None:
            return NoAnswer(self.name, f"busy with another request for {within_s:g} s")
        if connection.lost:
            return LinkLost(self.name, f"{self._wanted.path} {connection.lost}")
        counted = self.counters
        seen = f"{counted.stale} stale, {counted.incomplete} damaged so far"
        return NoAnswer(self.name, f"no picture came in {within_s:g} s ({seen})")

    def _meaning(self, error: OSError) -> DeviceError:
        """What a system error says of this camera."""
        meant = meaning(self.name, self._wanted.path, error)
        if isinstance(meant, LinkLost) and self._connection is not None:
            self._connection.lose(f"does not answer any more ({error.strerror})")
        return meant
