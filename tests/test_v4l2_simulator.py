"""The simulated V4L2 device: what the kernel's interface demands of one, whatever a client sends."""

import asyncio
import errno
import os
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import v4l2_abi
from simulators.clock import Clock
from simulators.v4l2 import Device, V4l2CameraServer, abi
from simulators.v4l2 import fuse_wire as wire
from simulators.v4l2.abi import Event, Request
from simulators.v4l2.controls import EXPOSURE_ABSOLUTE, GAIN, SOFTWARE_TRIGGER
from simulators.v4l2.formats import FORMATS
from simulators.v4l2.fuse_service import FuseService
from simulators.v4l2.port import Port
from tests.v4l2_rig import Scene

SIZE = (64, 48)
KIND = struct.pack("<i", 1)


def device(**options: object) -> Device:
    return Device("SN1", SIZE, **options)


def streaming(one: Device, count: int = 4) -> int:
    """A handle that streams with all buffers queued."""
    handle = one.open()
    one.ioctl(handle, Request.REQBUFS, bytes(v4l2_abi.ask_buffers(count)))
    for index in range(count):
        one.ioctl(handle, Request.QBUF, bytes(v4l2_abi.ask_buffer(index)))
    one.ioctl(handle, Request.STREAMON, KIND)
    return handle


def outcome(one: Device, handle: int, request: int, data: bytes) -> str:
    """The kernel's name of the refusal, or "ok"."""
    try:
        answer = one.ioctl(handle, request, data)
    except OSError as error:
        return errno.errorcode[error.errno or 0]
    return "ok" if len(answer) == (abi.size(request) if abi.answers(request) else 0) else "wrong length"


def test_driver_and_simulator_were_written_apart_and_have_the_same_numbers():
    for request in Request:
        if hasattr(v4l2_abi, request.name):
            assert getattr(v4l2_abi, request.name) == request, request.name
    assert v4l2_abi.EXPOSURE_ABSOLUTE == EXPOSURE_ABSOLUTE
    assert v4l2_abi.GAIN == GAIN


def test_numbers_are_those_of_the_kernels_header():
    header = Path("/usr/include/linux/videodev2.h")
    if not header.exists():
        pytest.skip("the kernel's headers are not installed (Debian package linux-libc-dev)")
    text = header.read_text(encoding="utf-8")
    for known in FORMATS.values():
        characters = ", ".join(f"'{character}'" for character in known.fourcc)
        assert f"v4l2_fourcc({characters})" in text, known.fourcc
    for request in Request:
        number = request & 0xFF
        name = next(line.split()[1] for line in text.splitlines() if "_IO" in line and f"'V', {number:2d}," in line)
        assert name.removeprefix("VIDIOC_") == request.name


def test_a_device_says_what_it_is():
    one = device()
    found = v4l2_abi.capability(one.ioctl(one.open(), Request.QUERYCAP, b""))
    assert found == (
        "cellsim",
        "Simulated camera",
        "platform:SN1",
        abi.CAN_CAPTURE | abi.CAN_STREAM | abi.EXT_PIX_FORMAT,
    )
    assert found.captures


def test_a_format_that_it_does_not_have_becomes_the_nearest_and_is_no_error():
    one = device()
    handle = one.open()
    asked = bytes(v4l2_abi.ask_format(70, 47, "H264"))
    got = v4l2_abi.format_set(one.ioctl(handle, Request.S_FMT, asked))
    assert got[:3] == (64, 46, "GREY")
    assert got.picture_bytes == 64 * 46


def test_only_one_client_may_stream_and_the_others_are_told_that_it_is_busy():
    one = device()
    first, second = streaming(one), one.open()
    assert outcome(one, second, Request.S_FMT, bytes(v4l2_abi.ask_format(64, 48, "GREY"))) == "EBUSY"
    assert outcome(one, second, Request.REQBUFS, bytes(v4l2_abi.ask_buffers(2))) == "EBUSY"
    assert outcome(one, first, Request.S_FMT, bytes(v4l2_abi.ask_format(64, 48, "GREY"))) == "EBUSY"
    assert one.poll(second) == Event.ERR
    one.close(first)
    one.ioctl(second, Request.S_FMT, bytes(v4l2_abi.ask_format(64, 48, "GREY")))


