"""A GigE Vision camera through Aravis: whole pictures of the right moment, or an error.

A connection has two threads: one makes the control calls in turn, one waits for pictures; both hand results to the
event loop. When a camera is lost, its connection is let go in the background (the library may take 14 s), and the next
open() starts with a new one. Which picture is the right one: `drivers.gige_inbox`.
"""

import asyncio
import time
from collections.abc import AsyncGenerator, Coroutine
from dataclasses import replace
from typing import Any, TypeVar

from drivers.aravis_library import ACCESS_DENIED, NO_LINK, NOT_CONTROLLER, NOT_FOUND, AravisError, LibraryMissing
from drivers.camera import Counters, Frame, Health, Setup, State, StateChange, Trigger
from drivers.camera_states import States
from drivers.errors import DeviceError, LinkLost, NoAnswer, Refused, Unavailable
from drivers.gige_connection import Connection
from drivers.gige_discovery import discover, where_instead
from drivers.gige_setup import Wanted

OPEN_WITHIN_S = 8.0  # a camera that is not there: 2.5 s; one whose last program died: its heartbeat time (3 s)
LOOK_AROUND_S = 0.4
CONTROL_WITHIN_S = 1.5
CLOSE_WITHIN_S = 2.0
MOST_PARTING = 4  # each holds 20 MB and two threads, for up to 14 s
EXPOSURE_TOLERANCE = 0.005  # cameras set exposure in steps of a line time, gain in steps of 0.1 dB or less
EXPOSURE_TOLERANCE_US = 1.0
GAIN_TOLERANCE_DB = 0.1
SILENT = "did not answer on its control channel"

T = TypeVar("T")


