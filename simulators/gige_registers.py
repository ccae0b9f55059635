"""The memory of a simulated GigE Vision camera as a client sees it, with each register's rules. Pure."""

import ipaddress
from typing import NamedTuple

from simulators import genicam, genicam_chunks
from simulators.genicam import Register
from simulators.gvcp import DO_NOT_FRAGMENT_BIT, PACKET_SIZE_MASK, WORD, Capability, Status

BOOTSTRAP_END = 0x20000


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
