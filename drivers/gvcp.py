"""GigE Vision control protocol as far as a camera is looked for with it: who is there, at which address. Pure.

Layouts are those of the GigE Vision standard (discovery; its answer is the first 248 bytes of the camera's registers).
"""

import ipaddress
import struct
from ipaddress import IPv4Address, IPv4Interface
from typing import NamedTuple

PORT = 3956
KEY, ACK_WANTED, ACK_BY_BROADCAST = 0x42, 0x01, 0x10
DISCOVERY, DISCOVERY_ACK = 0x0002, 0x0003
FORCE_IP, FORCE_IP_ACK = 0x0004, 0x0005
ACK_HEADER = struct.Struct(">HHHH")  # status, command, length, request number
ANSWER_BYTES = 248
MAC_AT, ADDRESS_AT, MASK_AT = 10, 36, 52
VENDOR_AT, MODEL_AT, VERSION_AT, SERIAL_AT, USER_NAME_AT = 72, 104, 136, 216, 232
UNSET = IPv4Address(0)


class Found(NamedTuple):
    """A camera that answered."""

    interface: IPv4Interface  # its address and network mask, as it says
    mac: str
    vendor: str
    model: str
    version: str
    serial: str
    user_name: str

    @property
    def address(self) -> IPv4Address:
        """Where it is."""
        return self.interface.ip


def question(number: int) -> bytes:
    """Who is there? The answer may come by broadcast, so that a camera with a foreign address can be heard."""
    return struct.pack(">BBHHH", KEY, ACK_WANTED | ACK_BY_BROADCAST, DISCOVERY, 0, number)


def force_ip(number: int, mac: str, interface: IPv4Interface) -> bytes:
    """The camera with this MAC address is to have this address and network mask until it is switched off."""
    body = struct.pack(
        ">2x6s12x4s12x4s12x4s",
        bytes.fromhex(mac.replace(":", "")),
        interface.ip.packed,
        interface.netmask.packed,
        UNSET.packed,  # no gateway
    )
    return struct.pack(">BBHHH", KEY, ACK_WANTED, FORCE_IP, len(body), number) + body


def answer(datagram: bytes, number: int) -> Found | None:
    """The camera that answers this question, or None when it is something else, or damaged."""
    if len(datagram) < ACK_HEADER.size + ANSWER_BYTES:
        return None
    status, command, length, its_number = ACK_HEADER.unpack_from(datagram)
    if (status, command, its_number) != (0, DISCOVERY_ACK, number) or length < ANSWER_BYTES:
        return None
    body = datagram[ACK_HEADER.size :]
    address, mask = (ipaddress.IPv4Address(body[at : at + 4]) for at in (ADDRESS_AT, MASK_AT))
    try:
        interface = IPv4Interface(f"{address}/{mask if mask != UNSET else 32}")
    except ValueError:  # no network mask
        return None
    return Found(
        interface,
        body[MAC_AT : MAC_AT + 6].hex(":"),
        _text(body, VENDOR_AT, 32),
        _text(body, MODEL_AT, 32),
        _text(body, VERSION_AT, 32),
        _text(body, SERIAL_AT, 16),
        _text(body, USER_NAME_AT, 16),
    )


def _text(body: bytes, at: int, length: int) -> str:
    """What is before the first zero; a damaged or hostile text must not reach a terminal as it is."""
    text = body[at : at + length].partition(b"\0")[0].decode(errors="replace")
    return "".join(each if each.isprintable() else "?" for each in text).strip()
