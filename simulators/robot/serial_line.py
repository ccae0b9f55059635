"""A serial line on a pseudo terminal, at the pace of its baud rate, with XON/XOFF."""

import asyncio
import contextlib
import os
import tty
from pathlib import Path
from typing import NamedTuple

from simulators.clock import Clock
from simulators.robot.pacing import Pacer
from simulators.robot.session import Host, Session

XON, XOFF = 0x11, 0x13
BITS_PER_BYTE = 11  # start, 8 data, parity, stop
HIGH_WATER, LOW_WATER = 512, 128
READ_SIZE = 4096


class Terminal(NamedTuple):
    """Both ends; the client's stays open, so that clients may come and go."""

    ours: int
    theirs: int


class SerialLine:
    """`tty` is the path that a client opens: of the pseudo terminal, or of the link to it."""

    def __init__(self, host: Host, clock: Clock, baud: int, *, flow: bool = True, link: Path | None = None) -> None:
        self.can_hold = flow
        self.session = Session(host, self, kind="serial")
        self._host, self._link = host, link
        byte_s = BITS_PER_BYTE / baud
        self._out = Pacer(clock, byte_s, self._put_out)
        self._in = Pacer(clock, byte_s, self._taken_in)
        self._full = False
        self._terminal: Terminal | None = None
        self.tty = ""
        self._open()

    def write(self, data: bytes) -> None:
        """At line speed."""
        self._out.put(data)

    def hold(self, on: bool) -> None:
        """Take nothing in for now; XOFF makes the client wait."""
        self._in.pause(on)
        self._flow_control()

    def hang_up(self) -> None:
        """There is nobody to say good-bye to."""

    def drop(self) -> None:
        """What is on the line is lost; a serial line has no other way to break."""
        self._out.clear()
        self._in.clear()

    def unplug(self, for_s: float) -> None:
        """The adapter is pulled out; it comes back after so long, under the same link and perhaps another path."""
        self.drop()
        self._shut()
        self._host.later(for_s, self._open)

    async def close(self) -> None:
        """Take the line away."""
        await self._out.close()
        await self._in.close()
        self._shut()

    def _open(self) -> None:
        self._terminal = Terminal(*os.openpty())
        ours, theirs = self._terminal
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        self.tty = os.ttyname(theirs)
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.tty)
            self.tty = str(self._link)
        asyncio.get_running_loop().add_reader(ours, self._readable)

    def _shut(self) -> None:
        if self._terminal is None:
            return
        asyncio.get_running_loop().remove_reader(self._terminal.ours)
        for fd in self._terminal:
            os.close(fd)
        self._terminal = None
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def _readable(self) -> None:
        assert self._terminal is not None
        with contextlib.suppress(BlockingIOError):
            data = os.read(self._terminal.ours, READ_SIZE)
            if XON in data or XOFF in data:
                self._out.pause(data.rfind(XOFF) > data.rfind(XON))
                data = data.translate(None, bytes((XON, XOFF)))
            self._in.put(data)
            self._flow_control()

    def _taken_in(self, data: bytes) -> None:
        self.session.heard(data)
        self._flow_control()

    def _flow_control(self) -> None:
        waiting = len(self._in.waiting)
        if not self.can_hold:
            return
        if not self._full and waiting > HIGH_WATER:
            self._full = True
            self._put_out(bytes((XOFF,)))
        elif self._full and waiting < LOW_WATER:
            self._full = False
            self._put_out(bytes((XON,)))

    def _put_out(self, data: bytes) -> None:
        if self._terminal is None:
            return
        with contextlib.suppress(BlockingIOError):  # a full terminal loses bytes, as a line without a listener
            os.write(self._terminal.ours, data)
