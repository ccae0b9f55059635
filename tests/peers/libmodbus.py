"""libmodbus (C, LGPL, Debian's libmodbus5) as a client, and as a server with a PLC in its memory.

`python -m tests.peers.libmodbus` serves on a free port of 127.0.0.1, which it prints, until it is killed.
"""

import ctypes as c
import os
import socket
from ctypes.util import find_library

from tests.peers import least_plc

FIRST_ERRNO = 112345678  # MODBUS_ENOBASE; exception codes follow
HELD_WORDS = 132


class Mapping(c.Structure):
    """modbus_mapping_t: the server's memory."""

    _fields_ = (
        *((name, c.c_int) for name in ("nb_bits", "start_bits", "nb_input_bits", "start_input_bits")),
        *((name, c.c_int) for name in ("nb_input_words", "start_input_words", "nb_words", "start_words")),
        *((name, c.POINTER(c.c_uint8)) for name in ("bits", "input_bits")),
        *((name, c.POINTER(c.c_uint16)) for name in ("input_words", "words")),
    )


def library():
    """libmodbus, or None where it is not installed."""
    name = find_library("modbus")
    if name is None:
        return None
    found = c.CDLL(name, use_errno=True)
    found.modbus_new_tcp.restype = c.c_void_p
    found.modbus_mapping_new.restype = c.POINTER(Mapping)
    found.modbus_strerror.restype = c.c_char_p
    return found


class Refused(Exception):
    """An exception answer."""

    def __init__(self, code):
        super().__init__(f"exception {code}")
        self.code = code


class Client:
    """A connection. Every call blocks until the answer, for half a second at most."""

    def __init__(self, port, unit=1):
        self._lib = library()
        self._context = c.c_void_p(self._lib.modbus_new_tcp(b"127.0.0.1", port))
        self._lib.modbus_set_slave(self._context, unit)
        self._done(self._lib.modbus_connect(self._context))

    def close(self):
        self._lib.modbus_close(self._context)
        self._lib.modbus_free(self._context)

    def read_bits(self, name, address, count):
        """`name` is bits or input_bits."""
        values = (c.c_uint8 * count)()
        self._call(f"modbus_read_{name}", address, count, values)
        return list(values)

    def read_words(self, name, address, count):
        """`name` is registers or input_registers."""
        values = (c.c_uint16 * count)()
        self._call(f"modbus_read_{name}", address, count, values)
        return list(values)

    def write_bit(self, address, value):
        self._call("modbus_write_bit", address, value)

    def write_word(self, address, value):
        self._call("modbus_write_register", address, value)

    def write_bits(self, address, values):
        self._call("modbus_write_bits", address, len(values), (c.c_uint8 * len(values))(*values))

    def write_words(self, address, values):
        self._call("modbus_write_registers", address, len(values), (c.c_uint16 * len(values))(*values))

    def mask(self, address, and_mask, or_mask):
        self._call("modbus_mask_write_register", address, c.c_uint16(and_mask), c.c_uint16(or_mask))

    def write_and_read(self, write_address, values, read_address, count):
        found = (c.c_uint16 * count)()
        written = (c.c_uint16 * len(values))(*values)
        self._call("modbus_write_and_read_registers", write_address, len(values), written, read_address, count, found)
        return list(found)

    def report_slave_id(self):
        self._call("modbus_report_slave_id", 64, (c.c_uint8 * 64)())

    def _call(self, name, *arguments):
        self._done(getattr(self._lib, name)(self._context, *arguments))

    def _done(self, result):
        if result >= 0:
            return
        number = c.get_errno()
        if FIRST_ERRNO < number <= FIRST_ERRNO + 11:
            raise Refused(number - FIRST_ERRNO)
        raise OSError(number, self._lib.modbus_strerror(number).decode())


def serve():
    """One client after the other; the PLC in the memory works once per request."""
    lib = library()
    context = c.c_void_p(lib.modbus_new_tcp(b"127.0.0.1", 0))
    memory = lib.modbus_mapping_new(0, 0, HELD_WORDS, 0)
    words, query = memory.contents.words, (c.c_uint8 * 260)()
    listening = c.c_int(lib.modbus_tcp_listen(context, 4))
    with socket.socket(fileno=os.dup(listening.value)) as same:
        print(same.getsockname()[1], flush=True)
    while lib.modbus_tcp_accept(context, c.byref(listening)) >= 0:
        while (size := lib.modbus_receive(context, query)) >= 0:
            least_plc.scan(words)
            lib.modbus_reply(context, query, size, memory)
        lib.modbus_close(context)


if __name__ == "__main__":
    serve()
