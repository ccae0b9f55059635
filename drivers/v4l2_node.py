"""A device node of the kernel: its ioctls, its mapped memory, what sysfs knows of it, what its errors mean."""

import errno
import fcntl
import mmap
import os
import re
import stat
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import numpy as np

from drivers import v4l2_abi as abi
from drivers.camera import Pixels
from drivers.errors import DeviceError, LinkLost, Mismatch, Refused

NOT_IN_A_SERIAL = re.compile(r"[^A-Za-z0-9._-]+")
BUS_PREFIX = re.compile(r"^[A-Za-z]+[:-]")
LONGEST_SERIAL = 16
MOST_FORMATS = 128
NO_SUCH_REQUEST = (errno.ENOTTY, errno.EINVAL, errno.ENODATA)  # or the end of a list


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


def asked(node: Node, request: int, argument: bytearray) -> bytearray:
    """The same argument, filled in by the device; raises OSError."""
    node.ioctl(request, argument)
    return argument


def formats(node: Node) -> list[str]:
    """Four characters of each pixel format that it offers; raises OSError."""
    found: list[str] = []
    try:
        while len(found) < MOST_FORMATS:
            found.append(abi.format_name(asked(node, abi.ENUM_FMT, abi.ask_format_name(len(found)))))
    except OSError as error:
        if error.errno not in NO_SUCH_REQUEST:
            raise
    return found


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


def meaning(name: str, where: str, error: OSError) -> DeviceError:
    """What a system error says of a camera. LinkLost: it is gone, and whatever was open is of no use."""
    code = errno.errorcode.get(error.errno or 0, str(error.errno))
    match error.errno:
        case errno.EBUSY:
            return Refused(name, code, f"another program is using {where}: stop that first")
        case errno.EACCES | errno.EPERM:
            return Refused(name, code, f"{where} may not be opened: the service's user must be in the group video")
        case errno.ENOTTY:
            return Mismatch(name, f"{where} is no V4L2 camera, or lacks what is needed")
        case errno.EINVAL | errno.ERANGE | errno.ENOMEM | errno.ENOSPC:
            return Refused(name, code, f"{where}: {error.strerror}")
    return LinkLost(name, f"{where}: {error.strerror or error}")
