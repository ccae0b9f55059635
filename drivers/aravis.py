"""A camera and its picture stream through libaravis-0.8: what a GigE Vision driver needs of them, no more.

Every call blocks and may raise AravisError; see `drivers.aravis_library`.
"""

import ctypes
from ctypes import byref, c_size_t, c_uint
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.aravis_library import NOT_FOUND, AravisError, Library, library

IMAGE = 1  # payload type
STATUS = {
    0: "success",
    1: "cleared",
    2: "timeout",
    3: "missing-packets",
    4: "wrong-packet-id",
    5: "size-mismatch",
    6: "filling",
    7: "aborted",
}
ALWAYS_ADJUST_PACKET_SIZE = 4
PACKET_SOCKET_DISABLED = 1
CHUNKS = (b"ChunkExposureTime", b"ChunkGain")
SOCKET_BUFFER_FIXED, SOCKET_BUFFER_AUTO = 0, 1
TIMESTAMP_CONTROL, TIMESTAMP_VALUE, LATCH = 0x0944, 0x0948, 0x2  # of the GigE Vision standard

Memory = NDArray[np.uint8]
Value = int | bool | str


class Arrived(NamedTuple):
    """A buffer that the library has done with. Width, height and format are 0 when it holds no whole picture."""

    memory: Memory
    received_bytes: int
    status: str
    width: int
    height: int
    pixel_format: int
    frame_id: int
    device_ns: int
    exposure: tuple[float, float] | None = None  # us and dB of this very picture, where the camera sends them along


class Device:
    """An opened camera. Raises LibraryMissing, AravisError."""

    def __init__(self, address: str) -> None:
        self._lib = library()
        self._camera: int | None = self._lib.camera_new(address.encode())
        if not self._camera:
            raise AravisError(NOT_FOUND, f"no camera at {address}")
        self._device = self._lib.device(self._camera)

    def close(self) -> None:
        """Let go; can take up to 10 s when the camera does not answer."""
        camera, self._camera = self._camera, None
        if camera:
            self._lib.unref(camera)

    @property
    def is_controller(self) -> bool:
        """Do we (still) have control, as far as the library's heartbeat knows?"""
        return bool(self._lib.is_controller(self._device))

    def take_control(self) -> None:
        """Ask for control; opening asks once already."""
        self._lib.take_control(self._device)

    def serial(self) -> str:
        """The serial number."""
        return (self._lib.serial(self._camera) or b"").decode(errors="replace").strip()

    # Features, by the names of the GenICam Standard Features Naming Convention

    def has(self, feature: str) -> bool:
        """Has this camera such a feature, and is it there in its present state?"""
        return bool(self._lib.has_feature(self._camera, feature.encode()))

    def integer(self, feature: str) -> int:
        """An integer feature."""
        return int(self._lib.integer(self._camera, feature.encode()))

    def real(self, feature: str) -> float:
        """A feature with a fraction."""
        return float(self._lib.real(self._camera, feature.encode()))

    def text(self, feature: str) -> str:
        """A text, or the present choice of an enumeration."""
        return (self._lib.text(self._camera, feature.encode()) or b"").decode(errors="replace")

    def choices(self, feature: str) -> list[str]:
        """What an enumeration can be."""
        count = c_uint()
        found = self._lib.choices(self._camera, feature.encode(), byref(count))
        try:
            return [found[number].decode(errors="replace") for number in range(count.value)]
        finally:
            self._lib.free(found)

    def value(self, feature: str, like: Value) -> Value:
        """A feature of the same type as `like`."""
        if isinstance(like, bool):
            return bool(self._lib.boolean(self._camera, feature.encode()))
        return self.integer(feature) if isinstance(like, int) else self.text(feature)

    def set_to(self, feature: str, value: Value) -> None:
        """Set a feature of the value's type."""
        name = feature.encode()
        if isinstance(value, bool):
            self._lib.set_boolean(self._camera, name, int(value))
        elif isinstance(value, int):
            self._lib.set_integer(self._camera, name, value)
        else:
            self._lib.set_text(self._camera, name, value.encode())

    # Pictures

    def set_region(self, left: int, top: int, width: int, height: int) -> tuple[int, int, int, int]:
        """Set the part of the sensor that is read out, in px; returns what the camera then has."""
        self._lib.set_region(self._camera, left, top, width, height)
        offsets = [self.integer(name) if self.has(name) else 0 for name in ("OffsetX", "OffsetY")]
        return offsets[0], offsets[1], self.integer("Width"), self.integer("Height")

    def set_pixel_format(self, code: int) -> int:
        """Set the format by its PFNC code; returns the code that the camera then has."""
        self._lib.set_pixel_format(self._camera, code)
        return int(self._lib.pixel_format(self._camera))

    def payload(self) -> int:
        """Bytes of a picture as it is set now."""
        return int(self._lib.payload(self._camera))

    def set_trigger(self, source: str) -> None:
        """One picture for each start signal of this source, on its rising edge."""
        self._lib.set_trigger(self._camera, source.encode())

    def clear_triggers(self) -> None:
        """Free run."""
        self._lib.clear_triggers(self._camera)

    def set_exposure(self, exposure_us: float, gain_db: float) -> tuple[float, float]:
        """Set both, and read both back."""
        self._lib.set_exposure(self._camera, exposure_us)
        self._lib.set_gain(self._camera, gain_db)
        return self.exposure()

    def exposure(self) -> tuple[float, float]:
        """Exposure in us and gain in dB, as the camera has them."""
        return float(self._lib.exposure(self._camera)), float(self._lib.gain(self._camera))

    def start(self) -> None:
        """Start acquisition."""
        self._lib.start(self._camera)

    def stop(self) -> None:
        """Stop acquisition."""
        self._lib.stop(self._camera)

    def trigger(self) -> None:
        """Trigger by software."""
        self._lib.trigger(self._camera)

    def tick_rate(self) -> int:
        """Ticks of the camera's clock in a second; 0 when it has none."""
        return int(self._lib.tick_rate(self._device))

    def ticks(self) -> int:
        """The camera's clock now."""
        value = (ctypes.c_ubyte * 8)()
        self._lib.write_register(self._device, TIMESTAMP_CONTROL, LATCH)
        self._lib.read_memory(self._device, TIMESTAMP_VALUE, 8, value)
        return int.from_bytes(bytes(value), "big")

    def packet_size(self) -> int:
        """Bytes in a stream packet, with all headers."""
        return int(self._lib.packet_size(self._camera))

    def set_packet_delay(self, delay_us: float) -> float:
        """Let the camera wait after each packet; returns the time that it then waits."""
        self._lib.set_packet_delay_ns(self._camera, round(delay_us * 1000))
        return int(self._lib.packet_delay_ns(self._camera)) / 1000

    def stream(self, socket_buffer_bytes: int | None = None, *, with_chunks: bool = False) -> "Stream":
        """Negotiate the packet size and open the stream: standard socket, and its buffer as large as may be.

        `with_chunks`: each picture brings its exposure time and gain.
        """
        self._lib.stream_options(self._camera, PACKET_SOCKET_DISABLED)
        self._lib.adjust_packet_size(self._camera, ALWAYS_ADJUST_PACKET_SIZE)
        handle = self._lib.create_stream(self._camera, None, None)
        if not handle:
            raise AravisError(-1, "no stream channel")
        if socket_buffer_bytes is None:
            self._lib.set_property(handle, b"socket-buffer", SOCKET_BUFFER_AUTO)
        else:
            self._lib.set_property(handle, b"socket-buffer", SOCKET_BUFFER_FIXED)
            self._lib.set_property(handle, b"socket-buffer-size", socket_buffer_bytes)
        return Stream(self._lib, handle, self._lib.chunk_parser(self._camera) if with_chunks else None)


