"""GigE Vision control protocol, the camera's end: datagrams to requests and back. Pure.

Layouts are those of the GigE Vision standard: an 8-byte header (key 0x42, flags, command, length, request id), then
addresses and 32-bit values, all big-endian.
"""

import ipaddress
import struct
from enum import IntEnum, IntFlag
from typing import NamedTuple

KEY = 0x42
HEADER = struct.Struct(">BBHHH")
ACK_HEADER = struct.Struct(">HHHH")
LONGEST_BODY = 540  # of a datagram of 576 bytes with all its headers
LONGEST_READ = 536  # bytes in one READMEM answer
WORD = struct.Struct(">I")
TEST_PACKET_BIT, DO_NOT_FRAGMENT_BIT, PACKET_SIZE_MASK = 0x80000000, 0x40000000, 0xFFFF


class Command(IntEnum):
    """What a client may ask."""

    DISCOVERY = 0x0002
    FORCE_IP = 0x0004
    PACKET_RESEND = 0x0040
    READ_REGISTER = 0x0080
    WRITE_REGISTER = 0x0082
    READ_MEMORY = 0x0084
    WRITE_MEMORY = 0x0086
    ACTION = 0x0100
    PENDING = 0x0088  # its answer, 0x0089, asks the client to wait


class Status(IntEnum):
    """What a camera may answer."""

    OK = 0
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    BUSY = 0x8007
    PACKET_UNAVAILABLE = 0x800C
    INVALID_HEADER = 0x800E


class Capability(IntFlag):
    """Bits of the capability register."""

    CONCATENATION = 0x1
    WRITE_MEMORY = 0x2
    PACKET_RESEND = 0x4
    PENDING_ACK = 0x20
    ACTION = 0x40
    SWITCHOVER = 0x00200000
    CONTROLLER_ADDRESS = 0x08000000
    SERIAL_NUMBER = 0x40000000
    USER_NAME = 0x80000000


class Request(NamedTuple):
    """One datagram from a client."""

    command: int
    wants_answer: bool
    number: int
    body: bytes


class Resend(NamedTuple):
    """A client misses packets `first` to `last` of one picture."""

    block: int
    first: int
    last: int


class Action(NamedTuple):
    """Cameras with this device key and group key, and a bit of this mask, are to act."""

    device_key: int
    group_key: int
    group_mask: int


class Forced(NamedTuple):
    """The camera with this MAC address is to have this address and network mask."""

    mac: bytes
    ip: str
    mask: int


def decode(datagram: bytes) -> Request | None:
    """The request in a datagram, or None when it is none."""
    if len(datagram) < HEADER.size:
        return None
    key, flags, command, length, number = HEADER.unpack_from(datagram)
    body = datagram[HEADER.size :]
    if key != KEY or number == 0 or length != len(body) or length > LONGEST_BODY:
        return None
    return Request(command, bool(flags & 1), number, body)


def answer(request: Request, status: Status, body: bytes = b"") -> bytes:
    """The acknowledgement of a request; a refusal has no body."""
    body = b"" if status else body
    return ACK_HEADER.pack(status, request.command + 1 & 0xFFFF, len(body), request.number) + body


def wait_for(request: Request, time_ms: int) -> bytes:
    """The notice that the answer to a request takes up to `time_ms`."""
    return ACK_HEADER.pack(Status.OK, Command.PENDING + 1, 4, request.number) + struct.pack(">HH", 0, time_ms)


def forced(body: bytes) -> Forced | None:
    """The address that a FORCEIP command gives, and to whom; None when the command is malformed."""
    if len(body) != 56:
        return None
    mac, address, mask = struct.unpack(">2x6s12x4s12x4s16x", body)
    return Forced(mac, str(ipaddress.IPv4Address(address)), int.from_bytes(mask, "big"))


def resend(body: bytes) -> Resend | None:
    """The packets that a PACKETRESEND command asks for; None when the command is malformed."""
    if len(body) != 12:
        return None
    channel, block, first, last = struct.unpack(">HHII", body)
    first, last = first & 0xFFFFFF, last & 0xFFFFFF
    return Resend(block, first, last) if channel == 0 and block and first <= last else None


def action(body: bytes) -> Action | None:
    """Whom an ACTION command means; None when the command is malformed."""
    return Action(*struct.unpack(">III", body)) if len(body) == 12 else None


def reads(request: Request) -> list[tuple[int, int]] | None:
    """Address and length of all that a READREG or READMEM asks for; None when the command is malformed."""
    body = request.body
    if request.command == Command.READ_REGISTER:
        whole = bool(body) and len(body) % 4 == 0
        return [(address, 4) for (address,) in WORD.iter_unpack(body)] if whole else None
    if len(body) != 8:
        return None
    address, length = struct.unpack(">IxxH", body)
    return [(address, length)] if 0 < length <= LONGEST_READ else None


def writes(request: Request) -> list[tuple[int, bytes]] | None:
    """Address and bytes of all that a WRITEREG or WRITEMEM brings; None when the command is malformed."""
    body = request.body
    if request.command == Command.WRITE_REGISTER:
        whole = bool(body) and len(body) % 8 == 0
        return [(a, WORD.pack(v)) for a, v in struct.iter_unpack(">II", body)] if whole else None
    if len(body) < 8 or len(body) % 4:
        return None
    address = WORD.unpack_from(body)[0]
    return [(address + at, body[4 + at : 8 + at]) for at in range(0, len(body) - 4, 4)]
