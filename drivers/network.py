"""The network cards of this computer, and what its kernel allows who receives from them. Linux."""

import array
import fcntl
import socket
import struct
from collections.abc import Callable
from ipaddress import IPv4Address, IPv4Interface
from pathlib import Path
from typing import NamedTuple, TypeVar

SIOCGIFCONF, SIOCGIFNETMASK = 0x8912, 0x891B  # linux/sockios.h
ENTRY = struct.Struct("16s4x4s16x")  # struct ifreq: name, and the address within a struct sockaddr_in
MASK = struct.Struct("20x4s16x")
MOST_ENTRIES = 128
CLASS_NET = Path("/sys/class/net")
NET_CORE = Path("/proc/sys/net/core")

T = TypeVar("T")


class Nic(NamedTuple):
    """One address of a network card. None: the card's driver does not tell."""

    name: str
    interface: IPv4Interface
    mtu_bytes: int | None
    link_mbps: int | None
    link: str | None  # "up", "down", "unknown"


class Receiving(NamedTuple):
    """What the kernel allows who receives datagrams."""

    buffer_bytes: int | None  # net.core.rmem_max
    backlog_packets: int | None  # net.core.netdev_max_backlog


def nics() -> list[Nic]:
    """All cards with an IPv4 address, an entry for each address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        return [_nic(any_socket, raw) for raw in _entries(any_socket)]


def nic_towards(address: IPv4Address, known: list[Nic]) -> Nic | None:
    """The card by which datagrams to this address leave; None when there is no way to it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        try:
            any_socket.connect((str(address), 9))  # sends nothing
            ours = IPv4Address(any_socket.getsockname()[0])
        except OSError:
            return None
    return next((nic for nic in known if _owns(nic, ours)), None)


def receiving() -> Receiving:
    """The kernel's limits."""
    return Receiving(_read(NET_CORE / "rmem_max", int), _read(NET_CORE / "netdev_max_backlog", int))


def _owns(nic: Nic, address: IPv4Address) -> bool:
    """The loopback card answers for its whole network."""
    return address == nic.interface.ip or (nic.interface.is_loopback and address in nic.interface.network)


def _entries(any_socket: socket.socket) -> list[bytes]:
    room = array.array("B", bytes(ENTRY.size * MOST_ENTRIES))
    length, address = len(room), room.buffer_info()[0]
    answer = fcntl.ioctl(any_socket, SIOCGIFCONF, struct.pack("iP", length, address))
    (used,) = struct.unpack_from("i", answer)
    return [bytes(room[at : at + ENTRY.size]) for at in range(0, used, ENTRY.size)]


def _nic(any_socket: socket.socket, raw: bytes) -> Nic:
    label, address = ENTRY.unpack(raw)
    (mask,) = MASK.unpack(fcntl.ioctl(any_socket, SIOCGIFNETMASK, raw))
    name = label.partition(b"\0")[0].decode(errors="replace").partition(":")[0]
    folder = CLASS_NET / name
    mbps = _read(folder / "speed", int)
    return Nic(
        name,
        IPv4Interface(f"{IPv4Address(address)}/{IPv4Address(mask)}"),
        _read(folder / "mtu", int),
        mbps if mbps is not None and mbps > 0 else None,
        _read(folder / "operstate", str),
    )


def _read(path: Path, kind: Callable[[str], T]) -> T | None:
    """A value that the kernel shows as a file, or None where it does not."""
    try:
        return kind(path.read_text().strip())
    except (OSError, ValueError):
        return None
