"""A camera that is lost is opened again, for as long as this runs."""

import asyncio
from contextlib import aclosing
from typing import NoReturn

from drivers.camera import Camera, State
from drivers.errors import DeviceError

FIRST_S, LONGEST_S = 0.5, 10.0
OF_NO_USE = (State.OFFLINE, State.FAULTED)


async def keep_open(camera: Camera, *, first_s: float = FIRST_S, longest_s: float = LONGEST_S) -> NoReturn:
    """Open the camera whenever it is not open; after each failure wait twice as long, up to `longest_s`.

    Why it cannot be opened is in the camera's state. To be cancelled by whoever began it.
    """
    while True:
        pause_s = first_s
        while camera.state.state in OF_NO_USE:
            try:
                await camera.open()
            except DeviceError:  # its state tells why
                await asyncio.sleep(pause_s)
                pause_s = min(2 * pause_s, longest_s)
        async with aclosing(camera.states()) as states:
            async for change in states:
                if change.state in OF_NO_USE:
                    break