class GigeCamera:
    """One camera; see `drivers.camera.Camera` for the contract of its verbs. They take turns.

    `address` is the camera's IP address. `socket_buffer_bytes` limits the receive buffer; without it, it is as large
    as the system permits (`rmem_max`). `packet_delay_us` is how long the camera waits after each packet.
    """

    def __init__(
        self,
        name: str,
        address: str,
        setup: Setup,
        *,
        socket_buffer_bytes: int | None = None,
        packet_delay_us: float = 0.0,
    ) -> None:
        self._name = name
        self._wanted = Wanted(name, address, setup, socket_buffer_bytes, packet_delay_us)
        self._connection: Connection | None = None
        self._parting: set[asyncio.Future[None]] = set()  # ends of earlier connections that are under way
        self._turn = asyncio.Lock()
        self._counters = Counters()
        self._states = States()

    @property
    def name(self) -> str:
        """What the operator calls it."""
        return self._name

    @property
    def counters(self) -> Counters:
        """What happened since this object was made, all connections together."""
        return self._counters + self._connection.counters if self._connection else self._counters

    @property
    def state(self) -> StateChange:
        """How it stands now."""
        return self._states.now

    @property
    def packet_size(self) -> int:
        """Bytes in a packet, as negotiated when it was armed; 0 when not open."""
        return self._connection.packet_size if self._connection else 0

    def states(self) -> AsyncGenerator[StateChange, None]:
        """The present state, then every change."""
        return self._states.follow()

    async def open(self) -> None:
        """Connect anew, check the serial number, set the format, arm; exposure and gain as last configured.

        Raises LinkLost (not there), NoAnswer, Mismatch (another camera), Refused (another program has it, or it does
        not take the format), Unavailable (library missing).
        """
        async with self._turn:
            self._part()
            if len(self._parting) > MOST_PARTING:
                count = len(self._parting)
                raise LinkLost(self._name, f"{self._wanted.where}: {count} earlier connections have not ended yet")
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
                await connection.open()
                await connection.arm(Trigger.SOFTWARE)
        except TimeoutError:
            raise NoAnswer(self._name, f"{self._wanted.where} could not be opened in {OPEN_WITHIN_S} s") from None
        except AravisError as error:
            meaning = self._meaning(error)
            if error.code != NOT_FOUND:
                raise meaning from error
            setup, address = self._wanted.setup, self._wanted.address
            advice = where_instead(await discover(within_s=LOOK_AROUND_S), setup.serial, address)
            raise LinkLost(self._name, f"{meaning.detail}; {advice}") from error
        except LibraryMissing as error:
            raise Unavailable(self._name, str(error)) from error

    async def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> None:
        """Set exposure and gain, also for later openings.

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
            raise Refused(self._name, "read-back", detail)
        self._wanted = replace(self._wanted, exposure=(exposure_us, gain_db))

    async def arm(self, trigger: Trigger = Trigger.SOFTWARE) -> None:
        """Take pictures by this trigger from now on.

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
        """Trigger and return the picture whose exposure began after this call; its pixels belong to the caller.

        `exposed` is set when the exposure is over, that is, exposure time and 2 ms after the trigger was acknowledged.

        `exposure_start_ns` is the camera's own time of it, carried over to the host's clock by a reading of both just
        before the trigger: good to half that reading's round trip (usually 0.1 to 1 ms), and within the bounds of the
        trigger's sending and the picture's arrival. Of a camera without a clock it is reckoned back from the arrival.
        Raises FrameLost, NoAnswer, LinkLost, Refused.
        """
        connection = None
        try:
            async with asyncio.timeout(within_s), self._turn:
                connection = self._open_connection()
                return await connection.grab(exposed)
        except TimeoutError:
            raise self._nothing_came(connection, within_s) from None
        except AravisError as error:
            raise self._meaning(error) from error

    async def next_frame(self, *, within_s: float = 1.0) -> Frame:
        """The next picture by the line, or the newest in free run; its time is good to about 0.1 ms.

        Raises FrameLost, NoAnswer, LinkLost, Refused.
        """
        try:
            async with asyncio.timeout(within_s):
                async with self._turn:
                    inbox = await self._open_connection().running_inbox()
                return await inbox.next_frame()
        except TimeoutError:
            raise NoAnswer(self._name, f"no picture came in {within_s:g} s") from None
        except AravisError as error:
            raise self._meaning(error) from error

    async def health(self) -> Health:
        """How it is; one that does not answer is an answer too."""
        temperature_c, packet_bytes, age_s, answers, has_clock = None, None, None, False, None
        try:
            async with asyncio.timeout(CONTROL_WITHIN_S), self._turn:
                connection = self._open_connection()
                packet_bytes, has_clock = connection.packet_size or None, connection.has_clock
                temperature_c = await connection.temperature_c()
                answers = True
                newest_ns = connection.inbox.newest_ns if connection.inbox else 0
                age_s = (time.monotonic_ns() - newest_ns) / 1e9 if newest_ns else None
        except (TimeoutError, AravisError, DeviceError):
            pass  # what is wrong will be said by the verb that needs the camera
        return Health(self.state.state, self.state.why, answers, temperature_c, packet_bytes, age_s, has_clock)

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
            self._counters += connection.counters
            parting = connection.close()
            self._parting.add(parting)
            parting.add_done_callback(self._parting.discard)
            self._states.to(State.OFFLINE, why)

    def _open_connection(self) -> Connection:
        if self._connection is None:
            raise LinkLost(self._name, f"{self._wanted.where} is not open")
        if self._connection.lost:
            raise LinkLost(self._name, f"{self._wanted.where} {self._connection.lost}; open it again")
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
            raise NoAnswer(self._name, f"{otherwise} within {CONTROL_WITHIN_S} s") from None
        except asyncio.CancelledError:
            connection.lose("was interrupted while it was being set")
            raise
        except AravisError as error:
            raise self._meaning(error) from error

    def _nothing_came(self, connection: Connection | None, within_s: float) -> DeviceError:
        if connection is None:
            return NoAnswer(self._name, f"busy with another request for {within_s:g} s")
        if connection.lost:
            return LinkLost(self._name, f"{self._wanted.where} {connection.lost}")
        if not connection.triggered:
            connection.lose(SILENT)
            return NoAnswer(self._name, f"trigger not acknowledged within {within_s:g} s")
        stale = self.counters.stale
        return NoAnswer(self._name, f"triggered, but no picture came in {within_s:g} s ({stale} stale so far)")

    def _meaning(self, error: AravisError) -> DeviceError:
        """What an error of the library says of this camera."""
        connection, detail = self._connection, f"{self._wanted.where}: {error}"
        if error.code in (ACCESS_DENIED, NOT_CONTROLLER):
            if connection is not None and connection.is_open:
                connection.lose("took control away")
                return LinkLost(self._name, f"{detail}; control was lost")
            if self._parting:
                return LinkLost(self._name, f"{detail}; an earlier connection has not let go of it yet")
            return Refused(self._name, "access denied", f"{detail}; another program controls it: stop that first")
        if error.code in NO_LINK:
            if connection is not None:
                connection.lose(SILENT)
            return LinkLost(self._name, detail)
        return Refused(self._name, f"aravis {error.code}", detail)
