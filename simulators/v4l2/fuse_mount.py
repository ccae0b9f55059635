"""Mounts a file whose every use is answered by us: /dev/fuse, without a library. Root may; others need fusermount3."""

import array
import ctypes
import errno
import os
import select
import shutil
import socket
import subprocess
import threading
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulators.v4l2 import fuse_wire as wire
from simulators.v4l2.fuse_service import FuseService
from simulators.v4l2.port import Port

DEVICE = Path("/dev/fuse")
LARGEST_REQUEST = 1 << 20
NO_SET_UID, NO_DEVICES, DETACH = 0x2, 0x4, 0x2
GONE = (errno.ENODEV, errno.ENOTCONN)
PASSING = (errno.ENOENT, errno.EINTR, errno.EAGAIN)
END_WITHIN_S = 2.0


def why_not() -> str:
    """Why no such file can be mounted here; "" when it can."""
    if not os.access(DEVICE, os.R_OK | os.W_OK):
        return f"{DEVICE} is not there, or not open to this user"
    if os.geteuid() and not shutil.which("fusermount3"):
        return "fusermount3 is missing (Debian package fuse3)"
    return ""


class FuseFile:
    """A file at `path` that behaves as the camera of `port`, from mount() to close()."""

    def __init__(self, port: Port, path: Path) -> None:
        self._port = port
        self.path = path
        self._made = False
        self._error: Exception | None = None

    def mount(self) -> None:
        """Put the file there. Raises OSError that says why it cannot be."""
        if reason := why_not():
            raise OSError(errno.ENODEV, reason)
        self._made = not self.path.exists()
        self.path.touch()
        self._fd = _mounted_by_root(self.path) if os.geteuid() == 0 else _mounted_by_helper(self.path)
        self._changed = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._ending = threading.Event()
        self._service = FuseService(self._port, (os.geteuid(), os.getegid()), self._send)
        self._port.wakes.append(self._wake)
        self._thread = threading.Thread(target=self._serve, name=f"fuse {self.path.name}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Take it away: whoever has it open finds it disconnected. Raises what went wrong while it was served."""
        self._port.wakes.remove(self._wake)
        self._ending.set()
        self._wake()
        self._thread.join(END_WITHIN_S)
        unmount(self.path)
        os.close(self._fd)
        os.close(self._changed)
        if self._made:
            with suppress(OSError):
                self.path.unlink()
        if self._error is not None:
            raise self._error

    def store(self, offset: int, data: NDArray[np.uint8]) -> None:
        """Put bytes into the pages that clients have mapped."""
        length = wire.STORE.size + data.nbytes
        head = wire.notice_head(wire.NOTIFY_STORE, length) + wire.STORE.pack(wire.ROOT, offset, data.nbytes, 0)
        with suppress(OSError):  # nobody has the file open
            os.writev(self._fd, [head, data.data])

    def _wake(self) -> None:
        os.eventfd_write(self._changed, 1)

    def _send(self, data: bytes) -> None:
        try:
            os.write(self._fd, data)
        except OSError as error:
            if error.errno not in (*PASSING, *GONE):  # interrupted, or released meanwhile
                raise

    def _serve(self) -> None:
        try:
            poll = select.poll()
            poll.register(self._fd, select.POLLIN)
            poll.register(self._changed, select.POLLIN)
            while not self._ending.is_set() and self._turn(dict(poll.poll())):
                pass
        except Exception as error:  # shown by close(): a thread has nobody to raise to
            self._error = error

    def _turn(self, ready: dict[int, int]) -> bool:
        """One request and one change at most; False when the file was unmounted by somebody else."""
        if self._changed in ready:
            os.eventfd_read(self._changed)
            self._service.look_again()
        if self._fd not in ready:
            return True
        try:
            self._service.handle(os.read(self._fd, LARGEST_REQUEST))
        except OSError as error:
            if error.errno in GONE:
                return False
            if error.errno not in PASSING:
                raise
        return True


def _mounted_by_root(path: Path) -> int:
    fd = os.open(DEVICE, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    options = f"fd={fd},rootmode=100666,user_id=0,group_id=0,allow_other".encode()
    libc = ctypes.CDLL(None, use_errno=True)
    flags = ctypes.c_ulong(NO_SET_UID | NO_DEVICES)
    if libc.mount(b"cellsim", os.fsencode(path), b"fuse.v4l2", flags, options):
        number = ctypes.get_errno()
        os.close(fd)
        raise OSError(number, f"{path} cannot be mounted: {os.strerror(number)}")
    return fd


def _mounted_by_helper(path: Path) -> int:
    """fusermount3 is setuid root; it hands the open /dev/fuse back over a socket."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    with ours, theirs:
        command = ["fusermount3", "-o", "fsname=cellsim,subtype=v4l2,nosuid,nodev", "--", str(path)]
        environment = {**os.environ, "_FUSE_COMMFD": str(theirs.fileno())}
        done = subprocess.run(command, env=environment, pass_fds=[theirs.fileno()], capture_output=True, check=False)
        if done.returncode:
            raise OSError(errno.EPERM, done.stderr.decode(errors="replace").strip())
        numbers = array.array("i")
        _data, sent, _flags, _address = ours.recvmsg(1, socket.CMSG_LEN(numbers.itemsize))
        numbers.frombytes(sent[0][2][: numbers.itemsize])
    os.set_blocking(numbers[0], False)
    return numbers[0]


def unmount(path: Path) -> None:
    """Take a file away that is mounted there; nothing when none is."""
    if os.geteuid() == 0:
        ctypes.CDLL(None).umount2(os.fsencode(path), DETACH)
    else:
        subprocess.run(["fusermount3", "-u", "-z", str(path)], capture_output=True, check=False)
