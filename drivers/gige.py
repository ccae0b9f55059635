"""A GigE Vision camera through Aravis: software trigger, Mono8, whole pictures of the right moment or an error.

A connection has two threads: one makes the control calls in turn, one waits for pictures; both hand results to the
event loop. When a camera is lost, its connection is let go in the background (the library may take 14 s), and the next
open() starts with a new one.

Which picture is ours: before each trigger the camera's clock is latched and read. A picture whose exposure began before
that reading belongs to an earlier trigger, whatever its number says; it is counted and dropped.
"""

import asyncio
from dataclasses import replace

from drivers.aravis import (
    ACCESS_DENIED,
    NOT_CONNECTED,
    NOT_CONTROLLER,
    NOT_FOUND,
    TIMEOUT,
    AravisError,
    LibraryMissing,
)
from drivers.camera import Frame
from drivers.errors import DeviceError, LinkLost, NoAnswer, Refused, Unavailable
from drivers.gige_connection import Connection, Counters, Wanted

OPEN_WITHIN_S = 8.0  # a camera that is not there: 2.5 s; one whose last program died: its heartbeat time (3 s)
CONFIGURE_WITHIN_S = 1.5
CLOSE_WITHIN_S = 2.0
MOST_PARTING = 4  # each holds 20 MB and two threads, for up to 14 s
EXPOSURE_TOLERANCE = 0.005  # cameras set exposure in steps of a line time, gain in steps of 0.1 dB or less
EXPOSURE_TOLERANCE_US = 1.0
GAIN_TOLERANCE_DB = 0.1


