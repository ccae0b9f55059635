"""Messages of the FUSE protocol (linux/fuse.h, version 7.31) as far as one file needs them. Pure."""

import errno
from enum import IntEnum
from struct import Struct
from typing import NamedTuple

VERSION = 7, 31
ROOT = 1  # node of the mounted file itself
HEADER = Struct("<2I2Q4I")  # length opcode unique node uid gid pid extensions
REPLY = Struct("<IiQ")  # length error unique
INIT = Struct("<4I")  # major minor readahead flags
INIT_REPLY = Struct("<4I2H2I2H8I")  # ... background congestion, max_write time_gran, max_pages alignment, flags2 unused
ATTRIBUTES = Struct("<Q2I6Q10I")  # valid_s valid_ns unused; inode size blocks, 3 times; 3 x ns mode links uid gid ...
OPEN = Struct("<2I")  # flags of open(2), unused
OPEN_REPLY = Struct("<Q2I")
HANDLE = Struct("<Q")
READ = Struct("<2QI")  # handle offset size ...
IOCTL = Struct("<Q2IQ2I")  # handle flags request argument in_size out_size
IOCTL_REPLY = Struct("<i3I")
POLL = Struct("<2Q2I")  # handle kernel_handle flags events
POLL_REPLY = Struct("<2I")
STORE = Struct("<2Q2I")  # node offset size
STATFS_REPLY = Struct("<5Q4I24x")
KEEP_CACHE = 0x2  # pages that were stored stay when the file is opened again
TELL_LATER = 0x1  # a poll request that wants to be notified
NOTIFY_POLL, NOTIFY_STORE = 1, 4
REGULAR = 0o100000
BLOCK = 4096


class Opcode(IntEnum):
    """Requests of the kernel."""

    FORGET = 2
    GETATTR = 3
    SETATTR = 4
    OPEN = 14
    READ = 15
    WRITE = 16
    STATFS = 17
    RELEASE = 18
    FSYNC = 20
    FLUSH = 25
    INIT = 26
    ACCESS = 34
    INTERRUPT = 36
    DESTROY = 38
    IOCTL = 39
    POLL = 40
    BATCH_FORGET = 42


UNANSWERED = frozenset({Opcode.FORGET, Opcode.INTERRUPT, Opcode.BATCH_FORGET})
SMALLEST_BODY: dict[int, int] = {
    Opcode.INIT: INIT.size,
    Opcode.OPEN: OPEN.size,
    Opcode.READ: READ.size,
    Opcode.RELEASE: HANDLE.size,
    Opcode.INTERRUPT: HANDLE.size,
    Opcode.IOCTL: IOCTL.size,
    Opcode.POLL: POLL.size,
}


class Message(NamedTuple):
    """One request: what, its number for the answer, its body."""

    opcode: int
    unique: int
    body: bytes


def parse(data: bytes) -> Message:
    """Take a request apart; raises ValueError when it is not one, or too short for what it says it is."""
    if len(data) < HEADER.size:
        raise ValueError(f"a request of {len(data)} bytes")
    length, opcode, unique, *_ = HEADER.unpack_from(data)
    if length != len(data):
        raise ValueError(f"a request of {len(data)} bytes that says {length}")
    body = data[HEADER.size :]
    if len(body) < SMALLEST_BODY.get(opcode, 0):
        raise ValueError(f"a request {opcode} with a body of {len(body)} bytes")
    return Message(opcode, unique, body)


def reply(unique: int, body: bytes = b"") -> bytes:
    """A good answer."""
    return REPLY.pack(REPLY.size + len(body), 0, unique) + body


def refusal(unique: int, error: int) -> bytes:
    """An error answer."""
    return REPLY.pack(REPLY.size, -error, unique)


def notice_head(code: int, length: int) -> bytes:
    """The head of something that the kernel did not ask for, with so many bytes to follow."""
    return REPLY.pack(REPLY.size + length, code, 0)


def welcome(body: bytes) -> bytes:
    """The answer to INIT; raises OSError when the kernel speaks another protocol."""
    major, minor, readahead, _flags = INIT.unpack_from(body)
    if (major, minor) < VERSION:
        raise OSError(errno.EPROTO, f"FUSE {major}.{minor}")
    most_write, background = 128 << 10, 12
    return INIT_REPLY.pack(*VERSION, readahead, 0, background, background, most_write, 1, 0, 0, *[0] * 8)


def attributes(size: int, mode: int, owner: tuple[int, int]) -> bytes:
    """Of the one file, valid for an hour."""
    times, nanoseconds = (0, 0, 0), (0, 0, 0)
    rest = (REGULAR | mode, 1, *owner, 0, BLOCK, 0)
    return ATTRIBUTES.pack(3600, 0, 0, ROOT, size, -(-size // 512), *times, *nanoseconds, *rest)
