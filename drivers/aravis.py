"""A thin typed binding to libaravis-0.8: what a GigE Vision driver needs of it, no more.

Every call blocks (a control call up to 2.5 s: 5 tries of 500 ms), releases the interpreter lock, and may raise
AravisError.
The library is loaded at the first use, so that a cell without such cameras does without it.
"""

import ctypes
from collections.abc import Callable
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_uint32, c_uint64, c_void_p
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

PACKAGE = "libaravis-0.8-0"
SONAME = "libaravis-0.8.so.0"
MONO8 = 0x01080001
DOMAIN = "arv-device-error-quark"
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
NOT_CONNECTED, TIMEOUT, NOT_FOUND, NOT_CONTROLLER, ACCESS_DENIED = 2, 5, 6, 10, 17
ALWAYS_ADJUST_PACKET_SIZE = 4
PACKET_SOCKET_DISABLED = 1
SOCKET_BUFFER_FIXED, SOCKET_BUFFER_AUTO = 0, 1
TIMESTAMP_CONTROL, TIMESTAMP_VALUE, LATCH = 0x0944, 0x0948, 0x2  # of the GigE Vision standard

Memory = NDArray[np.uint8]


class AravisError(Exception):
    """Aravis could not do it. `code` is its ArvDeviceError code, -1 for errors of other kinds."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code


class LibraryMissing(Exception):
    """The shared library is not installed."""


class _GError(ctypes.Structure):
    _fields_ = (("domain", c_uint32), ("code", c_int), ("message", c_char_p))


_Error = POINTER(_GError)


class Arrived(NamedTuple):
    """A buffer that the library has done with. Width and height are 0 when the status is not "success"."""

    memory: Memory
    received_bytes: int
    status: str
    width: int
    height: int
    pixel_format: int
    frame_id: int
    device_ns: int


class _Library:
    """The functions, with their types."""

    def __init__(self) -> None:
        try:
            self._arv = ctypes.CDLL(SONAME)
            self._gobject = ctypes.CDLL("libgobject-2.0.so.0")
            self._glib = ctypes.CDLL("libglib-2.0.so.0")
        except OSError as error:
            raise LibraryMissing(f"{error}; install the Debian package {PACKAGE}") from error
        self._declare_gobject()
        self._declare_camera()
        self._declare_device()
        self._declare_stream()

    def _declare_camera(self) -> None:
        p, s, i, u = c_void_p, c_char_p, c_int, c_uint
        self.camera_new = self._checked("camera_new", p, s)
        self.serial = self._checked("camera_get_device_serial_number", c_char_p, p)
        self.camera_number = self._checked("camera_get_integer", ctypes.c_int64, p, s)
        self.set_region = self._checked("camera_set_region", None, p, i, i, i, i)
        self.set_pixel_format = self._checked("camera_set_pixel_format", None, p, c_uint32)
        self.set_trigger = self._checked("camera_set_trigger", None, p, s)
        self.set_exposure = self._checked("camera_set_exposure_time", None, p, c_double)
        self.exposure = self._checked("camera_get_exposure_time", c_double, p)
        self.set_gain = self._checked("camera_set_gain", None, p, c_double)
        self.gain = self._checked("camera_get_gain", c_double, p)
        self.payload = self._checked("camera_get_payload", u, p)
        self.trigger = self._checked("camera_software_trigger", None, p)
        self.start = self._checked("camera_start_acquisition", None, p)
        self.stop = self._checked("camera_stop_acquisition", None, p)
        self.packet_size = self._checked("camera_gv_get_packet_size", u, p)
        self.create_stream = self._checked("camera_create_stream", p, p, p, p)
        self.adjust_packet_size = self._plain("camera_gv_set_packet_size_adjustment", None, p, i)
        self.stream_options = self._plain("camera_gv_set_stream_options", None, p, i)
        self.device = self._plain("camera_get_device", p, p)

    def _declare_device(self) -> None:
        p, i = c_void_p, c_int
        self.is_controller = self._plain("gv_device_is_controller", i, p)
        self.take_control = self._checked("gv_device_take_control", i, p)
        self.tick_rate = self._checked("gv_device_get_timestamp_tick_frequency", c_uint64, p)
        self.write_register = self._checked("device_write_register", i, p, c_uint64, c_uint32)
        self.read_memory = self._checked("device_read_memory", i, p, c_uint64, c_uint32, p)

    def _declare_stream(self) -> None:
        p, s, i = c_void_p, c_char_p, c_int
        self.push = self._plain("stream_push_buffer", None, p, p)
        self.pop = self._plain("stream_timeout_pop_buffer", p, p, c_uint64)
        self.info = self._plain("stream_get_info_uint64_by_name", c_uint64, p, s)
        self.buffer_new = self._plain("buffer_new", p, c_size_t, p)
        self.buffer_status = self._plain("buffer_get_status", i, p)
        self.buffer_data = self._plain("buffer_get_data", p, p, POINTER(c_size_t))
        self.buffer_width = self._plain("buffer_get_image_width", i, p)
        self.buffer_height = self._plain("buffer_get_image_height", i, p)
        self.buffer_format = self._plain("buffer_get_image_pixel_format", c_uint32, p)
        self.buffer_frame = self._plain("buffer_get_frame_id", c_uint64, p)
        self.buffer_time = self._plain("buffer_get_timestamp", c_uint64, p)

    def _declare_gobject(self) -> None:
        self._glib.g_error_free.argtypes = [c_void_p]
        self._glib.g_quark_to_string.argtypes = [c_uint32]
        self._glib.g_quark_to_string.restype = c_char_p
        self.unref = self._gobject.g_object_unref
        self.unref.argtypes, self.unref.restype = [c_void_p], None
        self._set = self._gobject.g_object_set
        self._set.restype = None

    def set_int(self, thing: int, name: bytes, value: int) -> None:
        """Set a property of an integer or enumeration type."""
        self._set(c_void_p(thing), c_char_p(name), c_int(value), c_void_p(None))

    def _plain(self, name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
        function = getattr(self._arv, f"arv_{name}")
        function.restype, function.argtypes = result, list(arguments)
        return function  # type: ignore[no-any-return]  # ctypes knows no types of foreign functions

    def _checked(self, name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
        function = self._plain(name, result, *arguments, POINTER(_Error))

        def call(*values: Any) -> Any:
            error = _Error()
            answer = function(*values, byref(error))
            if error:
                raise self._error(error)
            return answer

        return call

    def _error(self, error: Any) -> AravisError:
        """The Python exception for a GError, which is freed."""
        content = error.contents
        domain = (self._glib.g_quark_to_string(content.domain) or b"").decode()
        code = content.code if domain == DOMAIN else -1
        message = (content.message or b"no reason given").decode(errors="replace")
        self._glib.g_error_free(error)
        return AravisError(code, message)


@cache
def _library() -> _Library:
    return _Library()


class Device:
    """An opened camera. Raises LibraryMissing, AravisError."""

    def __init__(self, address: str) -> None:
        self._lib = _library()
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

    def number(self, feature: str) -> int:
        """An integer feature."""
        return int(self._lib.camera_number(self._camera, feature.encode()))

    def set_format(self, width: int, height: int) -> int:
        """Mono8, this size at the sensor's origin, software trigger; returns the payload size in bytes."""
        self._lib.set_pixel_format(self._camera, MONO8)
        self._lib.set_region(self._camera, 0, 0, width, height)
        self._lib.set_trigger(self._camera, b"Software")
        return int(self._lib.payload(self._camera))

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

    def stream(self, socket_buffer_bytes: int | None = None) -> "Stream":
        """Negotiate the packet size and open the stream: standard socket, and its buffer as large as may be."""
        self._lib.stream_options(self._camera, PACKET_SOCKET_DISABLED)
        self._lib.adjust_packet_size(self._camera, ALWAYS_ADJUST_PACKET_SIZE)
        handle = self._lib.create_stream(self._camera, None, None)
        if not handle:
            raise AravisError(-1, "no stream channel")
        if socket_buffer_bytes is None:
            self._lib.set_int(handle, b"socket-buffer", SOCKET_BUFFER_AUTO)
        else:
            self._lib.set_int(handle, b"socket-buffer", SOCKET_BUFFER_FIXED)
            self._lib.set_int(handle, b"socket-buffer-size", socket_buffer_bytes)
        return Stream(self._lib, handle)


class Stream:
    """Pictures as they come. The memory they come into is ours: `push` lends it, `pop` gives it back."""

    def __init__(self, library: _Library, handle: int) -> None:
        self._lib = library
        self._handle: int | None = handle
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
        if status == "success":
            lib = self._lib
            image = (lib.buffer_width(buffer), lib.buffer_height(buffer), lib.buffer_format(buffer))
        # The library counts what was received without regard to the buffer's size: the caller must compare.
        return Arrived(
            self._lent.pop(address),
            int(received.value),
            status,
            *image,
            int(self._lib.buffer_frame(buffer)),
            int(self._lib.buffer_time(buffer)),
        )

    def count(self, name: str) -> int:
        """One of the stream's own counters, for instance "n_resent_packets"."""
        return int(self._lib.info(self._handle, name.encode()))

    def close(self) -> None:
        """End the library's receive thread; no `pop` may be under way."""
        handle, self._handle = self._handle, None
        if handle:
            self._lib.unref(handle)
