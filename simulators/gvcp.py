"""GigE Vision control protocol, the camera's end: datagrams to requests and back, and the register memory. Pure.

Layouts are those of the GigE Vision standard: an 8-byte header (key 0x42, flags, command, length, request id), then
addresses and 32-bit values, all big-endian.
"""

import ipaddress
import struct
from enum import IntEnum, IntFlag
from typing import NamedTuple

from simulators import genicam, genicam_chunks
from simulators.genicam import Register

KEY = 0x42
HEADER = struct.Struct(">BBHHH")
ACK_HEADER = struct.Struct(">HHHH")
LONGEST_BODY = 540  # of a datagram of 576 bytes with all its headers
LONGEST_READ = 536  # bytes in one READMEM answer
BOOTSTRAP_END = 0x20000
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
    return ACK_HEADER.pack(status, request.command + 1, len(body), request.number) + body


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


class Identity(NamedTuple):
    """Who the camera says it is."""

    ip: str
    serial: str
    name: str


class Registers:
    """The camera's memory as a client sees it: bootstrap registers, feature registers and the description."""

    def __init__(self, identity: Identity, sensor: tuple[int, int], largest_packet: int) -> None:
        self.table = genicam.registers(sensor, largest_packet)
        self._by_address = {register.address: register for register in self.table.values()}
        self._memory = bytearray(BOOTSTRAP_END)
        self._xml = genicam.zipped(genicam.description(self.table, sensor))
        self.restart()
        self._identify(identity)

    def restart(self) -> None:
        """All settings as after power-on; who the camera is stays as it is."""
        for register in self.table.values():
            self._set(register.address, register.start)

    def _identify(self, identity: Identity) -> None:
        ip = int(ipaddress.IPv4Address(identity.ip))
        capability = Capability.WRITE_MEMORY | Capability.PACKET_RESEND | Capability.PENDING_ACK
        capability |= Capability.CONCATENATION | Capability.SERIAL_NUMBER | Capability.USER_NAME | Capability.ACTION
        capability |= Capability.SWITCHOVER | Capability.CONTROLLER_ADDRESS
        facts = {
            genicam.VERSION: 0x00010002,
            genicam.DEVICE_MODE: 0x80000001,  # big-endian, UTF-8 texts
            genicam.MAC_HIGH: 0x0200,  # a locally administered address, made from the IP address
            genicam.MAC_LOW: ip,
            genicam.IP_CAPABILITY: 0x7,
            genicam.IP_IN_USE: 0x5,
            genicam.CURRENT_IP: ip,
            genicam.CURRENT_MASK: 0xFF000000,
            genicam.INTERFACE_COUNT: 1,
            genicam.CHANNEL_COUNT: 1,
            genicam.ACTION_COUNT: 1,
            genicam.CAPABILITY: int(capability),
            genicam.TICK_RATE_HIGH: 0,
            genicam.TICK_RATE_LOW: genicam.TICKS_PER_S,
        }
        for address, value in facts.items():
            self._set(address, value)
        texts = {
            genicam.VENDOR: ("Cellctl", 32),
            genicam.MODEL: ("CellSim", 32),
            genicam.DEVICE_VERSION: ("1", 32),
            genicam.MAKER_INFO: ("simulated camera", 48),
            genicam.SERIAL: (identity.serial, 16),
            genicam.USER_NAME: (identity.name, 16),
            genicam.XML_URL: (
                f"Local:{genicam.XML_NAME}.zip;{genicam.XML_ADDRESS:x};{len(self._xml):x}",
                512,
            ),
        }
        for address, (text, length) in texts.items():
            self._memory[address : address + length] = _fixed(text.encode(), length)

    def _set(self, address: int, value: int) -> None:
        WORD.pack_into(self._memory, address, value & 0xFFFFFFFF)

    def __getitem__(self, name: str) -> int:
        return int(WORD.unpack_from(self._memory, self.table[name].address)[0])

    def __setitem__(self, name: str, value: int) -> None:
        """Set by the camera itself: no access rule applies."""
        self._set(self.table[name].address, value)

    @property
    def mac(self) -> bytes:
        """The hardware address."""
        return bytes(self._memory[genicam.MAC_HIGH + 2 : genicam.MAC_HIGH + 8])

    def move(self, ip: str, mask: int) -> None:
        """From now on the camera has this address."""
        self._set(genicam.CURRENT_IP, int(ipaddress.IPv4Address(ip)))
        self._set(genicam.CURRENT_MASK, mask)

    def discovery(self) -> bytes:
        """What the answer to a discovery carries."""
        return bytes(self._memory[: genicam.DISCOVERY_END])

    def read(self, address: int, length: int) -> bytes | Status:
        """Bytes from `address` on."""
        if address % 4 or length % 4:
            return Status.BAD_ALIGNMENT
        if address + length <= len(self._memory):
            return bytes(self._memory[address : address + length])
        offset = address - genicam.XML_ADDRESS
        if 0 <= offset < len(self._xml):
            return _fixed(self._xml[offset : offset + length], length)
        return Status.INVALID_ADDRESS

    def write(self, address: int, data: bytes, *, busy: bool) -> Status:
        """Four bytes from a client, if the register there takes them. `busy`: pictures are being taken."""
        value = WORD.unpack(data)[0]
        if genicam.USER_NAME <= address < genicam.USER_NAME + 16 and address % 4 == 0:
            self._set(address, value)
            return Status.OK
        register = self._by_address.get(address)
        if register is None:
            return self._why_not(address)
        if address == genicam.STREAM_PACKET:
            return self._set_packet(register, value)
        status = self._fits(register, value, busy=busy)
        if not status:
            self._set(address, value)
            bits = self["PixelFormat"] >> genicam.BITS_PER_PIXEL & 0xFF
            chunks = genicam_chunks.BYTES if self["ChunkModeActive"] else 0
            self["PayloadSize"] = (self["Width"] * self["Height"] * bits + 7) // 8 + chunks
        return status

    def _set_packet(self, register: Register, value: int) -> Status:
        """A size that the camera does not have becomes the next one below; a client reads back which."""
        size = min(max(value & PACKET_SIZE_MASK, register.low), register.high)
        self._set(register.address, size - (size - register.low) % register.step | value & DO_NOT_FRAGMENT_BIT)
        return Status.OK

    def _why_not(self, address: int) -> Status:
        if address % 4:
            return Status.BAD_ALIGNMENT
        return Status.WRITE_PROTECT if address < len(self._memory) else Status.INVALID_ADDRESS

    def _fits(self, register: Register, value: int, *, busy: bool) -> Status:
        if not register.writable:
            return Status.WRITE_PROTECT
        if register.locked and busy:
            return Status.BUSY
        inside = register.low <= value <= register.high and (value - register.low) % register.step == 0
        inside = inside and (register.only is None or value in register.only)
        return Status.OK if inside and self._region_fits(register, value) else Status.INVALID_PARAMETER

    def _region_fits(self, register: Register, value: int) -> bool:
        for size, offset, whole in (("Width", "OffsetX", "SensorWidth"), ("Height", "OffsetY", "SensorHeight")):
            if register.address in (self.table[size].address, self.table[offset].address):
                other = offset if register.address == self.table[size].address else size
                return value + self[other] <= self[whole]
        return True


def _fixed(data: bytes, length: int) -> bytes:
    return data[:length].ljust(length, b"\0")
