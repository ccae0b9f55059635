"""What the kernel is answered about the one file of a simulated V4L2 camera: open, ioctl, poll, pages, release.

An ioctl whose argument holds a pointer cannot be served: the kernel copies only as many bytes as its number says. So
there are no VIDIOC_*_EXT_CTRLS, no multi-planar formats and no user pointers. Device memory cannot be mapped either:
a client maps the file's pages, and every picture is stored into them before the client is told of it.
"""

import errno
import os
from collections.abc import Callable

from simulators.v4l2 import fuse_wire as wire
from simulators.v4l2.abi import answers
from simulators.v4l2.fuse_wire import Message, Opcode
from simulators.v4l2.port import Port

MODE = 0o666


class FuseService:
    """Answers requests, through `send`. Used in one thread."""

    def __init__(self, port: Port, owner: tuple[int, int], send: Callable[[bytes], None]) -> None:
        self._port = port
        self._owner = owner
        self._send = send
        self._impatient: set[int] = set()  # handles that were opened with O_NONBLOCK
        self._watching: dict[int, int] = {}  # the kernel's poll handle of a handle
        self._waiting: dict[int, tuple[int, int, bytes]] = {}  # ioctls that wait for a picture, by request
        self._verbs: dict[int, Callable[[Message], bytes]] = {
            Opcode.INIT: lambda message: wire.welcome(message.body),
            Opcode.GETATTR: self._attributes,
            Opcode.SETATTR: self._attributes,
            Opcode.OPEN: self._open,
            Opcode.READ: self._read,
            Opcode.RELEASE: self._release,
            Opcode.POLL: self._poll,
            Opcode.STATFS: lambda message: wire.STATFS_REPLY.pack(0, 0, 0, 1, 0, wire.BLOCK, 255, wire.BLOCK, 0),
            Opcode.FSYNC: lambda message: b"",
            Opcode.DESTROY: lambda message: b"",
        }

    def handle(self, data: bytes) -> None:
        """One request of the kernel; raises ValueError for what is none."""
        message = wire.parse(data)
        if message.opcode == Opcode.INTERRUPT:
            self._interrupt(wire.HANDLE.unpack_from(message.body)[0])
        elif message.opcode == Opcode.IOCTL:
            self._ioctl(message)
        elif message.opcode not in wire.UNANSWERED:
            self._send(self._answer(message))

    def look_again(self) -> None:
        """Something changed: tell who polls, and try again what waits for a picture."""
        for handle, kernel_handle in self._watching.items():
            if self._port.poll(handle):
                body = wire.HANDLE.pack(kernel_handle)
                self._send(wire.notice_head(wire.NOTIFY_POLL, len(body)) + body)
        for unique, waiting in list(self._waiting.items()):
            self._try(unique, *waiting)

    def _answer(self, message: Message) -> bytes:
        verb = self._verbs.get(message.opcode)
        if verb is None:
            return wire.refusal(message.unique, errno.ENOSYS)
        try:
            return wire.reply(message.unique, verb(message))
        except OSError as error:
            return wire.refusal(message.unique, error.errno or errno.EIO)

    def _attributes(self, _message: Message) -> bytes:
        return wire.attributes(self._port.device.memory.size, MODE, self._owner)

    def _open(self, message: Message) -> bytes:
        flags, _unused = wire.OPEN.unpack_from(message.body)
        handle = self._port.open()
        if flags & os.O_NONBLOCK:
            self._impatient.add(handle)
        return wire.OPEN_REPLY.pack(handle, wire.KEEP_CACHE, 0)

    def _release(self, message: Message) -> bytes:
        (handle,) = wire.HANDLE.unpack_from(message.body)
        self._impatient.discard(handle)
        self._watching.pop(handle, None)
        self._port.close(handle)
        return b""

    def _read(self, message: Message) -> bytes:
        """Pages that the kernel has dropped. The memory is the camera's; no lock, for a store may wait for this."""
        _handle, offset, size = wire.READ.unpack_from(message.body)
        return self._port.device.memory[offset : offset + size].tobytes()

    def _poll(self, message: Message) -> bytes:
        handle, kernel_handle, flags, _events = wire.POLL.unpack_from(message.body)
        if flags & wire.TELL_LATER:
            self._watching[handle] = kernel_handle
        return wire.POLL_REPLY.pack(self._port.poll(handle), 0)

    def _ioctl(self, message: Message) -> None:
        handle, _flags, request, _argument, in_size, _out_size = wire.IOCTL.unpack_from(message.body)
        self._try(message.unique, handle, request, message.body[wire.IOCTL.size :][:in_size])

    def _try(self, unique: int, handle: int, request: int, data: bytes) -> None:
        """Answer an ioctl, or let it wait when its client may be made to wait."""
        self._waiting.pop(unique, None)
        try:
            answer = self._port.ioctl(handle, request, data)
        except BlockingIOError as error:
            if handle in self._impatient:
                self._send(wire.refusal(unique, error.errno or errno.EAGAIN))
            else:
                self._waiting[unique] = (handle, request, data)
        except OSError as error:
            self._send(wire.refusal(unique, error.errno or errno.EIO))
        else:
            body = answer if answers(request) else b""
            self._send(wire.reply(unique, wire.IOCTL_REPLY.pack(0, 0, 0, 0) + body))

    def _interrupt(self, unique: int) -> None:
        if self._waiting.pop(unique, None) is not None:
            self._send(wire.refusal(unique, errno.EINTR))
