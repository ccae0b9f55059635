"""The buffers that a client shares with a simulated V4L2 camera, and whose turn each is. Pure."""

import errno
from collections import deque
from dataclasses import dataclass

from simulators.v4l2.abi import Flag

MOST_BUFFERS = 32
PAGE = 4096
NONE = Flag(0)
SEQUENCE_BITS = 0xFFFFFFFF


@dataclass(slots=True)
class Buffer:
    """One buffer: the client's (idle), waiting for a picture (QUEUED), being filled (no state), with one (DONE)."""

    index: int
    offset: int
    length: int
    state: Flag = NONE
    idle: bool = True
    flags: Flag = NONE
    used: int = 0
    stamp_ns: int = 0
    sequence: int = 0


class Buffers:
    """All buffers of one stream. Refusals are OSError with the number that the kernel would give."""

    def __init__(self, room_bytes: int) -> None:
        self._room_bytes = room_bytes
        self._all: list[Buffer] = []
        self._queued: deque[Buffer] = deque()
        self._done: deque[Buffer] = deque()
        self.sequence = 0  # of the next picture

    def __len__(self) -> int:
        return len(self._all)

    @property
    def any_done(self) -> bool:
        """Does a picture wait for the client?"""
        return bool(self._done)

    def allocate(self, count: int, picture_bytes: int) -> int:
        """So many buffers of a picture's size, or as many as there is room for; 0 frees all."""
        stride = -(-picture_bytes // PAGE) * PAGE
        count = min(count, MOST_BUFFERS, self._room_bytes // stride)
        self._all = [Buffer(index, index * stride, picture_bytes) for index in range(count)]
        self.forget()
        return count

    def forget(self) -> None:
        """All buffers back to the client; pictures in them are lost."""
        self._queued.clear()
        self._done.clear()
        for buffer in self._all:
            buffer.state, buffer.idle = NONE, True

    def find(self, index: int) -> Buffer:
        """A buffer; EINVAL when there is none of this number."""
        if index >= len(self._all):
            raise OSError(errno.EINVAL, f"no buffer {index}")
        return self._all[index]

    def queue(self, index: int) -> Buffer:
        """The client gives a buffer to be filled; EINVAL when it is not the client's."""
        buffer = self.find(index)
        if not buffer.idle:
            raise OSError(errno.EINVAL, f"buffer {index} is not the client's")
        buffer.idle, buffer.state = False, Flag.QUEUED
        self._queued.append(buffer)
        return buffer

    def dequeue(self) -> Buffer:
        """The client takes the oldest picture; EAGAIN when there is none yet."""
        if not self._done:
            raise BlockingIOError(errno.EAGAIN, "no picture yet")
        buffer = self._done.popleft()
        buffer.state, buffer.idle = NONE, True
        return buffer

    def count_picture(self) -> int:
        """The number of a picture that is being taken, whether or not it finds a buffer."""
        number = self.sequence
        self.sequence = (number + 1) & SEQUENCE_BITS
        return number

    def take(self) -> Buffer | None:
        """The oldest queued buffer, to be filled; None when the client has left none."""
        if not self._queued:
            return None
        buffer = self._queued.popleft()
        buffer.state = NONE
        return buffer

    def fill(self, buffer: Buffer) -> None:
        """It holds a picture now. Nothing happens when the buffers were forgotten meanwhile."""
        if buffer.idle or buffer.state or not any(buffer is known for known in self._all):
            return
        buffer.state = Flag.DONE
        self._done.append(buffer)
