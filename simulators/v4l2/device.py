"""A V4L2 capture device as a state machine: who has it open, what it is set to, whose turn each buffer is. Pure.

Whatever reaches it (a FUSE file, a call in the same process) hands over an ioctl's number and bytes. A refusal is an
OSError with the number that a kernel driver gives (kernel documentation, "Video for Linux API").
"""

import errno
from collections.abc import Callable, Iterable

import numpy as np

from simulators.v4l2 import abi
from simulators.v4l2.abi import Event, Flag, Request
from simulators.v4l2.buffers import PAGE, Buffer, Buffers
from simulators.v4l2.controls import Controls
from simulators.v4l2.window import Readout, for_capture

DRIVER, CARD, VERSION = "cellsim", "Simulated camera", 0x060100
CAPABILITIES = abi.CAN_CAPTURE | abi.CAN_STREAM | abi.EXT_PIX_FORMAT
ROOM_BUFFERS, DEEPEST_BYTES = 8, 2


class Device:
    """One camera. `changed` is called when streaming or presence change, and for each software trigger."""

    def __init__(
        self,
        serial: str,
        sensor: tuple[int, int] = (2592, 1944),
        *,
        formats: Iterable[str] = (),
        triggers: bool = True,
        rate_hz: float = 15.0,
        padding_bytes: int = 0,
        start_of_exposure: bool = True,
    ) -> None:
        self.serial = serial
        self.controls = Controls(triggers=triggers)
        self.readout = Readout(sensor, tuple(formats), rate_hz, padding_bytes)
        self.streaming = False
        self.gone = False
        self.foreign = False  # some other program has it
        self.changed: Callable[[], None] = _nothing
        self.driver = DRIVER  # the kernel's, of which some have habits that clients know
        self.monotonic = True  # time stamps are by this clock
        self.start_of_exposure = start_of_exposure  # or the end of the picture: what the time stamps tell
        room = ROOM_BUFFERS * (-(-((sensor[0] * DEEPEST_BYTES + padding_bytes) * sensor[1]) // PAGE) * PAGE)
        self.memory = np.zeros(room, np.uint8)
        self.buffers = Buffers(room)
        self._open: set[int] = set()
        self._last_handle = 0
        self._owner: int | None = None
        self._questions: dict[int, Callable[[bytes], bytes]] = {
            Request.QUERYCAP: self._capability,
            Request.ENUM_FMT: self.readout.describe_format,
            Request.G_FMT: self.readout.get_format,
            Request.TRY_FMT: self.readout.try_format,
            Request.QUERYBUF: self._query_buffer,
            Request.G_PARM: self.readout.get_parameters,
            Request.ENUMINPUT: _describe_input,
            Request.G_INPUT: lambda data: abi.NUMBER.pack(0),
            Request.S_INPUT: _set_input,
            Request.G_CTRL: self.controls.get,
            Request.S_CTRL: self._set_control,
            Request.QUERYCTRL: self.controls.describe,
            Request.QUERY_EXT_CTRL: self.controls.describe_at_length,
            Request.QUERYMENU: self.controls.describe_choice,
            Request.ENUM_FRAMESIZES: self.readout.describe_sizes,
            Request.ENUM_FRAMEINTERVALS: self.readout.describe_intervals,
            Request.G_SELECTION: self.readout.get_selection,
        }
        self._orders: dict[int, Callable[[bytes], bytes]] = {  # only from the one that streams
            Request.S_FMT: self._at_rest(self.readout.set_format),
            Request.S_SELECTION: self._at_rest(self.readout.set_selection),
            Request.S_PARM: self.readout.set_parameters,
            Request.REQBUFS: self._request_buffers,
            Request.QBUF: self._queue,
            Request.DQBUF: self._dequeue,
            Request.STREAMON: self._stream_on,
            Request.STREAMOFF: self._stream_off,
        }

    def open(self) -> int:
        """A new handle; ENODEV when the camera is unplugged."""
        self._be_there()
        self._last_handle += 1
        self._open.add(self._last_handle)
        return self._last_handle

    def close(self, handle: int) -> None:
        """The handle is not used any more; what it streamed ends."""
        self._open.discard(handle)
        if self._owner == handle:
            self._end_stream()
            self.buffers.allocate(0, PAGE)
            self._owner = None

    def ioctl(self, handle: int, request: int, data: bytes) -> bytes:
        """The argument as it comes back. Raises OSError; EAGAIN when a picture has to be waited for."""
        self._be_there()
        if handle not in self._open:
            raise OSError(errno.EBADF, f"no handle {handle}")
        verb = self._questions.get(request) or self._orders.get(request)
        if verb is None:
            raise OSError(errno.ENOTTY, f"no request {request:#x}")
        expected = abi.size(request) if abi.reads(request) else 0
        if len(data) < expected:
            raise OSError(errno.EINVAL, "the argument is too short")
        if request in self._orders:
            self._own(handle)
        answer = verb(data[:expected])
        if request == Request.REQBUFS:
            self._owner = handle if len(self.buffers) else None
        return answer

    def poll(self, handle: int) -> Event:
        """What a client may do without waiting."""
        if self.gone:
            return Event.ERR | Event.HUP
        if not self.streaming or handle != self._owner:
            return Event.ERR
        return Event.IN | Event.RDNORM if self.buffers.any_done else Event(0)

    def unplug(self, gone: bool) -> None:
        """Pull the plug, or put it in again."""
        self.gone = gone
        if gone:
            self._end_stream()
        self.changed()

    def _be_there(self) -> None:
        if self.gone:
            raise OSError(errno.ENODEV, "unplugged")

    def _own(self, handle: int) -> None:
        if self.foreign or self._owner not in (None, handle):
            raise OSError(errno.EBUSY, "another program has it")

    def _at_rest(self, verb: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
        """The verb, refused while there are buffers."""

        def checked(data: bytes) -> bytes:
            if len(self.buffers):
                raise OSError(errno.EBUSY, "buffers are allocated")
            return verb(data)

        return checked

    def _capability(self, _data: bytes) -> bytes:
        names = abi.text(self.driver, 16), abi.text(CARD, 32), abi.text(f"platform:{self.serial}", 32)
        return abi.CAPABILITY.pack(*names, VERSION, CAPABILITIES | abi.HAS_DEVICE_CAPS, CAPABILITIES)

    def _set_control(self, data: bytes) -> bytes:
        before = self.controls.presses
        answer = self.controls.set(data)
        if self.controls.presses != before:
            self.changed()
        return answer

    def _request_buffers(self, data: bytes) -> bytes:
        count, kind, memory, _capabilities = abi.REQUEST_BUFFERS.unpack(data)
        for_capture(kind)
        if memory != abi.MEMORY_MMAP:
            raise OSError(errno.EINVAL, "buffers are mapped memory only")
        if self.streaming:
            raise OSError(errno.EBUSY, "streaming")
        got = self.buffers.allocate(count, self.readout.picture_bytes)
        return abi.REQUEST_BUFFERS.pack(got, kind, memory, abi.SUPPORTS_MMAP)

    def _packed(self, buffer: Buffer) -> bytes:
        source = Flag.START_OF_EXPOSURE if self.start_of_exposure else Flag(0)
        clock = Flag.MONOTONIC if self.monotonic else Flag(0)
        flags = Flag.MAPPED | clock | source | buffer.state | buffer.flags
        seconds, rest_ns = divmod(buffer.stamp_ns, 1_000_000_000)
        head = (buffer.index, abi.CAPTURE, buffer.used, flags, abi.FIELD_NONE, seconds, rest_ns // 1000, b"")
        return abi.BUFFER.pack(*head, buffer.sequence, abi.MEMORY_MMAP, buffer.offset, buffer.length, 0)

    def _query_buffer(self, data: bytes) -> bytes:
        index, kind, *_ = abi.BUFFER.unpack(data)
        for_capture(kind)
        return self._packed(self.buffers.find(index))

    def _queue(self, data: bytes) -> bytes:
        index, kind, *_ = abi.BUFFER.unpack(data)
        for_capture(kind)
        return self._packed(self.buffers.queue(index))

    def _dequeue(self, data: bytes) -> bytes:
        for_capture(abi.BUFFER.unpack(data)[1])
        if not self.streaming:
            raise OSError(errno.EINVAL, "not streaming")
        return self._packed(self.buffers.dequeue())

    def _stream_on(self, data: bytes) -> bytes:
        for_capture(abi.NUMBER.unpack(data)[0])
        if not len(self.buffers):
            raise OSError(errno.EINVAL, "no buffers")
        if not self.streaming:
            self.streaming, self.buffers.sequence = True, 0
            self.changed()
        return b""

    def _stream_off(self, data: bytes) -> bytes:
        for_capture(abi.NUMBER.unpack(data)[0])
        self._end_stream()
        return b""

    def _end_stream(self) -> None:
        self.streaming = False
        self.buffers.forget()
        self.changed()


def _nothing() -> None:
    """Nobody listens."""


def _describe_input(data: bytes) -> bytes:
    if abi.NUMBER.unpack_from(data)[0]:
        raise OSError(errno.EINVAL, "one input only")
    return abi.INPUT.pack(0, abi.text("Camera 1", 32), abi.INPUT_CAMERA, 0, 0)


def _set_input(data: bytes) -> bytes:
    if abi.NUMBER.unpack(data)[0]:
        raise OSError(errno.EINVAL, "one input only")
    return data
