"""A serial port on the running loop: settings and lock by pyserial, reading and writing by the loop."""

import asyncio
import contextlib
import errno
import fcntl
import os
import termios
from collections.abc import Iterator

import serial

from drivers.link_address import SerialAddress

READ_SIZE = 4096
PARITIES = {"none": serial.PARITY_NONE, "odd": serial.PARITY_ODD, "even": serial.PARITY_EVEN}
PSEUDO_TERMINALS = range(136, 144)  # device major numbers


def reason(error: Exception, path: str) -> str:
    """Why a port could not be opened, with the remedy where there is one."""
    inner = (each.args[0] for each in _all(error) if isinstance(each, termios.error))
    number = int(getattr(error, "errno", None) or next(inner, 0))
    remedies = {
        errno.ENOENT: f"there is no {path}: is the adapter plugged in?",
        errno.EACCES: f"{path} may not be used: the service's user must be in the group of the port, usually dialout",
        errno.EBUSY: f"{path} is in use by another program",
        errno.EAGAIN: f"{path} is in use by another program",
        errno.EIO: f"{path} is no serial port that works",
        errno.ENOTTY: f"{path} is no serial port",
    }
    return remedies.get(number, str(error))


def _all(error: BaseException | None) -> Iterator[BaseException]:
    """An error and those that it came from."""
    while error is not None:
        yield error
        error = error.__context__


def _has_no_parity(path: str) -> bool:
    """A pseudo terminal (a line carried over a network, for instance) refuses parity when opened again."""
    return os.major(os.stat(path).st_rdev) in PSEUDO_TERMINALS


class SerialWire:
    """A serial port on the running loop; reads and writes never block. Raises SerialException."""

    def __init__(self, address: SerialAddress, receiver: asyncio.Protocol) -> None:
        self._receiver = receiver
        self._unsent = bytearray()
        self._loop = asyncio.get_running_loop()
        self._port: serial.Serial | None = serial.Serial(
            address.path,
            address.baud,
            parity=PARITIES["none" if _has_no_parity(address.path) else address.parity],
            xonxoff=address.flow == "xonxoff",
            rtscts=address.flow == "rtscts",
            exclusive=True,
            timeout=0,
        )
        fcntl.ioctl(self._port, termios.TIOCEXCL)  # the lock binds only those who ask for it; this binds all but root
        self._port.reset_input_buffer()
        self._fd = self._port.fileno()
        self._loop.add_reader(self._fd, self._readable)

    def write(self, data: bytes) -> None:
        """Send now what the port takes, the rest when it can."""
        if self._port is None:
            return
        # A control byte does not wait behind a line that flow control holds back.
        self._unsent[:] = data + self._unsent if len(data) == 1 else self._unsent + data
        self._writable()

    def get_write_buffer_size(self) -> int:
        """Bytes that the port has not taken."""
        return len(self._unsent)

    def close(self) -> None:
        """Let go; a serial line has nobody to say good-bye to."""
        self._drop(None)

    def abort(self) -> None:
        """The same."""
        self._drop(None)

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(error)
            return
        if data:
            self._receiver.data_received(data)
        else:
            self._drop(None)

    def _writable(self) -> None:
        try:
            sent = os.write(self._fd, self._unsent)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            self._drop(error)
            return
        del self._unsent[:sent]
        if self._unsent:
            self._loop.add_writer(self._fd, self._writable)
        else:
            self._loop.remove_writer(self._fd)

    def _drop(self, why: Exception | None) -> None:
        if self._port is None:
            return
        self._loop.remove_reader(self._fd)
        self._loop.remove_writer(self._fd)
        with contextlib.suppress(termios.error, OSError):  # else closing waits for what flow control holds back
            self._port.reset_output_buffer()
            fcntl.ioctl(self._port, termios.TIOCNXCL)
        self._port.close()
        self._port = None
        self._receiver.connection_lost(why)