@pytest.mark.parametrize(
    ("request_", "data", "error"),
    [
        (Request.QBUF, bytes(v4l2_abi.ask_buffer(9)), "EINVAL"),
        (Request.QBUF, bytes(v4l2_abi.ask_buffer(0)), "EINVAL"),  # the camera has it already
        (Request.DQBUF, bytes(v4l2_abi.ask_buffer()), "EAGAIN"),
        (Request.S_CTRL, bytes(v4l2_abi.ask_control(GAIN, 9999)), "ERANGE"),
        (Request.S_CTRL, bytes(v4l2_abi.ask_control(0x123456, 1)), "EINVAL"),
        (Request.G_CTRL, bytes(v4l2_abi.ask_control(SOFTWARE_TRIGGER)), "EACCES"),
        (0xC0205647, bytes(32), "ENOTTY"),  # VIDIOC_G_EXT_CTRLS: its argument holds a pointer
        (Request.S_CTRL, b"", "EINVAL"),
    ],
    ids=["no buffer", "twice", "no picture", "range", "control", "button", "pointers", "short"],
)
def test_what_cannot_be_is_refused_with_the_kernels_number(request_: int, data: bytes, error: str):
    one = device()
    assert outcome(one, streaming(one), request_, data) == error


def test_an_unplugged_device_is_gone_for_everything():
    one = device()
    handle = streaming(one)
    one.unplug(True)
    assert outcome(one, handle, Request.QUERYCAP, b"") == "ENODEV"
    assert one.poll(handle) == Event.ERR | Event.HUP
    with pytest.raises(OSError, match="unplugged"):
        one.open()


async def test_a_fault_that_it_does_not_have_is_refused():
    server = V4l2CameraServer(device(), Scene(SIZE), Clock())
    with pytest.raises(ValueError, match="no fault 'packet_loss'; it has busy, clear, drop"):
        server.inject("packet_loss")
    with pytest.raises(ValueError, match="unexpected keyword argument"):
        server.inject("drop", ratio=1)


# Whatever comes


numbers = st.one_of(st.sampled_from([GAIN, EXPOSURE_ABSOLUTE, SOFTWARE_TRIGGER]), st.integers(0, 2**32 - 1))
requests = st.one_of(st.sampled_from(list(Request)), st.integers(0, 2**32 - 1))
arguments = st.one_of(
    st.binary(max_size=240),
    st.builds(lambda n: bytes(v4l2_abi.ask_buffer(n)), st.integers(0, 9)),
    st.builds(lambda n: bytes(v4l2_abi.ask_buffers(n)), st.integers(0, 40)),
    st.builds(
        lambda a, b, c: bytes(v4l2_abi.ask_control(a, b % 2**31)), st.integers(0, 2**32 - 1), st.integers(0), st.none()
    ),
    st.just(KIND),
)


@settings(max_examples=80, deadline=None)
@given(st.lists(st.tuples(st.integers(1, 3), requests, arguments), max_size=40), st.booleans())
def test_no_call_breaks_the_device_and_every_buffer_is_at_one_place(
    calls: list[tuple[int, int, bytes]], unplugged: bool
):
    one = device()
    for _ in range(3):
        one.open()
    for number, (handle, request, data) in enumerate(calls):
        assert outcome(one, handle, request, data) != "wrong length"
        if number % 3 == 0 and (buffer := one.buffers.take()) is not None:
            one.buffers.fill(buffer)
        places = Counter(id(b) for b in (*one.buffers._queued, *one.buffers._done))
        assert max(places.values(), default=1) == 1
        assert not any(b.idle for b in (*one.buffers._queued, *one.buffers._done))
    one.unplug(unplugged)
    for handle in (1, 2, 3):
        one.poll(handle)
        one.close(handle)
    assert not one.streaming


