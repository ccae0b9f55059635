"""Who controls a simulated camera, and what all others may do: the privileges of the GigE Vision standard.

A client takes control, or exclusive access, by writing the privilege register. Under control others may still read
(they monitor); under exclusive access they get nothing but that register. A controller may permit that another one
who knows its key takes over without asking. One that is silent for the heartbeat time is let go.
"""

import asyncio
import socket
import time
from collections.abc import Callable

from simulators import genicam, gvcp
from simulators.gige_link import Counts
from simulators.gige_registers import Registers
from simulators.gvcp import Status
from simulators.gvsp import Target

EXCLUSIVE, CONTROL, SWITCHOVER = 0x1, 0x2, 0x4  # bits of the privilege register; its upper half is a key
PRIVILEGES = EXCLUSIVE | CONTROL | SWITCHOVER
KEY_SHIFT = 16
WATCH_S = 0.1
ELSEWHERE: Target = ("127.255.255.1", 1)  # where the program is that holds control by a fault


class Control:
    """The privilege register, and whoever holds it. `on_release` is called when a controller is let go."""

    def __init__(self, registers: Registers, counts: Counts, on_release: Callable[[], None]) -> None:
        self.holder: Target | None = None
        self._registers, self._counts, self._on_release = registers, counts, on_release
        self._heard_s = 0.0
        self._key = 0

    def hear(self, client: Target) -> None:
        """A command came from this client."""
        if client == self.holder:
            self._heard_s = time.monotonic()

    def may_read(self, client: Target, address: int) -> bool:
        """Exclusive access shuts all others out; whether it is held may always be asked."""
        others = self.holder not in (None, client)
        return not (others and self._registers["GevCCP"] & EXCLUSIVE) or address == genicam.CONTROL_PRIVILEGE

    def set_key(self, value: int) -> Status:
        """What another controller has to know; it cannot be read back."""
        if value >> KEY_SHIFT:
            return Status.INVALID_PARAMETER
        self._key = value
        return Status.OK

    def ask(self, value: int, client: Target, *, refused: bool) -> Status:
        """A write to the privilege register. `refused`: by a fault."""
        if self.holder not in (None, client) and not self._may_take_over(value):
            self._counts.controllers_refused += 1
            return Status.ACCESS_DENIED
        if not value & (EXCLUSIVE | CONTROL):
            self.release()
        elif refused:
            self._counts.controllers_refused += 1
            return Status.ACCESS_DENIED
        else:
            self._grant(value & PRIVILEGES, client)
        return Status.OK

    def _may_take_over(self, value: int) -> bool:
        return bool(self._registers["GevCCP"] & SWITCHOVER) and value >> KEY_SHIFT == self._key

    def _grant(self, privilege: int, client: Target) -> None:
        self.holder, self._heard_s = client, time.monotonic()
        self._registers["GevCCP"] = privilege
        self._registers["GevPrimaryApplicationSocket"] = client[1]
        self._registers["GevPrimaryApplicationIPAddress"] = gvcp.WORD.unpack(socket.inet_aton(client[0]))[0]

    def take_elsewhere(self) -> None:
        """Another program gets control, and keeps it until release()."""
        self._grant(CONTROL, ELSEWHERE)

    def release(self) -> None:
        """Nobody has control."""
        self.holder, self._key = None, 0
        for name in ("GevCCP", "GevPrimaryApplicationSocket", "GevPrimaryApplicationIPAddress"):
            self._registers[name] = 0
        self._on_release()

    async def watch(self) -> None:
        """Let a controller go that is not heard for the heartbeat time; wall time, for it is no part of the world."""
        while True:
            await asyncio.sleep(WATCH_S)
            silent_ms = (time.monotonic() - self._heard_s) * 1e3
            held = self.holder not in (None, ELSEWHERE)
            if held and silent_ms > self._registers["GevHeartbeatTimeout"]:
                self.release()
