"""Pictures from a folder, given out as if a camera took them: for trying recipes, for teaching, for replaying.

What a picture file is, is the business of whoever makes this camera (`Files`).
"""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from pathlib import Path
from typing import NamedTuple

from drivers.camera import Counters, Frame, Health, Pixels, Setup, State, StateChange, Trigger
from drivers.camera_states import States
from drivers.errors import FrameLost, LinkLost, NoAnswer, Refused
from drivers.pixels import MONO8

FREE_RUN_S = 0.1


class Unusable(Exception):
    """What a picture file or a folder of them cannot be used for; the text is a sentence with its name."""


class Files(NamedTuple):
    """How pictures are found in a folder, in order, and read as 8 bit (height, width). Both raise Unusable."""

    find: Callable[[Path], list[Path]]
    read: Callable[[Path], Pixels]


class FileCamera:
    """The pictures of one folder, each once; see `drivers.camera.Camera` for the verbs.

    Every picture must have the size of the setup's region. open() looks into the folder anew and begins at its first
    picture. A folder cannot say whose pictures it holds, so the setup's serial number is believed, and exposure and
    gain are those last configured: a file does not change by them.
    """

    def __init__(self, name: str, folder: Path, setup: Setup, files: Files) -> None:
        self._name, self._folder, self._setup, self._files = name, folder, setup, files
        self._left: list[Path] = []
        self._count = 0
        self._trigger: Trigger | None = None
        self._turn = asyncio.Lock()
        self._states = States()
        self._exposure = (0.0, 0.0)
        self._counters = Counters()
        self._newest_ns = 0

    @property
    def name(self) -> str:
        """What the operator calls it."""
        return self._name

    @property
    def counters(self) -> Counters:
        """Pictures given out, and files that could not be used."""
        return self._counters

    @property
    def state(self) -> StateChange:
        """How it stands now."""
        return self._states.now

    def states(self) -> AsyncGenerator[StateChange, None]:
        """The present state, then every change."""
        return self._states.follow()

    async def open(self) -> None:
        """Look into the folder. Raises LinkLost when it is not there, or no picture in it."""
        async with self._turn:
            self._trigger = None
            self._states.to(State.CONNECTING)
            try:
                self._left = await asyncio.to_thread(self._files.find, self._folder)
            except Unusable as error:
                self._states.to(State.OFFLINE, str(error))
                raise LinkLost(self._name, str(error)) from error
            self._count, self._trigger = 0, Trigger.SOFTWARE
            self._states.to(State.ARMED, Trigger.SOFTWARE)

    async def configure(self, *, exposure_us: float, gain_db: float = 0.0) -> None:
        """Remember what the frames are to say."""
        self._exposure = (exposure_us, gain_db)

    async def arm(self, trigger: Trigger = Trigger.SOFTWARE) -> None:
        """Give pictures out by grab(), or ten a second. Raises Refused for the line: a folder has none."""
        async with self._turn:
            self._check_open()
            if trigger is Trigger.LINE:
                raise Refused(self._name, "not available", "a folder has no trigger line")
            self._trigger = trigger
            self._states.to(State.ARMED, trigger)

    async def disarm(self) -> None:
        """Give nothing out."""
        async with self._turn:
            self._check_open()
            self._trigger = None
            self._states.to(State.READY)

    async def grab(self, *, within_s: float = 1.0, exposed: asyncio.Event | None = None) -> Frame:
        """The next picture of the folder.

        Raises FrameLost (the file cannot be used), NoAnswer (no picture is left), LinkLost, Refused.
        """
        return await self._given(Trigger.SOFTWARE, within_s, exposed)

    async def next_frame(self, *, within_s: float = 1.0) -> Frame:
        """The same in free run, ten times a second."""
        return await self._given(Trigger.FREE, within_s, None)

    async def _given(self, trigger: Trigger, within_s: float, exposed: asyncio.Event | None) -> Frame:
        try:
            async with asyncio.timeout(within_s), self._turn:
                self._check_armed(trigger)
                if trigger is Trigger.FREE:
                    await asyncio.sleep(FREE_RUN_S)
                return await self._next(exposed)
        except TimeoutError:
            raise NoAnswer(self._name, f"no picture was read within {within_s:g} s") from None

    async def _next(self, exposed: asyncio.Event | None) -> Frame:
        if not self._left:
            raise NoAnswer(self._name, f"all {self._count} pictures of {self._folder} were given out")
        path = self._left.pop(0)
        self._count += 1
        began_ns = time.monotonic_ns()
        if exposed is not None:
            exposed.set()
        try:
            pixels = await asyncio.to_thread(self._files.read, path)
        except Unusable as error:
            self._counters += Counters(incomplete=1)
            raise FrameLost(self._name, str(error)) from error
        return self._frame(path, pixels, began_ns)

    def _frame(self, path: Path, pixels: Pixels, began_ns: int) -> Frame:
        region = self._setup.region
        if pixels.shape != (region.height_px, region.width_px):
            self._counters += Counters(incomplete=1)
            size = f"{pixels.shape[1]} x {pixels.shape[0]} px"
            raise FrameLost(self._name, f"{path} is {size}, not {region.width_px} x {region.height_px}")
        pixels.flags.writeable = False
        self._counters += Counters(delivered=1)
        self._newest_ns = time.monotonic_ns()
        return Frame(
            pixels=pixels,
            frame_id=self._count,
            gap=0,
            exposure_start_ns=began_ns,
            received_ns=self._newest_ns,
            device_ns=began_ns,
            exposure_us=self._exposure[0],
            gain_db=self._exposure[1],
            camera_id=self._setup.serial,
            region=region,
            pixel_format=MONO8,
            payload=pixels.reshape(-1),
        )

    async def health(self) -> Health:
        """How it is."""
        now = self._states.now
        age_s = (time.monotonic_ns() - self._newest_ns) / 1e9 if self._newest_ns else None
        return Health(now.state, now.why, answers=now.state in (State.READY, State.ARMED), last_picture_s=age_s)

    async def close(self) -> None:
        """Let the folder go."""
        async with self._turn:
            self._trigger = None
            self._states.to(State.OFFLINE, "was closed")

    def _check_open(self) -> None:
        if self._states.now.state not in (State.READY, State.ARMED):
            raise LinkLost(self._name, f"{self._folder} is not open")

    def _check_armed(self, trigger: Trigger) -> None:
        self._check_open()
        if self._trigger is not trigger:
            state = f"armed for {self._trigger}" if self._trigger else "not armed"
            raise Refused(self._name, "not armed", f"it is {state}, this needs {trigger}")