class Stream:
    """Pictures as they come. The memory they come into is ours: `push` lends it, `pop` gives it back."""

    def __init__(self, library: Library, handle: int, chunk_parser: int | None = None) -> None:
        self._lib = library
        self._handle: int | None = handle
        self._chunk_parser = chunk_parser
        self._lent: dict[int, Memory] = {}

    def push(self, memory: Memory) -> None:
        """Lend memory for one picture."""
        self._lent[memory.ctypes.data] = memory
        self._lib.push(self._handle, self._lib.buffer_new(memory.nbytes, memory.ctypes.data))

    def pop(self, within_s: float) -> Arrived | None:
        """The next picture, whole or not, or None when none came."""
        buffer = self._lib.pop(self._handle, int(within_s * 1e6))
        if not buffer:
            return None
        try:
            return self._arrived(buffer)
        finally:
            self._lib.unref(buffer)

    def _arrived(self, buffer: int) -> Arrived:
        received = c_size_t()
        address = self._lib.buffer_data(buffer, byref(received))
        status = STATUS.get(self._lib.buffer_status(buffer), "unknown")
        image = (0, 0, 0)
        lib = self._lib
        # What is no picture, or says so by a damaged leader, must not be asked for a picture's size.
        if status == "success" and lib.buffer_kind(buffer) == IMAGE and lib.buffer_parts(buffer):
            image = (lib.buffer_width(buffer), lib.buffer_height(buffer), lib.buffer_format(buffer))
        # The library counts what was received without regard to the buffer's size: the caller must compare.
        memory = self._lent.pop(address)
        fits = status == "success" and received.value <= memory.nbytes
        return Arrived(
            memory,
            int(received.value),
            status,
            *image,
            int(self._lib.buffer_frame(buffer)),
            int(self._lib.buffer_time(buffer)),
            self._exposure(buffer) if fits else None,
        )

    def _exposure(self, buffer: int) -> tuple[float, float] | None:
        """What the picture's chunks say. The library walks through them, so the buffer must hold all of them."""
        if self._chunk_parser is None or not self._lib.buffer_has_chunks(buffer):
            return None
        try:
            exposure_us, gain_db = (self._lib.chunk_real(self._chunk_parser, buffer, name) for name in CHUNKS)
        except AravisError:
            return None
        return float(exposure_us), float(gain_db)

    def count(self, name: str) -> int:
        """One of the stream's own counters, for instance "n_resent_packets"."""
        return int(self._lib.info(self._handle, name.encode()))

    def close(self) -> None:
        """End the library's receive thread; no `pop` may be under way."""
        for thing in filter(None, (self._handle, self._chunk_parser)):
            self._lib.unref(thing)
        self._handle = self._chunk_parser = None