class GigeCamera:
    """One camera; see `drivers.camera.Camera` for the contract of its verbs. They take turns.

    `address` is the camera's IP address, `serial` its serial number, `width` and `height` the whole picture in px.
    `socket_buffer_bytes` limits the receive buffer; without it, it is as large as the system permits (`rmem_max`).
    """

    def __init__(
        self,
        name: str,
        address: str,
        serial: str,
        *,
        width: int = 2592,
        height: int = 1944,
        socket_buffer_bytes: int | None = None,
    ) -> None:
        self._name = name
        self._wanted = Wanted(name, address, serial, width, height, socket_buffer_bytes)
        self._connection: Connection | None = None
        self._parting: set[asyncio.Future[None]] = set()  # ends of earlier connections that are under way
        self._turn = asyncio.Lock()
        self._counters = Counters()

    @property
    def name(self) -> str:
        """What the operator calls it."""
        return self._name

    @property
    def counters(self) -> Counters:
        """What happened since this object was made, all connections together."""
        return self._counters + self._connection.counters if self._connection else self._counters

    @property
    def packet_size(self) -> int:
        """Bytes in a packet, as negotiated at open; 0 when not open."""
        return self._connection.packet_size if self._connection else 0

    async def open(self) -> None:
        """Connect anew, check the serial number, set the format, arm; exposure and gain as last configured.

        Raises LinkLost (not there), NoAnswer, Mismatch (another camera), Refused (another program has it, or it does
        not take the format), Unavailable (library missing).
        """
        async with self._turn:
            self._part()
            if len(self._parting) > MOST_PARTING:
                count = len(self._parting)
                raise LinkLost(self._name, f"{self._where}: {count} earlier connections have not ended yet")
            self._connection = connection = Connection(self._wanted)
            try:
                async with asyncio.timeout(OPEN_WITHIN_S):
                    await connection.open()
            except TimeoutError:
                self._part()
                raise NoAnswer(self._name, f"{self._where} could not be opened in {OPEN_WITHIN_S} s") from None
            except (AravisError, LibraryMissing) as error:
                meaning = self._meaning(error)  # before this connection is one of the earlier ones
                self._part()
                raise meaning from error
            except (DeviceError, asyncio.CancelledError):
                self._part()
                raise

    async def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> None:
        """Set exposure and gain, also for later openings.

        Raises Refused when the camera does not take them or reads back others, NoAnswer, LinkLost.
        """
        async with self._turn:
            connection = self._open_connection()
            try:
                async with asyncio.timeout(CONFIGURE_WITHIN_S):
                    got_us, got_db = await connection.configure(exposure_us, gain_db)
            except TimeoutError:
                connection.lose("did not answer on its control channel")
                detail = f"exposure not confirmed within {CONFIGURE_WITHIN_S} s"
                raise NoAnswer(self._name, detail) from None
            except AravisError as error:
                raise self._meaning(error) from error
        tolerance_us = max(EXPOSURE_TOLERANCE_US, EXPOSURE_TOLERANCE * exposure_us)
        if abs(got_us - exposure_us) > tolerance_us or abs(got_db - gain_db) > GAIN_TOLERANCE_DB:
            detail = f"asked for {exposure_us:g} us and {gain_db:g} dB, it set {got_us:g} us and {got_db:g} dB"
            raise Refused(self._name, "read-back", detail)
        self._wanted = replace(self._wanted, exposure=(exposure_us, gain_db))

    async def grab(self, *, within_s: float = 1.0, exposed: asyncio.Event | None = None) -> Frame:
        """Trigger and return the picture whose exposure began after this call; its pixels belong to the caller.

        `exposed` is set when the exposure is over, that is, exposure time and 2 ms after the trigger was acknowledged.

        `exposure_start_ns` is the camera's own time of it, carried over to the host's clock by a reading of both just
        before the trigger: good to half that reading's round trip (usually 0.1 to 1 ms), and within the bounds of the
        trigger's sending and the picture's arrival. Raises FrameLost, NoAnswer, LinkLost, Refused.
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

    async def close(self) -> None:
        """Let the camera go; returns after 2 s at the latest, what is left then ends in the background."""
        async with self._turn:
            self._part()
            if self._parting:
                await asyncio.wait(self._parting, timeout=CLOSE_WITHIN_S)

    @property
    def _where(self) -> str:
        return f"camera {self._wanted.serial} at {self._wanted.address}"

    def _part(self) -> None:
        """Drop the connection; it ends in the background."""
        connection, self._connection = self._connection, None
        if connection is not None:
            self._counters += connection.counters
            parting = connection.close()
            self._parting.add(parting)
            parting.add_done_callback(self._parting.discard)

    def _open_connection(self) -> Connection:
        if self._connection is None:
            raise LinkLost(self._name, f"{self._where} is not open")
        if self._connection.lost:
            raise LinkLost(self._name, f"{self._where} {self._connection.lost}; open it again")
        return self._connection

    def _nothing_came(self, connection: Connection | None, within_s: float) -> DeviceError:
        if connection is None:
            return NoAnswer(self._name, f"busy with another request for {within_s:g} s")
        if connection.lost:
            return LinkLost(self._name, f"{self._where} {connection.lost}")
        if not connection.triggered:
            connection.lose("did not answer on its control channel")
            return NoAnswer(self._name, f"trigger not acknowledged within {within_s:g} s")
        stale = self.counters.stale
        return NoAnswer(self._name, f"triggered, but no picture came in {within_s:g} s ({stale} stale so far)")

    def _meaning(self, error: AravisError | LibraryMissing) -> DeviceError:
        """What an error of the library says of this camera."""
        if isinstance(error, LibraryMissing):
            return Unavailable(self._name, str(error))
        detail = f"{self._where}: {error}"
        if error.code in (ACCESS_DENIED, NOT_CONTROLLER):
            if self._connection is not None and self._connection.is_open:
                self._connection.lose("took control away")
                return LinkLost(self._name, f"{detail}; control was lost")
            if self._parting:
                return LinkLost(self._name, f"{detail}; an earlier connection has not let go of it yet")
            return Refused(self._name, "access denied", f"{detail}; another program controls it: stop that first")
        if error.code in (TIMEOUT, NOT_CONNECTED, NOT_FOUND):
            if self._connection is not None:
                self._connection.lose("did not answer on its control channel")
            return LinkLost(self._name, detail)
        return Refused(self._name, f"aravis {error.code}", detail)
