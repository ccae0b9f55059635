"""libaravis-0.8 as ctypes sees it: the functions that a GigE Vision driver needs, with their types and errors.

Every call blocks (a control call up to 2.5 s: 5 tries of 500 ms), releases the interpreter lock, and may raise
AravisError. The library is loaded at the first use, so that a cell without such cameras does without it.
"""

import ctypes
from collections.abc import Callable
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_uint32, c_uint64, c_void_p
from functools import cache
from typing import Any

PACKAGE = "libaravis-0.8-0"
SONAME = "libaravis-0.8.so.0"
DOMAIN = "arv-device-error-quark"
NOT_CONNECTED, TIMEOUT, NOT_FOUND, NOT_CONTROLLER, ACCESS_DENIED = 2, 5, 6, 10, 17
NO_LINK = frozenset({NOT_CONNECTED, TIMEOUT, NOT_FOUND, NOT_CONTROLLER, ACCESS_DENIED})  # says nothing of a value


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


class Library:
    """The functions, with their types. Raises LibraryMissing."""

    def __init__(self) -> None:
        try:
            self._arv = ctypes.CDLL(SONAME)
            self._gobject = ctypes.CDLL("libgobject-2.0.so.0")
            self._glib = ctypes.CDLL("libglib-2.0.so.0")
        except OSError as error:
            raise LibraryMissing(f"{error}; install the Debian package {PACKAGE}") from error
        self._declare_gobject()
        self._declare_camera()
        self._declare_features()
        self._declare_device()
        self._declare_stream()

    def _declare_camera(self) -> None:
        p, s, i, u = c_void_p, c_char_p, c_int, c_uint
        self.camera_new = self._checked("camera_new", p, s)
        self.serial = self._checked("camera_get_device_serial_number", c_char_p, p)
        self.set_region = self._checked("camera_set_region", None, p, i, i, i, i)
        self.set_pixel_format = self._checked("camera_set_pixel_format", None, p, c_uint32)
        self.pixel_format = self._checked("camera_get_pixel_format", c_uint32, p)
        self.set_trigger = self._checked("camera_set_trigger", None, p, s)
        self.clear_triggers = self._checked("camera_clear_triggers", None, p)
        self.set_exposure = self._checked("camera_set_exposure_time", None, p, c_double)
        self.exposure = self._checked("camera_get_exposure_time", c_double, p)
        self.set_gain = self._checked("camera_set_gain", None, p, c_double)
        self.gain = self._checked("camera_get_gain", c_double, p)
        self.payload = self._checked("camera_get_payload", u, p)
        self.trigger = self._checked("camera_software_trigger", None, p)
        self.start = self._checked("camera_start_acquisition", None, p)
        self.stop = self._checked("camera_stop_acquisition", None, p)
        self.packet_size = self._checked("camera_gv_get_packet_size", u, p)
        self.packet_delay_ns = self._checked("camera_gv_get_packet_delay", c_int64, p)
        self.set_packet_delay_ns = self._checked("camera_gv_set_packet_delay", None, p, c_int64)
        self.create_stream = self._checked("camera_create_stream", p, p, p, p)
        self.adjust_packet_size = self._plain("camera_gv_set_packet_size_adjustment", None, p, i)
        self.stream_options = self._plain("camera_gv_set_stream_options", None, p, i)
        self.device = self._plain("camera_get_device", p, p)

    def _declare_features(self) -> None:
        p, s = c_void_p, c_char_p
        self.has_feature = self._checked("camera_is_feature_available", c_int, p, s)
        self.integer = self._checked("camera_get_integer", c_int64, p, s)
        self.set_integer = self._checked("camera_set_integer", None, p, s, c_int64)
        self.boolean = self._checked("camera_get_boolean", c_int, p, s)
        self.set_boolean = self._checked("camera_set_boolean", None, p, s, c_int)
        self.text = self._checked("camera_get_string", c_char_p, p, s)
        self.set_text = self._checked("camera_set_string", None, p, s, s)
        self.real = self._checked("camera_get_float", c_double, p, s)
        self.choices = self._checked(
            "camera_dup_available_enumerations_as_strings", POINTER(c_char_p), p, s, POINTER(c_uint)
        )

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
        self.chunk_parser = self._checked("camera_create_chunk_parser", p, p)
        self.chunk_real = self._checked("chunk_parser_get_float_value", c_double, p, p, s)
        self.buffer_new = self._plain("buffer_new", p, c_size_t, p)
        self.buffer_status = self._plain("buffer_get_status", i, p)
        self.buffer_data = self._plain("buffer_get_data", p, p, POINTER(c_size_t))
        self.buffer_kind = self._plain("buffer_get_payload_type", i, p)
        self.buffer_parts = self._plain("buffer_get_n_parts", c_uint, p)
        self.buffer_has_chunks = self._plain("buffer_has_chunks", i, p)
        self.buffer_width = self._plain("buffer_get_image_width", i, p)
        self.buffer_height = self._plain("buffer_get_image_height", i, p)
        self.buffer_format = self._plain("buffer_get_image_pixel_format", c_uint32, p)
        self.buffer_frame = self._plain("buffer_get_frame_id", c_uint64, p)
        self.buffer_time = self._plain("buffer_get_timestamp", c_uint64, p)

    def _declare_gobject(self) -> None:
        self._glib.g_error_free.argtypes = [c_void_p]
        self._glib.g_quark_to_string.argtypes = [c_uint32]
        self._glib.g_quark_to_string.restype = c_char_p
        self.free = self._glib.g_free
        self.free.argtypes, self.free.restype = [c_void_p], None
        self.unref = self._gobject.g_object_unref
        self.unref.argtypes, self.unref.restype = [c_void_p], None
        self._set = self._gobject.g_object_set
        self._set.restype = None

    def set_property(self, thing: int, name: bytes, value: int) -> None:
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
def library() -> Library:
    """The library, loaded at the first call. Raises LibraryMissing."""
    return Library()
