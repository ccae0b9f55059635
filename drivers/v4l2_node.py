"""A device node of the kernel, opened: its ioctls, its mapped memory, what sysfs knows about it."""

import fcntl
import mmap
import os
import re
import stat
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import numpy as np

from drivers.camera import Pixels

NOT_IN_A_SERIAL = re.compile(r"[^A-Za-z0-9._-]+")
BUS_PREFIX = re.compile(r"^[A-Za-z]+[:-]")
LONGEST_SERIAL = 16


class Node(Protocol):
    """An opened device."""

    def fileno(self) -> int:
        """For the event loop: readable when a picture waits, or when something is wrong."""

    def ioctl(self, request: int, argument: bytearray) -> None:
        """One system call, the argument changed in place; raises OSError."""

    def map(self, offset: int, length: int) -> Pixels:
        """Memory of a buffer, valid until close(); raises OSError, ValueError."""

    def close(self) -> None:
        """Give everything back; raises OSError."""


class KernelNode:
    """`/dev/videoN`, opened without waiting. Raises OSError."""

    def __init__(self, path: str) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        self._maps: list[mmap.mmap] = []

    def fileno(self) -> int:
        """See Node."""
        return self._fd

    def ioctl(self, request: int, argument: bytearray) -> None:
        """See Node. Begun anew when a signal interrupts it."""
        while True:
            try:
                fcntl.ioctl(self._fd, request, argument, True)
            except InterruptedError:
                continue
            return

    def map(self, offset: int, length: int) -> Pixels:
        """See Node."""
        mapped = mmap.mmap(self._fd, length, mmap.MAP_SHARED, mmap.PROT_READ, offset=offset)
        self._maps.append(mapped)
        return np.frombuffer(mapped, np.uint8)

    def close(self) -> None:
        """See Node."""
        for mapped in self._maps:
            with suppress(BufferError):  # somebody still looks at it: it goes when that ends
                mapped.close()
        self._maps.clear()
        os.close(self._fd)


def serial_number(path: str, bus: str) -> str:
    """What tells a camera from others of its kind: a USB camera's serial number, else the place where it is connected.

    `bus` is the device's bus information, for instance "platform:3f801000.csi", which gives "3f801000.csi".
    """
    return _usb_serial(path) or NOT_IN_A_SERIAL.sub("-", BUS_PREFIX.sub("", bus))[-LONGEST_SERIAL:]


def _usb_serial(path: str) -> str:
    """From sysfs; "" for what is no USB device, or has no number."""
    try:
        found = os.stat(path)
    except OSError:
        return ""
    if not stat.S_ISCHR(found.st_mode):
        return ""
    device = Path(f"/sys/dev/char/{os.major(found.st_rdev)}:{os.minor(found.st_rdev)}/device")
    try:
        text = (device.resolve().parent / "serial").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    return NOT_IN_A_SERIAL.sub("-", text.strip())[-LONGEST_SERIAL:]