class Kernel:
    """Collects what a service answers."""

    def __init__(self) -> None:
        self.port = Port(device())
        self.sent: list[bytes] = []
        self.service = FuseService(self.port, (0, 0), self.sent.append)

    def request(self, opcode: int, body: bytes, unique: int) -> None:
        """One request; `sent` is what it was answered."""
        self.sent.clear()
        self.service.handle(wire.HEADER.pack(wire.HEADER.size + len(body), opcode, unique, 1, 0, 0, 0, 0) + body)

    def ask(self, opcode: int, body: bytes) -> bytes:
        """One request that is answered well; the answer."""
        self.request(opcode, body, 7)
        (answer,) = self.sent
        assert wire.REPLY.unpack_from(answer) == (len(answer), 0, 7)
        return answer[wire.REPLY.size :]

    def ioctl(self, handle: int, request: int, data: bytes, unique: int = 7) -> None:
        """One call of a client."""
        head = wire.IOCTL.pack(handle, 0, request, 0, len(data), abi.size(request))
        self.request(wire.Opcode.IOCTL, head + data, unique)

    def waiting_client(self) -> None:
        """Somebody who opened it without O_NONBLOCK waits for a picture, by request 99."""
        (handle, *_) = wire.OPEN_REPLY.unpack(self.ask(wire.Opcode.OPEN, wire.OPEN.pack(os.O_RDWR, 0)))
        self.ioctl(handle, Request.REQBUFS, bytes(v4l2_abi.ask_buffers(2)))
        self.ioctl(handle, Request.QBUF, bytes(v4l2_abi.ask_buffer(0)))
        self.ioctl(handle, Request.STREAMON, KIND)
        self.ioctl(handle, Request.DQBUF, bytes(v4l2_abi.ask_buffer()), unique=99)
        assert self.sent == []


@settings(max_examples=80, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 60), st.binary(max_size=300), st.integers(0, 2**64 - 1)), max_size=20))
def test_every_request_of_the_kernel_gets_one_answer_or_is_none(requests_: list[tuple[int, bytes, int]]):
    kernel = Kernel()
    for opcode, body, unique in requests_:
        if len(body) < wire.SMALLEST_BODY.get(opcode, 0):
            with pytest.raises(ValueError, match="body"):
                kernel.request(opcode, body, unique)
            continue
        kernel.request(opcode, body, unique)
        waits = opcode == wire.Opcode.IOCTL and unique in kernel.service._waiting
        expected = 0 if opcode in wire.UNANSWERED or waits else 1
        assert len(kernel.sent) == expected
        for answer in kernel.sent:
            length, error, answered = wire.REPLY.unpack_from(answer)
            assert (length, answered) == (len(answer), unique)
            assert -4096 < error <= 0


@given(st.binary(max_size=200))
def test_bytes_that_are_no_request_are_refused(data: bytes):
    try:
        message = wire.parse(data)
    except ValueError:
        return
    assert len(data) == wire.HEADER.size + len(message.body)


def test_a_client_that_may_wait_gets_its_picture_when_it_is_there():
    kernel = Kernel()
    kernel.waiting_client()
    _number, buffer = kernel.port.begin_picture()
    assert buffer is not None
    buffer.used = 10
    kernel.port.end_picture(buffer)
    kernel.service.look_again()
    (answer,) = kernel.sent
    assert wire.REPLY.unpack_from(answer)[1:] == (0, 99)
    assert v4l2_abi.buffer_filled(answer[wire.REPLY.size + wire.IOCTL_REPLY.size :]).used_bytes == 10


def test_a_waiting_client_can_be_interrupted():
    kernel = Kernel()
    kernel.waiting_client()
    kernel.request(wire.Opcode.INTERRUPT, wire.HANDLE.pack(99), 100)
    assert kernel.sent == [wire.refusal(99, errno.EINTR)]


async def test_a_picture_of_the_wrong_shape_is_a_mistake_of_the_scene_and_is_raised():
    server = V4l2CameraServer(device(triggers=False), lambda exposure: np.zeros((2, 2), np.uint8), Clock(50.0))
    await server.start()
    opened = server.open_here()
    opened.ioctl(Request.REQBUFS, v4l2_abi.ask_buffers(2))
    opened.ioctl(Request.QBUF, v4l2_abi.ask_buffer(0))
    opened.ioctl(Request.STREAMON, bytearray(KIND))
    await asyncio.wait([server._sensor._task], timeout=2)
    opened.close()
    with pytest.raises(ValueError, match="must be"):
        await server.close()
