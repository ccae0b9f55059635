"""A simulated V4L2 camera for a client in the same process: where there is no FUSE, calls take the place of a file.

What a client of a device file does (open, ioctl, mmap, select, close) has one method each; nothing else differs.
"""

import os
import threading

import numpy as np
from numpy.typing import NDArray

from simulators.v4l2.port import Port

Bytes = NDArray[np.uint8]


class OpenDevice:
    """One opening. `fileno()` is readable when a picture waits, or when an ioctl would say what is wrong."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self._handle = port.open()
        self._signal = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._raised = self._closed = False
        self._lock = threading.Lock()
        port.wakes.append(self._update)

    def fileno(self) -> int:
        """For select, poll and epoll."""
        return self._signal

    def ioctl(self, request: int, data: bytearray) -> None:
        """In place, as the system call; raises OSError."""
        answer = self._port.ioctl(self._handle, request, bytes(data))
        data[: len(answer)] = answer
        self._update()

    def map(self, offset: int, length: int) -> Bytes:
        """The memory of one buffer; it is the camera's own."""
        return self._port.device.memory[offset : offset + length]

    def close(self) -> None:
        """Let it go."""
        self._port.wakes.remove(self._update)
        self._port.close(self._handle)
        with self._lock:
            self._closed = True
            os.close(self._signal)

    def _update(self) -> None:
        with self._lock:
            ready = bool(self._port.poll(self._handle)) and not self._closed
            if ready and not self._raised:
                os.eventfd_write(self._signal, 1)
            elif self._raised and not ready and not self._closed:
                os.eventfd_read(self._signal)
            self._raised = ready
