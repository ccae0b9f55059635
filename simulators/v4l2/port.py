"""A device for callers in any thread: one call at a time, and everybody who waits is told when something changed."""

import threading
from collections.abc import Callable

from simulators.v4l2.abi import Event
from simulators.v4l2.buffers import Buffer
from simulators.v4l2.device import Device


class Port:
    """`wakes` are called, in any thread and without the lock, when poll() or a waiting DQBUF may answer otherwise."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.wakes: list[Callable[[], None]] = []
        self._lock = threading.Lock()
        self._changed = False
        device.changed = self._note

    def _note(self) -> None:
        self._changed = True

    def open(self) -> int:
        """See Device."""
        with self._lock:
            return self.device.open()

    def close(self, handle: int) -> None:
        """See Device."""
        with self._lock:
            self.device.close(handle)
        self._tell()

    def ioctl(self, handle: int, request: int, data: bytes) -> bytes:
        """See Device."""
        with self._lock:
            answer = self.device.ioctl(handle, request, data)
        self._tell()
        return answer

    def poll(self, handle: int) -> Event:
        """See Device."""
        with self._lock:
            return self.device.poll(handle)

    def unplug(self, gone: bool) -> None:
        """See Device."""
        with self._lock:
            self.device.unplug(gone)
        self._tell()

    def begin_picture(self) -> tuple[int, Buffer | None]:
        """Number of a picture whose exposure begins, and a buffer for it if the client has left one."""
        with self._lock:
            buffers = self.device.buffers
            return buffers.count_picture(), buffers.take()

    def count_picture(self) -> int:
        """Number of a picture that gets lost."""
        with self._lock:
            return self.device.buffers.count_picture()

    def another_buffer(self) -> Buffer | None:
        """One more buffer, if the client has left one."""
        with self._lock:
            return self.device.buffers.take()

    def end_picture(self, buffer: Buffer) -> None:
        """The buffer holds its picture."""
        with self._lock:
            self.device.buffers.fill(buffer)
            self._changed = True
        self._tell()

    def _tell(self) -> None:
        if self._changed:
            self._changed = False
            for wake in tuple(self.wakes):  # a client may leave meanwhile
                wake()
