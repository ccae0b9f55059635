"""Whatever a device answers, the V4L2 driver gives a picture of the right size or an error of its own."""

import errno

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.pictures.jpeg import luma
from drivers import pixels, v4l2_abi
from drivers.camera import Counters, Pixels, Region, Setup, Trigger
from drivers.errors import DeviceError
from drivers.v4l2_abi import Filled, Flag
from drivers.v4l2_capture import Capture, Wanted
from drivers.v4l2_inbox import Inbox
from simulators.v4l2 import Device
from simulators.v4l2.port import Port

SIZE = (64, 48)
ERRORS = [errno.EINVAL, errno.ENOTTY, errno.EBUSY, errno.EIO, errno.ENODEV, errno.EAGAIN, errno.ERANGE]
OURS = (DeviceError, OSError)


class Mad:
    """A device of which some answers are changed: bytes overwritten, or an error instead."""

    def __init__(self, data: st.DataObject, pixel_format: pixels.PixelFormat) -> None:
        self._data = data
        self._port = Port(Device("SN1", SIZE, triggers=data.draw(st.booleans())))
        self._handle = self._port.open()
        self.madness = data.draw(st.sampled_from([0.0, 0.05, 0.5]))
        self._rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
        self.closed = False

    def fileno(self) -> int:
        raise AssertionError("nobody waits here")

    def ioctl(self, request: int, argument: bytearray) -> None:
        mad = self._rng.random() < self.madness
        if mad and self._rng.random() < 0.3:
            raise OSError(int(self._rng.choice(ERRORS)), "mad")
        answer = self._port.ioctl(self._handle, request, bytes(argument))
        argument[: len(answer)] = answer
        if mad:
            first = int(self._rng.integers(0, len(argument)))
            chosen = self._rng.choice([0, 1, 0x7F, 0xFF, *self._rng.integers(0, 256, 4)], 4)
            argument[first : first + 4] = chosen.astype(np.uint8).tobytes()[: len(argument) - first]

    def map(self, offset: int, length: int) -> Pixels:
        memory = self._port.device.memory
        if offset % 4096 or offset + length > memory.size or not length:
            raise ValueError("mmap length is greater than file size")
        return memory[offset : offset + length]

    def close(self) -> None:
        self.closed = True

    def take_picture(self) -> None:
        _number, buffer = self._port.begin_picture()
        if buffer is not None:
            buffer.used = buffer.length
            self._port.end_picture(buffer)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_a_mad_device_gives_whole_pictures_or_errors_of_the_driver(data: st.DataObject):
    chosen = data.draw(st.sampled_from([pixels.MONO8, pixels.MONO12, pixels.RAW10P]))
    opened: list[Mad] = []

    def open_node(_path: str) -> Mad:
        opened.append(Mad(data, chosen))
        return opened[0]

    setup = Setup("SN1", Region(0, 0, *SIZE), chosen)
    decode = luma if data.draw(st.booleans()) else None
    wanted = Wanted("camera 1", "/dev/null", setup, open_node, decode, exposure=(2000.0, 0.0))
    try:
        capture = Capture(wanted)
    except OURS:
        assert opened[0].closed
        return
    for trigger in (Trigger.SOFTWARE, Trigger.FREE, Trigger.LINE):
        try:
            capture.start(trigger)
            opened[0].take_picture()
            filled = capture.fetch()
            if filled is None or capture.flaw(filled):
                continue
            capture.earliest_start_ns(filled)
            picture, _payload = capture.copy(filled)
        except OURS:
            continue
        assert picture.shape == (SIZE[1], SIZE[0])
        assert picture.dtype == np.uint8
    capture.close()
    assert opened[0].closed


@given(st.binary(max_size=400))
def test_bytes_that_are_no_jpeg_are_an_error(data: bytes):
    for content in (data, b"\xff\xd8" + data + b"\xff\xd9"):
        try:
            picture = luma(content)
        except ValueError:
            continue
        assert picture.ndim == 2


PARSERS = [
    (v4l2_abi.capability, v4l2_abi.QUERYCAP),
    (v4l2_abi.format_name, v4l2_abi.ENUM_FMT),
    (v4l2_abi.format_set, v4l2_abi.S_FMT),
    (v4l2_abi.buffers_given, v4l2_abi.REQBUFS),
    (v4l2_abi.buffer_place, v4l2_abi.QUERYBUF),
    (v4l2_abi.buffer_filled, v4l2_abi.DQBUF),
    (v4l2_abi.picture_interval_s, v4l2_abi.G_PARM),
    (v4l2_abi.control_value, v4l2_abi.G_CTRL),
    (v4l2_abi.control_facts, v4l2_abi.QUERY_EXT_CTRL),
    (v4l2_abi.choice_name, v4l2_abi.QUERYMENU),
    (v4l2_abi.selection, v4l2_abi.G_SELECTION),
]


@given(st.sampled_from(PARSERS), st.randoms(use_true_random=False))
def test_every_answer_of_the_right_length_can_be_read(parser: tuple[object, int], chance: object):
    read, request = parser
    read(chance.randbytes(len(v4l2_abi.blank(request))))  # type: ignore[operator, attr-defined]


@settings(deadline=None)
@given(
    st.sampled_from([Trigger.LINE, Trigger.FREE]),
    st.lists(st.tuples(st.integers(1, 9), st.integers(0, 2**32 - 1), st.booleans()), max_size=30),
)
def test_every_buffer_is_kept_or_given_back_once_and_counted(trigger: Trigger, pictures: list[tuple[int, int, bool]]):
    given_back: list[int] = []
    inbox = Inbox("camera 1", trigger, given_back.append)
    inbox.floor_ns = 3
    for buffer, (stamp_ns, sequence, damaged) in enumerate(pictures):
        inbox.take(Filled(buffer, 1, Flag(0), stamp_ns, sequence), stamp_ns, "broken" if damaged else "")
    kept = [item.filled.buffer for item in inbox._waiting if not isinstance(item, DeviceError)]
    assert sorted(given_back + kept) == list(range(len(pictures)))
    counted: Counters = inbox.counters
    assert counted.stale + counted.incomplete + counted.overrun == len(given_back)
    assert all(pictures[buffer][0] >= 3 and not pictures[buffer][2] for buffer in kept)
    stamps = [pictures[buffer][0] for buffer in kept]
    assert stamps == sorted(set(stamps))
